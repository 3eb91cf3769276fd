"""Slices that need no picture of their own, because they are the front of another seen from behind ([J00] 4)."""

from collections.abc import Sequence

import numpy as np

from treebake.gl.photo import Photo
from treebake.model import Floats


def mirrored_pairs(photos: Sequence[Photo], orientations: int, count: int, tolerance: float) -> dict[int, int]:
    """Which photo can be had by mirroring which other one: {from behind: front}.

    photos: of `count` slices each, slicing after slicing around the tree; any more are left alone. Two opposite
    slicings share their planes. A pair is found where colour, coverage and relief differ by at most `tolerance` (of
    1) in the mean over what is covered. Where leaves hide each other, each side shows others, so dense trees have none.
    O(texels).
    """
    if orientations % 2 or tolerance <= 0:
        return {}
    half = orientations // 2 * count
    found = {}
    for front in range(half):
        slicing, index = divmod(front, count)
        behind = half + slicing * count + count - 1 - index
        if _difference(photos[front], photos[behind]) <= tolerance:
            found[behind] = front
    return found


def seen_from_behind(front: Floats, behind: Floats) -> Floats:
    """The row of the table of slices for a slice that shows another's picture from behind. Rows are (3 + 2 R, 4)."""
    row = behind.copy()
    row[1:3, 3] = -front[1:3, 3]  # nothing tells a picture from behind but that its range runs backwards
    row[3::2] = front[3::2][:, [2, 1, 0, 3]] * [-1, 1, -1, 1]
    row[4::2] = front[4::2][:, [2, 1, 0, 3]]
    return row


def _difference(front: Photo, behind: Photo) -> float:
    if front.albedo.shape != behind.albedo.shape:
        return float("inf")
    mirrored = front.albedo[:, ::-1]
    relief = front.relief[:, ::-1].copy()
    alpha = mirrored[..., 3:]
    relief[..., 1:3] = alpha - relief[..., 1:3]  # the slope up and the depth run the other way; both premultiplied
    both = np.concatenate([mirrored - behind.albedo, relief - behind.relief], axis=2)
    area = float(np.maximum(front.albedo[:, ::-1, 3], behind.albedo[..., 3]).sum())
    return float(np.abs(both).max(axis=2).sum()) / area if area else 0.0
