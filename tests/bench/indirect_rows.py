"""The rows of the indirect textures, I1 to I7, and what each of the papers' simplifications costs."""

import time

from tests.bench.decoder import decoded
from tests.bench.rows import CHESTNUT, TESTS, Measured, row
from tests.bench.runner import Runner
from treebake.compression import block_bytes

BENCH = TESTS / "bench"
FLAT = (*CHESTNUT, "--config", str(BENCH / "free_texels.toml"))
SMALL = ("--config", str(BENCH / "small_cloud.toml"))
TABLE_1 = {  # [GPSS07] Table 1: billboards, bytes
    "chestnut": (278, 3_486_762),
    "oak": (194, 3_119_734),
    "cork": (121, 1_462_870),
    "horse-chestnut": (202, 3_376_653),
    "shrub": (198, 1_349_091),
    "maple": (175, 1_381_600),
    "alder": (228, 1_332_837),
}
FLAT_LEAVES = ("indirect.flat=true", "indirect_cluster.compactness=0")  # the planes that suit them
MODES = {  # what the papers do, as settings
    "as it is": (),
    "16 orientations": ("indirect.orientations=16",),
    "flat": FLAT_LEAVES,
    "flat, 16 orientations": (*FLAT_LEAVES, "indirect.orientations=16"),
    "flat, one leaf a cell": (*FLAT_LEAVES, "indirect.single=true", "indirect.cell=0.5"),
}


def _planes(count: int) -> tuple[str, ...]:
    return "--set", f"indirect_cluster.billboards={count}"


def _bytes(run: Runner) -> int:
    return int(run.manifest("chestnut", *CHESTNUT)["indirect"]["gpu_bytes"])


@row("I1", 1_200_000, "bytes on the graphics card, 278 billboards: tables, block-compressed images, every mip")
def _i1(run: Runner) -> Measured:
    manifest = run.manifest("chestnut", *CHESTNUT)
    sizes = {each["file"].split("chestnut_")[1]: each["size"] for each in manifest["textures"]}
    note = ", ".join(f"{name} {width}x{height}" for name, (width, height) in sizes.items() if "foliage" not in name)
    return Measured(_bytes(run), _bytes(run) <= 1_200_000, note)


@row("I2", 66, "times our bytes that a flat atlas of 278 planes needs for our close-up FLIP: a lower bound")
def _i2(run: Runner) -> Measured:
    # A flat atlas never gets there, because its leaves lie in their planes; what ours score there is told beside.
    ours, flat = (_close(run, "indirect", *CHESTNUT), _close(run, "cloud", *FLAT, into="texels"))
    moved = run.scores("chestnut", *_mode("flat"), into="mode_flat", heights=(512,), of="indirect")["close"]["flip"]
    width, height = run.manifest("chestnut", *FLAT, into="texels")["textures"][0]["size"]
    times = 2 * block_bytes(width, height, 16) / _bytes(run)  # BC3 and BC5, with mips
    note = f"FLIP at {width}x{height} texels {flat:.3f}, ours {ours:.3f}; ours with leaves laid flat {moved:.3f}"
    return Measured(times, times >= 66 and flat > ours, note)


def _mode(name: str) -> tuple[str, ...]:
    return (*CHESTNUT, *SMALL, *(word for change in MODES[name] for word in ("--set", change)))


def _close(run: Runner, of: str, *options: str, into: str = "bakes") -> float:
    heights = (512,) if of == "indirect" else (64,)
    return float(run.scores("chestnut", *options, into=into, heights=heights, of=of)["close"]["flip"])


@row("I3", [1.0, 1.0, 1.0], "FLIP / floor(1 px): 278 billboards at 512 px, 107 at 256 px, 32 at 128 px")
def _i3(run: Runner) -> Measured:
    value, coverage = [], []
    for count, height in ((278, 512), (107, 256), (32, 128)):
        options, into = (
            (CHESTNUT, "bakes") if count == 278 else ((*CHESTNUT, *SMALL, *_planes(count)), f"planes{count}")
        )
        scores = run.scores("chestnut", *options, into=into, heights=(height,), of="indirect")[height]
        value.append(scores["flip_ratio"])
        coverage.append(scores["coverage"])
    return Measured(value, all(v <= 1 for v in value), f"coverage {', '.join(f'{c:.3f}' for c in coverage)}")


@row("I4", 0.5, "close-up FLIP over that of the flat cloud at no more bytes, the best of three")
def _i4(run: Runner) -> Measured:
    flats = {
        "2,000 planes": _close(run, "cloud_same_bytes", *CHESTNUT),
        "278 planes": _close(run, "cloud_same_bytes", *FLAT, into="texels"),
        "baked at 512x512": _close(run, "cloud", *CHESTNUT, "--set", "textures.atlas=512", into="bytes512"),
    }
    ours = _close(run, "indirect", *CHESTNUT)
    value = ours / min(flats.values())
    note = f"ours {ours:.3f}; " + ", ".join(f"{name} {flip:.3f}" for name, flip in flats.items())
    return Measured(value, value <= 0.5, note)


@row("I5", 1.0, "greatest ratio of our bytes to the paper's, over the seven species of Table 1")
def _i5(run: Runner) -> Measured:
    ratios, notes, sides = [], [], []
    for species, (count, theirs) in TABLE_1.items():
        published = run.manifest(species, *SMALL, *_planes(count), into="table1")
        tables = [each for each in published["textures"] if "hash" in each["file"] or "lists" in each["file"]]
        sides += [max(table["size"]) for table in tables]
        manifest = published["indirect"]
        ours = manifest["gpu_bytes"]
        ratios.append(ours / theirs)
        notes.append(f"{species} {manifest['leaves']:,} leaves {manifest['billboards']} {ours:,} : {count} {theirs:,}")
    notes.append(f"hash and lists textures at most {max(sides)} texels a side")
    return Measured(max(ratios), max(ratios) <= 1 and max(sides) <= 1024, "; ".join(notes))


@row(
    "I6",
    [0.25, 1.0],
    "decoder: greatest error of any leaf but twigs, in texels of its image, and in degrees; all listed",
)
def _i6(run: Runner) -> Measured:
    from treebake.asset import read_indirect
    from treebake.workspace import Workspace

    asset = run.asset("chestnut", *CHESTNUT)
    work = Workspace(asset)
    tree, clusters = work.read("twigs", "").value, work.read("indirect_cluster", "").value
    found = decoded(tree, clusters, read_indirect(asset / "chestnut.glb"))
    value = [float(found.texels.max()), float(found.degrees.max())]
    note = f"{len(found.texels):,} leaves, {found.listed.mean():.2%} listed"
    return Measured(value, value[0] <= 0.25 and value[1] <= 1 and bool(found.listed.all()), note)


@row("I7", 100, "R, the time of one 1024x1024 render of the source: bake of the indirect textures after clustering")
def _i7(run: Runner) -> Measured:
    from treebake.settings import Settings
    from treebake.stages.indirect import indirect
    from treebake.workspace import Workspace

    work = Workspace(run.asset("chestnut", *CHESTNUT))
    tree, clusters = work.read("twigs", "").value, work.read("indirect_cluster", "").value
    start = time.perf_counter()
    indirect(tree, clusters, Settings().indirect)
    bake, render = time.perf_counter() - start, run.render_seconds("chestnut")
    return Measured(bake / render, bake <= 100 * render, f"bake {bake:.1f} s, R {1000 * render:.1f} ms")


@row("M1", None, "FLIP / floor(1 px) at 512 px and close up (8 views) of the papers' simplifications")
def _m1(run: Runner) -> Measured:
    value = []
    for name in MODES:
        into = "mode_" + name.replace(" ", "_")
        scores = run.scores("chestnut", *_mode(name), into=into, heights=(512,), of="indirect")
        value.append([scores[512]["flip_ratio"], scores["close"]["flip_ratio"]])
    return Measured(value, True, "; ".join(MODES))


@row("C2", 3.0, "GB: bake a chestnut of 100,000 leaves, whole process")
def _c2(run: Runner) -> Measured:
    value = run.bake_memory("chestnut", 100_000, *CHESTNUT)
    return Measured(value, value <= 3)
