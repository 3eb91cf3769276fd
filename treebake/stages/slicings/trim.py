"""Cut the empty parts off a slice: a few rectangles hold all that it shows ([J00] 4, its quad-tree).

A quad-tree stores least, at the price of a quad for every leaf of it. A few rectangles, cut where that saves most, keep
the number of triangles that are drawn for a tree at [J00]'s.
"""

import numpy as np
from numpy.typing import NDArray

from treebake.model import Ints
from treebake.pictures import trimmed

_Rectangle = tuple[int, int, int, int]  # left, top, right, bottom


def trim(used: NDArray[np.bool_], count: int, gutter: int) -> Ints:
    """Rectangles that hold all texels in use: (count, 4) int32, left, top, right, bottom; empty ones are all zero.

    used: (h, w) bool. gutter: texels that each rectangle takes up beyond its sides. At most `count` of them, none
    overlapping, each cut made where it saves most. O(h w) a cut.
    """
    found = [_bounds(used, (0, 0, used.shape[1], used.shape[0]))] if used.any() else []
    while 0 < len(found) < count:
        cuts = [_best_cut(used, rectangle, gutter) for rectangle in found]
        best = int(np.argmax([saved for saved, _ in cuts]))
        saved, halves = cuts[best]
        if saved <= 0:
            break
        found[best : best + 1] = halves
    result = np.zeros((count, 4), np.int32)
    result[: len(found)] = np.array(found, np.int32).reshape(-1, 4)
    return result


def _bounds(used: NDArray[np.bool_], window: _Rectangle) -> _Rectangle:
    left, top, right, bottom = window
    found = trimmed(used[top:bottom, left:right])
    return left + found[0], top + found[1], left + found[2], top + found[3]


def _best_cut(used: NDArray[np.bool_], window: _Rectangle, gutter: int) -> tuple[float, list[_Rectangle]]:
    """What the best straight cut through a rectangle saves in texels, and its two halves."""
    left, top, right, bottom = window
    part = used[top:bottom, left:right]
    whole = (part.shape[0] + 2 * gutter) * (part.shape[1] + 2 * gutter)
    best, halves = 0.0, [window]
    for axis in (0, 1):
        across = part if axis == 0 else part.T
        cost = _areas(across, gutter)[:-1] + _areas(across[::-1], gutter)[-2::-1]
        if not len(cost) or whole - cost.min() <= best:
            continue
        best, at = float(whole - cost.min()), int(cost.argmin()) + 1
        windows = (
            [(left, top, right, top + at), (left, top + at, right, bottom)]
            if axis == 0
            else [(left, top, left + at, bottom), (left + at, top, right, bottom)]
        )
        halves = [_bounds(used, window) for window in windows]
    return best, halves


def _areas(part: NDArray[np.bool_], gutter: int) -> NDArray[np.float64]:
    """Texels that the tight rectangle about the first n rows takes up, for n = 1, 2, ...; the first row is in use."""
    rows, columns = part.shape
    in_use = part.any(axis=1)
    last = np.maximum.accumulate(np.where(in_use, np.arange(rows), 0))
    first_column = np.minimum.accumulate(np.where(in_use, part.argmax(axis=1), columns))
    last_column = np.maximum.accumulate(np.where(in_use, columns - 1 - part[:, ::-1].argmax(axis=1), 0))
    wide = last_column - first_column + 1
    return np.asarray((last + 1 + 2 * gutter) * (wide + 2 * gutter), np.float64)
