"""The box of each billboard: the leaves of its plane with their true depth, in a grid of hash cells.

A billboard is as thick as its leaves lie apart, so that a view ray meets each leaf where it is. A flat billboard is a
box without thickness.
"""

from dataclasses import dataclass

import numpy as np

from treebake.flatten import plane_frames
from treebake.model import Clusters, Doubles, Ints
from treebake.stages.indirect.poses import Poses

_FLAT = 1e-9  # of a cell: a thickness below this is rounding
_TURNS = 12  # in a right angle: a box is turned within its plane by a multiple of 7.5 degrees


@dataclass(frozen=True, eq=False)
class Boxes:
    """K boxes. frames: (K, 3, 3) float64, rows right, down, away from the front. corners: (K, 3) float64, the corner
    least along all three, in the frame. sizes: (K, 2) int32, cells. depths: (K,) float64, thickness in the tree's unit.
    planes: (K,) float64, how far behind the front the billboard's plane lies.
    """

    frames: Doubles
    corners: Doubles
    sizes: Ints
    depths: Doubles
    planes: Doubles

    def local(self, points: Doubles, billboard: Ints) -> Doubles:
        """Points (N, 3) in the frames of their boxes, from the corner, in the tree's unit."""
        return np.asarray(np.einsum("nij,nj->ni", self.frames[billboard], points) - self.corners[billboard])


def box(clusters: Clusters, contents: tuple[Poses, ...], cell: float) -> Boxes:
    """The smallest box, over 12 turns, that holds all of each plane's leaves, in every one of `contents`. O(N)."""
    labels, count = clusters.labels, clusters.count
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(count))
    upright = plane_frames(clusters.normals)

    def extent(directions: Doubles) -> tuple[Doubles, Doubles]:
        lows, highs = [], []
        for poses in contents:
            middle = np.einsum("nj,nj->n", poses.centers, directions[labels])
            reach = poses.reach(directions[labels])
            lows.append(np.minimum.reduceat((middle - reach)[order], starts))
            highs.append(np.maximum.reduceat((middle + reach)[order], starts))
        return np.min(lows, axis=0), np.max(highs, axis=0)

    frames, spans = [], []
    for angle in np.arange(_TURNS) * (np.pi / 2 / _TURNS):
        right = np.cos(angle) * upright[:, 0] + np.sin(angle) * upright[:, 1]
        frames.append(np.stack([right, np.cross(right, clusters.normals), -clusters.normals], axis=1))
        spans.append(np.stack([extent(frames[-1][:, axis]) for axis in range(2)], axis=2))  # low and high of each axis
    best = np.argmin([np.prod(high - low, axis=1) for low, high in spans], axis=0)
    rows = np.arange(count)
    frame = np.stack(frames)[best, rows]
    least, most = np.stack(spans)[best, :, rows].transpose(1, 0, 2)
    front, back = extent(frame[:, 2])
    return Boxes(
        frames=frame,
        corners=np.column_stack([least, front]),
        sizes=np.maximum(np.ceil((most - least) / cell - 1e-9), 1).astype(np.int32),
        depths=np.where(back - front < _FLAT * cell, 0, back - front),
        planes=clusters.offsets - front,
    )
