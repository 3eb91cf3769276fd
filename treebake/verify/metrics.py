"""How far one picture is from another: FLIP, SSIM, silhouette, coverage, depth."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d

from treebake.gl.target import Picture
from treebake.images import LUMINANCE, flip_error, to_srgb
from treebake.model import Doubles, Floats

SKY, GREY = (0.55, 0.72, 0.92), (0.18, 0.18, 0.18)  # the backgrounds, linear light
_FLIP_REACH = 16  # pixels that FLIP's filters look around them at 67 pixels per degree: 10, and some to spare
_SSIM_REACH = 5


@dataclass(frozen=True, eq=False)
class Scores:
    """What was measured in each of n views, every field (n,) float64.

    flip, ssim: means over the window and both backgrounds. iou: of the silhouettes. area: pixels that the candidate
    covers. depth: mean difference, in the mesh's unit, over the
    pixels that both cover; NaN where there are none.
    """

    flip: Doubles
    ssim: Doubles
    iou: Doubles
    area: Doubles
    depth: Doubles


def score(source: Picture, candidate: Picture) -> Scores:
    """Compare a candidate's picture with the source's."""
    ours, theirs = candidate.color[..., 3], source.color[..., 3]
    union = np.maximum(ours, theirs)
    both = (ours >= 0.5) & (theirs >= 0.5)
    box = _box(union > 0)  # all pixels outside are the same background, so errors need not be computed there
    pairs = [(over(source, background)[box], over(candidate, background)[box]) for background in (SKY, GREY)]
    dissimilarity = sum((1 - similarity(a, b)).sum(dtype=np.float64) for a, b in pairs) / (2 * union.size)
    figures = (
        flip(source, candidate),
        1 - dissimilarity,
        np.minimum(ours, theirs).sum(dtype=np.float64) / union.sum(dtype=np.float64) if union.any() else 1.0,
        ours.sum(dtype=np.float64),
        np.abs(candidate.depth - source.depth)[both].mean(dtype=np.float64) if both.any() else np.nan,
    )
    return Scores(*(np.array([figure], np.float64) for figure in figures))


def flip(one: Picture, other: Picture) -> float:
    """FLIP between two pictures: mean over the window and both backgrounds."""
    union = np.maximum(one.color[..., 3], other.color[..., 3])
    box = _box(union > 0)
    errors = [flip_error(over(one, ground)[box], over(other, ground)[box]) for ground in (SKY, GREY)]
    return float(sum(error.sum(dtype=np.float64) for error in errors) / (2 * union.size))


def flips(ones: Iterable[Picture], others: Iterable[Picture]) -> Doubles:
    """FLIP of the pairs, (n,) float64. Pictures come from this thread, where OpenGL lives, while two others score."""
    pool = ThreadPoolExecutor(2)
    try:
        return np.array(list(pool.map(flip, ones, others)))
    finally:
        pool.shutdown(cancel_futures=True)


def score_all(score_view: Callable[..., Scores], *inputs: Iterable[Any]) -> Scores:
    """Apply `score_view` to the views' inputs, and put the views together in their order.

    Inputs are drawn from the iterables in this thread, where OpenGL lives, while two others score.
    """
    pool = ThreadPoolExecutor(2)
    try:
        views = list(pool.map(score_view, *inputs))
    finally:
        pool.shutdown(cancel_futures=True)  # an interrupt does not wait for the rest
    return Scores(*(np.concatenate(column) for column in zip(*map(astuple, views), strict=True)))


def brightness(picture: Picture) -> float:
    """The luminance of all that a picture shows, added up."""
    return float(picture.color[..., :3].sum(axis=(0, 1), dtype=np.float64) @ LUMINANCE)


def over(picture: Picture, background: tuple[float, float, float]) -> Floats:
    """Put a picture over a background, linear light: (h, w, 3) float32 in 0..1."""
    color, alpha = picture.color[..., :3], picture.color[..., 3:]
    composite: Floats = np.clip(color + (1 - alpha) * np.asarray(background, np.float32), 0, 1)
    return composite


def similarity(a: Floats, b: Floats) -> Doubles:
    """Structural similarity (SSIM) of two linear (h, w, 3) pictures, on their sRGB-encoded luminance: (h, w) float64.

    Gaussian window of 11 x 11 pixels, sigma 1.5 ([WBSS04] 3.2).
    """
    x, y = (to_srgb(image @ LUMINANCE) / 255 for image in (a, b))
    offsets = np.arange(-_SSIM_REACH, _SSIM_REACH + 1)
    window = np.exp(-(offsets**2) / (2 * 1.5**2))
    window /= window.sum()

    fields = np.stack([x, y, x * x, y * y, x * y])
    x, y, xx, yy, xy = correlate1d(correlate1d(fields, window, axis=1), window, axis=2)
    c1, c2 = 0.01**2, 0.03**2
    result: Doubles = (2 * x * y + c1) * (2 * (xy - x * y) + c2)
    result /= (x * x + y * y + c1) * (xx - x * x + yy - y * y + c2)
    return result


def _box(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """The rectangle around what is set, as far as the filters reach; everything where nothing is set."""
    if not mask.any():
        return slice(None), slice(None)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    top, left = (max(int(lines[0]) - _FLIP_REACH, 0) for lines in (rows, columns))
    return slice(top, rows[-1] + _FLIP_REACH + 1), slice(left, columns[-1] + _FLIP_REACH + 1)
