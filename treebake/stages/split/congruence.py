"""Which leaves are copies of one another."""

import numpy as np
from numpy.typing import NDArray

from treebake.model import Doubles, Ints, Mesh

_CHUNK = 1 << 19  # corners aligned at a time, to bound the memory
_TRIES = 4  # exemplars tried in one bucket before the rest count as shapes of their own
_GRAIN = 0.02  # of the leaf size: how finely signatures are told apart; finer than leaves differ, coarser than noise

Longs = NDArray[np.int64]


def find_shapes(mesh: Mesh, face_leaf: Ints, tolerance: float) -> tuple[Ints, Ints, Doubles]:
    """Find congruent leaves: turned, moved, scaled or mirrored copies with equal uvs and material, faces in one order.

    face_leaf: (F,) int32 in 0..N-1. tolerance: greatest distance of two vertices, of the leaf's radius.
    Returns shape (N,) int32, exemplars (S,) int32 and transforms (N, 3, 4) float64, as in `Leaves`. A leaf that
    matches none is its own shape. Leaves are bucketed by a hash of what no motion changes, then aligned to the first of
    their bucket ([K76], [U91]); O(F log F).
    """
    count = int(face_leaf.max(initial=-1)) + 1
    by_leaf = np.argsort(face_leaf, kind="stable")
    sizes = np.bincount(face_leaf, minlength=count)
    starts = np.cumsum(sizes) - sizes
    shape = np.arange(count)
    transforms = np.tile(np.eye(3, 4), (count, 1, 1))
    for size in np.unique(sizes):
        leaves = np.flatnonzero(sizes == size)
        faces = by_leaf[starts[leaves, None] + np.arange(size)]
        _match(mesh, leaves, faces, tolerance, shape, transforms)
    exemplars, shape = np.unique(shape, return_inverse=True)
    return shape.astype(np.int32), exemplars.astype(np.int32), transforms


def _match(mesh: Mesh, leaves: Longs, faces: Longs, tolerance: float, shape: Longs, transforms: Doubles) -> None:
    """Fill `shape` (the exemplar) and `transforms` for leaves (N,) of K faces each (N, K)."""
    chunks = np.array_split(np.arange(len(leaves)), max(1, 3 * faces.size // _CHUNK))
    buckets = np.unique(np.concatenate([_signatures(mesh, faces[rows]) for rows in chunks]), return_inverse=True)[1]
    pending = np.arange(len(leaves))
    for _ in range(_TRIES):
        _, first, bucket = np.unique(buckets[pending], return_index=True, return_inverse=True)
        exemplar = pending[first][bucket]
        matched = np.zeros(len(pending), bool)
        for rows in np.array_split(np.arange(len(pending)), max(1, 3 * faces.shape[1] * len(pending) // _CHUNK)):
            found, matched[rows] = _align(mesh, faces[exemplar[rows]], faces[pending[rows]], tolerance)
            transforms[leaves[pending[rows]][matched[rows]]] = found[matched[rows]]
        matched[first] = True
        transforms[leaves[pending[first]]] = np.eye(3, 4)
        shape[leaves[pending[matched]]] = leaves[exemplar[matched]]
        pending = pending[~matched]
        if not len(pending):
            return


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

    [U91]; a mirror image is wound the other way round, so its second and third corners change places.
    """
    same_material = (mesh.face_material[source] == mesh.face_material[target]).all(axis=1)
    transforms, fits = _similarity(mesh, mesh.faces[source], mesh.faces[target], 1.0, tolerance)
    rest = np.flatnonzero(~fits)
    if len(rest):
        wound = mesh.faces[target[rest]][:, :, [0, 2, 1]]
        transforms[rest], fits[rest] = _similarity(mesh, mesh.faces[source[rest]], wound, -1.0, tolerance)
    return transforms, fits & same_material


def _similarity(
    mesh: Mesh, source: Ints, target: Ints, handedness: float, tolerance: float
) -> tuple[Doubles, NDArray[np.bool_]]:
    """As `_align`, for corners (N, K, 3) in one order; handedness: 1 for a rotation, -1 with a reflection."""
    count = len(source)
    uvs_fit = (np.abs(mesh.uvs[source] - mesh.uvs[target]) < 1e-3).reshape(count, -1).all(axis=1)
    x, y = (mesh.positions[corners].astype(np.float64).reshape(count, -1, 3) for corners in (source, target))
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
