"""Gather leaves into planes by k-means: the billboard cloud's clusters ([GSSK05] 2.1, 2.2).

`planes.py` has the error of a leaf on a plane, and the plane of least error.
"""

import logging
from dataclasses import dataclass

import numpy as np

from treebake.checks import check
from treebake.errors import MeshError
from treebake.model import Clusters, Doubles, Leaves
from treebake.planes import features, fill_empty, fit, misfit, nearest, oriented, summed, weights

LOG = logging.getLogger("treebake")


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
    origin = leaves.centers.mean(axis=0)
    rows, weight = features(leaves, origin, settings.angle_weight), weights(leaves)
    count = min(settings.billboards, leaves.count)
    if count < settings.billboards:
        LOG.info("cluster: %d leaves fill %d of the %d billboards asked for", count, count, settings.billboards)
    planes = _first_planes(rows, weight, count, settings)
    labels = np.full(leaves.count, -1, np.int32)
    for _ in range(settings.iterations):
        previous = labels
        labels, errors = nearest(rows, planes)
        labels = fill_empty(labels, weight * errors, count)
        planes, normals, centroids = fit(summed(rows, labels, count, weight), settings.compactness)
        if np.count_nonzero(labels != previous) * 2000 <= leaves.count:
            break
    return oriented(labels, normals, centroids + origin)


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
    sines = np.sqrt(np.clip(np.einsum("ij,ijk,ik->i", normals, misfit(leaves), normals), 0, 1))
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


def _first_planes(rows: Doubles, weight: Doubles, count: int, settings: ClusterSettings) -> Doubles:
    """k-means++ (Arthur & Vassilvitskii 2007): each plane is a leaf's own, drawn in proportion to its error so far."""
    random = np.random.Generator(np.random.PCG64(settings.seed))
    planes = np.empty((count, rows.shape[1]))
    least = np.full(len(rows), np.inf)
    chance = weight
    for k in range(count):
        cumulated = np.cumsum(chance)
        drawn = min(int(np.searchsorted(cumulated, random.random() * cumulated[-1], side="right")), len(rows) - 1)
        planes[k] = fit(rows[drawn : drawn + 1], settings.compactness)[0]
        least = np.minimum(least, np.maximum(rows @ planes[k], 0))
        # Where every leaf already lies in a plane (coplanar leaves), any leaf is as good as another.
        chance = weight * least if least.any() else weight
    return planes
