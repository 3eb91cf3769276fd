"""The ladder of an asset: which representation is drawn at which height, as measured.

At each height, from near to far, the cheapest representation that is invisible there (FLIP no more than floor(1 px)) is
the one to draw. Cheap is what asks for the least *work*: triangles and shaded fragments of a view, counted, so that the
ladder does not hang on how busy the machine was. Where nothing is invisible, what differs least is drawn.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from treebake.asset import Asset, LeftOut, Rung, read_indirect, read_slicings, read_views
from treebake.checks import check
from treebake.gl.draw import Drawing
from treebake.leaf_cards import leaf_cards
from treebake.meshes import read_mesh
from treebake.model import EMPTY_MESH, Layers, Mesh
from treebake.verify.cameras import Camera, cameras
from treebake.verify.cost import Cost, cost_of
from treebake.verify.metrics import flips
from treebake.verify.reference import Reference, reference
from treebake.verify.representations import without
from treebake.verify.switching import FADE

MOST_MOVED = 2.0  # pixels, root mean square, by which leaves may be moved: with more a cloud is not drawn to be judged
_HOPELESS = 1.5  # FLIP over floor(1 px) from which on the next height is not tried: a step there takes off less
_ENTRIES = {"leaves": "indirect", "indirect": "indirect", "slicings": "slicings", "views": "views"}  # of the manifest
_NO_WORSE = 1.25  # times the finest level's FLIP that a coarser standard level may have, where none is invisible


@dataclass(frozen=True)
class LadderSettings:
    """Where representations are compared to find their switch heights."""

    enabled: bool = True  # measure the ladder
    heights: tuple[int, ...] = (384, 256, 192, 128, 96, 64, 48, 32, 24, 16)  # pixels, 8 to 2048, the greatest first,
    # each 1.25 times the next or more: a change takes as long
    elevations: tuple[float, ...] = (0.0, 25.0, 60.0)  # degrees above the horizon, -90 to 90
    azimuths: int = 2  # evenly spaced views around the tree at each elevation, 1 or more


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to draw a tree. level: of a cloud, its place in the manifest's levels. displacement: how far it moves the
    leaves, in the source's unit; what has depth shows them where they are.
    """

    representation: str
    file: str
    level: int | None
    mesh: Mesh
    layers: Layers | None
    displacement: float = 0.0


@dataclass(frozen=True)
class Ladder:
    """Rungs from near to far, what is on none of them, and the switch heights of the standard levels."""

    rungs: tuple[Rung, ...]
    left_out: tuple[LeftOut, ...]
    level_heights: tuple[int, ...]


def drawn_as(asset: Asset, representation: str, level: int | None = None) -> Candidate:
    """One representation of an asset that has it, a cloud at one of its levels. Raises AssetError and InputError."""
    manifest, folder = asset.manifest, asset.folder
    entry = getattr(manifest, _ENTRIES[representation]) if level is None else manifest.levels[level]
    path, rest = folder / entry.file, EMPTY_MESH
    layers: Layers | None = None
    match representation:
        case "cloud":
            rest = read_mesh(path)
        case "leaves":
            rest, layers = without(read_mesh(path), "cloud"), leaf_cards(read_indirect(path))
        case "indirect":
            rest, layers = without(read_mesh(path), "cloud"), read_indirect(path)
        case "slicings":
            rest, layers = without(read_mesh(path), "slices"), read_slicings(path)
        case "views":
            layers = read_views(path, manifest.name)
    displacement = 0.0 if level is None else manifest.levels[level].displacement
    return Candidate(representation, entry.file, level, rest, layers, displacement)


def candidates(asset: Asset) -> tuple[Candidate, ...]:
    """Everything that an asset can be drawn as. Raises AssetError and InputError where a file is damaged."""
    there = [name for name, entry in _ENTRIES.items() if getattr(asset.manifest, entry)]
    clouds = [drawn_as(asset, "cloud", level) for level in range(len(asset.manifest.levels))]
    return (*(drawn_as(asset, name) for name in there), *clouds)


def ladder(
    asset: Asset,
    source: Mesh,
    settings: LadderSettings,
    cache: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Ladder:
    """Measure the ladder. O(heights x candidates x views x (faces + pixels)).

    source: the tree that the asset was baked from. cache, progress: as for `verify`; of heights. Raises SettingsError,
    AssetError and GraphicsError.
    """
    check_ladder(settings)
    found = candidates(asset)
    with ExitStack() as stack:
        drawings = [stack.enter_context(closing(Drawing(each.mesh, each.layers))) for each in found]
        costs = [cost_of(each.mesh, each.layers) for each in found]
        judge = _Judge(source, found, drawings, costs, cameras(source, settings.elevations, settings.azimuths), cache)
        chosen, levels, step = [], [0], 0
        clouds = [number for number, each in enumerate(found) if each.representation == "cloud"]
        for done, height in enumerate(settings.heights):
            judge.look(height)
            chosen.append(judge.cheapest(range(len(found))))
            best = max(1.0, _NO_WORSE * judge.measured(clouds[0])) if len(clouds) > 1 else 0.0
            while step + 1 < len(clouds) and judge.allowed(clouds[step + 1], best):
                step += 1
                levels.append(height)
            if progress:
                progress(done + 1, len(settings.heights))
    level_heights = (*levels[1:], *[settings.heights[-1]] * (len(clouds) - len(levels)), 0)
    return Ladder(*_rungs(found, costs, chosen, judge, settings.heights), level_heights)


def _rungs(
    found: Sequence[Candidate], costs: Sequence[Cost], chosen: Sequence[int], judge: "_Judge", heights: Sequence[int]
) -> tuple[tuple[Rung, ...], tuple[LeftOut, ...]]:
    """Runs of the same choice become rungs; each is drawn down to the height at which the next one is as good."""
    starts = [number for number, one in enumerate(chosen) if not number or chosen[number - 1] != one]
    rungs = []
    for number, start in enumerate(starts):
        one = chosen[start]
        following = starts[number + 1] if number + 1 < len(starts) else None
        rungs.append(
            Rung(
                representation=found[one].representation,
                file=found[one].file,
                level=found[one].level,
                min_height=heights[following] if following is not None else 0,
                flip_ratio=round(judge.ratios[one, heights[start]], 4),
                triangles=costs[one].triangles,
                gpu_bytes=costs[one].gpu_bytes,
            )
        )
    left_out = [
        LeftOut(each.representation, each.file, each.level, judge.verdict(number))
        for number, each in enumerate(found)
        if number not in chosen
    ]
    return tuple(rungs), tuple(left_out)


def check_ladder(settings: LadderSettings) -> None:
    """Raise SettingsError where a setting is out of range."""
    heights = settings.heights
    falling = all(above >= FADE * below for above, below in pairwise(heights))
    rules = (
        (
            "heights",
            bool(heights) and falling and all(8 <= h <= 2048 for h in heights),
            f"8 to 2048, the greatest first, each {FADE} times the next or more",
        ),
        ("elevations", bool(settings.elevations) and all(-90 <= e <= 90 for e in settings.elevations), "-90 to 90"),
        ("azimuths", settings.azimuths >= 1, "1 or more"),
    )
    check("ladder", settings, rules)


@dataclass
class _Judge:
    """Measures candidates at one height after the other, each only when it is asked for."""

    source: Mesh
    candidates: Sequence[Candidate]
    drawings: Sequence[Drawing]
    costs: Sequence[Cost]
    directions: tuple[Camera, ...]
    cache: Path | None
    ratios: dict[tuple[int, int], float] = field(default_factory=dict)  # FLIP over floor(1 px), by candidate and height
    height: int = 0
    before: int = 0  # the height above it
    known: Reference | None = None

    def look(self, height: int) -> None:
        self.before, self.height = self.height, height
        self.known = reference(self.source, None, self.directions, height, self.cache, lambda _: None)

    def displaced(self, candidate: int) -> bool:
        """Whether its leaves are moved so far, at this height, that it need not be drawn."""
        pixel = 2 * self.directions[0].radius / self.height
        return self.candidates[candidate].displacement > MOST_MOVED * pixel

    def allowed(self, candidate: int, most: float) -> bool:
        """Whether its FLIP over floor(1 px) is at most this at this height."""
        return not self.displaced(candidate) and self.measured(candidate) <= most

    def invisible(self, candidate: int) -> bool:
        """Whether it is at this height; not looked at where that at the height above left no hope."""
        hopeless = self.ratios.get((candidate, self.before), 0.0) > _HOPELESS
        return not hopeless and self.allowed(candidate, 1.0)

    def measured(self, candidate: int) -> float:
        """FLIP over floor(1 px) at this height."""
        key = candidate, self.height
        if key not in self.ratios:
            assert self.known is not None
            pictures = (self.drawings[candidate].picture(camera.view(self.height)) for camera in self.directions)
            measured = flips(map(self.known.picture, range(len(self.directions))), pictures)
            self.ratios[key] = float(measured.mean() / self.known.floor_one.flip.mean())
        return self.ratios[key]

    def cheapest(self, among: Sequence[int]) -> int:
        """The invisible one with the least work; where there is none, the one that differs least."""
        work = {one: self.work(one) for one in among}
        for one in sorted(among, key=lambda one: work[one]):
            if self.invisible(one):
                return one
        return min([one for one in among if not self.displaced(one)] or among, key=self.measured)

    def work(self, candidate: int) -> float:
        """Triangles and fragments of a view, mean of all."""
        drawing = self.drawings[candidate]
        fragments = [drawing.fragments(camera.view(self.height)) for camera in self.directions]
        return float(np.mean(fragments)) + self.costs[candidate].triangles

    def verdict(self, candidate: int) -> str:
        """Why one is on no rung."""
        measured = {height: ratio for (one, height), ratio in self.ratios.items() if one == candidate}
        if not measured:
            return "others were invisible for less work wherever it might have been"
        height, least = min(measured.items(), key=lambda item: item[1])
        if least > 1:
            return f"seen where it would have been the least work: FLIP / floor(1 px) is {least:.2f} at {height} px"
        return f"invisible ({least:.2f} at {height} px), but another was for less work"
