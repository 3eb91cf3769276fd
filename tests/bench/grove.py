"""How long a grove takes to draw: each tree as its source's triangles, or as what stands in for it.

A window of 640 x 480 pixels as in [J00], one sample a pixel; trees of a jittered grid, each turned otherwise; the
camera walks round the grove at eye level. Trees that lie outside of the view are left out on both sides.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.context import context, leave_framebuffer
from treebake.gl.draw import Drawing
from treebake.gl.view import Grove, View, looking
from treebake.model import Layers, Mesh

WINDOW = (640, 480)
_FIELD = math.radians(45)  # of view, from top to bottom
_FRAMES, _REPEATS = 8, 3
_EYE = 1.7  # height over the trees' feet, metres


@dataclass(frozen=True)
class Times:
    """Seconds of the worst frame: of the sources, and of what stands in for them."""

    source: float
    stand_in: float

    @property
    def ratio(self) -> float:
        """How many times faster the stand-ins are."""
        return self.source / self.stand_in


def distance_of(source: Mesh, height: float) -> float:
    """How far away a tree's bounding sphere is `height` pixels high."""
    return float(np.linalg.norm(np.ptp(source.bounds, axis=0))) / height * WINDOW[1] / 2 / math.tan(_FIELD / 2)


def compare(source: Mesh, rest: Mesh, layers: Layers, count: int, spacing: float, nearest: float) -> Times:
    """Draw count x count trees, `spacing` metres apart, the nearest one `nearest` metres away.

    rest: what is drawn as triangles beside the layers.
    """
    gl = context()
    target = gl.framebuffer([gl.texture(WINDOW, 4)], gl.depth_renderbuffer(WINDOW))
    grove = _grove(count, spacing)
    radius = float(np.linalg.norm(source.bounds, axis=1).max())
    with closing(Drawing(source)) as whole, closing(Drawing(rest, layers)) as light:
        frames = list(_frames(source, grove, nearest))
        for drawing in (whole, light):  # the first picture compiles
            _draw(gl, target, drawing, frames[0], grove)
        worst = []
        for drawing in (whole, light):
            times = []
            for view in frames:
                seen = _seen(view, grove, radius)
                times.append(
                    median(
                        _timed(lambda v=view, s=seen, d=drawing: _draw(gl, target, d, v, s)) for _ in range(_REPEATS)
                    )
                )
            worst.append(max(times))
    leave_framebuffer()
    target.release()
    return Times(*worst)


def _grove(count: int, spacing: float) -> Grove:
    rng = np.random.default_rng(0)
    line = (np.arange(count) - (count - 1) / 2) * spacing
    x, z = (axis.ravel() for axis in np.meshgrid(line, line))
    places = np.stack([x, np.zeros_like(x), z, np.ones_like(x)], axis=1)
    places[:, [0, 2]] += rng.uniform(-0.2, 0.2, (len(places), 2)) * spacing
    return Grove(places.astype(np.float32), rng.uniform(0, 2 * np.pi, len(places)).astype(np.float32))


def _frames(source: Mesh, grove: Grove, nearest: float) -> Iterator[View]:
    """From all round, as near as `nearest` to the nearest tree."""
    for azimuth in 360.0 * np.arange(_FRAMES) / _FRAMES:
        turn = turn_to(0.0, float(azimuth))
        ahead = grove.places[:, :3] @ turn[2]
        aside = np.abs(grove.places[:, :3] @ turn[0])
        distance = float((ahead + np.sqrt(np.maximum(nearest**2 - aside**2, 0))).max())
        eye = turn[2] * distance + [0, float(source.bounds[0, 1]) + _EYE, 0]
        depths = 0.5, 3 * distance
        yield looking(turn, eye, 1 / math.tan(_FIELD / 2), depths, WINDOW[1], 0.0, WINDOW[0] / WINDOW[1])


def _seen(view: View, grove: Grove, radius: float) -> Grove:
    """The trees of which something may be in view."""
    points = np.column_stack([grove.places[:, :3], np.ones(len(grove.places))])
    inside = points @ view.to_clip[3] > -radius
    for axis in (0, 1):
        edges = np.stack([view.to_clip[3] + view.to_clip[axis], view.to_clip[3] - view.to_clip[axis]])
        away = points @ edges.T
        inside &= (away > -radius * np.linalg.norm(edges[:, :3], axis=1)).all(axis=1)
    return grove.select(inside)


def _draw(gl: Any, target: Any, drawing: Drawing, view: View, grove: Grove) -> None:
    target.use()
    target.depth_mask = True
    target.clear()
    with gl.scope(target, gl.DEPTH_TEST):
        drawing.draw_solid(view, target, grove)
        drawing.draw_blended(view, target, grove)
    gl.finish()


def _timed(work: Callable[[], None]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
