"""Decides which rings and how many sides of a tube its silhouette needs.

A regular polygon inside a circle is thinner than the circle. The mean width of a convex outline is its perimeter over
pi (Cauchy), so a polygon of k sides keeps the mean silhouette of a circle of radius r, and the mantle's area with it,
where it grows to the radius r (pi / k) / sin(pi / k). Its sides then lie r (1 - (pi / k) / tan(pi / k)), about
r (pi / k)^2 / 3, inside the circle.
"""

from dataclasses import dataclass, replace

import numpy as np

from treebake.model import Doubles, Longs, Mesh
from treebake.tubes.find import Tubes

_MOST_WIDER = 2.0  # a ring changes its width by no more than this factor to make up for lost neighbours


@dataclass(frozen=True, eq=False)
class Plan:
    """The rings of new tubes, strand after strand.

    ring: (N,) the source ring. blend: (N,) float64, how far towards the next one, 0 to below 1. sides: (N,) of the new
    ring; as many as the source has keep the source's own vertices. width: (N,) float64, factor on the ring's width.
    strand: (N,) ascending from 0; rings of the same number are joined, in order. Every strand has two rings or more.
    """

    ring: Longs
    blend: Doubles
    sides: Longs
    width: Doubles
    strand: Longs


def ring_errors(tubes: Tubes) -> Doubles:
    """The error of leaving each ring out: (R,) float64, in units of length, infinite at both ends of a tube.

    It is how far the silhouette moves: the centreline's distance from the straight line between the rings around,
    plus the radius's from the blend of theirs. The worst ring of a gap splits it (Douglas and Peucker), in all tubes at
    once, and counts no more than the ring that made the gap, so the rings above any bound are the simplification to
    that bound. O(R) for each level of splits.
    """
    centers, radii = tubes.rings.centers, tubes.rings.radii
    errors, bound = np.full((2, len(radii)), np.inf)
    low, high = tubes.first[:-1][tubes.tube], tubes.first[1:][tubes.tube] - 1
    left = np.flatnonzero((low < np.arange(len(radii))) & (np.arange(len(radii)) < high))  # rings yet to be judged
    while len(left):
        a, b = low[left], high[left]
        chord, local = centers[b] - centers[a], centers[left] - centers[a]
        square = np.einsum("ij,ij->i", chord, chord)
        at = np.clip(np.einsum("ij,ij->i", local, chord) / np.where(square > 0, square, 1), 0, 1)
        aside = np.linalg.norm(local - at[:, None] * chord, axis=1)
        moved = aside + np.abs(radii[left] - radii[a] - at * (radii[b] - radii[a]))
        order = np.lexsort([moved, a])
        worst = order[np.append(np.diff(a[order]) > 0, True)]  # of each gap
        errors[left[worst]] = np.minimum(moved, bound[left])[worst]
        middle = left[worst][np.searchsorted(a[worst], a)]
        bound[left] = errors[middle]
        low[left] = np.where(left > middle, middle, a)
        high[left] = np.where(left < middle, middle, b)
        left = left[left != middle]
    return errors


def plan(tubes: Tubes, ring: Longs, tolerance: float) -> Plan:
    """Give every chosen ring the sides that move its silhouette no farther than `tolerance`, in units of length.

    ring: (N,) ascending, at least two of each tube. Sides are odd (an odd polygon is about equally wide from
    everywhere, one of four sides varies by 41 %), at least three, and never more than the source's; even on mirrored
    texture.
    """
    radii, source, mirrored = tubes.rings.radii[ring], tubes.rings.sides[ring], tubes.mirrored[tubes.tube[ring]]
    seen = np.pi * np.sqrt(radii / (3 * max(tolerance, np.finfo(np.float64).tiny)))
    least = np.ceil(np.minimum(seen, source.max(initial=3))).astype(np.int64)
    sides = np.where(mirrored, np.maximum(least + least % 2, 4), np.maximum(least + 1 - least % 2, 3))
    return Plan(
        ring=ring,
        blend=np.zeros(len(ring)),
        sides=np.minimum(sides, source),
        width=np.ones(len(ring)),
        strand=np.unique(tubes.tube[ring], return_inverse=True)[1],
    )


def cost(tubes: Tubes, chosen: Plan) -> Longs:
    """(T,) triangles of each new tube, its caps included. The plan's rings are the source's, not blends."""
    sides = np.where(tubes.rings.sides[chosen.ring] == 1, 0, chosen.sides)
    joined = np.diff(chosen.strand) == 0
    triangles = np.where(np.isin(chosen.ring, tubes.cap_ring), sides - 2, 0)
    triangles[:-1] += sides[:-1] * joined
    triangles[1:] += sides[1:] * joined
    return np.bincount(tubes.tube[chosen.ring], weights=triangles, minlength=tubes.count).astype(np.int64)


def keep_area(tubes: Tubes, chosen: Plan) -> Plan:
    """Widen or narrow each ring so that the silhouette keeps the area that the rings left out around it had.

    A ring answers for the integral of width times its share, which falls from one at the ring to zero at the chosen
    rings before and after. The plan's rings are the source's, not blends.
    """
    ring, radii, along, steps = chosen.ring, tubes.rings.radii, tubes.along, tubes.steps
    if not len(ring):
        return chosen
    section = np.flatnonzero(steps > 0)
    before = np.clip(np.searchsorted(ring, section, side="right") - 1, 0, max(len(ring) - 2, 0))
    inside = (ring[before] <= section) & (section < ring[before + 1])
    inside &= chosen.strand[before] == chosen.strand[before + 1]
    section, before = section[inside], before[inside]
    length = along[ring[before + 1]] - along[ring[before]]
    low, high = ((along[section + end] - along[ring[before]]) / length for end in (0, 1))

    had = _area(radii[section], radii[section + 1], 1 - low, 1 - high, steps[section], before, len(ring))
    had += _area(radii[section], radii[section + 1], low, high, steps[section], before + 1, len(ring))
    pair = np.flatnonzero(np.diff(chosen.strand) == 0)
    a, b = ring[pair], ring[pair + 1]
    chord = np.linalg.norm(tubes.rings.centers[b] - tubes.rings.centers[a], axis=1)
    has = _area(radii[a], radii[b], 1.0, 0.0, chord, pair, len(ring))
    has += _area(radii[a], radii[b], 0.0, 1.0, chord, pair + 1, len(ring))
    factor = np.where(has > 0, had / np.where(has > 0, has, 1), 1)
    return replace(chosen, width=np.clip(factor, 1 / _MOST_WIDER, _MOST_WIDER))


def solid_share(mesh: Mesh, tubes: Tubes, triangles: int) -> int:
    """How many of `triangles` go to the faces of no tube: their part of the area, or what the tubes have no use for."""
    areas = mesh.face_areas
    solid = (tubes.face_ring < 0) & (areas > 0)
    share = int(triangles * areas[solid].sum() / max(areas.sum(), np.finfo(np.float64).tiny))
    spare = triangles - int((tubes.face_ring >= 0).sum())
    return min(max(share, spare), int(solid.sum()))


def _area(
    radius_low: Doubles,
    radius_high: Doubles,
    share_low: Doubles | float,
    share_high: Doubles | float,
    length: Doubles,
    label: Longs,
    count: int,
) -> Doubles:
    """(count,) the integral of radius times share, both linear along each length, summed by label."""
    parallel = radius_low * share_low + radius_high * share_high
    crossed = radius_low * share_high + radius_high * share_low
    return np.bincount(label, weights=length * (2 * parallel + crossed) / 6, minlength=count).astype(np.float64)
