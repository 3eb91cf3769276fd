"""A tree relit by suns that nothing was baked or fitted with."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.gl.draw import Drawing
from treebake.gl.light import Light
from treebake.gl.target import Picture
from treebake.model import Mesh
from treebake.verify.cameras import Camera
from treebake.verify.metrics import flips
from treebake.verify.shaded import Shaded

_NOTHING = 1e-6  # FLIP
_SAME_PLACE = 1e-3  # of the tree's radius, by which depths that are the same may differ

Pair = tuple[Picture, Picture]  # source, candidate


@dataclass(frozen=True)
class Relit:
    """flip, flip_ratio: mean FLIP of the views, and over that of floor(1 px) under the same suns; flip_ratio_worst: of
    the worst sun. leaf_depth: mean difference of the depth of what the viewer sees of the foliage, over a leaf's
    length; None without leaves.
    """

    flip: float
    flip_ratio: float
    flip_ratio_worst: float
    leaf_depth: float | None


@dataclass(frozen=True, eq=False)
class Crown:
    """The part of a source that is leaves. leaf: length of one, in its unit."""

    mesh: Mesh
    leaf: float


def relit(
    source: Shaded,
    candidate: Shaded,
    crown: Crown | None,
    height: int,
    views: Sequence[Camera],
    suns: Sequence[Light],
    done: Callable[[int], None],
) -> tuple[Relit, tuple[Pair, ...]]:
    """Compare in every view, each under the next of the suns; also gives the first picture of each sun.

    O(views (faces + pixels + texels of the shadow map)). Raises GraphicsError.
    """
    under = [number % len(suns) for number in range(len(views))]
    pictures: list[Pair] = []
    floors = []
    for camera, sun in zip(views, under, strict=True):
        view = camera.view(height)
        pictures.append((source.picture(view, suns[sun]), candidate.picture(view, suns[sun])))
        floors.append(source.picture(camera.view(height, shift=1.0), suns[sun]))
        done(1)
    ours, theirs = zip(*pictures, strict=True)
    errors, floor = flips(ours, theirs), flips(ours, floors)
    of_sun = [slice(sun, None, len(suns)) for sun in range(min(len(suns), len(views)))]
    # Where the source is seen edge-on, what is moved is the same.
    by_sun = [errors[seen].mean() / floor[seen].mean() for seen in of_sun if floor[seen].mean() > _NOTHING]
    figures = Relit(
        flip=float(errors.mean()),
        flip_ratio=float(errors.mean() / max(floor.mean(), 1e-12)),
        flip_ratio_worst=float(max(by_sun, default=0.0)),
        leaf_depth=_leaf_depth(crown, pictures, height, views) if crown else None,
    )
    return figures, tuple(pictures[: len(suns)])


def _leaf_depth(crown: Crown, pictures: Sequence[Pair], height: int, views: Sequence[Camera]) -> float | None:
    """Where the source shows leaves and the candidate anything."""
    differences = []
    with closing(Drawing(crown.mesh, exact_cutouts=True)) as drawing:
        for camera, (source, candidate) in zip(views, pictures, strict=True):
            leaves = drawing.picture(camera.view(height))
            first = np.abs(leaves.depth - source.depth) < _SAME_PLACE * camera.radius
            both = _covers(leaves) & _covers(source) & _covers(candidate) & first
            differences.append(np.abs(candidate.depth - source.depth)[both])
    together = np.concatenate(differences)
    return float(together.mean(dtype=np.float64)) / crown.leaf if len(together) else None


def _covers(picture: Picture) -> NDArray[np.bool_]:
    return np.asarray(picture.color[..., 3] >= 0.5)
