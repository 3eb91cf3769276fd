"""Write a baked tree as files: NAME_LOD0.glb, NAME.glb and the like, textures/ and manifest.json."""

import logging
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from treebake import __version__
from treebake.asset.indirect import IMAGES, TABLES, indirect_bytes, indirect_extras
from treebake.asset.manifest import (
    FORMAT,
    Image,
    Indirect,
    Ladder,
    Level,
    Manifest,
    Picture,
    SlicingsEntry,
    Source,
    TranslucencyEntry,
    ViewsEntry,
    screen_coverage,
)
from treebake.asset.pictures import ATLAS, atlas_bytes, views_names, write_slicings, write_views
from treebake.asset.read import files_of
from treebake.errors import WorkspaceError
from treebake.files import atomic
from treebake.glb import Node, write_glb
from treebake.images import encode_floats, encode_png, encode_texture
from treebake.model import (
    BakedLevel,
    BakedTree,
    Impostor,
    IndirectTextures,
    Mesh,
    PictureAtlas,
    SlicedFoliage,
    Texture,
    Views,
)

LOG = logging.getLogger("treebake")

SHARED = "shared_views"  # folder and file of the views of trees that share an atlas


def write_asset(tree: BakedTree, folder: Path, shared: Path | None = None, ladder: Ladder | None = None) -> Manifest:
    """Write every file of the asset into `folder`, each atomically, the manifest last.

    shared: the file that `write_shared_views` wrote the tree's views into, relative to the folder; without it they get
    a file of their own. ladder: what was measured of it.
    Raises WorkspaceError where a file cannot be written, or where there is nothing to write.
    """
    finest = BakedLevel(tree.cloud, tree.trunk, 0, trunk_maps=tree.trunk_maps)
    if not _nodes(finest):
        raise WorkspaceError(f"{tree.name} has neither foliage nor trunk left; there is nothing to publish")
    # A level reaches down to where the next one begins, which is measured or else what that was made for.
    drawn_from = ladder.level_heights if ladder else (*(level.height for level in tree.levels), 0)
    levels, images = [], []
    for number, (level, height) in enumerate(zip((finest, *tree.levels), drawn_from, strict=True)):
        levels.append(_write_level(folder / f"{tree.name}_LOD{number}.glb", level, height))
        prefix = f"{tree.name}_LOD{number}" if number else tree.name
        maps = _maps(level.cloud.mesh) + _trunk_maps(level)
        images += [_write_image(folder, prefix, texture, space) for texture, space in maps]
    full = folder / f"{tree.name}.glb"
    extras = {} if tree.indirect is None else {"treebake": indirect_extras(tree.indirect)}
    write_glb(full, [_bound((finest, *tree.levels), levels)], extras)
    indirect = slicings = views = None
    if tree.indirect is not None:
        images += _write_indirect_images(folder, tree.name, tree.indirect)
        indirect = Indirect(
            file=full.name,
            billboards=len(tree.indirect.billboards),
            leaves=tree.indirect.leaves,
            gpu_bytes=indirect_bytes(tree.indirect),
        )
    if tree.slicings is not None:
        path = folder / f"{tree.name}_slicings.glb"
        write_slicings(path, tree.slicings)
        images += _write_atlas(folder, tree.name, tree.slicings.slicings.atlas)
        slicings = _slicings_entry(path.name, tree.slicings)
    if tree.views is not None:
        beside = shared or Path(f"{tree.name}_views.glb")
        if shared is None:
            write_views(folder / beside, [(tree.name, tree.views)])
            images += _write_atlas(folder, tree.name, tree.views.views.atlas)
        views = _views_entry(beside.as_posix(), tree.views.views)
    manifest = Manifest(
        format=FORMAT,
        generator=f"treebake {__version__}",
        name=tree.name,
        source=Source(tree.source_triangles, _corners(tree)),
        file=full.name,
        levels=tuple(levels),
        indirect=indirect,
        slicings=slicings,
        views=views,
        textures=tuple(images),
        ladder=ladder.rungs if ladder else (),
        left_out=ladder.left_out if ladder else (),
        translucency=_translucency(tree),
    )
    before = _named(folder)
    with atomic(folder / "manifest.json") as file:
        file.write(msgspec.json.format(msgspec.json.encode(manifest), indent=2) + b"\n")
    for stale in before - _named(folder):  # what an earlier bake left and this one does not have
        stale.unlink(missing_ok=True)
    return manifest


def _translucency(tree: BakedTree) -> TranslucencyEntry | None:
    if tree.translucency is None:
        return None
    through = tree.translucency.transmission
    return TranslucencyEntry(through.factor, through.color, tree.translucency.origin)


def _nodes(level: BakedLevel) -> list[tuple[str, Mesh]]:
    parts = {"cloud": level.cloud.mesh, "trunk": level.trunk}
    return [(name, mesh) for name, mesh in parts.items() if mesh.triangles]


def _bound(baked: Sequence[BakedLevel], levels: Sequence[Level]) -> Node:
    """All levels as one node, and the part of the screen down to which each is drawn."""
    near, *far = map(_nodes, baked)
    coverage = screen_coverage([level.min_height for level in levels]) if far else ()
    return Node("tree", near, far, coverage)


def _write_level(path: Path, level: BakedLevel, min_height: int) -> Level:
    nodes = _nodes(level)
    write_glb(path, nodes)
    return Level(
        file=path.name,
        representations=tuple(name for name, _ in nodes),
        billboards=len(set(level.cloud.face_cluster.tolist())),
        foliage_triangles=level.cloud.mesh.triangles,
        trunk_triangles=level.trunk.triangles,
        bytes=path.stat().st_size,
        min_height=min_height,
        trunk_iou=None if level.trunk_iou is None else round(level.trunk_iou, 4),
        displacement=round(level.cloud.displacement, 6),
        trunk_maps=level.trunk_maps.kind,
    )


def _named(folder: Path) -> set[Path]:
    """The files within the folder that its manifest names; none where there is no sound one."""
    try:
        manifest = msgspec.json.decode((folder / "manifest.json").read_bytes(), type=Manifest)
    except (OSError, msgspec.DecodeError):
        return set()
    inside = folder.resolve()
    return {path for file in files_of(manifest) if (path := (folder / file).resolve()).is_relative_to(inside)}


def write_shared_views(named: Sequence[tuple[str, Impostor]], out: Path) -> Path:
    """Write the views of trees that share an atlas into OUT/shared_views, with the atlas as loose files beside.

    Returns the GLB's path. Raises WorkspaceError.
    """
    folder = out / SHARED
    left_out = set(views_names(folder / f"{SHARED}.glb")) - {name for name, _ in named}
    if left_out:
        LOG.warning(
            "%s held the views of %s too, whose manifests still point there; give all trees that share an atlas",
            folder,
            ", ".join(sorted(left_out)),
        )
    write_views(folder / f"{SHARED}.glb", named)
    _write_atlas(folder, "shared", named[0][1].views.atlas)
    return folder / f"{SHARED}.glb"


def _slicings_entry(file: str, foliage: SlicedFoliage) -> SlicingsEntry:
    slicings = foliage.slicings
    return SlicingsEntry(
        file=file,
        slicings=slicings.orientations + slicings.above,
        slices=slicings.count,
        triangles=slicings.triangles,
        trunk_triangles=foliage.solid.triangles,
        texels_kept=round(slicings.atlas.coverage.pixels[..., 0].size / slicings.untrimmed, 4),
        gpu_bytes=atlas_bytes(slicings.atlas) + slicings.slices.nbytes,
    )


def _views_entry(file: str, views: Views) -> ViewsEntry:
    towards = views.pictures[:, 2, :3].astype(np.float64)
    elevations = np.degrees(np.arcsin(np.clip(towards[:, 1], -1, 1)))
    azimuths = np.degrees(np.arctan2(-views.pictures[:, 0, 2], views.pictures[:, 0, 0]))
    corners = views.pictures[:, 4, [0, 3, 2, 1]].astype(np.float64)
    return ViewsEntry(
        file=file,
        layout=views.layout,
        layers=views.layers,
        triangles=views.triangles,
        gpu_bytes=atlas_bytes(views.atlas) + views.pictures.nbytes,
        pictures=tuple(
            Picture(round(float(azimuth) % 360, 4), round(float(elevation), 4), number % views.layers, tuple(uv))
            for number, (azimuth, elevation, uv) in enumerate(
                zip(azimuths, elevations, corners.round(6).tolist(), strict=True)
            )
        ),
    )


def _maps(mesh: Mesh) -> list[tuple[Texture, str]]:
    """The textures of the cards, with their colour spaces."""
    if not mesh.triangles:
        return []
    material = mesh.materials[0]
    maps = [(material.color_map, "sRGB"), (material.normal_map, "linear"), (material.occlusion_map, "linear")]
    return [(texture, space) for texture, space in maps if texture is not None]


def _trunk_maps(level: BakedLevel) -> list[tuple[Texture, str]]:
    """The maps that were baked for the trunk, with their colour spaces; one that serves twice is there once."""
    if not level.trunk.triangles:
        return []
    material = level.trunk.materials[level.trunk.face_material[0]]
    maps = [(material.occlusion_map, "linear")] if level.trunk.occlusion_uvs is not None else []
    if level.trunk_maps.kind == "unique":
        others = material.normal_map, material.occlusion_map, material.roughness_map
        maps = [(material.color_map, "sRGB"), *((texture, "linear") for texture in others)]
    return list({id(texture): (texture, space) for texture, space in maps if texture is not None}.values())


def _write_image(folder: Path, name: str, texture: Texture, space: str) -> Image:
    path = folder / "textures" / f"{name}_{texture.name}.png"
    height, width = texture.pixels.shape[:2]
    with atomic(path) as file:
        file.write(encode_texture(texture, with_alpha=texture.has_alpha))
    return Image(path.relative_to(folder).as_posix(), (width, height), space)


def _write_atlas(folder: Path, name: str, atlas: PictureAtlas) -> list[Image]:
    return [_write_image(folder, name, getattr(atlas, image), space) for image, space in ATLAS.items()]


def _write_indirect_images(folder: Path, name: str, textures: IndirectTextures) -> list[Image]:
    """The tables and images once more as loose files: floats as EXR, all others as the 16-bit words of a grey PNG."""
    spaces = {image: "sRGB" if image.endswith("color") else "linear" for image in IMAGES}
    written = [_write_image(folder, name, getattr(textures, image), space) for image, space in spaces.items()]
    for table in TABLES:
        values = getattr(textures, table)
        is_float = values.dtype == np.float32
        pixels = values.reshape(len(values), -1, 4) if is_float else values.view(np.uint16).reshape(len(values), -1)
        path = folder / "textures" / f"{name}_{table}.{'exr' if is_float else 'png'}"
        with atomic(path) as file:
            file.write(encode_floats(pixels) if is_float else encode_png(pixels))
        written.append(Image(path.relative_to(folder).as_posix(), (pixels.shape[1], len(pixels)), "data"))
    return written


def _corners(tree: BakedTree) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    low, high = tree.source_bounds.tolist()
    return tuple(low), tuple(high)
