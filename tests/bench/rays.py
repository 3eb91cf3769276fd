"""The part of the sky that points of a mesh see, by rays: what occlusion is held against."""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from treebake.model import AlphaMode, Doubles, Floats, Longs, Mesh

_START = 1e-3  # of the leaf, that a ray starts off its point
_PIECE = 1 << 20  # rays at once


def sky_by_rays(mesh: Mesh, vertices: Longs, thin: NDArray[np.bool_], rays: int, leaf: float, seed: int) -> Doubles:
    """What `rays` random rays per vertex tell, with the cosine's density: (U,) float64.

    vertices: (U,) of the mesh. thin: (U,) bool, those that see on both sides. Rays go on through what is cut out.
    """
    random = np.random.default_rng(seed)
    scene = EmbreeScene()
    TriangleMesh(scene, mesh.positions, mesh.faces)
    seen = np.empty(len(vertices))
    step = max(_PIECE // rays, 1)
    for first in range(0, len(vertices), step):
        some = slice(first, first + step)
        normals = mesh.normals[vertices[some]].astype(np.float64).repeat(rays, axis=0)
        ways = _cosine_rays(normals, thin[some].repeat(rays), random)
        origins = mesh.positions[vertices[some]].astype(np.float64).repeat(rays, axis=0)
        open_ = _pass(scene, mesh, origins, ways, _START * leaf, random)
        seen[some] = open_.reshape(-1, rays).mean(axis=1)
    return seen


def _cosine_rays(normals: Doubles, thin: NDArray[np.bool_], random: np.random.Generator) -> Doubles:
    """Unit directions whose density is the cosine to each normal; of thin ones half go to the other side."""
    ball = random.normal(size=normals.shape)
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    ways = normals * (1 - 1e-9) + ball  # Lambert: the unit sphere that touches the surface
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    back = thin & (random.random(len(thin)) < 0.5)
    return np.where(back[:, None], -ways, ways)


def _pass(
    scene: EmbreeScene, mesh: Mesh, origins: Doubles, ways: Doubles, off: float, random: np.random.Generator
) -> NDArray[np.bool_]:
    """Which rays leave the mesh."""
    leaves = np.ones(len(ways), bool)
    active = np.arange(len(ways))
    at = origins + off * ways
    while len(active):
        hit = scene.run(at.astype(np.float32), ways[active].astype(np.float32), output=True)
        met = hit["primID"] >= 0
        active, at, hit = active[met], at[met], {name: values[met] for name, values in hit.items()}
        stops = _opaque(mesh, hit["primID"], hit["u"], hit["v"], random)
        leaves[active[stops]] = False
        along = hit["tfar"].astype(np.float64)[:, None] + off
        active, at = active[~stops], (at + along * ways[active])[~stops]
    return leaves


def _opaque(
    mesh: Mesh, faces: NDArray[np.int32], u: Floats, v: Floats, random: np.random.Generator
) -> NDArray[np.bool_]:
    """Whether a ray ends where it meets a face: alpha is bilinear, without mips."""
    weights = np.stack([1 - u - v, u, v], axis=1)
    uvs = np.einsum("ni,nij->nj", weights, mesh.uvs[mesh.faces[faces]])
    opaque = np.ones(len(faces), bool)
    for index, material in enumerate(mesh.materials):
        here = np.flatnonzero(mesh.face_material[faces] == index)
        if material.alpha_mode is AlphaMode.OPAQUE or not len(here):
            continue
        alpha = np.full(len(here), material.base_color[3])
        if material.color_map is not None:
            alpha *= _bilinear(material.color_map.pixels[..., 3], uvs[here])
        blend = material.alpha_mode is AlphaMode.BLEND
        opaque[here] = alpha >= (random.random(len(here)) if blend else material.alpha_cutoff)
    return opaque


def _bilinear(values: NDArray[np.uint8], uvs: Doubles) -> Doubles:
    """In 0..1, repeating."""
    height, width = values.shape
    place = uvs * (width, height) - 0.5
    corner = np.floor(place).astype(int)
    x, y = (place - corner).T
    left, top = corner.T
    columns, rows = (np.stack([left, left + 1]) % width, np.stack([top, top + 1]) % height)
    a, b = (values[row, columns] / 255 for row in rows)
    return np.asarray((1 - y) * ((1 - x) * a[0] + x * a[1]) + y * ((1 - x) * b[0] + x * b[1]))
