"""Merge planes into ever fewer ones, nested, for levels of detail ([GSSK05] 2.4).

Planes are merged bottom-up, in rounds: each looks for the partner whose merging costs least, and pairs that chose each
other become one. What a merger costs, by the error of `planes.py`, is in closed form: A of both is A_i + A_j + w d d^T,
with w = m_i m_j / (m_i + m_j) and d the way between their centroids. At each level asked for, Lloyd iterations
move whole planes of the level above to the parent that suits them best, so levels stay nested.

Nested planes are dearer than planes of the same leaves clustered afresh: the summed error of the chestnut's 278, 107,
32, 16 and 8 planes is 1.7, 2.8, 4.6, 4.9 and 4.8 times as large (row M2). Most of it is in angles, which are hardly
seen at the heights that such levels are for: FLIP over floor(1 px) of the cards, nested and afresh, is 1.68 and 1.64
(278 planes, 256 pixels), 1.71 and 1.76 (107, 128), 1.68 and 1.70 (32, 64), 1.65 and 1.61 (16, 48), 1.57 and 1.65
(8, 32). Nested planes can be followed from level to level, so they stay. With a compactness of 0.1 in place of 0.005
FLIP is 0.2 higher at each level.
"""

import logging
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from treebake.checks import check
from treebake.model import Clusters, Doubles, Hierarchy, Ints, Leaves
from treebake.planes import centered, features, fill_empty, fit, least_error, nearest, oriented, summed, weights

LOG = logging.getLogger("treebake")

_BATCH = 32  # planes whose mergers with all others are looked at at once: they fit into the processor's cache
_GOLDEN = 0.6180339887498949  # its multiples spread evenly over 0..1
_TIE = 1e-12  # of the whole error of one plane: below it costs are equal, and pairs are drawn as if by lot
_ITERATIONS = 30  # of Lloyd, at most


@dataclass(frozen=True)
class HierarchySettings:
    """The levels, and how planes are merged."""

    billboards: tuple[int, ...] = (278, 107, 32, 16, 8)  # planes of each coarser level, descending, each 1 or more
    angle_weight: float = 2.0  # as for cluster, > 0
    compactness: float = 0.005  # as for cluster, >= 0


def hierarchy(leaves: Leaves, clusters: Clusters, settings: HierarchySettings) -> Hierarchy:
    """Merge the planes of `clusters` level after level. O(K^2) time for K planes, and O(N) once; O(N + K) memory.

    Levels with no fewer planes than there are above them are left out.
    Raises SettingsError where a setting is out of range.
    """
    _check(settings)
    origin = leaves.centers.mean(axis=0)
    rows = features(leaves, origin, settings.angle_weight)
    sums = summed(rows, clusters.labels, clusters.count, weights(leaves))
    levels, parents = [clusters], []
    for count in settings.billboards:
        if count >= clusters.count:
            LOG.info("hierarchy: there are %d planes, so the level of %d is left out", clusters.count, count)
            continue
        parent = _refined(sums, _merged(sums, count, settings.compactness), count, settings.compactness)
        sums = summed(sums, parent, count)
        _, normals, centroids = fit(sums, settings.compactness)
        parents.append(parent)
        levels.append(oriented(parent[levels[-1].labels], normals, centroids + origin))
    return Hierarchy(tuple(levels), tuple(parents))


def _check(settings: HierarchySettings) -> None:
    counts = settings.billboards
    rules = (
        ("billboards", all(a > b for a, b in pairwise((*counts, 0))), "descending numbers of 1 or more"),
        ("angle_weight", settings.angle_weight > 0, "above 0"),
        ("compactness", settings.compactness >= 0, "0 or more"),
    )
    check("hierarchy", settings, rules)


def _merged(sums: Doubles, count: int, compactness: float) -> Ints:
    """Merge planes with summed features (K, 16) until `count` are left: (K,) int32, the merged plane of each."""
    labels = np.arange(len(sums), dtype=np.int32)
    while len(sums) > count:
        partner, cost = _cheapest(sums, compactness)
        one = np.arange(len(sums))
        pairs = np.flatnonzero((partner[partner] == one) & (one < partner))
        pairs = pairs[np.argsort(cost[pairs], kind="stable")][: len(sums) - count]
        one[partner[pairs]] = pairs
        merged = np.unique(one, return_inverse=True)[1].astype(np.int32)
        sums = summed(sums, merged, len(sums) - len(pairs))
        labels = merged[labels]
    return labels


def _cheapest(sums: Doubles, compactness: float) -> tuple[Ints, Doubles]:
    """The partner of each plane (K,) whose merging raises the summed error least, and by how much: (K,) float64."""
    count = len(sums)
    mass, place, upper = centered(sums)
    error = least_error(upper.T)
    tie = _TIE * float(centered(sums.sum(axis=0, keepdims=True))[2][0, :3].sum())
    partner, cost = np.zeros(count, np.int32), np.full(count, np.inf)
    for start in range(0, count, _BATCH):  # each pair once: a batch of planes with itself and all that come after
        rows, columns = np.arange(start, min(start + _BATCH, count))[:, None], np.arange(start, count)
        x, y, z = (place[rows] - place[columns]).transpose(2, 0, 1)
        weight = mass[rows] * mass[columns] / (mass[rows] + mass[columns])
        apart = weight * np.stack([x * x, y * y, z * z, x * y, x * z, y * z])
        both = least_error(upper.T[:, rows] + upper.T[:, None, columns] + apart)
        raised = both - error[rows] - error[columns] + compactness * apart[:3].sum(axis=0)
        raised += tie * ((rows + 1.0) * (columns + 1.0) * _GOLDEN % 1)
        raised[rows[:, 0] - start, rows[:, 0] - start] = np.inf
        for mine, theirs, table in ((rows[:, 0], columns, raised), (columns, rows[:, 0], raised.T)):
            best = table.argmin(axis=1)
            least = table[np.arange(len(mine)), best]
            better = least < cost[mine]
            cost[mine[better]], partner[mine[better]] = least[better], theirs[best[better]]
    return partner, cost


def _refined(sums: Doubles, labels: Ints, count: int, compactness: float) -> Ints:
    """Lloyd iterations over whole planes with summed features (K, 16)."""
    for _ in range(_ITERATIONS):
        previous = labels
        labels, errors = nearest(sums, fit(summed(sums, labels, count), compactness)[0])
        labels = fill_empty(labels, errors, count)
        if (labels == previous).all():
            break
    return labels
