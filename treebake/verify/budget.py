"""Find the smallest representation of an asset that is invisible at a height, within caps on triangles and bytes."""

import logging
from contextlib import closing
from dataclasses import dataclass

from treebake.asset import Asset, Rung
from treebake.checks import check
from treebake.errors import BudgetError
from treebake.gl.draw import Drawing
from treebake.model import Mesh
from treebake.verify.cameras import bounding_sphere, cameras
from treebake.verify.cost import Cost, cost_of
from treebake.verify.drawn_as import Candidate, candidates
from treebake.verify.ladder import MOST_MOVED
from treebake.verify.metrics import flips
from treebake.verify.reference import reference

LOG = logging.getLogger("treebake")

_ELEVATIONS, _AZIMUTHS = (0.0, 25.0, 60.0), 4  # degrees; views at each


@dataclass(frozen=True)
class BudgetSettings:
    """What is asked of the one representation that is kept."""

    height: int = 0  # pixels of the tree's bounding sphere at which it is to be invisible, 16 to 2048; 0: all are kept
    triangles: int = 0  # that it may have, at most; 0: any number
    bytes: int = 0  # on the graphics card, block-compressed, at most; 0: any number


def smallest(
    asset: Asset,
    source: Mesh,
    settings: BudgetSettings,
) -> Rung:
    """The representation with the fewest bytes that is invisible; where none is, the one that differs least.

    Whether it can be is told first by how far a cloud moves its leaves, in pixels; only then it is drawn. source: the
    tree that the asset was baked from. O(candidates x views (faces + pixels)).
    Raises SettingsError, BudgetError where nothing is within the caps, AssetError and GraphicsError.
    """
    check_budget(settings)
    costs = {candidate: cost_of(candidate.mesh, candidate.layers) for candidate in candidates(asset)}
    fitting = [one for one, cost in costs.items() if _within(cost, settings)]
    if not fitting:
        least = min(costs.values(), key=lambda cost: cost.gpu_bytes)
        raise BudgetError(
            f"nothing of {asset.manifest.name} is within [budget] triangles = {settings.triangles}, bytes = "
            f"{settings.bytes}; the smallest has {least.triangles:,} triangles and {least.gpu_bytes:,} bytes"
        )
    pixel = 2 * bounding_sphere(source)[1] / settings.height
    near = [one for one in fitting if one.displacement <= MOST_MOVED * pixel] or fitting
    directions = cameras(source, _ELEVATIONS, _AZIMUTHS)
    known = reference(source, None, directions, settings.height, None, lambda _: None)
    ratios: dict[Candidate, float] = {}
    for one in sorted(near, key=lambda one: costs[one].gpu_bytes):
        with closing(Drawing(one.mesh, one.layers)) as drawing:
            pictures = (drawing.picture(camera.view(settings.height)) for camera in directions)
            measured = flips(map(known.picture, range(len(directions))), pictures)
        ratios[one] = float(measured.mean() / known.floor_one.flip.mean())
        LOG.info("budget: FLIP / floor(1 px) of %s is %.2f at %d px", one.name, ratios[one], settings.height)
        if ratios[one] <= 1:
            break
    best = min(ratios, key=lambda one: ratios[one])
    cost = costs[best]
    return Rung(best.representation, best.file, best.level, 0, round(ratios[best], 4), cost.triangles, cost.gpu_bytes)


def check_budget(settings: BudgetSettings) -> None:
    """Raise SettingsError where a setting is out of range."""
    rules = (
        ("height", 16 <= settings.height <= 2048, "16 to 2048, the height that the budget is for"),
        ("triangles", settings.triangles >= 0, "0 or more"),
        ("bytes", settings.bytes >= 0, "0 or more"),
    )
    check("budget", settings, rules)


def _within(cost: Cost, settings: BudgetSettings) -> bool:
    triangles = not settings.triangles or cost.triangles <= settings.triangles
    return triangles and (not settings.bytes or cost.gpu_bytes <= settings.bytes)
