"""Pack rectangles into one atlas."""

import numpy as np

from treebake.errors import BudgetError
from treebake.model import Doubles, Ints

_STEPS = 24  # of the bisection; the density is then exact to a thousandth of a texel across the atlas


def pack(sizes: Doubles, limit: int, density_limit: float, padding: int) -> tuple[Ints, float, tuple[int, int]]:
    """Place rectangles on shelves, highest first, at the highest texel density that fits.

    sizes: (C, 2) float64, width and height in the tree's unit. limit: the atlas's greatest side in texels, a power of
    two. density_limit: texels per unit that are enough. padding: texels kept free on every side of a card.
    Returns the top left texel of each card's content (C, 2) int32, the density, and the atlas's (width, height): the
    smallest powers of two that hold the cards at `density_limit`, or the limit at the density that fits it.

    Raises BudgetError where the cards do not fit even at one texel each.
    """
    atlases = [
        (side, height) for side in (1 << bits for bits in range(6, limit.bit_length())) for height in (side // 2, side)
    ]
    largest = float(sizes.max())
    low, high = 1 / largest, min(density_limit, limit / largest)  # one texel each, and more than the atlas is wide
    for width, height in atlases:
        origins = _shelves(sizes, high, padding, width, height)
        if origins is not None:
            return origins, high, (width, height)
    best = _shelves(sizes, low, padding, limit, limit)
    if best is None:
        raise BudgetError(
            f"{len(sizes)} cards do not fit into an atlas of {limit} x {limit} texels; "
            "raise [textures] atlas, or lower [textures] triangles or [cluster] billboards"
        )
    for _ in range(_STEPS):
        middle = (low + high) / 2
        origins = _shelves(sizes, middle, padding, limit, limit)
        low, high, best = (low, middle, best) if origins is None else (middle, high, origins)
    return best, low, (limit, limit)


def pack_cells(sizes: Ints, limit: int) -> tuple[Ints, tuple[int, int]] | None:
    """Place rectangles of whole cells on shelves of the width that leaves least empty.

    sizes: (C, 2) int32, columns and rows. limit: the greatest side. Returns the top left cell of each (C, 2) int32 and
    the atlas's (width, height), its width a power of two; None where they do not fit.
    """
    best: tuple[Ints, tuple[int, int]] | None = None
    for width in (1 << bits for bits in range(limit.bit_length())):
        origins = _shelves(sizes.astype(np.float64), 1.0, 0, width, limit)
        if origins is None:
            continue
        height = int((origins[:, 1] + sizes[:, 1]).max())
        if best is None or width * height < best[1][0] * best[1][1]:
            best = origins, (width, height)
    return best


def texel_sizes(sizes: Doubles, density: float) -> Ints:
    """Whole texels that hold rectangles of these sizes: (C, 2) int32, at least one each way."""
    return np.maximum(np.ceil(sizes * density), 1).astype(np.int32)


def _shelves(sizes: Doubles, density: float, padding: int, width: int, height: int) -> Ints | None:
    """Fill rows from left to right; None where the atlas is too small."""
    cells = texel_sizes(sizes, density) + 2 * padding
    if cells[:, 0].max() > width or cells[:, 1].max() > height or np.prod(cells, axis=1).sum() > width * height:
        return None
    order = np.argsort(-cells[:, 1], kind="stable")
    ends = np.cumsum(cells[order, 0])
    origins = np.empty_like(cells)
    first, top = 0, 0
    while first < len(order):
        used = ends[first - 1] if first else 0
        last = int(np.searchsorted(ends, used + width, side="right"))
        row = order[first:last]
        if top + cells[row[0], 1] > height:
            return None
        origins[row, 0] = ends[first:last] - cells[row, 0] - used
        origins[row, 1] = top
        first, top = last, top + int(cells[row[0], 1])
    return origins + padding
