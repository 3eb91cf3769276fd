"""The rows: what is promised, and how each is measured. Trees that are not there leave their row unmeasured."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.bench.runner import NotMeasured, Runner

TESTS = Path(__file__).parents[1]
CHESTNUT = ("--config", "configs/chestnut.toml")
FREE = (*CHESTNUT, "--config", str(Path(__file__).parent / "free_atlas.toml"))  # 278 planes, atlas not limited
ONE_LEVEL = ("--set", "levels.enabled=false", "--set", "ladder.enabled=false")
BIRCH = ("sapling_white_birch.glb", "--config", "configs/sapling_white_birch.toml", *ONE_LEVEL)
FOUR = ("ez_oak_large.glb", BIRCH[0], "treegen_palm.glb", "quaternius_tree_1/Tree_1.obj")
ALL = (512, 256, 128, 64)


@dataclass(frozen=True)
class Measured:
    """A row's outcome; value is None where it was not measured."""

    value: Any
    holds: bool
    note: str = ""


@dataclass(frozen=True)
class Row:
    """A promise and the function that measures it."""

    bound: Any
    unit: str
    measure: Callable[[Runner], Measured]


ROWS: dict[str, Row] = {}


def row(name: str, bound: Any, unit: str) -> Callable[[Callable[[Runner], Measured]], Callable[[Runner], Measured]]:
    """Register a measuring function under a row's id."""

    def register(measure: Callable[[Runner], Measured]) -> Callable[[Runner], Measured]:
        ROWS[name] = Row(bound, unit, measure)
        return measure

    return register


def _up_to(value: list[float], bound: list[float], note: str = "") -> Measured:
    return Measured(value, all(v <= b for v, b in zip(value, bound, strict=True)), note)


def _within(value: list[float], low: float, high: float, note: str = "") -> Measured:
    return Measured(value, all(low <= v <= high for v in value), note)


def _size(asset: Path) -> str:
    manifest = json.loads((asset / "manifest.json").read_text())
    level, sheet = manifest["levels"][0], manifest["textures"][0]["size"]
    return (
        f"{level['file']}: {level['billboards']} billboards, {level['foliage_triangles']} foliage + "
        f"{level['trunk_triangles']} trunk triangles, atlas {sheet[0]}x{sheet[1]}"
    )


@row("E1", [1.10, 0.85], "FLIP / floor(1 px) at 512, 256 px")
def _e1(run: Runner) -> Measured:
    scores = run.scores("chestnut", *FREE, into="free", heights=ALL)
    note = _size(run.asset("chestnut", *FREE, into="free"))
    return _up_to([scores[h]["flip_ratio"] for h in (512, 256)], [1.10, 0.85], note)


@row("E2", [0.98, 1.02], "coverage ratio at 512, 256, 128, 64 px, from .. to")
def _e2(run: Runner) -> Measured:
    scores = run.scores("chestnut", *FREE, into="free", heights=ALL)
    return _within([scores[h]["coverage"] for h in ALL], 0.98, 1.02, _size(run.asset("chestnut", *FREE, into="free")))


@row("E3", [1.20, 1.00], "FLIP / floor(1 px) at 512, 256 px; <= 4,000 foliage triangles, one 2048x2048 atlas")
def _e3(run: Runner) -> Measured:
    scores = run.scores("chestnut", *CHESTNUT, heights=ALL)
    asset = run.asset("chestnut", *CHESTNUT)
    result = _up_to([scores[h]["flip_ratio"] for h in (512, 256)], [1.20, 1.00], _size(asset))
    return Measured(result.value, result.holds and _in_budget(asset, foliage=4000), result.note)


def _in_budget(asset: Path, *, foliage: int | None = None, whole: int | None = None) -> bool:
    """Whether LOD0 has at most so many triangles and no texture is larger than 2048x2048."""
    manifest = json.loads((asset / "manifest.json").read_text())
    level = manifest["levels"][0]
    total = level["foliage_triangles"] + level["trunk_triangles"]
    images = [texture for texture in manifest["textures"] if texture["color_space"] != "data"]
    small = all(max(texture["size"]) <= 2048 for texture in images)
    return small and (foliage is None or level["foliage_triangles"] <= foliage) and (whole is None or total <= whole)


@row("E4", [0.95, 1.05], "foliage coverage ratio at 256 px, from .. to: ez_oak, white_birch, palm, quaternius")
def _e4(run: Runner) -> Measured:
    heights = {BIRCH[0]: (512, 256, 128)}  # what E8 measures too
    scores = [run.scores(name, *_config_of(name), heights=heights.get(name, (256,))) for name in FOUR]
    value = [score[256]["foliage_coverage"] for score in scores]
    return _within(value, 0.95, 1.05)


def _config_of(tree: str) -> tuple[str, ...]:
    return "--config", f"configs/{Path(tree).stem}.toml", *ONE_LEVEL


@row("E5", 400, "R, the time of one 1024x1024 render of the source")
def _e5(run: Runner) -> Measured:
    bake, render = run.bake_seconds("chestnut", *CHESTNUT), run.render_seconds("chestnut")
    return Measured(bake / render, bake <= 400 * render, f"bake {bake:.1f} s, R {1000 * render:.1f} ms")


@row("E6", 0, "files that differ between two bakes")
def _e6(run: Runner) -> Measured:
    first, second = (_files(run.asset("chestnut", *CHESTNUT, into=into)) for into in ("bakes", "again"))
    differing = sorted(name for name in first.keys() | second.keys() if first.get(name) != second.get(name))
    return Measured(len(differing), not differing, f"of {len(first)}, {sum(map(len, first.values())):,} bytes")


def _files(folder: Path) -> dict[str, bytes]:
    """What is published, without the stages and the report."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {
        str(name): path.read_bytes()
        for path in files
        if (name := path.relative_to(folder)).parts[0] not in ("stages", "report")
    }


@row("E7", [0, 0], "errors, warnings of the Khronos glTF validator on every GLB written")
def _e7(run: Runner) -> Measured:
    if not shutil.which("node") or not (TESTS / "node_modules/gltf-validator").exists():
        raise NotMeasured("node or its package gltf-validator is absent")
    run.asset("chestnut", *CHESTNUT)
    paths = sorted(run.folder.rglob("*.glb"))
    command = ["node", str(TESTS / "gltf_validate.mjs"), *map(str, paths)]
    reports = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout).values()
    value = [sum(report[kind] for report in reports) for kind in ("errors", "warnings")]
    return Measured(value, value == [0, 0], f"{len(paths)} files")


@row(
    "E8",
    [1.05, 1.00, 1.00],
    "FLIP / floor(1 px) at 512, 256, 128 px; coverage 0.97 to 1.03, <= 12,000 triangles in all",
)
def _e8(run: Runner) -> Measured:
    scores, asset = run.scores(*BIRCH, heights=(512, 256, 128)), run.asset(*BIRCH)
    ratios, coverage = ([scores[h][name] for h in (512, 256, 128)] for name in ("flip_ratio", "coverage"))
    holds = _up_to(ratios, [1.05, 1.00, 1.00]).holds and _within(coverage, 0.97, 1.03).holds
    note = f"coverage {', '.join(f'{c:.3f}' for c in coverage)}; {_size(asset)}"
    return Measured(ratios, holds and _in_budget(asset, whole=12_000), note)


@row("C1", [45, 3.0], "seconds, GB: cluster 200,000 leaves into 278 planes")
def _c1(_run: Runner) -> Measured:
    done = subprocess.run([sys.executable, "-m", "tests.bench.scale"], check=True, capture_output=True, text=True)
    return _up_to(json.loads(done.stdout), [45, 3.0], "peak memory of the whole process")
