"""What someone sees where one level goes over into the next: steps of its morph, and what is left to jump.

What is left is the atlas, not the place of the leaves: on the chestnut it is 1.66, 1.77, 1.67, 1.35 and 1.15 from level
to level, without a morph 1.90, 1.91, 1.77, 1.55 and 1.28; and the same planes baked anew at the next level's texels a
pixel and height differ by 1.74 (278 planes, 128 pixels), 1.66 (107, 64) and 1.47 (32, 48).
"""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from treebake.gl.draw import Drawing
from treebake.gl.target import Picture
from treebake.model import Mesh
from treebake.verify.cameras import Camera
from treebake.verify.metrics import flips
from treebake.verify.reference import reference


@dataclass(frozen=True)
class Morphing:
    """A level at the least height that it is for, and the next one; FLIP, mean of the views, over that of floor(1 px).

    level: its number, 0 the nearest. step: the largest from one weight to the next, in `steps` equal steps from 0 to 1.
    last: from weight 1 to the next level. jump: from weight 0 to the next level, what would be seen without the morph.
    """

    level: int
    height: int
    steps: int
    step: float
    last: float
    jump: float


def morphings(
    source: Mesh, levels: Sequence[tuple[Mesh, int]], views: Sequence[Camera], steps: int, cache: Path | None
) -> tuple[Morphing, ...]:
    """Sweep every level but the last from weight 0 to 1 and on to the next. O(levels x steps x views (faces + pixels)).

    levels: from near to far, each with the least height in pixels that it is for. cache: as for `verify`.
    Raises GraphicsError.
    """
    found = []
    for number, ((mesh, height), (coarser, _)) in enumerate(pairwise(levels)):
        floor = reference(source, None, views, height, cache, lambda _: None).floor_one.flip.mean()
        first = before = _drawn(mesh.morphed(0), views, height)
        largest = 0.0
        for weight in np.linspace(0, 1, steps + 1)[1:]:
            after = _drawn(mesh.morphed(float(weight)), views, height)
            largest, before = max(largest, _flip(before, after)), after
        following = _drawn(coarser.morphed(0), views, height)
        last, jump = _flip(before, following), _flip(first, following)
        found.append(Morphing(number, height, steps, *(float(value / floor) for value in (largest, last, jump))))
    return tuple(found)


def _drawn(mesh: Mesh, views: Sequence[Camera], height: int) -> list[Picture]:
    with closing(Drawing(mesh)) as drawing:
        return [drawing.picture(view.view(height)) for view in views]


def _flip(before: Sequence[Picture], after: Sequence[Picture]) -> float:
    return float(flips(before, after).mean())
