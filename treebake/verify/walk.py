"""A forest drawn by its ladder next to the same forest drawn as its sources, frame by frame along a path."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from treebake.asset import Asset
from treebake.checks import check
from treebake.errors import AssetError, SettingsError
from treebake.gl.draw import Drawing, renderer
from treebake.gl.scene import Scene, Stand
from treebake.gl.target import Picture
from treebake.gl.view import View
from treebake.model import Doubles, Floats, Forest, Mesh
from treebake.verify.cameras import bounding_sphere
from treebake.verify.metrics import SKY, flip, over
from treebake.verify.path import path, view_of
from treebake.verify.stands import Kind, Trees, kind_of, seen, stands

_TRIMMED = 0.05  # of the frames, the slowest, which the worst frame is not looked for among ([J00] 4)
_REPEATS = 3  # times that a frame is drawn for its time
_LONG = 1.0  # seconds, of drawing a frame, after which it is not drawn again
_NEAREST = 0.02  # depth that is seen, in the radius of the smallest tree


@dataclass(frozen=True)
class WalkSettings:
    """How a forest is looked at."""

    width: int = 640  # pixels of the window, 64 to 4096; by default [J00]'s
    height: int = 480  # pixels, 64 to 4096
    field_of_view: float = 45.0  # degrees from top to bottom, 10 to 120
    frames: int = 24  # of the path, half walked and half flown, 2 or more
    compared: int = 8  # of these frames, evenly spread, in which the source is drawn too, 0 or more


@dataclass(frozen=True)
class Frame:
    """One frame. trees: in view. milliseconds: of one drawing with a sample a pixel. overdraw: fragments asked for per
    pixel of the window. flip_ratio: FLIP over floor(1 px) of the same frame. None where the source was not drawn.
    """

    trees: int
    milliseconds: float
    triangles: int
    draw_calls: int
    overdraw: float
    source_milliseconds: float | None = None
    flip: float | None = None
    flip_ratio: float | None = None


@dataclass(frozen=True, eq=False)
class Walk:
    """What was found along the path.

    worst: milliseconds of the slowest frame, without the slowest 5 % where there are 20 frames or more.
    speed_up_worst: the source's over ours, each at its worst, of the compared frames; speed_up_mean: of their mean
    times. flip_ratio: mean FLIP over the mean floor. None where no frame was compared. gpu_bytes: of all rungs of all
    species. samples: the compared frames that differ most, source and ours, (h, w, 3) float32 linear.
    """

    renderer: str
    frames: tuple[Frame, ...]
    worst: float
    mean: float
    speed_up_worst: float | None
    speed_up_mean: float | None
    flip_ratio: float | None
    gpu_bytes: int
    samples: tuple[tuple[Floats, Floats], ...]


def walk(
    forest: Forest,
    assets: Mapping[str, Asset],
    sources: Mapping[str, Mesh],
    settings: WalkSettings,
    progress: Callable[[int, int], None] | None = None,
    along: Forest | None = None,
) -> Walk:
    """Draw the frames of the path. O(frames x trees x faces).

    assets, sources: of each species of the forest. along: another forest of the same species, whose path is walked.
    Raises AssetError where an asset has no ladder, SettingsError where
    a source is missing or a setting is out of range, and GraphicsError.
    """
    _check(settings)
    for name in forest.names:
        if name not in sources:
            raise SettingsError(f"there is no source of {name}; name its file with --source, as {name}.glb")
        if not assets[name].manifest.ladder:
            raise AssetError(f"{assets[name].folder} has no ladder; bake it with ladder.enabled = true")
    with ExitStack() as stack:

        def alone(source: Mesh, exact: bool) -> Kind:
            drawing = stack.enter_context(closing(Drawing(source, exact_cutouts=exact)))
            return Kind(*bounding_sphere(source), (drawing,), (0,))

        ours = [kind_of(assets[name], sources[name], stack) for name in forest.names]
        theirs, exact = ([alone(sources[name], cut) for name in forest.names] for cut in (False, True))
        scene = stack.enter_context(closing(Scene((settings.width, settings.height))))
        return _Walker(forest, ours, theirs, exact, scene, settings).go(
            along or forest,
            sum(rung.gpu_bytes for name in forest.names for rung in assets[name].manifest.ladder),
            progress,
        )


def _check(settings: WalkSettings) -> None:
    rules = (
        ("width", 64 <= settings.width <= 4096, "64 to 4096"),
        ("height", 64 <= settings.height <= 4096, "64 to 4096"),
        ("field_of_view", 10 <= settings.field_of_view <= 120, "10 to 120"),
        ("frames", settings.frames >= 2, "2 or more"),
        ("compared", 0 <= settings.compared <= settings.frames, "0 to frames"),
    )
    check("walk", settings, rules)


@dataclass(frozen=True, eq=False)
class _Walker:
    """The forest three times: by its ladder, as its sources for their time, and as what the sources are."""

    forest: Forest
    ours: Sequence[Kind]
    theirs: Sequence[Kind]
    exact: Sequence[Kind]
    scene: Scene
    settings: WalkSettings

    def go(self, along: Forest, gpu_bytes: int, progress: Callable[[int, int], None] | None) -> Walk:
        settings, trees = self.settings, Trees.of(self.forest, self.ours)
        reach = float(trees.radii.max(initial=0.0)) or 1.0
        eyes = path(along, 2 * Trees.of(along, self.ours).radii, reach, settings.frames, settings.field_of_view)
        compared = set(np.linspace(0, settings.frames - 1, settings.compared).round().astype(int).tolist())
        frames, samples = [], []
        floors: list[float] = []
        for number, eye in enumerate(eyes):
            far = float(np.linalg.norm(trees.centers - eye.place, axis=1).max(initial=0.0)) + reach
            depths = _NEAREST * float(trees.radii.min(initial=reach)), far
            view, moved = (
                view_of(eye, (settings.width, settings.height), settings.field_of_view, depths, shift)
                for shift in (0.0, 1.0)
            )
            frame, pictures = self.frame(trees, view, moved if number in compared else None)
            frames.append(frame)
            if pictures:
                floors.append(pictures[2])
                samples.append((frame.flip_ratio or 0.0, pictures[:2]))
            if progress:
                progress(number + 1, len(eyes))
        mine = np.array([frame.milliseconds for frame in frames])
        pairs = np.array([(f.source_milliseconds, f.milliseconds) for f in frames if f.source_milliseconds is not None])
        flips = sum(frame.flip for frame in frames if frame.flip is not None)
        worst = sorted(samples, key=lambda sample: -sample[0])[:2]
        return Walk(
            renderer=renderer(),
            frames=tuple(frames),
            worst=_worst(mine),
            mean=float(mine.mean()),
            speed_up_worst=_worst(pairs[:, 0]) / _worst(pairs[:, 1]) if len(pairs) else None,
            speed_up_mean=float(pairs[:, 0].mean() / pairs[:, 1].mean()) if len(pairs) else None,
            flip_ratio=flips / sum(floors) if any(floors) else None,
            gpu_bytes=gpu_bytes,
            samples=tuple((over(source, SKY), over(ours, SKY)) for _, (source, ours) in worst),
        )

    def frame(
        self, trees: Trees, view: View, moved: View | None
    ) -> tuple[Frame, tuple[Picture, Picture, float] | None]:
        """One frame; with `moved`, the view moved by a pixel, compared with the source: its picture, ours, floor."""
        chosen = seen(view, self.forest, trees)
        drawn = stands(view, trees, chosen, self.ours)
        counts = [(len(stand.grove.turns), stand.drawing) for stand in drawn]
        frame = Frame(
            trees=len(chosen),
            milliseconds=self.timed(view, drawn),
            triangles=sum(count * drawing.triangles for count, drawing in counts),
            draw_calls=sum(stand.drawing.calls(view, stand.grove) for stand in drawn),
            overdraw=self.scene.fragments(view, drawn) / (self.settings.width * self.settings.height),
        )
        if moved is None:
            return frame, None
        source, exact = (stands(view, trees, chosen, kinds) for kinds in (self.theirs, self.exact))
        true, ours, shifted = (
            self.scene.picture(one, what) for one, what in ((view, exact), (view, drawn), (moved, exact))
        )
        measured, floor = flip(true, ours), flip(true, shifted)
        compared = replace(
            frame,
            source_milliseconds=self.timed(view, source),
            flip=measured,
            flip_ratio=measured / floor if floor else None,
        )
        return compared, (true, ours, floor)

    def timed(self, view: View, drawn: Sequence[Stand]) -> float:
        """Milliseconds of a drawing, of a quick one the median of several; the first may compile and is not timed."""
        self.scene.draw(view, drawn)
        times: list[float] = []
        while len(times) < _REPEATS and sum(times) < _LONG:
            start = time.perf_counter()
            self.scene.draw(view, drawn)
            times.append(time.perf_counter() - start)
        return 1000 * median(times)


def _worst(times: Doubles) -> float:
    """The greatest, the slowest 5 % left out."""
    kept = np.sort(times)[: max(len(times) - int(_TRIMMED * len(times)), 1)]
    return float(kept[-1])
