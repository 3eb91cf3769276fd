"""The rows of slicings and view impostors, S1 to S9."""

import time
from typing import Any

from tests.bench.grove import Times, compare, distance_of
from tests.bench.rows import CHESTNUT, ONE_LEVEL, Measured, row
from tests.bench.runner import Runner

LEVEL = ("--set", "verify.elevations=[0]")
SLICED = (*LEVEL, "--set", "verify.azimuths=24")  # at 0, 15 and 30 degrees from the nearest of 6 slicings
VIEWED = (*LEVEL, "--set", "verify.azimuths=32")  # at 0, 11 and 22 degrees from the nearest of 8 views
TURNED = (*LEVEL, "--set", "verify.azimuths=1", "--set", "verify.turn=256")
VIEWS = ("--set", "views.layout=ring", "--set", "views.layers=3", "--set", "views.texels=128")
RING = (*CHESTNUT, *VIEWS, *ONE_LEVEL)  # 8 views
ONLY_SIDES = ("--set", "slicings.above=false", "--set", "slicings.far_height=0")  # 6 x 5 slices and no others


@row(
    "S1", [1.0, 1.3, 0.65, 0.85], "slicings 6x5x256, elevation 0, FLIP / floor(1 px): mean, worst at 256 px, at 128 px"
)
def _s1(run: Runner) -> Measured:
    scores = run.scores("chestnut", *CHESTNUT, heights=(256, 128), of="slicings", sets=SLICED)
    value = [scores[height][name] for height in (256, 128) for name in ("flip_ratio", "flip_ratio_worst")]
    coverage = ", ".join(f"{scores[height]['coverage']:.3f}" for height in (256, 128))
    holds = all(v <= bound for v, bound in zip(value, (1.0, 1.3, 0.65, 0.85), strict=True))
    return Measured(value, holds, f"24 azimuths; coverage {coverage}; trunk {_trunk(run):,} triangles")


def _trunk(run: Runner) -> int:
    return int(run.manifest("chestnut", *CHESTNUT)["slicings"]["trunk_triangles"])


@row("S2", 2_000_000, "bytes on the graphics card of 6x5 slices, with mips, block-compressed")
def _s2(run: Runner) -> Measured:
    only = run.manifest("chestnut", *CHESTNUT, *ONLY_SIDES, *ONE_LEVEL, into="sides")["slicings"]
    whole = run.manifest("chestnut", *CHESTNUT)["slicings"]
    note = f"texels kept {only['texels_kept']:.1%}; with slices from above and for far away {whole['gpu_bytes']:,}"
    return Measured(only["gpu_bytes"], only["gpu_bytes"] <= 2_000_000, note)


@row("S3", [0.98, 1.02], "slicings: luminance over the source's, mean of a full turn, from .. to")
def _s3(run: Runner) -> Measured:
    turn = _turn(run, "slicings")
    worst = f"worst frame {turn['brightness_worst']:.3f}"
    return Measured(turn["brightness"], 0.98 <= turn["brightness"] <= 1.02, worst)


@row("S4", [0.9, 1.3], "8 views at 64 px, elevation 0, FLIP / floor(1 px): mean, worst")
def _s4(run: Runner) -> Measured:
    figures = run.scores("chestnut", *RING, into="ring", heights=(64,), of="views", sets=VIEWED)[64]
    value = [figures["flip_ratio"], figures["flip_ratio_worst"]]
    return Measured(value, value[0] <= 0.9 and value[1] <= 1.3, f"32 azimuths; coverage {figures['coverage']:.3f}")


@row("S5", [1.3, 1.6], "largest FLIP step of a turn in 1-degree steps at 256 px over the source's: slicings, views")
def _s5(run: Runner) -> Measured:
    value = [_turn(run, of)["step"] for of in ("slicings", "views")]
    return Measured(value, value[0] <= 1.3 and value[1] <= 1.6)


def _turn(run: Runner, of: str) -> Any:
    return run.scores("chestnut", *RING, into="ring", heights=(64,), of=of, sets=TURNED)["turn"]


@row("S6", [40, 6], "triangles drawn for a tree: slicings without the trunk, one view")
def _s6(run: Runner) -> Measured:
    manifest = run.manifest("chestnut", *RING, into="ring")
    value = [manifest[name]["triangles"] for name in ("slicings", "views")]
    return Measured(value, value[0] <= 40 and value[1] <= 6)


@row("S7", 20, "times: worst frame of 100 trees, source over slicings with their trunks")
def _s7(run: Runner) -> Measured:
    from treebake.gl import slicings

    found = _grove(run, "slicings", 10, 15.0, nearest=10.0)
    chosen, slicings.RELIEF_HEIGHT = slicings.RELIEF_HEIGHT, float("inf")
    try:
        flat = _grove(run, "slicings", 10, 15.0, nearest=10.0)
    finally:
        slicings.RELIEF_HEIGHT = chosen
    return Measured(
        found.ratio, found.ratio >= 20, f"{_seconds(found)}; with flat slices {flat.ratio:.1f}x: {_seconds(flat)}"
    )


@row("S8", 30, "times: worst frame of 400 trees, at most 64 px high, source over views")
def _s8(run: Runner) -> Measured:
    found = _grove(run, "views", 20, 10.0, nearest=None)
    return Measured(found.ratio, found.ratio >= 30, _seconds(found))


def _seconds(times: Times) -> str:
    return f"{1000 * times.source:.0f} ms to {1000 * times.stand_in:.0f} ms"


def _grove(run: Runner, of: str, count: int, spacing: float, nearest: float | None) -> Times:
    from treebake.asset import read_asset
    from treebake.meshes import read_mesh
    from treebake.verify import VerifySettings, representations

    asset = read_asset(run.asset("chestnut", *RING, into="ring"))
    source = read_mesh(run.source("chestnut"))
    meshes, layers = representations(asset, [256], VerifySettings(representations=(of,)))[of]
    assert layers is not None
    return compare(source, meshes[256], layers, count, spacing, nearest or distance_of(source, 64))


@row("S9", 120, "R, the time of one 1024x1024 render of the source: bake of slicings and views")
def _s9(run: Runner) -> Measured:
    from treebake.settings import Settings
    from treebake.stages.slicings import slicings
    from treebake.stages.trunk import trunk
    from treebake.stages.twigs import twigs
    from treebake.stages.views import ViewSettings, views
    from treebake.workspace import Workspace

    work, settings = Workspace(run.asset("chestnut", *CHESTNUT)), Settings()
    parts, tree = work.read("split", "").value, work.read("twigs", "").value
    start = time.perf_counter()
    sparse = twigs(parts, settings.slicing_twigs)
    trunk(sparse.trunk, settings.slicing_trunk)
    slicings(sparse, settings.slicings)
    middle = time.perf_counter()
    views((tree,), ViewSettings(layout="ring", layers=3, texels=128))
    end = time.perf_counter()
    views((tree,), settings.views)
    hemi, render = time.perf_counter() - end, run.render_seconds("chestnut")
    note = f"slices {middle - start:.1f} s, 8 views {end - middle:.1f} s, R {1000 * render:.1f} ms; hemi {hemi:.1f} s"
    return Measured((end - start) / render, end - start <= 120 * render, note)
