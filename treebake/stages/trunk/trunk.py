"""Simplifies the trunk to a triangle budget: tubes lose rings and sides, what is solid goes through edge collapse.

General decimators stop at slender triangles, and a thin tube has no others: of the 188,096 triangles in the 2,138
tubes of a sapling birch, quadric edge collapse can drop 9 %, or more at the cost of half the area.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from treebake.errors import SettingsError
from treebake.geometry import join
from treebake.model import Doubles, Mesh
from treebake.stages.trunk.decimate import decimate
from treebake.tubes.find import Tubes, find_tubes
from treebake.tubes.ladder import Mask
from treebake.tubes.loft import loft
from treebake.tubes.plan import Plan, cost, keep_area, plan, ring_errors, solid_share

_ROUNDS = 60  # bisections of the tolerance
# Where tubes must be left out, the parts of the budget that one three-sided section of each of the others may take.
# The one is chosen that draws the least silhouette wrong. Measured on trunks at a 20th of their triangles (sapling
# birch, chestnut, ez_oak), FLIP over floor(1 px) at 512 pixels: 1.0 of the budget 2.10, 2.09, 2.83; 0.5 1.06, 1.44,
# 2.13; 0.3 0.99, 1.48, 1.95; 0.2 1.04, 1.52, 1.97; 0.12 1.13, 1.63, 2.05.
_SECTIONS = (1.0, 0.7, 0.5, 0.4, 0.3, 0.2, 0.14, 0.1)
_log = logging.getLogger("treebake")


@dataclass(frozen=True)
class TrunkSettings:
    """How small the trunk becomes."""

    triangles: int = 8000  # triangles of the whole trunk, > 0; a trunk within it stays as it is


def trunk(mesh: Mesh, settings: TrunkSettings) -> Mesh:
    """Simplify a trunk to a number of triangles, or return it unchanged where it has no more.

    One tolerance governs all tubes: every ring stays whose loss would move the silhouette farther, and every ring has
    the sides that keep it within, so triangles go where the silhouette needs them. The mean width of each ring and the
    area of the silhouette around it are kept; material, texture coordinates and normals are the source's. Where
    occlusion maps have texture coordinates of their own, both are dropped; `trunk_maps` bakes them from the source.
    The budget is a hard cap: where three-sided tubes of one section are still too many, the smallest are left out, and
    more of them, so that the others keep their shape; with a warning.

    Raises SettingsError where a setting is out of range.
    """
    if not settings.triangles > 0:
        raise SettingsError(f"[trunk] triangles is {settings.triangles}; it must be above 0")
    if mesh.triangles <= settings.triangles:
        return mesh
    if mesh.occlusion_uvs is not None:
        bare = tuple(replace(material, occlusion_map=None) for material in mesh.materials)
        mesh = replace(mesh, occlusion_uvs=None, materials=bare)
    tubes = find_tubes(mesh)
    solid = mesh.select((tubes.face_ring < 0) & (mesh.face_areas > 0))
    if solid.triangles:
        solid = decimate(solid, solid_share(mesh, tubes, settings.triangles))
    built, _ = loft(mesh, tubes, keep_area(tubes, _fitting_plan(tubes, settings.triangles - solid.triangles)))
    return join(built, solid)


def _fitting_plan(tubes: Tubes, triangles: int) -> Plan:
    """The plan of the least tolerance that costs no more than `triangles`; the smallest tubes go where none does."""
    errors = ring_errors(tubes)
    floor = cost(tubes, plan(tubes, np.flatnonzero(np.isinf(errors)), np.inf))
    if floor.sum() <= triangles:
        return _finest(tubes, errors, triangles)[0]
    radii = tubes.rings.radii
    silhouette = np.bincount(tubes.tube, tubes.steps * (radii + np.append(radii[1:], 0)), tubes.count).astype(
        np.float64
    )
    largest = np.argsort(-silhouette, kind="stable")
    spent = np.cumsum(floor[largest])
    drafts: list[tuple[float, Plan, Mask]] = []
    for share in _SECTIONS:
        kept = np.zeros(tubes.count, np.bool_)
        kept[largest[spent <= share * triangles]] = True
        if kept.any() or not drafts:
            chosen, tolerance = _finest(tubes, np.where(kept[tubes.tube], errors, -1), triangles)
            drafts.append((_wrong(tubes, errors, tolerance, silhouette, kept), chosen, kept))
    _, best, kept = min(drafts, key=lambda draft: draft[0])
    _log.warning(
        "trunk: %d triangles cannot hold %d tubes; left out the %d smallest, %.1f %% of their silhouette; "
        "raise trunk.triangles or let twigs move them to the foliage",
        triangles,
        tubes.count,
        int((~kept).sum()),
        100 * silhouette[~kept].sum() / silhouette.sum(),
    )
    return best


def _wrong(tubes: Tubes, errors: Doubles, tolerance: float, silhouette: Doubles, kept: Mask) -> float:
    """About how much silhouette is drawn where there is none, or is missing.

    A tube that is left out is missing; one that lost rings is off by their greatest error here and there, and by an
    eighth of it in the mean, which fits what was measured.
    """
    moved = np.zeros(tubes.count)
    np.maximum.at(moved, tubes.tube, np.where(errors <= tolerance, errors, 0))
    width = 2 * np.bincount(tubes.tube, tubes.rings.radii, tubes.count) / np.bincount(tubes.tube, minlength=tubes.count)
    apart = np.minimum(moved / 8 / np.where(width > 0, width, np.inf), 1)
    return float((silhouette * np.where(kept, apart, 1)).sum())


def _finest(tubes: Tubes, errors: Doubles, triangles: int) -> tuple[Plan, float]:
    """The plan of the least tolerance that costs no more than `triangles`, and that; rings of negative error go."""
    least, most = 0.0, 2 * float(errors[np.isfinite(errors)].max(initial=0) + tubes.rings.radii.max(initial=0))
    best = plan(tubes, np.flatnonzero(np.isinf(errors)), np.inf)
    for _ in range(_ROUNDS):
        middle = (least + most) / 2
        draft = plan(tubes, np.flatnonzero(errors > middle), middle)
        if cost(tubes, draft).sum() > triangles:
            least = middle
        else:
            most, best = middle, draft
    return best, most
