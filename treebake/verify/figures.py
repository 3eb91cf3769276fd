"""The figures of a report, summed up over the views."""

from dataclasses import dataclass

import numpy as np

from treebake.model import Doubles
from treebake.verify.cost import Cost
from treebake.verify.metrics import Scores
from treebake.verify.reference import Reference


@dataclass(frozen=True)
class Figures:
    """One line of the report: means over the views; None where there is nothing to measure.

    flip and ssim are means over the window and both backgrounds. flip_ratio is mean FLIP over the mean FLIP of
    floor(1 px); flip_worst and flip_ratio_worst are the worst view's. iou is of the silhouettes, by covered area.
    coverage is the covered area over the source's; foliage_coverage the same with what the source's bare trunk covers,
    where that is known, taken off both. (Leaving out the trunk's pixels instead would reward a shift: a birch moved by
    one pixel scored 1.10.) depth_cm reads the mesh's unit as a metre. overdraw is fragments per covered pixel.
    """

    flip: float
    flip_worst: float
    flip_ratio: float | None
    flip_ratio_worst: float | None
    ssim: float
    iou: float
    coverage: float | None
    foliage_coverage: float | None
    depth_cm: float | None
    overdraw: float | None
    triangles: int
    draw_calls: int
    gpu_bytes: int


def summed_up(scores: Scores, known: Reference, views: slice, cost: Cost, fragments: Doubles) -> Figures:
    """Sum up the scores of a candidate in some of the views of its reference.

    fragments: one for each of those views.
    """
    floor = known.floor_one.flip[views]
    trunk = known.trunk_area[views].sum()
    seen = ~np.isnan(scores.depth)
    return Figures(
        flip=float(scores.flip.mean()),
        flip_worst=float(scores.flip.max()),
        flip_ratio=_ratio(scores.flip.mean(), floor.mean()),
        flip_ratio_worst=float((scores.flip / floor).max()) if floor.all() else None,
        ssim=float(scores.ssim.mean()),
        iou=float(scores.iou.mean()),
        coverage=_ratio(scores.area.sum(), known.area[views].sum()),
        foliage_coverage=_ratio(max(scores.area.sum() - trunk, 0.0), known.area[views].sum() - trunk),
        depth_cm=float(scores.depth[seen].mean() * 100) if seen.any() else None,
        overdraw=_ratio(fragments.sum(), scores.area.sum()),
        triangles=cost.triangles,
        draw_calls=cost.draw_calls,
        gpu_bytes=cost.gpu_bytes,
    )


def _ratio(part: float, whole: float) -> float | None:
    return float(part / whole) if whole else None
