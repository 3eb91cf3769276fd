"""Where every leaf lies and how it is turned: as it is in the source, or laid into its billboard's plane."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from treebake.flatten import turns_into
from treebake.model import Clusters, Doubles, Leaves, Mesh
from treebake.stages.indirect.shapes import Shapes


@dataclass(frozen=True, eq=False)
class Poses:
    """N leaves as boxes in the tree's frame.

    centers: (N, 3) float64. frames: (N, 3, 3) float64, rows right, down, away of each leaf's image, right-handed.
    halves: (N, 3) float64, half the box along those. mirrored: (N,) bool, whether its image is reversed sidewards.
    """

    centers: Doubles
    frames: Doubles
    halves: Doubles
    mirrored: NDArray[np.bool_]

    def reach(self, directions: Doubles) -> Doubles:
        """Half the extent of each box along a direction (N, D) of its own: (N,)."""
        along = np.einsum("nij,nj->ni", self.frames, directions)
        return np.asarray((np.abs(along) * self.halves).sum(axis=1))


def poses(foliage: Mesh, leaves: Leaves, shapes: Shapes) -> Poses:
    """The leaves as they are in the source."""
    shape = shapes.of_leaf
    linear = leaves.transforms[:, :, :3] @ np.swapaxes(shapes.frames, 1, 2)[shape]  # columns right, down, away
    determinant = np.linalg.det(linear)
    scale = np.cbrt(np.abs(determinant))
    mirrored = determinant < 0
    linear[mirrored, :, 0] *= -1
    exact = Poses(
        centers=np.einsum("nij,nj->ni", leaves.transforms[:, :, :3], shapes.centers[shape])
        + leaves.transforms[:, :, 3],
        frames=np.swapaxes(linear / scale[:, None, None], 1, 2),
        halves=shapes.halves[shape] * scale[:, None],
        mirrored=mirrored,
    )
    return _with_twigs(exact, foliage, leaves) if leaves.is_twig.any() else exact


def laid_flat(exact: Poses, leaves: Leaves, clusters: Clusters) -> Poses:
    """The leaves turned and moved into their planes, as [GPSS07] and [GSSK05] have them, and as thin as these."""
    normals = clusters.normals[clusters.labels]
    turned = replace(exact, frames=exact.frames @ np.swapaxes(turns_into(normals, leaves), 1, 2))
    away = np.einsum("nj,nj->n", exact.centers, normals) + clusters.offsets[clusters.labels]
    return replace(turned, centers=exact.centers - away[:, None] * normals, halves=exact.halves * (1, 1, 0))


def snapped(exact: Poses, count: int) -> Poses:
    """The leaves turned about their normals to the nearest of `count` directions: an orientation index ([GPSS07] 3)."""
    away = exact.frames[:, 2]
    level = np.cross([0.0, 1.0, 0.0], away)  # a direction that every leaf of one normal agrees on
    level = np.where(np.linalg.norm(level, axis=1, keepdims=True) > 1e-6, level, [1.0, 0.0, 0.0])
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    upright = np.cross(away, level)
    right = exact.frames[:, 0]
    angle = np.arctan2((right * upright).sum(axis=1), (right * level).sum(axis=1))
    angle = (np.rint(angle / (2 * np.pi) * count) / count * 2 * np.pi)[:, None]
    right = level * np.cos(angle) + upright * np.sin(angle)
    return replace(exact, frames=np.stack([right, np.cross(away, right), away], axis=1))


def _with_twigs(exact: Poses, foliage: Mesh, leaves: Leaves) -> Poses:
    """Twig pieces get the box of a rod: its length down the image, its width the same all around."""
    twig = leaves.is_twig
    along = np.einsum("fki,fi->fk", foliage.positions[foliage.faces], leaves.axes[leaves.face_leaf])
    low, high = np.full(leaves.count, np.inf), np.full(leaves.count, -np.inf)
    np.minimum.at(low, leaves.face_leaf, along.min(axis=1))
    np.maximum.at(high, leaves.face_leaf, along.max(axis=1))
    length = np.maximum(high - low, 1e-12)
    middle = (low + high) / 2 - np.einsum("ni,ni->n", leaves.centers, leaves.axes)
    right = np.cross(leaves.normals, leaves.axes)
    rods = np.stack([right, leaves.axes, -leaves.normals], axis=1)
    width = leaves.areas / length
    return Poses(
        centers=np.where(twig[:, None], leaves.centers + middle[:, None] * leaves.axes, exact.centers),
        frames=np.where(twig[:, None, None], rods, exact.frames),
        halves=np.where(twig[:, None], np.stack([width, length, width], axis=1) / 2, exact.halves),
        mirrored=exact.mirrored & ~twig,
    )
