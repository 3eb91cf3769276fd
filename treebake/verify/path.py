"""The way that a forest is looked at: a walk into it at eye level, then a flight up and back until all is in view."""

import math
from dataclasses import dataclass

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.view import View, looking
from treebake.model import Doubles, Forest

_EYE = 0.17  # height of the eye over the ground, in median tree heights: a person before a tree of ten metres
_LANES = 41  # parallel ways that are compared for the one that stays clear of trunks
_UP = 40.0  # degrees that the flight ends looking down


@dataclass(frozen=True, eq=False)
class Eye:
    """place: (3,) float64, where the viewer is. elevation: degrees that it looks down, otherwise along -Z."""

    place: Doubles
    elevation: float


def path(forest: Forest, heights: Doubles, reach: float, frames: int, field_of_view: float) -> list[Eye]:
    """Half of the frames walk from the forest's edge to its middle, half fly up from there.

    heights: (n,) float64 of the trees, in the world. reach: by which a tree's origin may lie inside what is to be seen.
    field_of_view: degrees, from top to bottom.
    """
    ground = forest.places[:, [0, 2]].astype(np.float64)
    height = float(np.median(heights)) if len(heights) else 1.0
    radius = float(np.linalg.norm(ground, axis=1).max(initial=0.0)) + reach
    lane = _clear_lane(ground, radius, reach)
    walk = (frames + 1) // 2
    first = [Eye(np.array([lane, _EYE * height, z]), 0.0) for z in np.linspace(radius, 0.0, walk)]
    away = (radius + reach) / math.sin(math.radians(field_of_view / 2))
    up = math.radians(_UP)
    last = np.array([0.0, away * math.sin(up), away * math.cos(up)])
    flight = np.linspace(0, 1, frames - walk + 1)[1:]
    return first + [Eye(first[-1].place + part**2 * (last - first[-1].place), _UP * part) for part in flight]


def view_of(
    eye: Eye, window: tuple[int, int], field_of_view: float, depths: tuple[float, float], shift: float = 0.0
) -> View:
    """What is seen from there between two depths, (width, height) pixels large, moved right by `shift` pixels."""
    width, height = window
    scale = 1 / math.tan(math.radians(field_of_view / 2))
    return looking(turn_to(eye.elevation, 0.0), eye.place, scale, depths, height, shift, width / height)


def _clear_lane(ground: Doubles, radius: float, reach: float) -> float:
    """The x near the middle whose line along z stays farthest from every tree that stands on the way."""
    lanes = np.linspace(-2 * reach, 2 * reach, _LANES)
    passed = ground[(ground[:, 1] > -reach) & (ground[:, 1] < radius)]
    if not len(passed):
        return 0.0
    clear = np.abs(passed[:, :1] - lanes).min(axis=0)
    return float(lanes[int(clear.argmax())])
