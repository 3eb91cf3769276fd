"""The shadows that a tree casts: on the ground, on itself, and as the sun's depth map has it."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from treebake.gl.light import DARK, Light
from treebake.gl.view import View
from treebake.model import Doubles, Floats
from treebake.verify.metrics import brightness
from treebake.verify.shaded import Ground, Shaded


@dataclass(frozen=True)
class Shadows:
    """ground_iou: of the shadows on the ground. self_shadow: part of the sunlight that its own shadow takes from what
    the viewer sees, and source_self_shadow the source's. depth_map_cm: mean difference of how far the sun's light
    comes, where it is stopped in both, reading the unit as a metre; None where nowhere; depth_map_iou: of where it is.
    """

    ground_iou: float
    self_shadow: float
    source_self_shadow: float
    depth_map_cm: float | None
    depth_map_iou: float


def shadows(
    source: Shaded,
    candidate: Shaded,
    points: Doubles,
    view: View,
    suns: Sequence[Light],
    ground: int,
    done: Callable[[int], None],
) -> tuple[Shadows, tuple[tuple[Floats, Floats], ...]]:
    """Compare the shadows of every sun; also gives those on the ground, source and candidate.

    points: as of `Shaded`. view: from where the trees' own shadows are seen. ground: pixels of its picture, a side.
    Raises GraphicsError.
    """
    common, union, stopped, either = 0.0, 0.0, 0, 0
    between: list[NDArray[np.float32]] = []
    lights = np.zeros((2, 2))  # source, candidate; with shadows, without
    grounds = []
    for light in suns:
        with closing(Ground(points, light, ground)) as below:
            (ours, one), (theirs, other) = (each.shadow(light, below) for each in (source, candidate))
        grounds.append((ours, theirs))
        common += float(np.minimum(ours, theirs).sum(dtype=np.float64))
        union += float(np.maximum(ours, theirs).sum(dtype=np.float64))
        here, there = np.isfinite(one), np.isfinite(other)
        stopped, either = stopped + int((here & there).sum()), either + int((here | there).sum())
        between.append(np.abs(one[here & there] - other[here & there]))
        sun = replace(light, sky=DARK, ground=DARK)
        for row, each in enumerate((source, candidate)):
            lights[row] += [brightness(each.picture(view, sun, shadows=behind)) for behind in (True, False)]
        done(1)
    taken = 1 - lights[:, 0] / np.maximum(lights[:, 1], 1e-12)
    together = np.concatenate(between)
    figures = Shadows(
        ground_iou=common / union if union else 1.0,
        self_shadow=float(taken[1]),
        source_self_shadow=float(taken[0]),
        depth_map_cm=100 * float(together.mean(dtype=np.float64)) if len(together) else None,
        depth_map_iou=stopped / either if either else 1.0,
    )
    return figures, tuple(grounds)
