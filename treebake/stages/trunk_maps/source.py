"""Looks up the maps of a source where texels of a new one need them."""

from collections.abc import Callable, Iterator

import numpy as np

from treebake.images import bilinear, mip_chain
from treebake.model import Doubles, Floats, Longs, Material, Mesh, Texture
from treebake.stages.trunk_maps.texels import Texels, blended, frame_at


def used_materials(mesh: Mesh) -> list[Material]:
    """The materials that faces use."""
    return [mesh.materials[index] for index in np.unique(mesh.face_material)]


def source_colors(source: Mesh, texels: Texels) -> Doubles:
    """(T, 3) linear colour, factors and maps."""
    colors = _looked_up(source, texels, lambda material: material.color_map, source.uvs, srgb=True)
    factors: Doubles = np.array([material.base_color[:3] for material in source.materials])
    return colors * factors[_material(source, texels)]


def source_occlusion(source: Mesh, texels: Texels) -> Doubles:
    """(T,) the part of the sky that is seen: what vertices see times what maps say."""
    uvs = source.uvs if source.occlusion_uvs is None else source.occlusion_uvs
    seen = _looked_up(source, texels, lambda material: material.occlusion_map, uvs, srgb=False)[:, 0]
    if source.occlusion is None:
        return seen
    return seen * blended(source.occlusion[source.faces][..., None], texels.face, texels.weights)[:, 0]


def source_roughness(source: Mesh, texels: Texels) -> Doubles:
    """(T, 2) roughness and metal, factors and maps."""
    maps = _looked_up(source, texels, lambda material: material.roughness_map, source.uvs, srgb=False)[:, 1:]
    factors: Doubles = np.array([(material.roughness, material.metallic) for material in source.materials])
    return maps * factors[_material(source, texels)]


def source_normals(source: Mesh, texels: Texels) -> Doubles:
    """(T, 3) unit normals in the mesh's frame: interpolated ones, bumped by the normal maps."""
    frame = frame_at(source, source.uvs, texels.face, texels.weights)
    bumps = _looked_up(source, texels, lambda material: material.normal_map, source.uvs, srgb=False) * 2 - 1
    bare = np.array([material.normal_map is None for material in source.materials])[_material(source, texels)]
    bumps[bare] = 0, 0, 1
    normals = np.einsum("ni,nij->nj", bumps, frame.axes)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-6, normals / np.maximum(length, 1e-6), frame.normals)


def _material(source: Mesh, texels: Texels) -> Longs:
    return np.asarray(source.face_material[texels.face], np.int64)


def _looked_up(
    source: Mesh, texels: Texels, choose: Callable[[Material], Texture | None], uvs: Floats, *, srgb: bool
) -> Doubles:
    """(T, 3) of the chosen maps, white where a material has none, in mips that match the texels' density."""
    found, material = np.ones((len(texels.face), 3)), _material(source, texels)
    places = blended(uvs[source.faces], texels.face, texels.weights)
    for index, texture in _chosen(source, choose):
        rows = np.flatnonzero(material == index)
        chain = mip_chain(texture.pixels, srgb=srgb)
        height, width = texture.pixels.shape[:2]
        corners = uvs[source.faces[texels.face[rows]]].astype(np.float64) * (width, height)
        d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2 / source.face_areas[texels.face[rows]]
        mips = np.rint(np.log2(np.maximum(area, 1e-30)) / 2 - np.log2(texels.density))
        mips = np.clip(mips, 0, len(chain) - 1).astype(np.int64)
        for mip in np.unique(mips):
            those = rows[mips == mip]
            found[those] = bilinear(chain[mip], places[those], srgb=srgb)
    return found


def _chosen(source: Mesh, choose: Callable[[Material], Texture | None]) -> Iterator[tuple[int, Texture]]:
    for index in np.unique(source.face_material).tolist():
        texture = choose(source.materials[index])
        if texture is not None:
            yield index, texture
