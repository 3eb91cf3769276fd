"""Fit the brightness of what stands in for a tree to renders of the tree ([J00] 2.3, which guesses it).

Blended slicings and views let the background through, and parallel pictures show leaves at other angles than a viewer
sees them. So the correction's multiplier m is the one at which as much is covered as by the source, all the way round,
and an exposure makes up for the rest of the difference in light.
"""

import math
from contextlib import closing
from dataclasses import replace
from typing import TypeVar

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.draw import Drawing
from treebake.gl.view import View, looking
from treebake.images import LUMINANCE
from treebake.model import Doubles, Mesh, Slicings, Views

StandIn = TypeVar("StandIn", Slicings, Views)

_AZIMUTHS = 7  # views around the tree: with no usual number of orientations in step
_HALF_VIEW = math.radians(17.5)  # that the tree's bounding sphere fills
_MULTIPLIERS = np.array([0.0, 0.6, 1.2, 3.0])  # at which the stand-in is drawn; others are interpolated
_EXPOSURES = (0.4, 2.0)  # soft light alone doubles that of leaves which all stand on edge to the sun


def fit_brightness(stand_in: StandIn, rest: Mesh, source: Mesh, height: int) -> StandIn:
    """The stand-in with its multiplier and exposure. O(views (faces + pixels)).

    rest: what is drawn with it. source: the tree that both stand for. height: pixels of the tree's bounding sphere at
    which they are compared.
    """
    middle = source.bounds.astype(np.float64).mean(axis=0)
    radius = float(np.linalg.norm(source.positions[source.used] - middle, axis=1).max(initial=0)) or 1.0
    views = [_around(middle, radius, 360.0 * step / _AZIMUTHS, height) for step in range(_AZIMUTHS)]
    with closing(Drawing(source, exact_cutouts=True)) as drawing:
        wanted = np.array([_seen(drawing, view) for view in views])
    shown = np.flatnonzero(wanted.all(axis=1))  # a leaf seen from its edge shows nothing
    if not len(shown):
        return stand_in
    views, wanted = [views[i] for i in shown], wanted[shown]
    drawn = []
    for multiplier in _MULTIPLIERS:
        with closing(Drawing(rest, replace(stand_in, brightness=float(multiplier), exposure=1.0))) as drawing:
            drawn.append([_seen(drawing, view) for view in views])
    areas, lights = np.moveaxis(np.array(drawn) / wanted, 2, 0)  # (multipliers, views) each
    fine = np.linspace(_MULTIPLIERS[0], _MULTIPLIERS[-1], 301)
    errors = sum((np.interp(fine, _MULTIPLIERS, column) - 1) ** 2 for column in areas.T)
    multiplier = float(fine[int(np.argmin(errors))])
    light = np.mean([np.interp(multiplier, _MULTIPLIERS, column) for column in lights.T])
    return replace(stand_in, brightness=multiplier, exposure=float(np.clip(1 / max(light, 1e-6), *_EXPOSURES)))


def _around(middle: Doubles, radius: float, azimuth: float, height: int) -> View:
    turn = turn_to(0.0, azimuth)
    distance = radius / math.sin(_HALF_VIEW)
    depths = distance - 1.5 * radius, distance + 1.5 * radius
    return looking(turn, middle + distance * turn[2], 1 / math.tan(_HALF_VIEW), depths, height, 0.0)


def _seen(drawing: Drawing, view: View) -> tuple[float, float]:
    """The area that is covered, and the light that comes from it."""
    color = drawing.picture(view).color.sum(axis=(0, 1), dtype=np.float64)
    return float(color[3]), float(color[:3] @ LUMINANCE)
