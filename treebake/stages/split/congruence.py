"""Which leaves are copies of one another."""

import numpy as np
from numpy.typing import NDArray

from treebake.model import Doubles, Ints, Longs, Mesh

_CHUNK = 1 << 19  # corners aligned at a time, to bound the memory
_TRIES = 4  # exemplars tried in one bucket
_COMMON = 4  # shapes that the exemplars of the others are tried against
_GRAIN = 0.02  # of the leaf size: how finely signatures are told apart; finer than leaves differ, coarser than noise


def find_shapes(mesh: Mesh, face_leaf: Ints, tolerance: float) -> tuple[Ints, Ints, Doubles]:
    """Find congruent leaves: turned, moved, scaled or mirrored copies with equal uvs and material, faces in one order.

    face_leaf: (F,) int32 in 0..N-1. tolerance: greatest distance of two vertices, of the leaf's radius.
    Returns shape (N,) int32, exemplars (S,) int32 and transforms (N, 3, 4) float64, as in `Leaves`. A leaf that
    matches none is its own shape. Leaves are bucketed by a hash of what no motion changes and aligned to the first of
    their bucket (Umeyama 1991); what noise threw into another bucket is tried against the commonest shapes. O(F log F).
    """
    count = int(face_leaf.max(initial=-1)) + 1
    by_leaf = np.argsort(face_leaf, kind="stable")
    sizes = np.bincount(face_leaf, minlength=count)
    starts = np.cumsum(sizes) - sizes
    shape = np.arange(count)
    transforms = np.tile(np.eye(3, 4), (count, 1, 1))
    for size in np.unique(sizes):
        leaves = np.flatnonzero(sizes == size)
        found, transforms[leaves] = _match(mesh, by_leaf[starts[leaves, None] + np.arange(size)], tolerance)
        shape[leaves] = leaves[found]
    exemplars, shape = np.unique(shape, return_inverse=True)
    return shape.astype(np.int32), exemplars.astype(np.int32), transforms


def _match(mesh: Mesh, faces: Longs, tolerance: float) -> tuple[Longs, Doubles]:
    """The exemplar (N,) and transform (N, 3, 4) of leaves of K faces each (N, K)."""
    exemplar = np.arange(len(faces))
    transforms = np.tile(np.eye(3, 4), (len(faces), 1, 1))
    hashes = np.concatenate([_signatures(mesh, faces[part]) for part in _chunks(faces)])
    pending = exemplar.copy()
    for _ in range(_TRIES):
        _, first, bucket = np.unique(hashes[pending], return_index=True, return_inverse=True)
        others = np.setdiff1d(np.arange(len(pending)), first)
        tried, rows = pending[first][bucket[others]], pending[others]
        found, fits = _align(mesh, faces[tried], faces[rows], tolerance)
        exemplar[rows[fits]], transforms[rows[fits]] = tried[fits], found[fits]
        pending = rows[~fits]
    shapes, sizes = np.unique(exemplar, return_counts=True)
    by_size = shapes[np.argsort(-sizes, kind="stable")]
    common, rest = by_size[:_COMMON], by_size[_COMMON:]
    for tried in common:
        found, fits = _align(mesh, faces[np.full(len(rest), tried)], faces[rest], tolerance)
        moved = np.full(len(faces), -1)
        moved[rest[fits]] = np.flatnonzero(fits)
        members = np.flatnonzero(moved[exemplar] >= 0)
        transforms[members] = _compose(transforms[members], found[moved[exemplar[members]]])
        exemplar[members] = tried
        rest = rest[~fits]
    return exemplar, transforms


def _chunks(faces: Longs) -> list[Longs]:
    return np.array_split(np.arange(len(faces)), max(1, 3 * faces.size // _CHUNK))


def _compose(outer: Doubles, inner: Doubles) -> Doubles:
    """(N, 3, 4) that apply `inner`, then `outer`."""
    composed = outer[:, :, :3] @ inner
    composed[:, :, 3] += outer[:, :, 3]
    return composed


def _signatures(mesh: Mesh, faces: Longs) -> Longs:
    """A hash (N,) of the leaves' faces (N, K): equal, up to noise on a grain's border, for copies and mirror images."""
    corners = mesh.faces[faces]
    points = mesh.positions[corners].astype(np.float64)
    points -= points.mean(axis=(1, 2), keepdims=True)
    size = np.sqrt((points**2).sum(axis=3).mean(axis=(1, 2)))[:, None, None]
    distances = np.sort(np.linalg.norm(points, axis=3), axis=2) / size
    edges = np.sort(np.linalg.norm(points - np.roll(points, 1, axis=2), axis=3), axis=2) / size
    uvs = mesh.uvs[corners].mean(axis=2, dtype=np.float64)
    values = np.concatenate([distances, edges, uvs], axis=2).reshape(len(faces), -1)
    # The shift keeps round ratios, such as the 1 of a square's corners, off the border of a grain.
    grains = np.floor(values / _GRAIN + 0.618).astype(np.int64)
    keys = np.concatenate([grains, mesh.face_material[faces]], axis=1)
    factors = np.random.default_rng(0).integers(-(1 << 62), 1 << 62, keys.shape[1])
    hashes: Longs = (keys * factors).sum(axis=1)
    return hashes


def _align(mesh: Mesh, source: Longs, target: Longs, tolerance: float) -> tuple[Doubles, NDArray[np.bool_]]:
    """The similarities (N, 3, 4) that take leaves onto others, faces (N, K) each, and whether they fit: (N,) bool.

    A mirror image is wound the other way round, so its second and third corners change places.
    """
    transforms = np.empty((len(source), 3, 4))
    fits = np.empty(len(source), bool)
    for part in _chunks(source):
        x, y = mesh.faces[source[part]], mesh.faces[target[part]]
        transforms[part], fits[part] = _similarity(mesh, x, y, 1.0, tolerance)
        rest = np.flatnonzero(~fits[part])
        mirrored = _similarity(mesh, x[rest], y[rest][:, :, [0, 2, 1]], -1.0, tolerance)
        transforms[part[rest]], fits[part[rest]] = mirrored
        fits[part] &= (mesh.face_material[source[part]] == mesh.face_material[target[part]]).all(axis=1)
    return transforms, fits


def _similarity(
    mesh: Mesh, source: Ints, target: Ints, handedness: float, tolerance: float
) -> tuple[Doubles, NDArray[np.bool_]]:
    """As `_align`, for corners (N, K, 3) in one order; handedness: 1 for a rotation, -1 with a reflection."""
    uvs_fit = (np.abs(mesh.uvs[source] - mesh.uvs[target]) < 1e-3).all(axis=(1, 2, 3))
    x, y = (
        mesh.positions[corners].astype(np.float64).reshape(len(source), 3 * source.shape[1], 3)
        for corners in (source, target)
    )
    x_center, y_center = x.mean(axis=1), y.mean(axis=1)
    x -= x_center[:, None]
    y -= y_center[:, None]
    u, singular, v = np.linalg.svd(np.swapaxes(y, 1, 2) @ x)
    sign = np.where(np.linalg.det(u @ v) * handedness < 0, -1.0, 1.0)
    u[:, :, 2] *= sign[:, None]
    singular[:, 2] *= sign
    scale = singular.sum(axis=1) / (x**2).sum(axis=(1, 2))
    linear = (u @ v) * scale[:, None, None]
    error = np.linalg.norm(y - x @ np.swapaxes(linear, 1, 2), axis=2).max(axis=1)
    radius = np.linalg.norm(y, axis=2).max(axis=1)
    rounding = 4 * np.finfo(np.float32).eps * np.abs(y_center).max(axis=1)
    shift = y_center - np.einsum("nij,nj->ni", linear, x_center)
    return np.concatenate([linear, shift[:, :, None]], axis=2), uvs_fit & (error <= tolerance * radius + rounding)
