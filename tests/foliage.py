"""Leaves made by hand: one textured quad each, all arrays read-only so that a stage that writes into them fails."""

from dataclasses import fields
from typing import Any

import numpy as np
from stems import empty

from treebake.flatten import plane_frames
from treebake.model import AlphaMode, Clusters, Doubles, Leaves, Material, Mesh, Texture, Tree

GREEN = Material("leaf", base_color=(0.1, 0.5, 0.1, 1.0), double_sided=True)


def painted() -> Material:
    """A leaf whose picture has no symmetry: red above green, blue to the right, cut to a disc, black where clear."""
    v, u = (np.mgrid[:64, :64] + 0.5) / 64
    pixels = np.zeros((64, 64, 4), np.uint8)
    pixels[..., 0] = np.where(v < 0.4, 220, 60)
    pixels[..., 1] = np.where(v < 0.4, 60, 200)
    pixels[..., 2] = np.where(u > 0.6, 200, 30)
    inside = np.hypot(u - 0.5, v - 0.5) < 0.45
    pixels[~inside] = 0
    pixels[inside, 3] = 255
    return Material("painted", color_map=Texture("painted", pixels), alpha_mode=AlphaMode.MASK, double_sided=True)


PAINTED = painted()


def frozen(value: Any) -> Any:
    """The same dataclass with its arrays, and those of dataclasses in it, made read-only."""
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, np.ndarray):
            part.flags.writeable = False
        elif isinstance(part, (Mesh, Leaves)):
            frozen(part)
    return value


def leaves_at(
    centers: object, normals: object = (0.0, 0.0, 1.0), *, radius: float = 0.1, axes: object | None = None
) -> Leaves:
    """Leaves without a mesh: squares whose corners are `radius` away from their centres. normals: one each, or one."""
    p = np.array(centers, np.float64).reshape(-1, 3)
    n = np.broadcast_to(np.array(normals, np.float64), p.shape).copy()
    count = len(p)
    return frozen(
        Leaves(
            face_leaf=np.arange(count, dtype=np.int32).repeat(2),
            centers=p,
            normals=n / np.linalg.norm(n, axis=1, keepdims=True),
            areas=np.full(count, 2 * radius**2),
            radii=np.full(count, float(radius)),
            axes=np.zeros_like(p) if axes is None else np.broadcast_to(np.array(axes, np.float64), p.shape).copy(),
            shape=np.zeros(count, np.int32),
            exemplars=np.zeros(min(count, 1), np.int32),
            transforms=np.concatenate([np.tile(np.eye(3), (count, 1, 1)), (p - p[:1])[:, :, None]], axis=2),
        )
    )


def leaf_tree(
    centers: object,
    normals: object = (0.0, 0.0, 1.0),
    *,
    size: float = 0.2,
    material: Material = GREEN,
    shading: object | None = None,
    uvs: object = ((0, 1), (1, 1), (1, 0), (0, 0)),
    axes: object | None = None,
) -> Tree:
    """A tree without a trunk: square leaves of side `size`, upright in their planes.

    shading: the vertices' normal, one or one each, where it is not the leaf's. axes: see `leaves_at`.
    """
    leaves = leaves_at(centers, normals, radius=size / np.sqrt(2), axes=axes)
    frames = plane_frames(leaves.normals)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * size / 2
    positions = leaves.centers[:, None] + np.einsum("ka,nai->nki", corners, frames[:, :2])
    quads = np.arange(leaves.count)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]])
    shaded = leaves.normals if shading is None else np.broadcast_to(np.array(shading), leaves.normals.shape)
    mesh = Mesh(
        positions=positions.reshape(-1, 3).astype(np.float32),
        normals=shaded.repeat(4, axis=0).astype(np.float32),
        uvs=np.tile(np.array(uvs, np.float32), (leaves.count, 1)),
        faces=quads.reshape(-1, 3).astype(np.int32),
        face_material=np.zeros(2 * leaves.count, np.int32),
        face_node=np.zeros(2 * leaves.count, np.int32),
        materials=(material,),
        nodes=("leaves",),
    )
    return frozen(Tree(trunk=empty(), foliage=mesh, leaves=leaves, decisions=()))


def planes(labels: object, normals: object, offsets: object) -> Clusters:
    """Clusters given by hand."""
    return frozen(
        Clusters(
            labels=np.array(labels, np.int32),
            normals=np.array(normals, np.float64).reshape(-1, 3),
            offsets=np.array(offsets, np.float64).reshape(-1),
        )
    )


def rotation(seed: int) -> Doubles:
    """A random proper rotation: (3, 3)."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def random_leaves(seed: int, count: int, *, spread: float = 1.0, radius: float = 0.1) -> Leaves:
    """Leaves facing anywhere in a cube of side 2 `spread`."""
    random = np.random.default_rng(seed)
    return leaves_at(random.uniform(-spread, spread, (count, 3)), random.normal(size=(count, 3)), radius=radius)
