"""Simplifies the trunk to a triangle budget: tubes lose rings and sides, what is solid goes through edge collapse.

General decimators stop at slender triangles, and a thin tube has no others: of the 188,096 triangles in the 2,138
tubes of a sapling birch, quadric edge collapse can drop 9 %, or more at the cost of half the area.
"""

import logging
from dataclasses import dataclass

import numpy as np

from treebake.errors import SettingsError
from treebake.geometry import join
from treebake.model import Mesh
from treebake.stages.trunk.decimate import decimate
from treebake.tubes.find import Tubes, find_tubes
from treebake.tubes.loft import loft
from treebake.tubes.plan import Plan, cost, keep_area, plan, ring_errors, solid_share

_ROUNDS = 60  # bisections of the tolerance
_log = logging.getLogger("treebake")


@dataclass(frozen=True)
class TrunkSettings:
    """How small the trunk becomes."""

    triangles: int = 8000  # triangles of the whole trunk, > 0; a trunk within it stays as it is


def trunk(mesh: Mesh, settings: TrunkSettings) -> Mesh:
    """Simplify a trunk to a number of triangles, or return it unchanged where it has no more.

    One tolerance governs all tubes: every ring stays whose loss would move the silhouette farther, and every ring has
    the sides that keep it within, so triangles go where the silhouette needs them. The mean width of each ring and the
    area of the silhouette around it are kept; material, texture coordinates and normals are the source's.
    The budget is a hard cap: where three-sided tubes of one section are still too many, the smallest are left out,
    with a warning.

    Raises SettingsError where a setting is out of range.
    """
    if not settings.triangles > 0:
        raise SettingsError(f"[trunk] triangles is {settings.triangles}; it must be above 0")
    if mesh.triangles <= settings.triangles:
        return mesh
    tubes = find_tubes(mesh)
    solid = mesh.select((tubes.face_ring < 0) & (mesh.face_areas > 0))
    if solid.triangles:
        solid = decimate(solid, solid_share(mesh, tubes, settings.triangles))
    built, _ = loft(mesh, tubes, keep_area(tubes, _fitting_plan(tubes, settings.triangles - solid.triangles)))
    return join(built, solid)


def _fitting_plan(tubes: Tubes, triangles: int) -> Plan:
    """The plan of the least tolerance that costs no more than `triangles`; the smallest tubes go where none does."""
    errors = ring_errors(tubes)
    coarsest = plan(tubes, np.flatnonzero(np.isinf(errors)), np.inf)
    floor = cost(tubes, coarsest)
    kept = np.ones(tubes.count, np.bool_)
    if floor.sum() > triangles:
        radii = tubes.rings.radii
        silhouette = np.bincount(tubes.tube, tubes.steps * (radii + np.append(radii[1:], 0)), tubes.count)
        largest = np.argsort(-silhouette, kind="stable")
        kept[largest[np.cumsum(floor[largest]) > triangles]] = False
        _log.warning(
            "trunk: %d triangles cannot hold %d tubes; left out the %d smallest, %.1f %% of their silhouette; "
            "raise trunk.triangles or let twigs move them to the foliage",
            triangles,
            tubes.count,
            int((~kept).sum()),
            100 * silhouette[~kept].sum() / silhouette.sum(),
        )
    errors = np.where(kept[tubes.tube], errors, -1)
    least, most = 0.0, 2 * float(errors[np.isfinite(errors)].max(initial=0) + tubes.rings.radii.max(initial=0))
    best = plan(tubes, np.flatnonzero(np.isinf(errors)), np.inf)
    for _ in range(_ROUNDS):
        middle = (least + most) / 2
        draft = plan(tubes, np.flatnonzero(errors > middle), middle)
        if cost(tubes, draft).sum() > triangles:
            least = middle
        else:
            most, best = middle, draft
    return best
