"""Tubes for tests, made as generators make them: a grid of rings, with the texture's seam twice."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from treebake.model import Doubles, Floats, Leaves, Material, Mesh, Tree

BARK = Material("bark")
LEAF = Material("leaf", double_sided=True)


def mesh_of(positions: Floats, faces: Sequence[Sequence[int]] | Doubles, uvs: Doubles | None = None) -> Mesh:
    """A mesh of one material with the faces' own normals, averaged at each vertex."""
    points = np.asarray(positions, np.float32).reshape(-1, 3)
    index = np.asarray(faces, np.int32).reshape(-1, 3)
    normals = np.zeros_like(points)
    sides = np.cross(points[index[:, 1]] - points[index[:, 0]], points[index[:, 2]] - points[index[:, 0]])
    for corner in range(3):
        np.add.at(normals, index[:, corner], sides)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        positions=points,
        normals=normals / np.where(length > 0, length, 1),
        uvs=np.zeros((len(points), 2), np.float32) if uvs is None else np.asarray(uvs, np.float32),
        faces=index,
        face_material=np.zeros(len(index), np.int32),
        face_node=np.zeros(len(index), np.int32),
        materials=(BARK,),
        nodes=("tree",),
    )


def stem(
    *,
    radii: Sequence[float] = (0.1, 0.1, 0.1),
    sides: int = 8,
    length: float = 2.0,
    bend: float = 0.0,
    capped: bool = False,
    mirrored: bool = False,
    flip_sections: bool = False,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Mesh:
    """An upright tube of evenly spaced rings, open at its base; a last radius of 0 makes a pointed tip.

    bend: sideways shift of the middle. mirrored: the texture runs around and back. flip_sections: v is 0, 1, 0, 1 ...
    """
    rings = len(radii)
    height = np.linspace(0, 1, rings)
    turn = np.linspace(0, 2 * np.pi, sides + 1)
    turn[-1] = 0  # exactly, as a tube closes
    u = np.linspace(0, 1, sides + 1)
    around = np.stack([np.sin(turn), np.zeros(sides + 1), np.cos(turn)], axis=1)
    center = np.stack([bend * np.sin(np.pi * height), length * height, np.zeros(rings)], axis=1) + at
    positions = np.round(center[:, None] + np.asarray(radii)[:, None, None] * around, 6)
    v = np.arange(rings) % 2 if flip_sections else np.arange(rings)
    uvs = np.stack(np.broadcast_arrays(1 - abs(2 * u - 1) if mirrored else u, v[:, None]), axis=-1)
    faces = []
    for ring in range(rings - 1):
        for side in range(sides):
            a = ring * (sides + 1) + side
            b = a + sides + 1
            faces += [(a, a + 1, b), (a + 1, b + 1, b)]
    if radii[-1] == 0:
        faces = [face for face in faces if sum(vertex >= (rings - 1) * (sides + 1) for vertex in face) < 2]
    tube = replace(
        mesh_of(positions, faces, uvs.reshape(-1, 2)), normals=np.tile(around, (rings, 1)).astype(np.float32)
    )
    fan = [(0, side, side + 1) for side in range(1, sides - 1)]
    return together(tube, mesh_of(positions[-1], fan)) if capped else tube


def together(*meshes: Mesh) -> Mesh:
    """Meshes of the same materials as one."""
    offset = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    return Mesh(
        positions=np.concatenate([mesh.positions for mesh in meshes]),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        uvs=np.concatenate([mesh.uvs for mesh in meshes]),
        faces=np.concatenate([mesh.faces + np.int32(o) for mesh, o in zip(meshes, offset, strict=False)]),
        face_material=np.concatenate([mesh.face_material for mesh in meshes]),
        face_node=np.concatenate([mesh.face_node for mesh in meshes]),
        materials=meshes[0].materials,
        nodes=meshes[0].nodes,
    )


def flat_shaded(mesh: Mesh) -> Mesh:
    """The same faces, no two of which share a vertex."""
    points = mesh.positions[mesh.faces]
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return Mesh(
        positions=points.reshape(-1, 3),
        normals=np.repeat(normal, 3, axis=0).astype(np.float32),
        uvs=mesh.uvs[mesh.faces].reshape(-1, 2),
        faces=np.arange(3 * len(points), dtype=np.int32).reshape(-1, 3),
        face_material=mesh.face_material,
        face_node=mesh.face_node,
        materials=mesh.materials,
        nodes=mesh.nodes,
    )


def sphere(rounds: int = 4) -> Mesh:
    """A closed solid without a grid: an octahedron, split and blown up."""
    points = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]], np.float64)
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(rounds):
        a, b, c = (points[faces[:, i]] for i in range(3))
        corners = np.concatenate(
            [
                np.stack(three, axis=1)
                for three in ((a, a + b, c + a), (a + b, b, b + c), (c + a, b + c, c), (a + b, b + c, c + a))
            ]
        )
        corners /= np.linalg.norm(corners, axis=2, keepdims=True)
        points, index = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
        faces = index.reshape(-1, 3)
    return mesh_of(points.astype(np.float32), faces)


def empty() -> Mesh:
    """No face and no vertex."""
    return mesh_of(np.zeros((0, 3), np.float32), [])


def tree_of(trunk: Mesh, leaves: int = 3) -> Tree:
    """A tree with that trunk and one-triangle leaves of 0.2 in size in a row above it."""
    center = np.stack([np.arange(leaves), np.full(leaves, 3.0), np.zeros(leaves)], axis=1)
    corners = np.array([[-0.1, -0.05, 0], [0.1, -0.05, 0], [0, 0.1, 0]])
    positions = (center[:, None] + corners).reshape(-1, 3)
    foliage = mesh_of(positions, np.arange(3 * leaves))
    foliage = replace(foliage, materials=(LEAF,), nodes=("leaves",))
    found = Leaves(
        face_leaf=np.arange(leaves, dtype=np.int32),
        centers=center,
        normals=np.tile([0.0, 0.0, 1.0], (leaves, 1)),
        areas=np.full(leaves, 0.015),
        radii=np.full(leaves, np.hypot(0.1, 0.05)),
        axes=np.zeros((leaves, 3)),
        shape=np.zeros(leaves, np.int32),
        exemplars=np.zeros(min(leaves, 1), np.int32),
        transforms=np.concatenate([np.tile(np.eye(3), (leaves, 1, 1)), (center - center[:1])[:, :, None]], axis=2),
    )
    return Tree(trunk=trunk, foliage=foliage, leaves=found, decisions=())
