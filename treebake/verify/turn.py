"""What someone sees who walks round a tree: whether it changes brightness, and whether it pops."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from treebake.gl.draw import Drawing
from treebake.gl.target import Picture
from treebake.images import LUMINANCE, flip_error
from treebake.model import Doubles, Layers, Mesh
from treebake.verify.cameras import cameras
from treebake.verify.metrics import GREY, SKY, over

_AT_ONCE = 12  # frames kept in memory


@dataclass(frozen=True)
class Turn:
    """One turn round a tree at elevation 0, in `frames` equal steps, its bounding sphere `height` pixels high.

    brightness: luminance of the candidate over the source's, mean of the turn; brightness_worst: of the frame that is
    farthest from 1. Both are of all pixels that either covers, over both backgrounds. step: FLIP from one frame to the
    next over the source's own between the same two frames, at its largest.
    """

    height: int
    frames: int
    brightness: float
    brightness_worst: float
    step: float


def turn(
    source: Mesh,
    candidate: Mesh,
    layers: Layers | None,
    height: int,
    frames: int,
    done: Callable[[int], None],
) -> Turn:
    """Draw both from every frame's view and compare. O(frames (faces + pixels)). Raises GraphicsError."""
    views = [camera.view(height) for camera in cameras(source, (0.0,), frames)]
    lights, steps = [], []  # (frames, 2) each: source, candidate
    with (
        closing(Drawing(source, exact_cutouts=True)) as reference,
        closing(Drawing(candidate, layers)) as drawing,
        ThreadPoolExecutor(2) as pool,
    ):
        before = [(reference.picture(views[-1]), drawing.picture(views[-1]))]
        for first in range(0, frames, _AT_ONCE):
            shown = [(reference.picture(view), drawing.picture(view)) for view in views[first : first + _AT_ONCE]]
            chain = before[-1:] + shown
            lights += [_lights(*pair) for pair in shown]
            steps += list(pool.map(_steps, chain[:-1], chain[1:]))
            before = shown
            done(len(shown))
    light, step = np.array(lights), np.array(steps)
    ratios = light[:, 1] / np.maximum(light[:, 0], 1e-12)
    return Turn(
        height=height,
        frames=frames,
        brightness=float(light[:, 1].sum() / max(light[:, 0].sum(), 1e-12)),
        brightness_worst=float(ratios[np.abs(ratios - 1).argmax()]),
        step=float((step[:, 1] / np.maximum(step[:, 0], 1e-12)).max()),
    )


def _lights(source: Picture, candidate: Picture) -> Doubles:
    either = (source.color[..., 3] > 0) | (candidate.color[..., 3] > 0)
    pictures = (source, candidate)
    return np.array(
        [sum(float((over(each, ground)[either] @ LUMINANCE).sum()) for ground in (SKY, GREY)) for each in pictures]
    )


def _steps(before: Sequence[Picture], after: Sequence[Picture]) -> list[float]:
    return [
        sum(float(flip_error(over(a, ground), over(b, ground)).mean()) for ground in (SKY, GREY))
        for a, b in zip(before, after, strict=True)
    ]
