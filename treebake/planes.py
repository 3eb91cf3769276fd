"""The error of leaves on planes ([GSSK05] 2.1), and the planes of least error.

The error of a leaf (centre p, normal m) on a plane (n, d) is E = (n.p + d)^2 + alpha (1 - (n.m)^2), equation 1. Three
things are added to the paper:

- alpha is `angle_weight` times the leaf's squared radius, so that a tree in centimetres clusters like one in metres.
  Turning a disc of radius r by a small angle t moves its points by r^2 t^2 / 4 in the mean square: 0.25 is the weight
  at which both terms speak of the same displacement.
- A twig piece fits every plane that holds its axis a, so its angle term is (n.a)^2. Both are n.Q.n with a symmetric Q.
- `compactness` times the squared distance to the cluster's centroid keeps clusters together, for atlases that would
  otherwise store the empty space between far-apart leaves of one plane.

E is linear in sixteen numbers per leaf, its *features* p p^T, p, 1, alpha Q: one matrix product gives all errors, and
the features' sums over a cluster give its best plane and that plane's summed error, whatever the number of leaves.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse

from treebake.model import Clusters, Doubles, Ints, Leaves

_BATCH = 16384  # leaves whose errors are held at once: 36 MB at 278 planes
_PAIRS = (np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2]))  # the six entries of a symmetric 3x3
_TWICE = np.array([1, 1, 1, 2, 2, 2])  # an off-diagonal entry stands for two


def misfit(leaves: Leaves) -> Doubles:
    """Q of every leaf: (N, 3, 3), with n.Q.n the squared sine of the turn that brings the leaf into a plane n."""
    along_axis = leaves.axes[:, :, None] * leaves.axes[:, None, :]
    off_normal = np.eye(3) - leaves.normals[:, :, None] * leaves.normals[:, None, :]
    return np.where(leaves.is_twig[:, None, None], along_axis, off_normal)


def weights(leaves: Leaves) -> Doubles:
    """(N,) float64, mean 1: an error counts for as much as is seen of the leaf."""
    return np.asarray(leaves.areas / leaves.areas.mean())


def features(leaves: Leaves, origin: Doubles, angle_weight: float) -> Doubles:
    """The features of every leaf: (N, 16) float64, of places from `origin`, near which p p^T keeps its digits."""
    p = leaves.centers - origin
    alpha = angle_weight * leaves.radii**2
    return np.concatenate(
        [
            p[:, _PAIRS[0]] * p[:, _PAIRS[1]],
            p,
            np.ones((len(p), 1)),
            alpha[:, None] * misfit(leaves)[:, _PAIRS[0], _PAIRS[1]],
        ],
        axis=1,
    )


def displacement(leaves: Leaves, clusters: Clusters) -> float:
    """How far the points of leaves move into their planes: root of the mean square by area, in the tree's unit."""
    normals = clusters.normals[clusters.labels]
    distances = np.einsum("ij,ij->i", normals, leaves.centers) + clusters.offsets[clusters.labels]
    turned = leaves.radii**2 / 4 * np.einsum("ij,ijk,ik->i", normals, misfit(leaves), normals)
    return float(np.sqrt(np.average(distances**2 + np.maximum(turned, 0), weights=leaves.areas)))


def summed(values: Doubles, labels: Ints, count: int, weight: Doubles | None = None) -> Doubles:
    """Weighted sums of features (N, 16) over each of `count` labels: (count, 16) float64."""
    weight = np.ones(len(labels)) if weight is None else weight
    member = sparse.csr_matrix((weight, (labels, np.arange(len(labels)))), shape=(count, len(labels)))
    return np.asarray(member @ values)


def centered(sums: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """Of each cluster: mass (K,), centroid (K, 3), sum of (p - c)(p - c)^T and alpha Q (K, 6), xx yy zz xy xz yz.

    That sum is the matrix A of equation 5: n.A.n is the error of the plane through the centroid with the normal n.
    """
    mass = sums[:, 9]
    centroids = sums[:, 6:9] / mass[:, None]
    moments = sums[:, :6] - mass[:, None] * centroids[:, _PAIRS[0]] * centroids[:, _PAIRS[1]]
    return mass, centroids, moments + sums[:, 10:]


def fit(sums: Doubles, compactness: float) -> tuple[Doubles, Doubles, Doubles]:
    """The best plane of each cluster from its summed features (K, 16): coefficients (K, 16), normal, centroid (K, 3).

    Features @ coefficients is E. The normal is the eigenvector of the smallest eigenvalue of A ([GSSK05] equation 5);
    with the leaf's 1 - (n.m)^2 written as n.Q.n, A has the same eigenvectors as the paper's.
    """
    _, centroids, upper = centered(sums)
    scatter = np.empty((len(sums), 3, 3))
    scatter[:, _PAIRS[0], _PAIRS[1]] = upper
    scatter[:, _PAIRS[1], _PAIRS[0]] = upper
    normals = np.linalg.eigh(scatter)[1][:, :, 0]
    offsets = -np.einsum("ij,ij->i", normals, centroids)
    return coefficients(normals, offsets, centroids, compactness), normals, centroids


def least_error(upper: Doubles) -> Doubles:
    """The smallest eigenvalue of symmetric 3x3 matrices (6, ...): (...,) float64, by the roots of the cubic.

    Of a cluster's A it is the summed error of the best plane, but for compactness.
    """
    xx, yy, zz, xy, xz, yz = upper
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    det = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cube = 2 * spread**3
    angle = np.arccos(np.clip(det / np.where(cube > 0, cube, 1), -1, 1)) / 3
    return np.asarray(mean + 2 * spread * np.cos(angle + 2 * np.pi / 3))


def coefficients(normals: Doubles, offsets: Doubles, centroids: Doubles, compactness: float) -> Doubles:
    """The weights of the features in the error of each plane: (K, 16). offsets: (K,), centroids: (K, 3)."""
    square = _TWICE * normals[:, _PAIRS[0]] * normals[:, _PAIRS[1]]
    d = offsets[:, None]
    weight = np.concatenate([square, 2 * d * normals, d * d, square], axis=1)
    weight[:, :3] += compactness
    weight[:, 6:9] -= 2 * compactness * centroids
    weight[:, 9] += compactness * (centroids**2).sum(axis=1)
    return weight


def nearest(values: Doubles, coefficients: Doubles) -> tuple[Ints, Doubles]:
    """The plane of least error for each row of features (N, 16): (N,) int32, and that error (N,)."""
    labels = np.empty(len(values), np.int32)
    errors = np.empty(len(values))
    for start in range(0, len(values), _BATCH):
        batch = slice(start, start + _BATCH)
        error = values[batch] @ coefficients.T
        labels[batch] = error.argmin(axis=1)
        errors[batch] = np.take_along_axis(error, labels[batch][:, None], axis=1)[:, 0]
    return labels, np.maximum(errors, 0)


def fill_empty(labels: Ints, errors: Doubles, count: int) -> Ints:
    """Give each empty cluster one of the rows that fit worst, taken from clusters that keep another."""
    sizes = np.bincount(labels, minlength=count)
    empty = np.flatnonzero(sizes == 0)
    if not len(empty):
        return labels
    worst_first = np.argsort(-errors, kind="stable")
    # The n-th row of a cluster, worst first, may leave while fewer than its size have gone.
    sorted_labels = labels[worst_first]
    order = np.argsort(sorted_labels, kind="stable")
    rank = np.empty(len(labels), np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    rank[order] = np.arange(len(labels)) - starts[sorted_labels[order]]
    movable = worst_first[rank < sizes[sorted_labels] - 1]
    result = labels.copy()
    result[movable[: len(empty)]] = empty
    return result


def oriented(labels: Ints, normals: Doubles, centroids: Doubles) -> Clusters:
    """The planes through centroids (K, 3), in the tree's frame, turned so that d >= 0."""
    offsets = -np.einsum("ij,ij->i", normals, centroids)
    outward = np.where(offsets < 0, -1.0, 1.0)
    return Clusters(labels=labels, normals=normals * outward[:, None], offsets=offsets * outward)


def with_pieces(
    clusters: Clusters, leaves: Leaves, grown: Leaves, kept: int, angle_weight: float, compactness: float
) -> Clusters:
    """The planes of `leaves` for other leaves: the first `kept` of both are the same and stay where they are.

    Each further one of `grown`, a piece of a twig, goes to the plane of least error. No plane moves, so one that had
    nothing but pieces may be left without any. O(K (N - kept)).
    """
    origin = leaves.centers.mean(axis=0)
    sums = summed(features(leaves, origin, angle_weight), clusters.labels, clusters.count, weights(leaves))
    offsets = clusters.offsets + clusters.normals @ origin
    planes = coefficients(clusters.normals, offsets, centered(sums)[1], compactness)
    found, _ = nearest(features(grown, origin, angle_weight)[kept:], planes)
    return replace(clusters, labels=np.concatenate([clusters.labels[:kept], found]))
