"""Cluster 200,000 leaves into 278 planes; prints the seconds and the process's peak memory in GB as JSON."""

import json
import resource
import time

import numpy as np

from treebake.model import Leaves
from treebake.stages.cluster import ClusterSettings, cluster


def leaves(count: int, seed: int = 0) -> Leaves:
    """Discs of 3 cm radius on shells of a crown of 10 m, turned every way."""
    rng = np.random.default_rng(seed)
    outward, normals = rng.normal(size=(2, count, 3))
    outward, normals = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (outward, normals))
    return Leaves(
        face_leaf=np.arange(count, dtype=np.int32),
        centers=outward * rng.uniform(3, 5, (count, 1)),
        normals=normals,
        areas=np.full(count, 0.002),
        radii=np.full(count, 0.03),
        axes=np.zeros((count, 3)),
        shape=np.zeros(count, np.int32),
        exemplars=np.zeros(1, np.int32),
        transforms=np.tile(np.eye(3, 4), (count, 1, 1)),
    )


if __name__ == "__main__":
    tree = leaves(200_000)
    start = time.perf_counter()
    cluster(tree, ClusterSettings(billboards=278))
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2  # Linux counts in KiB
    print(json.dumps([seconds, peak]))
