"""Gather pictures into one atlas."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import rectpack
from numpy.typing import NDArray

from treebake.errors import BudgetError
from treebake.gl.photo import Photo
from treebake.images import bleed, to_srgb, value_texels
from treebake.model import Bytes, Floats, Ints, Longs, PictureAtlas, Texture

STEEPEST = 4.0  # slopes run from -STEEPEST to STEEPEST
# Of a square, in width, that are tried for an atlas: 49 save 1.4 % of a chestnut's slices' texels against 7.
_STRETCHES = np.linspace(0.85, 1.3, 49)
MOST_ATLAS = 16384  # texels a side
_FEW = 128  # pictures, up to which the better of two ways to pack is quick
_LEAST = 0.07  # coverage of a texel that makes a picture larger
OCCLUSION = 8  # texels of the coverage each way for one of the occlusion, which is smooth


@dataclass(frozen=True, eq=False)
class Part:
    """A rectangle of a photo (rows and columns of `source`) and the texel of the atlas where its top left one goes."""

    photo: Photo
    source: tuple[slice, slice]
    origin: tuple[int, int]  # x, y


def covered(photo: Photo) -> NDArray[np.bool_]:
    """(h, w) bool, the texels that show anything; a single sample of 16 at a picture's edge is nothing."""
    return photo.albedo[..., 3] > _LEAST


def trimmed(used: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of what is set in (h, w) bool; all zero where nothing is."""
    rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    return (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1) if len(rows) else (0, 0, 0, 0)


def pack_pictures(sizes: Ints, gutter: int, limit: int) -> tuple[Ints, tuple[int, int]] | None:
    """Place pictures in a small, nearly square atlas.

    sizes: (C, 2) int32, columns and rows. gutter: texels kept free around each, a power of two; of less than 4, 4 are
    kept. limit: the atlas's greatest side, another. Returns the top left texel of each (C, 2) int32, and the atlas's
    (width, height), multiples of `OCCLUSION` that halve evenly as often as the gutter does; None where they do not fit.
    About O(C^2): 1 s for 100 pictures, and for 1,000. Shelves, as for cards, leave 12 % of a chestnut's slices' atlas
    empty, this 4 %.

    No two pictures share a texel of the occlusion, and filtering mixes no neighbour in: each has a room that begins and
    ends with whole texels of it, and half of one around it at least. Rooms on multiples of 4, the blocks of
    compression, take 1.5 % fewer texels of a chestnut's slices; there a neighbour is up to half of what is looked up at
    a picture's edge.
    """
    side = max(OCCLUSION, gutter)
    if not len(sizes):
        return np.zeros((0, 2), np.int32), (side, side)
    cell, around = _spacing(gutter)
    cells = (-(-(sizes + 2 * around) // cell)).astype(np.int64)
    most, square = limit // cell, np.sqrt(np.prod(cells, axis=1).sum())
    stretches = _STRETCHES if len(cells) <= _FEW else _STRETCHES[::16]
    widths = np.clip((square * stretches).astype(int), cells[:, 0].max(), most).tolist()
    tries = [_placed(cells, width, most) for width in widths]
    fitting = [placed for placed in tries if placed is not None]
    if not fitting:
        return None
    origins = min(fitting, key=lambda placed: np.prod((placed + cells).max(axis=0)))
    width, height = -(-(origins + cells).max(axis=0) * cell // side) * side
    return (origins * cell + around).astype(np.int32), (int(width), int(height))


def _placed(cells: Longs, width: int, height: int) -> Longs | None:
    """The top left cell of each picture, in order, in an atlas of this size ([Jylänki 2010])."""
    algorithm = rectpack.MaxRectsBl if len(cells) <= _FEW else rectpack.SkylineBlWm
    packer = rectpack.newPacker(pack_algo=algorithm, sort_algo=rectpack.SORT_SSIDE, rotation=False)
    packer.add_bin(width, height)
    for number, (columns, rows) in enumerate(cells.tolist()):
        packer.add_rect(columns, rows, rid=number)
    packer.pack()
    found = sorted((number, x, y) for _, x, y, _, _, number in packer.rect_list())
    return np.array(found, np.int64)[:, 1:] if len(found) == len(cells) else None


def place_pictures(sizes: Ints, gutter: int, limit: int, table: str, others: str) -> tuple[Ints, tuple[int, int]]:
    """`pack_pictures`, or a BudgetError that says what to do where they do not fit.

    table: of the settings, whose `atlas` is the limit. others: what else can be lowered there.
    """
    packed = pack_pictures(sizes, gutter, limit)
    if packed is not None:
        return packed
    area = np.prod((sizes + 2 * gutter).astype(np.int64), axis=1).sum()
    least = max(int(np.sqrt(area)), int(sizes.max()))
    sides = (1 << bits for bits in range(max(least - 1, 1).bit_length(), MOST_ATLAS.bit_length()))
    enough = next((side for side in sides if pack_pictures(sizes, gutter, side)), None)
    raised = f"set [{table}] atlas = {enough}, or " if enough else ""
    raise BudgetError(
        f"{len(sizes)} pictures do not fit into an atlas of {limit} texels a side; {raised}lower [{table}] {others}"
    )


def compose(parts: Iterable[Part], size: tuple[int, int], gutter: int, name: str) -> PictureAtlas:
    """Put parts of photos into an atlas of `size` (width, height), where `pack_pictures` placed them. O(texels).

    gutter: texels that are free around each part and show the photo's own surroundings.

    Coverage keeps every texel; of the rest, one texel of each 2 x 2 is kept, the one that is covered most, because a
    mean of two leaves is neither. Occlusion is a mean, of what is covered. Clear texels take what is around them, so
    that no mip mixes in what is not there; those of the occlusion, of which a few make a picture, take what is around
    them in the picture itself.
    """
    width, height = size
    coverage = np.zeros((height, width), np.float32)
    values = np.zeros((height, width, 7), np.float32)  # albedo, relief, occlusion
    rooms = []  # in texels of the occlusion
    for part in parts:
        photo, (rows, columns), (x, y) = part.photo, part.source, part.origin
        # The gutter shows what is around the part, so that nothing fades where a picture was cut in two.
        top, left = (min(gutter, window.start) for window in (rows, columns))
        here = np.s_[rows.start - top : rows.stop + gutter, columns.start - left : columns.stop + gutter]
        alpha = photo.albedo[here][..., 3]
        there = np.s_[y - top : y - top + alpha.shape[0], x - left : x - left + alpha.shape[1]]
        coverage[there] = alpha
        values[there] = np.dstack([photo.albedo[here][..., :3], photo.relief[here]])
        rooms.append((_room(y, rows, gutter), _room(x, columns, gutter)))
    sky, share = (_blocks(image, OCCLUSION).mean(axis=2)[..., 0] for image in (values[..., 6:], coverage[..., None]))
    for room in rooms:
        if share[room].any():
            sky[room], share[room] = bleed(np.dstack([sky[room]] * 3 + [share[room]]))[..., 0], 1
    grey = value_texels(sky, share)
    best = _blocks(coverage[..., None], 2).argmax(axis=2)[..., None]
    alpha = np.take_along_axis(_blocks(coverage[..., None], 2), best, axis=2)[:, :, 0]
    values = np.take_along_axis(_blocks(values[..., :6], 2), best, axis=2)[:, :, 0]
    albedo, relief = (bleed(np.dstack([values[..., i : i + 3], alpha])) for i in (0, 3))
    return PictureAtlas(
        coverage=_texture(f"{name}_coverage", np.repeat(_bytes(coverage)[..., None], 3, axis=2)),
        albedo=_texture(f"{name}_albedo", to_srgb(albedo)),
        relief=_texture(f"{name}_relief", _bytes(relief)),
        occlusion=_texture(f"{name}_occlusion", np.repeat(grey[..., None], 3, axis=2)),
        mips=gutter.bit_length() - 1,
    )


def _room(origin: int, window: slice, gutter: int) -> slice:
    """The texels of the occlusion that are one picture's alone, along an axis."""
    cell, around = _spacing(gutter)
    end = -(-(origin + window.stop - window.start + around) // cell) * cell
    return slice(max(origin - around, 0) // OCCLUSION, end // OCCLUSION)


def _spacing(gutter: int) -> tuple[int, int]:
    """Of what rooms begin and end on multiples, and what is kept free in one around its picture, in texels."""
    return max(OCCLUSION, gutter // 2), max(gutter, OCCLUSION // 2)


def _blocks(image: Floats, side: int) -> Floats:
    """(h, w, n) as blocks of side x side texels: (h / side, w / side, side^2, n)."""
    height, width, channels = image.shape
    tiles = image.reshape(height // side, side, width // side, side, channels).transpose(0, 2, 1, 3, 4)
    return tiles.reshape(height // side, width // side, side**2, channels)


def _bytes(values: Floats) -> Bytes:
    return np.asarray(np.rint(np.clip(values, 0, 1) * 255), np.uint8)


def _texture(name: str, pixels: Bytes) -> Texture:
    return Texture(name, np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)]))
