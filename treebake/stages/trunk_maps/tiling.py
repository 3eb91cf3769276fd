"""Tells whether a mesh repeats its textures, and how fine that makes them."""

import numpy as np

from treebake.gl.uv_bake import face_texels
from treebake.model import Floats, Mesh

_RASTER = 256  # texels by which the part of a texture that is used is measured
_OUTSIDE = 0.01  # of a tile; as far may a texture coordinate be off by filtering
_OVERLAP = 1.1  # of the used part: more texture area than that is used twice


def tiled_density(mesh: Mesh) -> float:
    """The texels of textures that a unit of length has, where they repeat or are used more than once.

    It is the root of texels over area; 0 where no material has a texture, or each texel of it is used once at most.
    """
    texels = area = 0.0
    for index in np.unique(mesh.face_material).tolist():
        material, mask = mesh.materials[index], mesh.face_material == index
        maps = [each for each in (material.color_map, material.normal_map, material.roughness_map) if each is not None]
        uv_area = _uv_area(mesh.uvs[mesh.faces[mask]])
        if maps and uv_area > 0 and _repeats(mesh, mask, uv_area):
            texels += uv_area * max(each.pixels[..., 0].size for each in maps)
            area += float(mesh.face_areas[mask].sum())
    return float(np.sqrt(texels / area)) if area else 0.0


def _repeats(mesh: Mesh, mask: np.ndarray, uv_area: float) -> bool:
    uvs = mesh.uvs[mesh.faces[mask]]
    if uvs.min() < -_OUTSIDE or uvs.max() > 1 + _OUTSIDE or uv_area > 1:
        return True
    covered = len(face_texels(mesh.uvs, mesh.faces[mask], _RASTER)[0]) / _RASTER**2
    return uv_area > _OVERLAP * covered


def _uv_area(corners: Floats) -> float:
    """The area (F, 3, 2) of faces on the texture, in tiles."""
    d1, d2 = ((corners[:, end] - corners[:, 0]).astype(np.float64) for end in (1, 2))
    return float(np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]).sum() / 2)
