"""The protocol: which views are drawn, what is measured in them, and how the figures are summed up."""

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock

import numpy as np

from treebake.errors import MeshError, SettingsError
from treebake.gl.draw import Drawing, renderer
from treebake.gl.target import Picture
from treebake.images import flip_error
from treebake.model import Doubles, Floats, Layers, Mesh
from treebake.verify.cameras import CLOSE_UP, Camera, CloseUp, cameras
from treebake.verify.cost import Cost, cost_of
from treebake.verify.figures import Figures, summed_up
from treebake.verify.metrics import SKY, Scores, over, score, score_all
from treebake.verify.morph import Morphing
from treebake.verify.reference import SCALE, reference
from treebake.verify.thresholds import CLOSE, failures, parse
from treebake.verify.turn import Turn, turn

LOG = logging.getLogger("treebake")

REPRESENTATIONS = ("cloud", "cloud_same_bytes", "indirect", "leaves", "slicings", "views")
JUDGED = (
    "cloud",
    "indirect",
    "leaves",
    "slicings",
    "views",
    "candidate",
)  # by the thresholds; the others are there to compare with
_QUICK_HEIGHT = 256


@dataclass(frozen=True)
class VerifySettings:
    """How a candidate is judged."""

    heights: tuple[int, ...] = (512, 256, 128, 64)  # heights of the source's bounding sphere, pixels, each 16 to 2048
    elevations: tuple[float, ...] = (0.0, 25.0, 60.0)  # degrees above the horizon, -90 to 90
    azimuths: int = 8  # evenly spaced views around the tree at each elevation, 1 or more
    quick: bool = False  # only a third of the views, only at 256 pixels, and not close up
    turn: int = 0  # height in pixels at which the tree is looked at from all round; 0: it is not, or 16 to 2048
    frames: int = 360  # of that turn, 2 or more
    morph: int = 0  # steps in which each level of a cloud is morphed into the next where it ends; 0: it is not, to 64
    representations: tuple[str, ...] = ()  # of an asset: "cloud", "cloud_same_bytes", "indirect", "leaves",
    # "slicings", "views"; none given: all
    thresholds: dict[str, float | dict[str, float]] = field(default_factory=dict)
    # bounds on the candidate's figures: a figure's name, with _min or _max (default), to a value, or to one per height,
    # e.g. { flip_ratio = { 512 = 1.2, close = 1.0 }, coverage_min = 0.98 }


@dataclass(frozen=True, eq=False)
class Sample:
    """One view to look at, over the sky: source and candidate (h, w, 3) float32 linear, flip (h, w) float32."""

    camera: Camera | CloseUp
    source: Floats
    candidate: Floats
    flip: Floats


@dataclass(frozen=True, eq=False)
class Level:
    """Everything measured at one height, and each elevation's worst view."""

    height: int
    candidate: Figures
    floor_half: Figures
    floor_one: Figures
    empty: Figures
    samples: tuple[Sample, ...]

    @property
    def invisible(self) -> bool:
        """Whether the candidate differs no more from the source than the source moved by one pixel."""
        return self.candidate.flip_ratio is not None and self.candidate.flip_ratio <= 1


@dataclass(frozen=True, eq=False)
class Report:
    """What `verify` found.

    levels: one per height, greatest first. close_up: the crown's edge, its height that of the window; None where it was
    not looked at. turn, morphs: once round the tree, and each level of a cloud into the next, where that was asked for.
    views: cameras at each height. renderer: the OpenGL that drew. misses: the thresholds that the candidate missed, one
    line each.
    """

    levels: tuple[Level, ...]
    close_up: Level | None
    turn: Turn | None
    views: int
    renderer: str
    misses: tuple[str, ...]
    morphs: tuple[Morphing, ...] = ()


def verify(
    source: Mesh,
    candidate: Mesh | Mapping[int, Mesh],
    settings: VerifySettings | None = None,
    cache: Path | None = None,
    *,
    layers: Layers | None = None,
    trunk: Mesh | None = None,
    close: Sequence[CloseUp] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Report:
    """Measure how a candidate differs from its source, both drawn as a stock glTF client draws them.

    candidate: one mesh, or one for each height; the greatest one's is looked at close up. layers: what belongs to the
    candidate and is drawn by its own shader. close: from where to look close up. cache: a folder where the source's
    pictures and floors are kept, so that only the candidate is drawn the next time. trunk: the part of the
    source that is not foliage; without it, foliage_coverage is of the whole tree. progress: called with the views done
    and to do, from any thread, one call at a time. O(heights x views x (faces + pixels)).

    Raises MeshError for an empty source, SettingsError and GraphicsError.
    """
    settings = settings or VerifySettings()
    heights, directions = _plan(source, settings)
    candidates = candidate if isinstance(candidate, Mapping) else dict.fromkeys(heights, candidate)
    if missing := [height for height in heights if height not in candidates]:
        raise SettingsError(f"no candidate for {missing[0]} px; give one mesh per height, or leave out that height")

    close = () if settings.quick else close
    frames = settings.frames if settings.turn and not settings.quick else 0
    tally = _Tally(2 * (len(heights) * len(directions) + len(close)) + frames, progress)

    def level(mesh: Mesh, views: Sequence[Camera | CloseUp], height: int) -> Level:
        return _level(source, trunk, mesh, layers, views, height, cache, tally)

    levels = tuple(level(candidates[height], directions, height) for height in heights)
    close_up = level(candidates[heights[0]], close, CLOSE_UP) if close else None
    around = turn(source, candidates[heights[0]], layers, settings.turn, frames, tally) if frames else None
    measured: list[tuple[int | str, Figures]] = [(level.height, level.candidate) for level in levels]
    if close_up:
        measured.append((CLOSE, close_up.candidate))
    return Report(levels, close_up, around, len(directions), renderer(), failures(measured, settings.thresholds))


def _plan(source: Mesh, settings: VerifySettings) -> tuple[list[int], tuple[Camera, ...]]:
    for bad, what in (
        (
            not settings.heights or not all(16 <= height <= 2048 for height in settings.heights),
            "heights: 16 to 2048, 1 or more",
        ),
        (
            not settings.elevations or not all(-90 <= e <= 90 for e in settings.elevations),
            "elevations: -90 to 90, 1 or more",
        ),
        (settings.azimuths < 1, "azimuths: 1 or more"),
        (settings.turn and not 16 <= settings.turn <= 2048, "turn: 0 or 16 to 2048"),
        (settings.frames < 2, "frames: 2 or more"),
        (not 0 <= settings.morph <= 64, "morph: 0 to 64"),
    ):
        if bad:
            raise SettingsError(f"verify.{what}")
    for name in settings.representations:
        if name not in REPRESENTATIONS:
            known = ", ".join(REPRESENTATIONS)
            raise SettingsError(f"verify.representations: there is no {name}; known are {known}")
    if not source.triangles:
        raise MeshError("the source has no triangles, so nothing can be compared with it; give the tree that was baked")
    directions = cameras(source, settings.elevations, settings.azimuths)
    heights = [_QUICK_HEIGHT] if settings.quick else sorted(set(settings.heights), reverse=True)
    # A slip in the thresholds should not take minutes to show, nor pass as success.
    asked = {height for _, _, height, _ in parse(settings.thresholds) if isinstance(height, int)}
    if unknown := asked - set(settings.heights):
        raise SettingsError(f"verify.thresholds: {min(unknown)} px is not among verify.heights; measure it or drop it")
    if settings.quick and (settings.turn or settings.morph):
        LOG.warning(
            "a quick run does not walk round the tree, nor morph it; leave out --quick, or verify.turn and morph"
        )
    if unseen := asked - set(heights):
        LOG.warning("thresholds at %s px are not judged: a quick run measures %d px only", _list(unseen), heights[0])
    return heights, directions[SCALE] if settings.quick else directions


def _list(heights: set[int]) -> str:
    return ", ".join(map(str, sorted(heights, reverse=True)))


@dataclass
class _Tally:
    """Counts the views done, from whichever thread, and tells."""

    total: int
    progress: Callable[[int, int], None] | None
    done: int = 0
    lock: Lock = field(default_factory=Lock)

    def __call__(self, views: int) -> None:
        with self.lock:
            self.done += views
            if self.progress:
                self.progress(self.done, self.total)


def _level(
    source: Mesh,
    trunk: Mesh | None,
    candidate: Mesh,
    layers: Layers | None,
    directions: Sequence[Camera | CloseUp],
    height: int,
    cache: Path | None,
    scored: Callable[[int], None],
) -> Level:
    known = reference(source, trunk, directions, height, cache, scored)
    views = [camera.view(height) for camera in directions]

    def judge(index: int, picture: Picture) -> Scores:
        result = score(known.picture(index), picture)
        scored(1)
        return result

    with closing(Drawing(candidate, layers)) as drawing:
        scores = score_all(judge, range(len(views)), map(drawing.picture, views))
        fragments = np.array([drawing.fragments(view) for view in views])
        samples = tuple(
            _sample(directions[index], known.picture(index), drawing.picture(views[index]))
            for index in _worst_of_each_elevation(directions, scores.flip)
        )

    def figures(scores: Scores, cost: Cost, fragments: Doubles, views: slice = slice(None)) -> Figures:
        return summed_up(scores, known, views, cost, fragments[views])

    return Level(
        height=height,
        candidate=figures(scores, cost_of(candidate, layers), fragments),
        floor_half=figures(known.floor_half, cost_of(source), known.fragments, SCALE),
        floor_one=figures(known.floor_one, cost_of(source), known.fragments),
        empty=figures(known.empty, Cost(0, 0, 0), np.zeros(len(views)), SCALE),
        samples=samples,
    )


def _sample(camera: Camera | CloseUp, source: Picture, candidate: Picture) -> Sample:
    ours, theirs = over(source, SKY), over(candidate, SKY)
    return Sample(camera, ours, theirs, flip_error(ours, theirs))


def _worst_of_each_elevation(directions: Sequence[Camera | CloseUp], flip: Doubles) -> list[int]:
    elevations = np.array([camera.elevation for camera in directions])
    return [int(np.argmax(np.where(elevations == elevation, flip, -1))) for elevation in np.unique(elevations)]
