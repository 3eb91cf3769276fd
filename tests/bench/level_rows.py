"""The rows of levels of detail."""

import numpy as np

from tests.bench.rows import CHESTNUT, Measured, row
from tests.bench.runner import Runner


@row("M2", None, "summed error of nested planes over that of the same leaves clustered afresh, at each level")
def _m2(run: Runner) -> Measured:
    from treebake.model import Clusters, Doubles, Leaves
    from treebake.planes import features, fit, summed, weights
    from treebake.settings import Settings
    from treebake.stages.cluster import ClusterSettings, cluster
    from treebake.stages.hierarchy import hierarchy
    from treebake.workspace import Workspace

    work, settings = Workspace(run.asset("chestnut", *CHESTNUT)), Settings().hierarchy
    leaves: Leaves = work.read("twigs", "").value.leaves
    rows: Doubles = features(leaves, leaves.centers.mean(axis=0), settings.angle_weight)

    def error(found: Clusters) -> float:
        sums = summed(rows, found.labels, found.count, weights(leaves))
        return float(np.einsum("ij,ij->", sums, fit(sums, settings.compactness)[0]))

    same = {"angle_weight": settings.angle_weight, "compactness": settings.compactness}
    nested = hierarchy(leaves, work.read("cluster", "").value, settings).levels[1:]
    value = [error(level) / error(cluster(leaves, ClusterSettings(billboards=level.count, **same))) for level in nested]
    return Measured(value, True, f"planes: {', '.join(str(level.count) for level in nested)}")
