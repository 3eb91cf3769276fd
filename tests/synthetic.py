"""Small meshes and views made by hand, for the tests of drawing and of the verifier."""

import numpy as np

from treebake.gl.view import View
from treebake.model import Material, Mesh, Texture

# Seen from +Z without perspective: x and y in -1..1 fill the picture.
FRONT = View(np.diag([1.0, 1.0, -1.0, 1.0]), 8, 0.0, 2.0)
BACK = View(np.diag([-1.0, 1.0, 1.0, 1.0]), 8, 0.0, 2.0)

SUN_DIRECTION = np.array([0.5, 0.8, 0.35]) / np.linalg.norm([0.5, 0.8, 0.35])
SUN, SKY, GROUND = np.array([[1.25, 1.15, 1.0], [0.45, 0.52, 0.62], [0.22, 0.20, 0.16]])
SOFTNESS = 0.5  # of pictures


def lit(albedo: object, normal: object, softness: float = 0.0) -> np.ndarray:
    """The readable twin of lighting.glsl: linear colour of a surface."""
    n = np.asarray(normal, np.float64) / np.linalg.norm(np.asarray(normal))
    sun = n @ SUN_DIRECTION
    light = SUN * (sun + np.hypot(sun, softness)) / 2 + GROUND + (SKY - GROUND) * (0.5 + 0.5 * n[1])
    return np.minimum(np.asarray(albedo) * light, 1.0)


def quad(
    material: Material,
    *,
    x: tuple[float, float] = (-1.0, 1.0),
    y: tuple[float, float] = (-1.0, 1.0),
    z: float = 0.0,
    uvs: object = ((0, 1), (1, 1), (1, 0), (0, 0)),
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0),
) -> Mesh:
    """A rectangle that faces +Z, its picture upright: corners from the lower left, counter-clockwise."""
    corners = [(x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z)]
    return Mesh(
        positions=np.array(corners, np.float32),
        normals=np.tile(np.array(normal, np.float32), (4, 1)),
        uvs=np.array(uvs, np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        face_material=np.zeros(2, np.int32),
        face_node=np.zeros(2, np.int32),
        materials=(material,),
        nodes=("quad",),
    )


def joined(*meshes: Mesh) -> Mesh:
    """Several meshes as one, each with its own materials and nodes."""

    def shifted(arrays: list[np.ndarray], sizes: list[int]) -> np.ndarray:
        starts = np.cumsum([0, *sizes[:-1]])
        return np.concatenate([a + start for a, start in zip(arrays, starts, strict=True)]).astype(np.int32)

    return Mesh(
        positions=np.concatenate([m.positions for m in meshes]),
        normals=np.concatenate([m.normals for m in meshes]),
        uvs=np.concatenate([m.uvs for m in meshes]),
        faces=shifted([m.faces for m in meshes], [len(m.positions) for m in meshes]),
        face_material=shifted([m.face_material for m in meshes], [len(m.materials) for m in meshes]),
        face_node=shifted([m.face_node for m in meshes], [len(m.nodes) for m in meshes]),
        materials=tuple(material for m in meshes for material in m.materials),
        nodes=tuple(node for m in meshes for node in m.nodes),
    )


def texture(pixels: object, alpha: int = 255) -> Texture:
    """From (h, w, 3) or (h, w, 4) values in 0..255."""
    array = np.asarray(pixels, np.uint8)
    if array.shape[2] == 3:
        array = np.concatenate([array, np.full((*array.shape[:2], 1), alpha, np.uint8)], axis=2)
    return Texture("made", array)


def small_tree() -> Mesh:
    """A brown trunk (node 0, material 0) with three green leaves, a few units tall."""
    leaf = Material("leaf", base_color=(0.1, 0.5, 0.1, 1.0), double_sided=True)
    bark = Material("bark", base_color=(0.3, 0.2, 0.1, 1.0), double_sided=True)
    return joined(
        quad(bark, x=(-0.1, 0.1), y=(0.0, 2.0)),
        quad(leaf, x=(-0.8, -0.1), y=(1.0, 1.6)),
        quad(leaf, x=(0.1, 0.9), y=(1.3, 2.1), z=0.2),
        quad(leaf, x=(-0.4, 0.4), y=(1.9, 2.4), z=-0.3),
    )
