"""Counts the rings of tubes, and tells from them which components are tubes.

The vertices of a tube fall into rings by their edge distance from the open loop at its base, or from the cap of a
closed one. Each ring must be one cycle, each pair of rings one annulus of triangles; only the first and the last may be
capped or shrink to a point. What fails is solid.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from treebake.geometry import components
from treebake.model import Longs
from treebake.tubes.surface import Surface, scatter

_CAP = 0.9  # least cosine between the axis of a closed tube and the normals of its cap

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Ladder:
    """The components that are tubes, ring by ring.

    level: (V,) ring number from the base, -1 for the vertices of no ring. after: (V,) the next vertex on the ring,
    itself for a point. side: (N,) faces between two rings; turn: (N, 3) their corners, those on one ring first;
    rising: (N,) whether that ring is the lower one. flat: (M,) faces of caps.
    """

    level: Longs
    after: Longs
    side: Longs
    turn: Longs
    rising: Mask
    flat: Longs


def find_ladder(surface: Surface) -> Ladder:
    """Count the rings and keep the components that pass every test of a tube."""
    comp, vertices = surface.comp, len(surface.positions)
    level = _levels(surface)
    last = np.full(surface.count, -1)
    np.maximum.at(last, comp, level)
    inner = (level > 0) & (level < last[comp])
    bad = last < 1

    heights = level[surface.faces]
    low, high = heights.min(axis=1, keepdims=True), heights.max(axis=1, keepdims=True)
    flat = np.flatnonzero(low == high)
    bad[comp[surface.faces[flat][inner[surface.faces[flat]]]]] = True
    side = np.flatnonzero(low != high)
    rising = (heights[side] == low[side]).sum(axis=1) == 2
    odd = (heights[side] == np.where(rising[:, None], high[side], low[side])).argmax(axis=1)
    turn = (odd[:, None] + [1, 2, 0]) % 3
    a, b, _ = np.take_along_axis(surface.faces[side], turn, axis=1).T

    # Every vertex of a ring starts one ring edge and ends one, of the faces above and of the faces below.
    ringed = np.zeros(vertices, np.bool_)
    for way in (rising, ~rising):
        starts, ends = (np.bincount(v[way], minlength=vertices) for v in (a, b))
        bad[comp[(starts != ends) | (starts > 1) | (inner & (starts != 1))]] = True
        ringed |= starts == 1
    after = np.arange(vertices)
    after[b[~rising]] = a[~rising]
    after[a[rising]] = b[rising]

    rim = surface.edges[surface.uses == 1]
    bad[comp[rim[(level[rim[:, 0]] != level[rim[:, 1]]) | inner[rim[:, 0]], 0]]] = True
    bad[comp[surface.edges[surface.uses > 2, 0]]] = True

    _, rung, size = np.unique(comp * (vertices + 1) + level + 1, return_inverse=True, return_counts=True)
    ringed |= (size[rung] == 1) & ~inner  # a point
    cycle = components(np.stack([np.flatnonzero(ringed), after[ringed]], axis=1), vertices)
    for label in (rung, cycle):  # one cycle on a level, and no level without
        found = np.unique(comp[ringed] * (vertices + 1) + label[ringed]) // (vertices + 1)
        bad |= np.bincount(found, minlength=surface.count) != last + 1
    good = ~bad[surface.face_comp]
    kept = good[side]
    return Ladder(
        level=np.where(ringed & ~bad[comp], level, -1),
        after=after,
        side=side[kept],
        turn=turn[kept],
        rising=rising[kept],
        flat=flat[good[flat]],
    )


def _levels(surface: Surface) -> Longs:
    """(V,) edges from the nearest vertex of the base, -1 where there is no way."""
    count, ends = len(surface.positions), surface.edges
    rim = ends[surface.uses == 1]
    loop = components(rim, count)
    around = np.linalg.norm(surface.positions[rim[:, 0]] - surface.positions[rim[:, 1]], axis=1)
    length = np.bincount(loop[rim[:, 0]], weights=around, minlength=count)
    vertices = np.unique(rim)
    order = vertices[np.lexsort([loop[vertices], length[loop[vertices]], surface.comp[vertices]])]
    widest = np.full(surface.count, -1)
    widest[surface.comp[order]] = loop[order]  # the last written, hence the longest, stays
    opened = vertices[loop[vertices] == widest[surface.comp[vertices]]]
    seeds = np.concatenate([opened, _closed_ends(surface, widest < 0)])
    if not len(seeds):
        return np.full(count, -1)
    graph = coo_matrix((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    distance = dijkstra(graph, directed=False, indices=seeds, unweighted=True, min_only=True)
    return np.where(np.isfinite(distance), distance, -1).astype(np.int64)


def _closed_ends(surface: Surface, closed: Mask) -> Longs:
    """The vertices of one cap of each closed component, or the one vertex where that end is pointed."""
    mask = closed[surface.comp]
    if not mask.any():
        return np.zeros(0, np.int64)
    weight = np.bincount(surface.comp, minlength=surface.count)[:, None]
    local = surface.positions - (scatter(surface.positions, surface.comp, surface.count) / weight)[surface.comp]
    spread = scatter(local[:, :, None] * local[:, None, :], surface.comp, surface.count)
    axis = np.linalg.eigh(spread)[1][:, :, 2]
    height = np.einsum("ij,ij->i", local, axis[surface.comp])
    top = np.zeros(surface.count, np.int64)
    order = np.lexsort([height, surface.comp])
    top[surface.comp[order]] = order  # the last written, hence the highest, stays
    a, b, c = (surface.positions[surface.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    facing = np.einsum("ij,ij->i", normal, axis[surface.face_comp])
    cap = surface.faces[(np.abs(facing) > _CAP * np.linalg.norm(normal, axis=1)) & closed[surface.face_comp]]
    patch = components(np.concatenate([cap[:, :2], cap[:, 1:]]), len(surface.positions))
    return np.flatnonzero(mask & (patch == patch[top[surface.comp]]))
