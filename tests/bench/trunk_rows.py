"""The row of simplified trunks and their maps, A6."""

from tests.bench.rows import BIRCH, Measured, row
from tests.bench.runner import Runner
from treebake.meshes import read_mesh
from treebake.model import Mesh
from treebake.stages.split import SplitSettings, split
from treebake.stages.trunk import TrunkSettings, trunk
from treebake.stages.trunk_maps import TrunkMapSettings, trunk_maps
from treebake.verify import VerifySettings, verify

TREES = ("chestnut", "ez_oak_large.glb", BIRCH[0])
BOUND = 1.1


@row("A6", [BOUND] * 3, "trunk at a 20th of its triangles, with maps, no leaves: FLIP / floor(1 px) at 512 px")
def _a6(run: Runner) -> Measured:
    values, notes = [], []
    for name in TREES:
        full = split(read_mesh(run.source(name)), SplitSettings()).trunk
        bare = trunk(full, TrunkSettings(full.triangles // 20))
        mapped = trunk_maps(bare, full, full, None, TrunkMapSettings())
        values.append(_flip_ratio(full, mapped.mesh))
        maps = mapped.maps
        notes.append(
            f"{name}: {bare.triangles} of {full.triangles} triangles, {maps.kind} ({maps.source_density:.3g} texels a "
            f"unit in the source, {maps.density:.3g} in a map), without maps {_flip_ratio(full, bare):.3f}"
        )
    return Measured(values, all(value <= BOUND for value in values), "; ".join(notes))


def _flip_ratio(source: Mesh, candidate: Mesh) -> float:
    (level,) = verify(source, candidate, VerifySettings(heights=(512,))).levels
    assert level.candidate.flip_ratio is not None
    return level.candidate.flip_ratio
