"""The ladder of an asset: which representation is drawn at which height, as measured.

At each height, from near to far, the cheapest representation that is invisible there (FLIP no more than floor(1 px)) is
the one to draw. Cheap is what asks for the least *work*: triangles and shaded fragments of a view, counted, so that the
ladder does not hang on how busy the machine was. Where nothing is invisible, what differs least is drawn.
"""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from treebake.asset import Asset, Ladder, LeftOut, Rung
from treebake.checks import check
from treebake.gl.draw import Drawing
from treebake.model import Mesh
from treebake.verify.cameras import Camera, cameras
from treebake.verify.cost import Cost, cost_of
from treebake.verify.drawn_as import Candidate, candidates
from treebake.verify.metrics import flips
from treebake.verify.reference import Reference, reference
from treebake.verify.switching import FADE

MOST_MOVED = 2.0  # pixels, root mean square, by which leaves may be moved: with more a cloud is not drawn to be judged
_HOPELESS = 1.5  # FLIP over floor(1 px) from which on the next height is not tried: a step there takes off less
_NO_WORSE = 1.25  # times the finest level's FLIP that a coarser standard level may have, where none is invisible


@dataclass(frozen=True)
class LadderSettings:
    """Where representations are compared to find their switch heights."""

    enabled: bool = True  # measure the ladder
    heights: tuple[int, ...] = (512, 256, 192, 128, 96, 64, 48, 32, 24, 16)  # pixels, 8 to 2048, the greatest first,
    # each 1.25 times the next or more: a change takes as long
    elevations: tuple[float, ...] = (0.0, 25.0, 60.0)  # degrees above the horizon, -90 to 90
    azimuths: int = 2  # evenly spaced views around the tree at each elevation, 1 or more


def ladder(
    asset: Asset,
    source: Mesh,
    settings: LadderSettings,
) -> Ladder:
    """Measure the ladder. O(heights x candidates x views x (faces + pixels)).

    source: the tree that the asset was baked from. Raises SettingsError, AssetError and GraphicsError.
    """
    check_ladder(settings)
    found = candidates(asset)
    with ExitStack() as stack:
        drawings = [stack.enter_context(closing(Drawing(each.mesh, each.layers))) for each in found]
        costs = [cost_of(each.mesh, each.layers) for each in found]
        judge = _Judge(source, found, drawings, costs, cameras(source, settings.elevations, settings.azimuths))
        chosen, levels, step = [], [0], 0
        clouds = [number for number, each in enumerate(found) if each.representation == "cloud"]
        for height in settings.heights:
            judge.look(height)
            chosen.append(judge.cheapest(range(len(found))))
            best = max(1.0, _NO_WORSE * judge.measured(clouds[0])) if len(clouds) > 1 else 0.0
            while step + 1 < len(clouds) and judge.allowed(clouds[step + 1], best):
                step += 1
                levels.append(height)
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
    ratios: dict[tuple[int, int], float] = field(default_factory=dict)  # FLIP over floor(1 px), by candidate and height
    tried: set[tuple[int, int]] = field(default_factory=set)  # what was seen where less work was looked for
    height: int = 0
    before: int = 0  # the height above it
    known: Reference | None = None

    def look(self, height: int) -> None:
        self.before, self.height = self.height, height
        self.known = reference(self.source, None, self.directions, height, None, lambda _: None)

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
            self.tried.add((one, self.height))
        return min([one for one in among if not self.displaced(one)] or among, key=self.measured)

    def work(self, candidate: int) -> float:
        """Triangles and fragments of a view, mean of all."""
        drawing = self.drawings[candidate]
        fragments = [drawing.fragments(camera.view(self.height)) for camera in self.directions]
        return float(np.mean(fragments)) + self.costs[candidate].triangles

    def verdict(self, candidate: int) -> str:
        """Why one is on no rung."""
        seen = {height: self.ratios[one, height] for one, height in self.tried & self.ratios.keys() if one == candidate}
        if seen:
            height, least = min(seen.items(), key=lambda item: item[1])
            return f"seen where it would have been less work: FLIP / floor(1 px) is {least:.2f} at best, at {height} px"
        if any(one == candidate for one, _ in self.tried):
            return f"moves its leaves by more than {MOST_MOVED:g} pixels where it would have been less work"
        return "others were invisible for less work at every height"
