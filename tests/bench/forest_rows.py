"""The rows of levels of detail and forests, L1 to L7: the chestnut alone, and the seven species together."""

import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from statistics import median
from typing import Any

from tests.bench.rows import CHESTNUT, Measured, row
from tests.bench.runner import Runner

SEVEN = ("chestnut", "oak", "cork", "horse-chestnut", "shrub", "maple", "alder")
ALONE = ("chestnut",)
FEW = ("--set", "walk.frames=20", "--set", "walk.compared=20")  # 100 trees: the source in every frame
MANY = ("--set", "walk.frames=12", "--set", "walk.compared=4")  # 1000 trees: in a sample of them
GSSK05_WINDOW = (1024, 768)


def _options(name: str) -> tuple[str, ...]:
    return CHESTNUT if name == "chestnut" else ()


def _scene(run: Runner, species: Sequence[str], trees: int) -> Path:
    assets = [run.asset(name, *_options(name)) for name in species]
    path = run.folder / f"{species[0]}_{len(species)}_{trees}.glb"
    run.treebake("forest", *assets, "--trees", trees, "--seed", 1, "-o", path)
    return path


def _walk(run: Runner, species: Sequence[str], trees: int, sets: tuple[str, ...]) -> Any:
    """What `verify --forest` tells; walked once for all rows."""
    key = f"{species[0]}_{len(species)}_{trees}"
    if key not in run.walked:
        sources = [word for name in species for word in ("--source", run.source(name))]
        run.walked[key] = run.treebake("verify", "--forest", _scene(run, species, trees), *sources, *sets)
    return run.walked[key]


def _both(run: Runner, figure: str, trees: int, sets: tuple[str, ...]) -> tuple[list[float], str]:
    walks = [_walk(run, species, trees, sets) for species in (ALONE, SEVEN)]
    times = [f"{walk['worst']:.0f} ms at worst, {walk['mean']:.0f} in the mean" for walk in walks]
    return [walk[figure] for walk in walks], f"{'; '.join(times)}; {walks[0]['renderer'].split(',')[0]}"


@row("L1", 20, "times: worst frame of 100 trees, source over ladder: chestnuts, seven species")
def _l1(run: Runner) -> Measured:
    value, note = _both(run, "speed_up_worst", 100, FEW)
    return Measured(value, min(value) >= 20, note)


@row("L2", 30, "times: mean frame of 1000 trees, source over ladder: chestnuts, seven species")
def _l2(run: Runner) -> Measured:
    value, note = _both(run, "speed_up_mean", 1000, MANY)
    return Measured(value, min(value) >= 30, note)


@row("L3", 3, "times: mean frame time of 10,000 trees over that of 1000, same views: chestnuts, seven species")
def _l3(run: Runner) -> Measured:
    pairs = [[_frame_time(run, species, trees) for trees in (1000, 10_000)] for species in (ALONE, SEVEN)]
    value = [many / few for few, many in pairs]
    note = "; ".join(f"{few:.0f} ms to {many:.0f} ms" for few, many in pairs)
    return Measured(value, max(value) <= 3, note)


def _frame_time(run: Runner, species: Sequence[str], trees: int) -> float:
    """Milliseconds, mean of the frames of the way through 1000 trees."""
    from treebake.asset import read_asset, read_forest
    from treebake.meshes import read_mesh
    from treebake.verify import WalkSettings, walk

    forest, folders = read_forest(_scene(run, species, trees))
    few, _ = read_forest(_scene(run, species, 1000))
    assets = {name: read_asset(folder) for name, folder in zip(forest.names, folders, strict=True)}
    sources = {name: read_mesh(run.source(name)) for name in species}
    return walk(forest, assets, sources, WalkSettings(frames=8, compared=0), along=few).mean


@row("L4", 7, "times: leaves alone, source over the cloud of 32 billboards, chestnut 736 px high in 1024x768")
def _l4(run: Runner) -> Measured:
    from treebake.asset import read_asset
    from treebake.meshes import read_mesh
    from treebake.verify.cameras import MARGIN, cameras
    from treebake.verify.drawn_as import without
    from treebake.workspace import Workspace

    folder = run.asset("chestnut", *CHESTNUT)
    asset = read_asset(folder)
    number = next(n for n, level in enumerate(asset.manifest.levels) if level.billboards == 32)
    cards = without(read_mesh(asset.level_paths[number]), "trunk")
    leaves = Workspace(folder).read("split", "").value.foliage
    views = cameras(read_mesh(run.source("chestnut")), (0.0, 25.0, 60.0), 3)
    value, notes = [], []
    for height in (GSSK05_WINDOW[1] - MARGIN, asset.manifest.levels[number - 1].min_height):
        seconds = [_seconds(mesh, [view.view(height) for view in views]) for mesh in (leaves, cards)]
        value.append(seconds[0] / seconds[1])
        notes.append(f"{height} px: {1000 * seconds[0]:.1f} ms to {1000 * seconds[1]:.1f} ms, {value[-1]:.1f}x")
    return Measured(value[0], value[0] >= 7, f"{'; '.join(notes)}; {cards.triangles} triangles")


def _seconds(mesh: Any, views: Sequence[Any]) -> float:
    from treebake.gl.draw import Drawing
    from treebake.gl.scene import Scene, Stand
    from treebake.gl.view import ONE_TREE

    with closing(Drawing(mesh)) as drawing, closing(Scene(views[0].window)) as scene:
        stand = Stand(drawing, ONE_TREE)
        scene.draw(views[0], [stand])  # the first one compiles
        times = []
        for view in (view for view in views for _ in range(3)):
            start = time.perf_counter()
            scene.draw(view, [stand])
            times.append(time.perf_counter() - start)
    return median(times)


@row("L5", 1.0, "FLIP / floor(1 px), mean along the way through 100 trees: chestnuts, seven species")
def _l5(run: Runner) -> Measured:
    value, note = _both(run, "flip_ratio", 100, FEW)
    return Measured(value, max(value) <= 1, note)


@row(
    "L6",
    1.2,
    "largest FLIP step at any change of rungs over the source's own, in 1 % steps: chestnut, of seven species",
)
def _l6(run: Runner) -> Measured:
    changes = _walk(run, SEVEN, 100, FEW)["changes"]
    steps = {name: max((change["step"] for change in each), default=0.0) for name, each in changes.items()}
    note = ", ".join(f"{name} {step:.2f}" for name, step in steps.items())
    return Measured([steps["chestnut"], max(steps.values())], max(steps.values()) <= 1.2, note)


@row("L7", 24_000_000, "bytes on the graphics card: every rung of the ladders of seven species, with vertices")
def _l7(run: Runner) -> Measured:
    ladders = {name: run.manifest(name, *_options(name))["ladder"] for name in SEVEN}
    value = sum(rung["gpu_bytes"] for ladder in ladders.values() for rung in ladder)
    note = "; ".join(
        f"{name} " + ", ".join(f"{rung['representation']} to {rung['min_height']} px" for rung in ladder)
        for name, ladder in ladders.items()
    )
    return Measured(value, value <= 24_000_000, note)
