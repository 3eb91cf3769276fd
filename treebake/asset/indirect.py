"""The indirect textures in a GLB: its root's `extras.treebake.indirect`."""

from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from treebake.asset.extras import Extras, IndirectExtras, read_extras, read_transmission, transmission_extras
from treebake.asset.manifest import FORMAT
from treebake.compression import block_bytes
from treebake.formats.gltf_file import GltfFile
from treebake.lookup import LIST_BITS, ROW_BITS
from treebake.model import IndirectTextures, LeafCards, Longs, Texture

TABLES = {  # name: values of one texel, texels of one row (0: of the image's own size)
    "billboards": (4, 5),
    "shapes": (4, 4),
    "hash_texture": (1, 0),
    "lists_texture": (1, 1 << ROW_BITS),
    "placements": (4, 1 << ROW_BITS),
    "ambient": (4, 1 << ROW_BITS),
}
IMAGES = ("leaf_color", "leaf_normal", "far_color", "far_normal")
_NUMBERS = {"billboards": "f4", "shapes": "f4", "hash_texture": "u4", "lists_texture": "u2", "placements": "u4"}


def indirect_extras(textures: IndirectTextures) -> dict[str, Any]:
    """The indirect textures as `extras.treebake` of a GLB holds them."""
    tables = {name: getattr(textures, name).reshape(-1, width) for name, (width, _) in TABLES.items()}
    images = {name: getattr(textures, name) for name in IMAGES}
    values = {**tables, **images, "hash_width": textures.hash_texture.shape[1], "largest": textures.largest}
    values |= {"leaves": textures.leaves, "transmission": transmission_extras(textures.transmission)}
    ordered = {field.name: values[field.name] for field in fields(IndirectExtras)}
    return {"format": FORMAT, "indirect": ordered}


def read_indirect(path: Path) -> IndirectTextures:
    """Read the indirect textures of a GLB, checked so far that a lookup stays inside the tables.

    Raises AssetError where they are missing, of an unknown format or damaged.
    """
    return read_extras(path, "indirect textures", _read)


def _read(file: GltfFile, extras: Extras) -> tuple[IndirectTextures, str]:
    where = extras.indirect
    if where is None:
        raise ValueError("there are none")
    found: Any = {name: _table(file, where, name) for name in TABLES}
    found |= {name: file.texture(getattr(where, name)) for name in IMAGES}
    found |= {"leaves": where.leaves, "largest": where.largest, "transmission": read_transmission(where.transmission)}
    textures = IndirectTextures(**found)
    return textures, _damage(textures)


def indirect_bytes(textures: IndirectTextures) -> int:
    """Bytes on the graphics card: tables as they are; colours BC3, normals BC5, heights and the sky that is seen BC4,
    with all their mips.
    """
    return sum(int(getattr(textures, name).nbytes) for name in TABLES) + _image_bytes(textures, IMAGES)


def leaf_card_bytes(leaves: LeafCards) -> int:
    """The same of leaves on cards of their own."""
    tables = leaves.cards.nbytes + leaves.shapes.nbytes + leaves.ambient.nbytes
    return tables + _image_bytes(leaves, ("leaf_color", "leaf_normal"))


def _image_bytes(holder: IndirectTextures | LeafCards, names: Iterable[str]) -> int:
    images = [(name, getattr(holder, name).pixels.shape) for name in names]
    return sum(block_bytes(w, h, 16 + 8 * name.endswith("normal")) for name, (h, w, _) in images)


def _table(file: GltfFile, where: IndirectExtras, name: str) -> np.ndarray:
    width, row = TABLES[name]
    values = file.accessor(getattr(where, name))
    if values.dtype.str[1:] != _NUMBERS.get(name, "u1") or values.shape[1] != width:
        raise ValueError(f"table {name} has values of another kind")
    if name in ("billboards", "shapes"):
        return values.reshape(-1, width * row)
    shape = (-1, row or where.hash_width, width) if width > 1 else (-1, row or where.hash_width)
    return values.reshape(shape)


def _damage(textures: IndirectTextures) -> str:
    """What is wrong with the tables, or nothing."""
    if not all(isinstance(getattr(textures, name), Texture) for name in IMAGES):
        return "an image is missing"
    if not all(getattr(textures, name).size for name in TABLES):
        return "a table is empty"
    boards, hashes = textures.billboards, textures.hash_texture.astype(np.int64)
    sizes, origins, first = boards[:, 12:14], boards[:, 16:18], boards[:, 18]
    checks = (
        (np.isfinite(boards).all() and np.isfinite(textures.shapes).all(), "a table holds no numbers"),
        (np.isfinite(textures.largest), "the largest leaf has no size"),
        ((textures.shapes[:, :2] > 0).all(), "a shape has no size"),
        (((hashes >> LIST_BITS) + _counts(hashes)).max() <= textures.lists_texture.size, "a list leaves its texture"),
        ((sizes >= 1).all() and (boards[:, 14] >= 0).all(), "a billboard has no size"),
        ((origins >= 0).all() and (origins + sizes <= hashes.shape[::-1]).all(), "a billboard leaves the hash texture"),
        (textures.leaves <= textures.placements[..., 0].size, "there are fewer placements than leaves"),
        (textures.ambient.shape[:2] == textures.placements.shape[:2], "there is not one ambient entry per placement"),
        ((textures.placements[..., 3] >> 16).max() < len(textures.shapes), "a placement has an unknown shape"),
        ((first >= 0).all(), "a billboard has no placements"),
    )
    wrong = next((what for sound, what in checks if not sound), "")
    if not wrong and (first + _last_entries(textures) >= textures.leaves).any():
        wrong = "a list names a leaf that is not there"
    return wrong


def _counts(hashes: Longs) -> Longs:
    return hashes & (1 << LIST_BITS) - 1


def _last_entries(textures: IndirectTextures) -> Longs:
    """The greatest number that a list of each billboard holds."""
    hashes = textures.hash_texture.astype(np.int64)
    used = np.flatnonzero(_counts(hashes))
    texels = hashes.reshape(-1)[used]
    offsets, counts = texels >> LIST_BITS, _counts(texels)
    entries = np.append(textures.lists_texture.reshape(-1).astype(np.int64), 0)
    most = np.zeros(hashes.size, np.int64)
    if len(used):
        most[used] = np.maximum.reduceat(entries, np.stack([offsets, offsets + counts], axis=1).reshape(-1))[::2]
    grid = most.reshape(hashes.shape)
    grids = textures.billboards[:, [16, 17, 12, 13]].astype(int)
    return np.array([grid[y : y + rows, x : x + columns].max() for x, y, columns, rows in grids])
