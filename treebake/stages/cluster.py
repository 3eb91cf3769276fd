"""Gather leaves into planes by k-means: the billboard cloud's clusters ([GSSK05] 2.1, 2.2).

The error of a leaf (centre p, normal m) on a plane (n, d) is E = (n.p + d)^2 + alpha (1 - (n.m)^2), equation 1. Three
things are added to the paper:

- alpha is `angle_weight` times the leaf's squared radius, so that a tree in centimetres clusters like one in metres.
  Turning a disc of radius r by a small angle t moves its points by r^2 t^2 / 4 in the mean square: 0.25 is the weight
  at which both terms speak of the same displacement.
- A twig piece fits every plane that holds its axis a, so its angle term is (n.a)^2. Both are n.Q.n with a symmetric Q.
- `compactness` times the squared distance to the cluster's centroid keeps clusters together, for atlases that would
  otherwise store the empty space between far-apart leaves of one plane.

E is linear in sixteen numbers per leaf (p p^T, p, 1, Q), so one matrix product gives all errors of a batch of leaves,
and the same numbers summed per cluster give the matrix A of equation 5.
"""

import logging
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from treebake.checks import check
from treebake.errors import MeshError
from treebake.model import Clusters, Doubles, Ints, Leaves

LOG = logging.getLogger("treebake")

_BATCH = 16384  # leaves whose errors are held at once: 36 MB at 278 planes
_PAIRS = (np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2]))  # the six entries of a symmetric 3x3
_TWICE = np.array([1, 1, 1, 2, 2, 2])  # an off-diagonal entry stands for two


@dataclass(frozen=True)
class ClusterSettings:
    """How leaves are gathered into planes."""

    billboards: int = 2000  # planes, 1 or more; capped at the number of leaves
    angle_weight: float = 2.0  # alpha over the squared leaf radius, > 0; 0.25 weighs distance and turn as displacement
    compactness: float = 0.005  # weight of the squared distance to the cluster's centre, >= 0; 0 is the paper's
    iterations: int = 60  # at most, 1 or more; stops earlier once fewer than one leaf in 2,000 changes its plane
    seed: int = 0  # of the random choice of the first planes, 0 or more


def cluster(leaves: Leaves, settings: ClusterSettings) -> Clusters:
    """Find the planes and the leaves of each. O(iterations * N * K) time, O(N + K) memory.

    Raises SettingsError where a setting is out of range and MeshError where there is no leaf.
    """
    _check(settings)
    if not leaves.count:
        raise MeshError("there are no leaves to cluster; name the foliage with [split] foliage_materials")
    origin = leaves.centers.mean(axis=0)  # centred, so that p p^T keeps its digits
    features = _features(leaves, origin, settings.angle_weight)
    weights = leaves.areas / leaves.areas.mean()  # an error counts for as much as is seen of it
    count = min(settings.billboards, leaves.count)
    if count < settings.billboards:
        LOG.info("cluster: %d leaves fill %d of the %d billboards asked for", count, count, settings.billboards)
    planes = _first_planes(features, weights, count, settings)
    labels = np.full(leaves.count, -1, np.int32)
    for _ in range(settings.iterations):
        previous = labels
        labels, errors = _assign(features, planes)
        labels = _fill_empty(labels, weights * errors, count)
        planes = _fit(features, weights, labels, count, settings.compactness)[0]
        if np.count_nonzero(labels != previous) * 2000 <= leaves.count:
            break
    normals, centroids = _fit(features, weights, labels, count, settings.compactness)[1:]
    offsets = -np.einsum("ij,ij->i", normals, centroids + origin)
    outward = np.where(offsets < 0, -1.0, 1.0)
    return Clusters(labels=labels, normals=normals * outward[:, None], offsets=offsets * outward)


@dataclass(frozen=True)
class ClusterStatistics:
    """How far leaves are from their planes; distances in the tree's unit, angles in degrees, means over leaves."""

    leaves: int
    billboards: int
    distance_mean: float
    distance_worst: float
    distance_percent: float  # mean distance over the mean leaf diameter, per cent
    angle_mean: float
    angle_worst: float


def cluster_statistics(leaves: Leaves, clusters: Clusters) -> ClusterStatistics:
    """Measure the distance of every leaf's centre from its plane, and the angle of its normal to the plane's."""
    normals = clusters.normals[clusters.labels]
    distances = np.abs(np.einsum("ij,ij->i", normals, leaves.centers) + clusters.offsets[clusters.labels])
    sines = np.sqrt(np.clip(np.einsum("ij,ijk,ik->i", normals, _misfit(leaves), normals), 0, 1))
    angles = np.degrees(np.arcsin(sines))
    return ClusterStatistics(
        leaves=leaves.count,
        billboards=clusters.count,
        distance_mean=float(distances.mean()),
        distance_worst=float(distances.max()),
        distance_percent=float(100 * distances.mean() / (2 * leaves.radii.mean())),
        angle_mean=float(angles.mean()),
        angle_worst=float(angles.max()),
    )


def _check(settings: ClusterSettings) -> None:
    rules = (
        ("billboards", settings.billboards >= 1, "1 or more"),
        ("angle_weight", settings.angle_weight > 0, "above 0"),
        ("compactness", settings.compactness >= 0, "0 or more"),
        ("iterations", settings.iterations >= 1, "1 or more"),
        ("seed", settings.seed >= 0, "0 or more"),
    )
    check("cluster", settings, rules)


def _misfit(leaves: Leaves) -> Doubles:
    """Q of every leaf: (N, 3, 3), with n.Q.n the squared sine of the turn that brings the leaf into a plane n."""
    along_axis = leaves.axes[:, :, None] * leaves.axes[:, None, :]
    off_normal = np.eye(3) - leaves.normals[:, :, None] * leaves.normals[:, None, :]
    return np.where(leaves.is_twig[:, None, None], along_axis, off_normal)


def _features(leaves: Leaves, origin: Doubles, angle_weight: float) -> Doubles:
    """The sixteen numbers per leaf in which E is linear: p p^T (6), p (3), 1, alpha Q (6)."""
    p = leaves.centers - origin
    alpha = angle_weight * leaves.radii**2
    return np.concatenate(
        [
            p[:, _PAIRS[0]] * p[:, _PAIRS[1]],
            p,
            np.ones((len(p), 1)),
            alpha[:, None] * _misfit(leaves)[:, _PAIRS[0], _PAIRS[1]],
        ],
        axis=1,
    )


def _coefficients(normals: Doubles, offsets: Doubles, centroids: Doubles, compactness: float) -> Doubles:
    """The weights of the sixteen features in the error of each plane: (K, 16)."""
    square = _TWICE * normals[:, _PAIRS[0]] * normals[:, _PAIRS[1]]
    d = offsets[:, None]
    coefficients = np.concatenate([square, 2 * d * normals, d * d, square], axis=1)
    coefficients[:, :3] += compactness
    coefficients[:, 6:9] -= 2 * compactness * centroids
    coefficients[:, 9] += compactness * (centroids**2).sum(axis=1)
    return coefficients


def _first_planes(features: Doubles, weights: Doubles, count: int, settings: ClusterSettings) -> Doubles:
    """k-means++ (Arthur & Vassilvitskii 2007): each plane is a leaf's own, drawn in proportion to its error so far."""
    random = np.random.Generator(np.random.PCG64(settings.seed))
    planes = np.empty((count, features.shape[1]))
    least = np.full(len(features), np.inf)
    chance = weights
    for k in range(count):
        cumulated = np.cumsum(chance)
        drawn = min(int(np.searchsorted(cumulated, random.random() * cumulated[-1], side="right")), len(features) - 1)
        one = features[drawn : drawn + 1]
        planes[k] = _fit(one, np.ones(1), np.zeros(1, np.int32), 1, settings.compactness)[0]
        least = np.minimum(least, np.maximum(features @ planes[k], 0))
        # Where every leaf already lies in a plane (coplanar leaves), any leaf is as good as another.
        chance = weights * least if least.any() else weights
    return planes


def _assign(features: Doubles, planes: Doubles) -> tuple[Ints, Doubles]:
    """The plane of least error for each leaf, and that error."""
    labels = np.empty(len(features), np.int32)
    errors = np.empty(len(features))
    for start in range(0, len(features), _BATCH):
        batch = slice(start, start + _BATCH)
        error = features[batch] @ planes.T
        labels[batch] = error.argmin(axis=1)
        errors[batch] = np.take_along_axis(error, labels[batch][:, None], axis=1)[:, 0]
    return labels, np.maximum(errors, 0)


def _fill_empty(labels: Ints, errors: Doubles, count: int) -> Ints:
    """Give each empty cluster one of the leaves that fit worst, taken from clusters that keep another."""
    sizes = np.bincount(labels, minlength=count)
    empty = np.flatnonzero(sizes == 0)
    if not len(empty):
        return labels
    worst_first = np.argsort(-errors, kind="stable")
    # The n-th leaf of a cluster, worst first, may leave while fewer than its size have gone.
    sorted_labels = labels[worst_first]
    order = np.argsort(sorted_labels, kind="stable")
    rank = np.empty(len(labels), np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    rank[order] = np.arange(len(labels)) - starts[sorted_labels[order]]
    movable = worst_first[rank < sizes[sorted_labels] - 1]
    result = labels.copy()
    result[movable[: len(empty)]] = empty
    return result


def _fit(
    features: Doubles, weights: Doubles, labels: Ints, count: int, compactness: float
) -> tuple[Doubles, Doubles, Doubles]:
    """The best plane of each cluster: coefficients (K, 16), normals (K, 3) and centroids (K, 3).

    The normal is the eigenvector of the smallest eigenvalue of A ([GSSK05] equation 5); with the leaf's 1 - (n.m)^2
    written as n.Q.n, A is the sum of (p - c)(p - c)^T + alpha Q, which has the same eigenvectors.
    """
    member = sparse.csr_matrix((weights, (labels, np.arange(len(labels)))), shape=(count, len(labels)))
    sums = np.asarray(member @ features)
    mass = sums[:, 9]
    centroids = sums[:, 6:9] / mass[:, None]
    scatter = np.empty((count, 3, 3))
    upper = sums[:, :6] - mass[:, None] * centroids[:, _PAIRS[0]] * centroids[:, _PAIRS[1]] + sums[:, 10:]
    scatter[:, _PAIRS[0], _PAIRS[1]] = upper
    scatter[:, _PAIRS[1], _PAIRS[0]] = upper
    normals = np.linalg.eigh(scatter)[1][:, :, 0]
    offsets = -np.einsum("ij,ij->i", normals, centroids)
    return _coefficients(normals, offsets, centroids, compactness), normals, centroids
