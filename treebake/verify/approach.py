"""What someone sees who walks up to a tree that changes its rungs: whether it pops."""

import math
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from treebake.asset import Asset
from treebake.geometry import turn_to
from treebake.gl.draw import Drawing
from treebake.gl.scene import Scene
from treebake.gl.view import ONE_TREE, View, looking
from treebake.model import Doubles, Mesh
from treebake.verify.cameras import FIELD_OF_VIEW, MARGIN
from treebake.verify.metrics import flips
from treebake.verify.stands import Kind, Trees, kind_of, stands
from treebake.verify.switching import FADE

_NEARER = 1.01  # from frame to frame: a step of 14 cm at 14 m
_AROUND = 1.05  # of the heights between which a rung changes, that is looked at beside them
_AZIMUTH = 20.0  # degrees, of the way that is walked: in step with no usual number of pictures


@dataclass(frozen=True)
class Change:
    """One change of rungs. height: pixels at which it begins. step: the largest FLIP between two frames that follow one
    another, over the source's own between the same two.
    """

    height: int
    nearer: str
    farther: str
    step: float


def approach(asset: Asset, source: Mesh) -> tuple[Change, ...]:
    """Walk up to one tree through every change of its ladder, at elevation 0. O(changes (faces + pixels)).

    Raises AssetError and GraphicsError.
    """
    ladder = asset.manifest.ladder
    changes = []
    with ExitStack() as stack:
        ours = kind_of(asset, source, stack)
        center, radius = ours.center, ours.radius
        whole = stack.enter_context(closing(Drawing(source, exact_cutouts=True)))
        theirs = Kind(center, radius, (whole,), (0,))
        for nearer, farther in pairwise(ladder):
            top = nearer.min_height * _AROUND
            size = math.ceil(top) + MARGIN
            scene = stack.enter_context(closing(Scene((size, size))))
            steps = math.ceil(math.log(FADE * _AROUND**2) / math.log(_NEARER))
            views = [_view(center, radius, top / _NEARER**step, size) for step in range(steps + 1)]
            mine, own = (_steps(scene, views, kind) for kind in (ours, theirs))
            largest = float((mine / np.maximum(own, 1e-9)).max())
            changes.append(Change(nearer.min_height, nearer.representation, farther.representation, largest))
    return tuple(changes)


def _view(center: Doubles, radius: float, height: float, size: int) -> View:
    """From where the sphere is `height` pixels high, in a window of `size` pixels a side."""
    turn = turn_to(0.0, _AZIMUTH)
    scale = 1 / math.tan(math.radians(FIELD_OF_VIEW / 2))
    distance = radius * size * scale / height
    return looking(turn, center + distance * turn[2], scale, (distance - 2 * radius, distance + 2 * radius), size, 0.0)


def _steps(scene: Scene, views: Sequence[View], kind: Kind) -> Doubles:
    """FLIP from each frame to the next: (n - 1,) float64."""
    one = Trees(ONE_TREE, np.zeros(1, np.int32), kind.center[None], np.array([kind.radius]))
    pictures = [scene.picture(view, stands(view, one, np.zeros(1, np.intp), [kind])) for view in views]
    return flips(pictures[:-1], pictures[1:])
