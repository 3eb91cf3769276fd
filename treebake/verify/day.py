"""A tree through the hours of a day."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from treebake.gl.light import Light
from treebake.verify.cameras import Camera
from treebake.verify.metrics import brightness, flips
from treebake.verify.relit import Pair
from treebake.verify.shaded import Shaded


@dataclass(frozen=True)
class Day:
    """brightness: light that comes from the tree in all hours over what comes from the source; brightness_worst: of the
    hour farthest from 1. flip_ratio: mean FLIP of the hours over that of floor(1 px). Without a sun they count too.
    """

    hours: int
    brightness: float
    brightness_worst: float
    flip_ratio: float


def through_day(
    source: Shaded,
    candidate: Shaded,
    camera: Camera,
    height: int,
    hours: Sequence[Light],
    done: Callable[[int], None],
) -> tuple[Day, tuple[Pair, ...]]:
    """Compare from one camera in the light of every hour; also gives the pictures. Raises GraphicsError."""
    view, moved = camera.view(height), camera.view(height, shift=1.0)
    pictures: list[Pair] = []
    floors = []
    for light in hours:
        pictures.append((source.picture(view, light), candidate.picture(view, light)))
        floors.append(source.picture(moved, light))
        done(1)
    ours, theirs = zip(*pictures, strict=True)
    lights = np.array([[brightness(each) for each in pair] for pair in pictures])
    ratios = lights[:, 1] / np.maximum(lights[:, 0], 1e-12)
    figures = Day(
        hours=len(hours),
        brightness=float(lights[:, 1].sum() / max(lights[:, 0].sum(), 1e-12)),
        brightness_worst=float(ratios[np.abs(ratios - 1).argmax()]),
        flip_ratio=float(flips(ours, theirs).mean() / max(flips(ours, floors).mean(), 1e-12)),
    )
    return figures, tuple(pictures)
