"""Gives a simplified trunk maps of what the full one looks like ([GPSS07] 5.2).

Bark that the source repeats stays as it is, since a map of the whole trunk would blur it, and so does bark that lets
light through, which one opaque material cannot show; then only the light that reaches it is baked, over texture
coordinates of its own. All else is unwrapped and gets one material.
"""

from dataclasses import dataclass, replace

import numpy as np

from treebake.checks import check, is_power_of_two
from treebake.images import color_texels, normal_texels
from treebake.model import AlphaMode, Bytes, Doubles, Floats, MappedTrunk, Material, Mesh, Texture, TrunkMaps
from treebake.stages.trunk_maps.source import (
    source_colors,
    source_normals,
    source_occlusion,
    source_roughness,
    used_materials,
)
from treebake.stages.trunk_maps.texels import Texels, find_texels
from treebake.stages.trunk_maps.tiling import tiled_density
from treebake.unwrap import Unwrapped, unwrap

_PIXEL = 2.0  # texels of a pixel
_SMOOTH = 4.0  # how much coarser a map of occlusion alone is: light does not change within a few texels
_FLAT = 1.5 / 255  # a tangent-space normal that is nowhere farther from straight has no map


@dataclass(frozen=True)
class TrunkMapSettings:
    """The maps of trunks.

    Measured, FLIP over floor(1 px) at 512 pixels without maps and with sizes of 256, 512, 1024, and bytes of the normal
    map: a birch of 9,400 triangles 0.993, 0.997, 0.997, 0.996 (0.14, 0.44, 1.2 MB), a palm of 2,359 0.322, 0.272,
    0.272, 0.272 (0.06, 0.14, 0.14 MB).
    """

    enabled: bool = True  # bake maps of the full trunk for the simplified one; false: it stores no occlusion
    size: int = 512  # greatest side of a map, texels, a power of two, 16 to 4096
    height: int = 512  # pixels of the trunk's greatest extent that a map is fine enough for, 16 to 4096


def trunk_maps(
    simple: Mesh, given: Mesh, full: Mesh, finest: TrunkMaps | None, settings: TrunkMapSettings
) -> MappedTrunk:
    """Bake the colour, normals, occlusion and roughness of `full` for `simple`.

    given: what simple was simplified from, full without the twigs that moved; as many triangles: it was not. finest: of
    the tree's finest level, None where this is it; the source's textures are compared with a map of that level, so that
    a tree's levels do not differ in it.

    "tiled": full repeats its textures, which are finer than a map that uses each texel once, or is not opaque, or was
    not simplified; materials, texture coordinates and maps stay, and where occlusion is known it goes into one map over
    `occlusion_uvs`. Not opaque is a material with an alpha below 1 that counts, in its factor or anywhere in its map,
    or with a transmission. "unique": one opaque material, with the maps that say more than its factors do. "none": it
    is switched off, or there is no trunk. Faces without area are left out. Raises SettingsError and GraphicsError.
    """
    rules = (
        ("size", is_power_of_two(settings.size, 16, 4096), "a power of two, 16 to 4096"),
        ("height", 16 <= settings.height <= 4096, "16 to 4096"),
    )
    check("trunk_maps", settings, rules)
    kept, source = (mesh.select(mesh.face_areas > 0) for mesh in (simple, full))
    if not settings.enabled or not kept.triangles or not source.triangles:
        return MappedTrunk(simple, TrunkMaps("none"))
    wanted = _PIXEL * settings.height / float(np.ptp(source.bounds, axis=0).max())
    charts = unwrap(kept, wanted, settings.size)
    tiled = tiled_density(source)
    density = finest.density if finest and finest.density else charts.density
    if tiled > density or simple.triangles == given.triangles or not all(map(_is_opaque, used_materials(source))):
        maps = TrunkMaps("tiled", tiled, charts.density)
        if not _has_occlusion(source):
            return MappedTrunk(simple, maps)
        return MappedTrunk(_with_occlusion(kept, source, unwrap(kept, wanted / _SMOOTH, settings.size)), maps)
    return MappedTrunk(_with_maps(kept, source, charts), TrunkMaps("unique", tiled, charts.density))


def _is_opaque(material: Material) -> bool:
    clear = material.base_color[3] < 1 or (material.color_map is not None and material.color_map.has_alpha)
    return material.transmission is None and not (clear and material.alpha_mode is not AlphaMode.OPAQUE)


def _has_occlusion(source: Mesh) -> bool:
    return source.occlusion is not None or any(material.occlusion_map for material in used_materials(source))


def _with_occlusion(mesh: Mesh, source: Mesh, charts: Unwrapped) -> Mesh:
    """The mesh as it is, with the source's occlusion in a map."""
    cut = _cut(mesh, charts)
    texels = find_texels(cut, charts.uvs, charts.size, charts.density, source)
    seen = _texture("trunk_occlusion", texels.spread(np.repeat(source_occlusion(source, texels)[:, None], 3, axis=1)))
    return replace(
        cut,
        occlusion_uvs=charts.uvs,
        materials=tuple(replace(material, occlusion_map=seen) for material in mesh.materials),
    )


def _with_maps(mesh: Mesh, source: Mesh, charts: Unwrapped) -> Mesh:
    """The mesh with one material, whose maps are baked from the source."""
    cut = _cut(mesh, charts)
    texels = find_texels(cut, charts.uvs, charts.size, charts.density, source)
    used = used_materials(source)
    material = Material("trunk", double_sided=any(each.double_sided for each in used))
    base_color, *others = {each.base_color for each in used}
    if others or any(each.color_map for each in used):
        material = replace(material, color_map=_color_map(source, texels))
    else:
        material = replace(material, base_color=base_color)
    material = replace(material, normal_map=_normal_map(source, texels))
    material = _with_surface(material, source, texels)
    return replace(
        cut, uvs=charts.uvs, face_material=np.zeros(cut.triangles, np.int32), materials=(material,), occlusion_uvs=None
    )


def _cut(mesh: Mesh, charts: Unwrapped) -> Mesh:
    """The mesh with its vertices doubled where charts end."""
    return replace(
        mesh,
        positions=mesh.positions[charts.vertices],
        normals=mesh.normals[charts.vertices],
        uvs=mesh.uvs[charts.vertices],
        faces=charts.faces,
        morph=mesh.morph and mesh.morph[charts.vertices],
        occlusion=None,
    )


def _color_map(source: Mesh, texels: Texels) -> Texture:
    return _opaque("trunk_color", color_texels(texels.image(source_colors(source, texels))))


def _normal_map(source: Mesh, texels: Texels) -> Texture | None:
    """In tangent space; None where it is flat."""
    axes = texels.frame.axes
    bumps: Doubles = np.einsum("nij,nj->ni", axes, source_normals(source, texels))
    bumps[~axes[:, 0].any(axis=1)] = 0, 0, 1  # there the shader takes no notice of it
    if not (np.abs(bumps[:, :2]) > _FLAT).any():
        return None
    sheet = texels.image(bumps)
    return Texture("trunk_normal", normal_texels(sheet[..., :3], sheet[..., 3]))


def _with_surface(material: Material, source: Mesh, texels: Texels) -> Material:
    """With one image of occlusion (R), roughness (G) and metal (B), as far as they say more than factors."""
    used = used_materials(source)
    factors, *others = {(each.roughness, each.metallic) for each in used}
    rough = bool(others) or any(each.roughness_map for each in used)
    if not rough:
        material = replace(material, roughness=factors[0], metallic=factors[1])
    if not rough and not _has_occlusion(source):
        return material
    channels = np.repeat(source_occlusion(source, texels)[:, None], 3, axis=1)
    if rough:
        channels[:, 1:] = source_roughness(source, texels)
    image = _texture("trunk_surface", texels.spread(channels))
    if rough:
        material = replace(material, roughness_map=image, roughness=1.0, metallic=1.0)
    return replace(material, occlusion_map=image) if _has_occlusion(source) else material


def _texture(name: str, values: Floats) -> Texture:
    """A linear image (h, w, 3) in 0..1 as a texture."""
    return _opaque(name, np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8))


def _opaque(name: str, texels: Bytes) -> Texture:
    return Texture(name, np.dstack([texels, np.full(texels.shape[:2], 255, np.uint8)]))
