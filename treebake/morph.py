"""Cards of one level that turn into the planes of the next, so that a level can go over into the next without a jump.

A plane whose leaves a plane of the next level takes over turns towards it: each card about its centre, by the least
rotation that lays it into that plane, and then along the plane's normal. It keeps its size and what it shows.
"""

from dataclasses import replace

import numpy as np

from treebake.flatten import least_turns
from treebake.model import BillboardCloud, Hierarchy, Morph


def morph_to_next(cloud: BillboardCloud, planes: Hierarchy, level: int) -> BillboardCloud:
    """The cloud of a level with a morph of its cards into the planes of the next; the last one stays as it is.

    cloud: cards of four vertices each, on the planes of that level. O(cards).
    """
    if level == len(planes.parents):
        return cloud
    finer, coarser = planes.levels[level : level + 2]
    parents = planes.parents[level]
    corners = cloud.mesh.positions.astype(np.float64).reshape(-1, 4, 3)
    plane = cloud.face_cluster[::2]
    start, end = finer.normals[plane], coarser.normals[parents[plane]]
    offset = coarser.offsets[parents[plane]]
    side = np.where(np.einsum("ij,ij->i", start, end) < 0, -1.0, 1.0)  # never more than a quarter turn
    end, offset = side[:, None] * end, side * offset
    centers = corners.mean(axis=1)
    there = centers - (np.einsum("ij,ij->i", end, centers) + offset)[:, None] * end
    moved = there[:, None] + np.einsum("cij,ckj->cki", least_turns(start, end), corners - centers[:, None])
    morph = Morph(moved.reshape(-1, 3).astype(np.float32), end.repeat(4, axis=0).astype(np.float32))
    return replace(cloud, mesh=replace(cloud.mesh, morph=morph))
