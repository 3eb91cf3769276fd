"""Slicings and view impostors in GLBs of their own: `extras.treebake.slicings` and `.views`."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from treebake.asset.extras import AtlasExtras, Extras, read_extras, read_transmission, transmission_extras
from treebake.asset.manifest import FORMAT
from treebake.compression import block_bytes
from treebake.errors import AssetError
from treebake.formats.gltf_file import GltfFile
from treebake.glb import write_glb
from treebake.model import Floats, Impostor, PictureAtlas, SlicedFoliage, Slicings, Texture, Views

ATLAS = {"coverage": "linear", "albedo": "sRGB", "relief": "linear", "occlusion": "linear"}  # with their colour spaces
_DRAWN = {
    "coverage": (8, 0),
    "albedo": (8, 1),
    "relief": (16 + 8, 1),
    "occlusion": (8, 3),
}  # bytes of a block, halvings
SUPPORT = 33


def write_slicings(path: Path, foliage: SlicedFoliage) -> None:
    """Write slicings, their standard cards for any viewer, and what is solid. Raises WorkspaceError."""
    slicings = foliage.slicings
    nodes = [("slices", foliage.standard), ("trunk", foliage.solid)]
    where = {
        "atlas": _atlas_extras(slicings.atlas),
        "slices": slicings.slices.reshape(-1, 4),
        "rectangles": slicings.rectangles,
        "orientations": slicings.orientations,
        "count": slicings.count,
        "center": slicings.center.tolist(),
        "size": slicings.size,
        "above": slicings.above,
        "far_row": slicings.far_row,
        "far_height": slicings.far_height,
        "dropped": slicings.dropped,
        "brightness": slicings.brightness,
        "exposure": slicings.exposure,
        "untrimmed": slicings.untrimmed,
        "transmission": transmission_extras(slicings.transmission),
    }
    write_glb(path, nodes, {"treebake": {"format": FORMAT, "slicings": where}})


def read_slicings(path: Path) -> Slicings:
    """Read the slicings of a GLB. Raises AssetError where they are missing, of an unknown format or damaged."""
    return read_extras(path, "slicings", _slicings)


def _slicings(file: GltfFile, extras: Extras) -> tuple[Slicings, str]:
    where = extras.slicings
    if where is None:
        raise ValueError("there are none")
    values = asdict(where) | {
        "slices": _table(file, where.slices, 3 + 2 * where.rectangles),
        "center": np.array(where.center),
        "atlas": _atlas(file, where.atlas),
        "transmission": read_transmission(where.transmission),
    }
    del values["rectangles"]
    slicings = Slicings(**values)
    slicings_baked = where.orientations + where.above
    rows = slicings_baked * (where.count + (where.far_height > 0))
    checks = (
        (_sound(slicings.slices, slicings.atlas), "a slice leaves the atlas, or holds no numbers"),
        (len(slicings.slices) == rows, "there are more or fewer slices than it says"),
        (where.far_row == slicings_baked * where.count, "its far slices start elsewhere"),
    )
    return slicings, next((what for sound, what in checks if not sound), "")


def write_views(path: Path, named: Sequence[tuple[str, Impostor]]) -> None:
    """Write the views of one or several trees that share an atlas; of a single tree, two crossed cards for any viewer.

    Raises WorkspaceError.
    """
    trees = [
        {
            "name": name,
            "pictures": views.pictures.reshape(-1, 4),
            "layout": views.layout,
            "side": views.side,
            "layers": views.layers,
            "center": views.center.tolist(),
            "radius": views.radius,
            "support": views.support.reshape(-1, 1),
            "brightness": views.brightness,
            "exposure": views.exposure,
            "transmission": transmission_extras(views.transmission),
        }
        for name, views in ((name, impostor.views) for name, impostor in named)
    ]
    where = {"atlas": _atlas_extras(named[0][1].views.atlas), "trees": trees}
    nodes = [("views", impostor.standard) for _, impostor in named] if len(named) == 1 else []
    write_glb(path, nodes, {"treebake": {"format": FORMAT, "views": where}})


def read_views(path: Path, name: str) -> Views:
    """Read the views of the tree `name` from a GLB. Raises AssetError as `read_slicings` does."""

    def read(file: GltfFile, extras: Extras) -> tuple[Views, str]:
        if extras.views is None:
            raise ValueError("there are none")
        where = next((tree for tree in extras.views.trees if tree.name == name), None)
        if where is None:
            raise ValueError(f"there are none of {name}")
        values = asdict(where) | {
            "pictures": _table(file, where.pictures, 5),
            "center": np.array(where.center),
            "support": file.accessor(where.support).reshape(-1),
            "atlas": _atlas(file, extras.views.atlas),
            "transmission": read_transmission(where.transmission),
        }
        del values["name"]
        views = Views(**values)
        count = where.side if where.layout == "ring" else where.side**2
        checks = (
            (where.layout in ("ring", "hemi"), f"its layout is {where.layout}"),
            (where.side >= 2, "it has a single view"),
            (_sound(views.pictures, views.atlas), "a picture leaves the atlas, or holds no numbers"),
            (len(views.pictures) == count * where.layers, "there are more or fewer pictures than it says"),
            (
                views.support.dtype == np.float32
                and len(views.support) == SUPPORT
                and np.isfinite(views.support).all(),
                "its support is of another length",
            ),
        )
        return views, next((what for sound, what in checks if not sound), "")

    return read_extras(path, "views", read)


def views_names(path: Path) -> tuple[str, ...]:
    """The trees whose views a GLB holds; none where it is missing or damaged."""
    try:
        return read_extras(path, "views", lambda _file, extras: (_names(extras), ""))
    except AssetError:
        return ()


def _names(extras: Extras) -> tuple[str, ...]:
    return tuple(tree.name for tree in extras.views.trees) if extras.views else ()


def atlas_bytes(atlas: PictureAtlas) -> int:
    """Bytes on the graphics card of what drawing looks up: coverage, depth, occlusion BC4, albedo BC1, slopes BC5.

    With the mips that show nothing of neighbours; no others are ever looked up.
    """
    total = 0
    for name, (block, halvings) in _DRAWN.items():
        height, width = getattr(atlas, name).pixels.shape[:2]
        total += block_bytes(width, height, block, max(atlas.mips - halvings, 0))
    return total


def _atlas_extras(atlas: PictureAtlas) -> dict[str, Any]:
    return {**{name: getattr(atlas, name) for name in ATLAS}, "mips": atlas.mips}


def _atlas(file: GltfFile, where: AtlasExtras) -> PictureAtlas:
    images: dict[str, Any] = {name: file.texture(getattr(where, name)) for name in ATLAS}
    if not all(isinstance(image, Texture) for image in images.values()):
        raise ValueError("an image is missing")
    return PictureAtlas(**images, mips=where.mips)


def _table(file: GltfFile, index: int, columns: int) -> Floats:
    values = file.accessor(index)
    if values.dtype != np.float32 or values.shape[1] != 4:
        raise ValueError("a table has values of another kind")
    return values.reshape(-1, columns, 4)


def _sound(table: Floats, atlas: PictureAtlas) -> bool:
    """Whether all texture coordinates of a table of pictures are inside, and the images fit each other."""
    height, width = atlas.coverage.pixels.shape[:2]
    fitting = all(
        getattr(atlas, name).pixels.shape[:2] == (height >> halvings, width >> halvings)
        for name, (_, halvings) in _DRAWN.items()
    )
    inside = (table[:, 4::2] >= 0) & (table[:, 4::2] <= 1)
    return bool(len(table) and np.isfinite(table).all() and inside.all() and fitting)
