"""What is to be photographed for each slice ([J00] 2.2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.gl.photo import Shot
from treebake.model import Doubles, Tree
from treebake.stages.slicings.assign import Slicing


@dataclass(frozen=True, eq=False)
class Slice:
    """One slice: its plane's distance from the center, and the box that its shot sees, (3,) float64 along the slicing's
    axes from the center, depths from the plane.
    """

    slicing: Slicing
    offset: float
    shot: Shot
    low: Doubles
    high: Doubles

    @property
    def texel(self) -> float:
        """Size of a texel."""
        return float((self.high - self.low)[0]) / self.shot.size[0]


def shots(tree: Tree, slicing: Slicing, center: Doubles, texels: int, solid: NDArray[np.bool_]) -> list[Slice]:
    """The slices of one slicing, furthest first. O(faces).

    texels: of the slicing box's longer side. solid: (F,) bool, faces that are on no slice. Large primitives are cut up
    between the slices, all others are whole on one.
    """
    foliage, face_leaf = tree.foliage, tree.leaves.face_leaf
    points = (foliage.positions.astype(np.float64) - center) @ slicing.turn.T
    depth = points[:, 2][foliage.faces]
    nearest, farthest = depth.max(axis=1), depth.min(axis=1)
    size, low, high = _box(points[foliage.used, :2], texels)
    found = []
    for index, offset in enumerate(slicing.offsets):
        slab = slicing.slab(index)
        whole = (slicing.slice == index) & ~slicing.large
        passing = slicing.large[face_leaf] & (nearest >= slab[0]) & (farthest < slab[1])
        faces, cut = np.flatnonzero(whole[face_leaf] & ~solid), np.flatnonzero(passing & ~solid)
        seen = np.concatenate([depth[faces].ravel(), np.clip(depth[cut], *slab).ravel()])
        least, most = (float(seen.min()), float(seen.max())) if len(seen) else (offset, offset)
        room = 1e-3 * float((high - low)[0]) / size[0] + 1e-6 * (most - least)  # what lies at the ends is seen too
        box = np.array([*low, least - room]), np.array([*high, most + room])
        shift = slicing.turn @ center
        shot = Shot(
            turn=slicing.turn,
            low=box[0] + shift,
            high=box[1] + shift,
            size=size,
            faces=faces.astype(np.int32),
            cut=cut.astype(np.int32),
            slab=(slab[0] + float(shift[2]), slab[1] + float(shift[2])),
        )
        down = np.array([0.0, 0.0, offset])
        found.append(Slice(slicing, float(offset), shot, box[0] - down, box[1] - down))
    return found


def _box(points: Doubles, texels: int) -> tuple[tuple[int, int], Doubles, Doubles]:
    """Whole texels that hold points (N, 2), `texels` along the longer side, and their box, about the points' middle."""
    low, high = points.min(axis=0), points.max(axis=0)
    texel = float((high - low).max()) / texels or 1.0
    width, height = (max(int(np.ceil(side / texel - 1e-6)), 1) for side in high - low)
    middle, half = (low + high) / 2, texel / 2 * np.array([width, height])
    return (width, height), middle - half, middle + half
