"""Which primitive goes to which slice of a slicing ([J00] 2.2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.model import Doubles, Ints, Leaves, Mesh

_SHALLOW = 0.4  # depth of the foliage, in its largest leaf's length, below which a single slice holds it
_SPACINGS = np.geomspace(0.4, 1, 96)  # that are tried, over the even division of the foliage's depth


@dataclass(frozen=True, eq=False)
class Slicing:
    """The slices of one orientation, furthest from the viewer first: planes towards . (p - center) = offsets.

    turn: (3, 3) float64, rows right, up, towards the viewer. spacing: between slices. offsets: (M,) float64.
    slice: (N,) int32, the one nearest to each primitive. large: (N,) bool, primitives that reach farther than the
    spacing.
    """

    turn: Doubles
    spacing: float
    offsets: Doubles
    slice: Ints
    large: NDArray[np.bool_]

    def slab(self, index: int) -> tuple[float, float]:
        """What is nearer to this slice than to others, along the way to the viewer from the center."""
        edges = np.array([-np.inf, *(self.offsets[:-1] + self.offsets[1:]) / 2, np.inf])
        return float(edges[index]), float(edges[index + 1])


def assign(foliage: Mesh, leaves: Leaves, center: Doubles, turn: Doubles, count: int) -> Slicing:
    """Give every primitive the slice nearest to its centroid. O(F + N).

    The slices stand at the one spacing at which leaves are moved least onto them, by area and squared distance.
    """
    along = (leaves.centers - center) @ turn[2]
    reach, leaf = 2 * float(np.abs(along).max()), 2 * float(leaves.radii.max())
    if reach < _SHALLOW * leaf:  # nothing to slice, and no spacing that makes the leaves large ones
        reach = leaf * count / float(_SPACINGS[0])
    moved = [_moved(along, leaves.areas, reach / count * share, count) for share in _SPACINGS]
    spacing = reach / count * float(_SPACINGS[int(np.argmin(moved))])
    corners = ((foliage.positions.astype(np.float64) - center) @ turn[2])[foliage.faces]
    low, high = np.full(leaves.count, np.inf), np.full(leaves.count, -np.inf)
    np.minimum.at(low, leaves.face_leaf, corners.min(axis=1))
    np.maximum.at(high, leaves.face_leaf, corners.max(axis=1))
    return Slicing(
        turn=turn,
        spacing=spacing,
        offsets=(np.arange(count, dtype=np.float64) - (count - 1) / 2) * spacing,
        slice=_nearest(along, spacing, count).astype(np.int32),
        large=high - low > spacing,
    )


def _nearest(along: Doubles, spacing: float, count: int) -> Doubles:
    return np.asarray(np.clip(np.rint(along / spacing + (count - 1) / 2), 0, count - 1))


def _moved(along: Doubles, areas: Doubles, spacing: float, count: int) -> float:
    off = along - (_nearest(along, spacing, count) - (count - 1) / 2) * spacing
    return float((areas * off**2).sum())
