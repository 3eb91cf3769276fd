"""Trim the slices' pictures, pack what is left, and say in a table where it is."""

from collections.abc import Sequence

import numpy as np

from treebake.gl.photo import Photo
from treebake.model import Floats, PictureAtlas
from treebake.pictures import Part, compose, covered, place_pictures
from treebake.stages.slicings.mirror import seen_from_behind
from treebake.stages.slicings.shots import Slice
from treebake.stages.slicings.trim import trim


def layout(
    slices: Sequence[Slice],
    photos: Sequence[Photo],
    mirrored: dict[int, int],
    rectangles: int,
    gutter: int,
    limit: int,
) -> tuple[Floats, PictureAtlas]:
    """The table of slices (S, 3 + 2 rectangles, 4) float32, as FORMAT.md has it, and the atlas.

    mirrored: slices that show another's picture from behind. gutter: texels kept free around each rectangle. limit: the
    atlas's greatest side. Raises BudgetError where the pictures do not fit.
    """
    found = np.stack([trim(covered(photo), rectangles, gutter) for photo in photos])
    found[list(mirrored)] = 0
    row, column = np.nonzero(found[..., 2] > found[..., 0])
    used = found[row, column]
    origins, size = place_pictures(
        used[:, 2:] - used[:, :2], gutter, limit, "slicings", "texels, slices or orientations"
    )
    parts = (
        Part(photos[number], (slice(top, bottom), slice(left, right)), (int(x), int(y)))
        for number, (left, top, right, bottom), (x, y) in zip(
            row.tolist(), used.tolist(), origins.tolist(), strict=True
        )
    )
    table = np.zeros((len(slices), 3 + 2 * rectangles, 4), np.float32)
    for number, each in enumerate(slices):
        table[number, :3, :3] = each.slicing.turn
        table[number, :3, 3] = each.offset, each.low[2], each.high[2]
    texel = np.array([each.texel for each in slices])[row, None]
    corner = np.array([[each.low[0], each.high[1]] for each in slices])[row]
    low, high = corner + used[:, [0, 3]] * [1, -1] * texel, corner + used[:, [2, 1]] * [1, -1] * texel
    table[row, 3 + 2 * column] = np.concatenate([low, high], axis=1)
    ends = origins + used[:, 2:] - used[:, :2]
    table[row, 4 + 2 * column] = np.column_stack([origins[:, 0], ends[:, 1], ends[:, 0], origins[:, 1]]) / [
        *size,
        *size,
    ]
    for behind, front in mirrored.items():
        table[behind] = seen_from_behind(table[front], table[behind])
    return table, compose(parts, size, gutter, "slicings")
