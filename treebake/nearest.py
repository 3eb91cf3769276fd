"""The nearest points of a surface that may be open, non-manifold, or many thin tubes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from treebake.model import Doubles, Longs

_PLACES = np.array([[1, 1, 1], [4, 1, 1], [1, 4, 1], [1, 1, 4], [1, 4, 4], [4, 1, 4], [4, 4, 1]], np.float64)
_SAMPLES = _PLACES / _PLACES.sum(axis=1, keepdims=True)  # barycentric, where a face is looked for
_CANDIDATES = 16  # samples looked at for a point
_BATCH = 1 << 16  # points at a time: bounds memory


@dataclass(frozen=True, eq=False)
class Triangles:
    """A surface to be found by place: (F, 3, 3) float64, each with an area."""

    corners: Doubles

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree((_SAMPLES @ self.corners).reshape(-1, 3))

    @cached_property
    def _normals(self) -> Doubles:
        a, b, c = np.moveaxis(self.corners, 1, 0)
        normals = np.cross(b - a, c - a)
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def nearest_face(self, places: Doubles) -> Longs:
        """(N,) the face with the sample nearest to each place (N, 3): about the nearest one, and fast."""
        return np.asarray(self._tree.query(places)[1], np.int64) // len(_SAMPLES)

    def nearest_point(self, places: Doubles, facing: Doubles) -> tuple[Longs, Doubles]:
        """The nearest point that looks the same way: its face (N,) and barycentric weights (N, 3).

        places, facing: (N, 3) float64. Of the faces around a place, those whose normal is within 90 degrees of `facing`
        go first, so that a thin tube is not seen from its other side; where there are none, the nearest counts.
        O(N log F).
        """
        found = [
            self._nearest_point(places[start : start + _BATCH], facing[start : start + _BATCH])
            for start in range(0, len(places), _BATCH)
        ]
        if not found:
            return np.zeros(0, np.int64), np.zeros((0, 3))
        faces, weights = zip(*found, strict=True)
        return np.concatenate(faces), np.concatenate(weights)

    def _nearest_point(self, places: Doubles, facing: Doubles) -> tuple[Longs, Doubles]:
        count = min(_CANDIDATES, len(_SAMPLES) * len(self.corners))
        near = np.asarray(self._tree.query(places, count)[1], np.int64).reshape(-1, count) // len(_SAMPLES)
        weights = _clamped(self.corners[near.ravel()], np.repeat(places, count, axis=0)).reshape(-1, count, 3)
        points = np.einsum("nki,nkij->nkj", weights, self.corners[near])
        squares = ((points - places[:, None]) ** 2).sum(axis=2)
        away = np.einsum("nkj,nj->nk", self._normals[near], facing) <= 0
        best = np.lexsort([squares, away], axis=1)[:, 0]
        rows = np.arange(len(places))
        return near[rows, best], weights[rows, best]


def barycentric(triangles: Doubles, places: Doubles) -> Doubles:
    """(N, 3) weights of the corners (N, 3, 3) at the places (N, 3), projected onto each triangle's plane."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normal = np.cross(a, b)
    square = np.einsum("ij,ij->i", normal, normal)
    local = places - triangles[:, 0]
    second = np.einsum("ij,ij->i", np.cross(local, b), normal) / square
    third = np.einsum("ij,ij->i", np.cross(a, local), normal) / square
    return np.stack([1 - second - third, second, third], axis=1)


def _clamped(triangles: Doubles, places: Doubles) -> Doubles:
    """(N, 3) weights of the nearest point of each triangle."""
    weights = barycentric(triangles, places)
    outside = np.flatnonzero((weights < 0).any(axis=1))
    corners, place = triangles[outside], places[outside]
    least = np.full(len(outside), np.inf)
    for start, stop in ((0, 1), (1, 2), (2, 0)):
        edge, local = corners[:, stop] - corners[:, start], place - corners[:, start]
        at = np.clip(np.einsum("ij,ij->i", local, edge) / np.einsum("ij,ij->i", edge, edge), 0, 1)
        square = ((local - at[:, None] * edge) ** 2).sum(axis=1)
        nearer = square < least
        least[nearer] = square[nearer]
        rows = outside[nearer]
        weights[rows] = 0
        weights[rows, start], weights[rows, stop] = 1 - at[nearer], at[nearer]
    return weights
