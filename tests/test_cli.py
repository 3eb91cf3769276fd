"""The command line: its commands, its exits, and one clear line for every bad input."""

import base64
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_validate import assert_valid

from treebake import cli, pipeline
from treebake.asset import files_of, read_asset
from treebake.formats.gltf_file import GltfFile
from treebake.glb import write_glb
from treebake.images import encode_png
from treebake.meshes import read_mesh
from treebake.model import Material, Mesh
from treebake.verify.cameras import CLOSE_UP

COMMANDS = {"grow", "cluster", "textures", "bake", "verify", "forest", "inspect"}
COARSE = ["--set", "textures.atlas=128", "--set", "textures.supersample=1"]
COARSE += [part for table in ("slicings", "views") for part in ("--set", f"{table}.texels=16")]
COARSE += [part for table in ("slicings", "views") for part in ("--set", f"{table}.supersample=1")]
COARSE += ["--set", "views.side=3"]
COARSE += ["--set", "levels.enabled=false", "--set", "ladder.enabled=false"]  # but where a test is about them
NO_PICTURES = ["--set", "slicings.enabled=false", "--set", "views.enabled=false"]
TEXTURES = [*COARSE, *NO_PICTURES]


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        return self.err.splitlines()


@pytest.fixture
def treebake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Outcome]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["treebake", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            cli.main()
        captured = capsys.readouterr()
        return Outcome(int(exit_.value.code or 0), captured.out, captured.err)

    return run


def leafy(count: int, *, coplanar: bool = False) -> tuple[tuple[str, Mesh], ...]:
    """A box of a trunk and `count` leaves, triangles of 10 cm, on a crown of 1 m."""
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(count, 3, 3)) * 0.05 + rng.normal(size=(count, 1, 3)) + [0, 3, 0]
    if coplanar:
        corners[..., 1] = 3
    positions = corners.reshape(-1, 3).astype(np.float32)
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    box = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 3) for z in (0, 0.1)], np.float32)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], np.int32)
    return (
        ("trunk", mesh(box, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3), Material("bark", (0.2, 0.1, 0.05, 1.0)))),
        ("leaves", mesh(positions, faces, Material("leaf", (0.1, 0.4, 0.1, 1.0), double_sided=True))),
    )


def mesh(positions: Any, faces: Any, material: Material) -> Mesh:
    zeros = np.zeros(len(faces), np.int32)
    up = np.tile(np.array([0, 1, 0], np.float32), (len(positions), 1))
    return Mesh(positions, up, positions[:, :2] * 0, faces, zeros, zeros, (material,), ("node",))


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    write_glb(tmp_path / "tree.glb", leafy(40))
    return tmp_path / "tree.glb"


def gltf(
    path: Path, positions: Any = ((1, 0, 0), (0, 1, 0), (0, 0, 1)), indices: Any = (0, 1, 2), **extra: Any
) -> Path:
    """A glTF file of one primitive, right or wrong."""
    points, corners = np.asarray(positions, np.float32), np.asarray(indices, np.uint32)
    data = points.tobytes() + corners.tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"name": "leaf"}],
        "buffers": [{"byteLength": len(data), "uri": f"data:;base64,{base64.b64encode(data).decode()}"}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": corners.nbytes},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(points), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": len(corners), "type": "SCALAR"},
        ],
    }
    path.write_text(json.dumps({**document, **extra}))
    return path


def missing(folder: Path) -> Path:
    return folder / "nowhere.glb"


def truncated(folder: Path) -> Path:
    write_glb(folder / "bad.glb", leafy(3))
    data = (folder / "bad.glb").read_bytes()
    (folder / "bad.glb").write_bytes(data[: len(data) // 2])
    return folder / "bad.glb"


def not_a_mesh(folder: Path) -> Path:
    (folder / "bad.glb").write_text("Dear tree,")
    return folder / "bad.glb"


def unknown_suffix(folder: Path) -> Path:
    (folder / "bad.docx").write_text("Dear tree,")
    return folder / "bad.docx"


def no_triangles(folder: Path) -> Path:
    (folder / "bad.obj").write_text("v 0 0 0\n")
    return folder / "bad.obj"


def nan_vertex(folder: Path) -> Path:
    return gltf(folder / "bad.gltf", [[0, 0, 0], [1, 0, 0], [0, np.nan, 0]])


def index_out_of_range(folder: Path) -> Path:
    return gltf(folder / "bad.gltf", indices=(0, 1, 3))


def uri_leaving_the_folder(folder: Path) -> Path:
    (folder.parent / "outside.bin").write_bytes(bytes(48))
    return gltf(folder / "bad.gltf", buffers=[{"byteLength": 48, "uri": "../outside.bin"}])


BAD = [
    (missing, "nowhere.glb"),
    (truncated, "bad.glb"),
    (not_a_mesh, "bad.glb"),
    (unknown_suffix, "bad.docx"),
    (no_triangles, "triangle"),
    (nan_vertex, "NaN"),
    (index_out_of_range, "vertex"),
    (uri_leaving_the_folder, "outside.bin"),
]


@pytest.mark.parametrize(("make", "says"), BAD, ids=lambda value: getattr(value, "__name__", ""))
@pytest.mark.parametrize("command", ["bake", "cluster"])
def test_bad_tree_is_one_line_and_exit_2(
    tmp_path: Path, treebake: Callable[..., Outcome], make: Callable[[Path], Path], says: str, command: str
) -> None:
    (tmp_path / "in").mkdir()
    result = treebake(command, make(tmp_path / "in"), "-o", tmp_path / "out", "-q")
    assert (result.code, result.out) == (2, "")
    assert len(result.lines) == 1
    assert result.lines[0].startswith("treebake: error: ")
    assert says in result.lines[0]
    assert not (tmp_path / "out").exists()


def test_commands_are_these() -> None:
    assert set(cli.cli.commands) == COMMANDS


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_help_names_units_and_defaults_of_the_dataclasses(treebake: Callable[..., Outcome], command: str) -> None:
    text = " ".join(treebake(command, "--help").out.split())
    for option in cli.cli.commands[command].params:
        if isinstance(option, cli.SettingOption):
            setting = __import__("treebake.settings", fromlist=["keys"]).keys()[option.key]
            assert setting.help
            assert f"{setting.help} [{option.key}, default: {setting.default}]" in text


def test_help_imports_nothing_heavy() -> None:
    code = "import sys; from treebake.cli import cli; cli(['--help'], standalone_mode=False); print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert not {"numpy", "scipy", "moderngl", "rich", "msgspec"} & set(modules.split())


def test_bake_publishes_and_says_what(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("bake", tree, "-o", tmp_path / "out", "--billboards", 7, *COARSE, "--json")
    assert result.code == 0, result.err
    facts = json.loads(result.out)
    assert facts["asset"] == str(tmp_path / "out/tree")
    assert (facts["leaves"], facts["billboards"], facts["source_triangles"]) == (40, 7, 52)
    assert (tmp_path / "out/tree/tree_LOD0.glb").exists()
    assert (facts["indirect"]["file"], facts["indirect"]["leaves"]) == ("tree.glb", 40)
    assert (tmp_path / "out/tree/tree.glb").exists()
    manifest = json.loads((tmp_path / "out/tree/manifest.json").read_text())
    assert [manifest[name]["file"] for name in ("slicings", "views")] == ["tree_slicings.glb", "tree_views.glb"]
    written = {path.name for path in (tmp_path / "out/tree").iterdir()}
    assert {"tree_slicings.glb", "tree_views.glb"} < written


def test_two_bakes_give_the_same_bytes(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    for out in ("a", "b"):
        assert treebake("bake", tree, "-o", tmp_path / out, *COARSE).code == 0
    first, second = (sorted(p for p in (tmp_path / out).rglob("*") if p.is_file()) for out in ("a", "b"))
    assert [p.relative_to(tmp_path / "a") for p in first] == [p.relative_to(tmp_path / "b") for p in second]
    assert [p.name for p, q in zip(first, second, strict=True) if p.read_bytes() != q.read_bytes()] == []


SPLIT = ["split", "occlusion", "translucency", "normals"]


def skipped(result: Outcome) -> list[str]:
    """The stages that a bake found done."""
    return [line.split()[0] for line in result.lines if line.endswith("up to date")]


def test_second_bake_skips_the_stages_and_says_so(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    treebake("bake", tree, "-o", tmp_path, *COARSE)
    again = treebake("bake", tree, "-o", tmp_path, *COARSE)
    foliage = [*SPLIT, "twigs", "cluster", "indirect_cluster", "views", "indirect"]
    sliced = ["slicing_twigs", "slicing_trunk", "slicing_trunk_maps", "slicings"]
    assert skipped(again) == [*foliage, *sliced, "billboards", "trunk", "trunk_maps"]
    forced = treebake("bake", tree, "-o", tmp_path, *COARSE, "--force")
    assert "up to date" not in forced.err


def test_only_what_depends_on_a_setting_runs_again(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    treebake("bake", tree, "-o", tmp_path, *COARSE)
    again = treebake("bake", tree, "-o", tmp_path, *COARSE, "--trunk-triangles", 100)
    sliced = ["slicing_twigs", "slicing_trunk", "slicing_trunk_maps", "slicings"]
    # twigs and trunk ran, with the same outcome
    rest = [*SPLIT, "cluster", "indirect_cluster", "views", "indirect", *sliced, "billboards", "trunk_maps"]
    assert skipped(again) == rest
    again = treebake("bake", tree, "-o", tmp_path, *COARSE, "--set", "indirect_cluster.billboards=3")
    # the trunk's budget, too, is another again
    assert skipped(again) == [*SPLIT, "cluster", "views", *sliced, "billboards", "trunk_maps"]


def test_light_goes_through_leaves_unless_it_is_told_not_to(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    little = (*TEXTURES, "--set", "indirect.enabled=false")
    found = []
    for flag in ((), ("--no-translucency",)):
        assert treebake("bake", tree, "-o", tmp_path, *little, *flag).code == 0
        manifest = json.loads((tmp_path / tree.stem / "manifest.json").read_text())
        used = GltfFile(tmp_path / tree.stem / manifest["file"]).json.get("extensionsUsed", [])
        found.append((manifest["translucency"], "KHR_materials_diffuse_transmission" in used))
    (lit, known), off = found
    assert (lit["origin"], known) == ("broad leaf", True)
    assert off == (None, False)


def test_turned_normals_are_not_in_images_that_leaves_share(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    found = []
    for crown in (0, 1):
        assert treebake("bake", tree, "-o", tmp_path, *TEXTURES, "--set", f"normals.crown={crown}").code == 0
        images = tmp_path / tree.stem / "textures"
        names = ("leaf_normal", "far_normal", "foliage_normal")
        found.append([(images / f"{tree.stem}_{name}.png").read_bytes() for name in names])
    assert [one == other for one, other in zip(*found, strict=True)] == [True, True, False]


def test_slicings_and_views_run_again_by_their_own_settings(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    treebake("bake", tree, "-o", tmp_path, *COARSE)
    trunk = ("--set", "slicing_trunk.triangles=100")  # the budget of both their twigs and their trunk
    first = [*SPLIT, "twigs", "cluster", "indirect_cluster", "views", "indirect"]
    last = ["billboards", "trunk", "trunk_maps"]
    rest = [*first, "slicing_trunk_maps", "slicings", *last]
    assert skipped(treebake("bake", tree, "-o", tmp_path, *COARSE, *trunk)) == rest
    fewer = ("--set", "slicings.slices=2", "--set", "views.side=2")
    rest = [*SPLIT, "twigs", "cluster", "indirect_cluster", "indirect"]
    rest += ["slicing_twigs", "slicing_trunk", "slicing_trunk_maps"]
    assert skipped(treebake("bake", tree, "-o", tmp_path, *COARSE, *trunk, *fewer)) == [*rest, *last]


def test_cluster_then_textures_is_bake(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    treebake("bake", tree, "-o", tmp_path, *COARSE)
    assert treebake("cluster", tree, "-o", tmp_path / "work").code == 0
    assert treebake("textures", tmp_path / "work", "-o", tmp_path / "out", *COARSE).code == 0
    for name in ("tree_LOD0.glb", "tree.glb", "tree_slicings.glb", "tree_views.glb"):
        baked, made = ((tmp_path / folder / "tree" / name).read_bytes() for folder in (".", "out"))
        assert baked == made


def test_textures_without_cluster_names_the_command(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("textures", tmp_path / "work")
    assert result.code == 2
    assert f"treebake cluster TREE -o {tmp_path / 'work'}" in result.err


def test_missing_texture_warns_and_goes_on(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    textured = {
        "materials": [{"name": "leaf", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}],
        "images": [{"uri": "gone.png"}],
    }
    result = treebake("bake", gltf(tmp_path / "tree.gltf", **textured), "-o", tmp_path / "out", "-q", *TEXTURES)
    assert result.code == 0, result.err
    assert any(line.startswith("treebake: warning: ") and "gone.png" in line for line in result.lines)


def test_tree_without_leaves_is_all_trunk_with_a_warning(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    write_glb(tmp_path / "bare.glb", leafy(1)[:1])
    result = treebake("bake", tmp_path / "bare.glb", "-o", tmp_path / "out", *TEXTURES, "--json")
    assert result.code == 0, result.err
    assert "treebake: warning: split: no foliage" in result.err
    facts = json.loads(result.out)
    assert facts["levels"][0]["representations"] == "trunk"
    assert "indirect" not in facts


def test_a_tree_without_leaves_has_views_and_no_slicings(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    write_glb(tmp_path / "bare.glb", leafy(1)[:1])
    assert treebake("bake", tmp_path / "bare.glb", "-o", tmp_path, *COARSE).code == 0
    manifest = json.loads((tmp_path / "bare/manifest.json").read_text())
    assert manifest["slicings"] is None
    assert manifest["views"]["file"] == "bare_views.glb"


def test_a_single_triangle_bakes_into_everything(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("bake", gltf(tmp_path / "leaf.gltf"), "-o", tmp_path, *COARSE)
    assert result.code == 0, result.err


@pytest.mark.parametrize(
    ("leaves", "coplanar"), [(1, False), (5, False), (30, True)], ids=["one leaf", "fewer than billboards", "coplanar"]
)
def test_odd_foliage_still_bakes(tmp_path: Path, treebake: Callable[..., Outcome], leaves: int, coplanar: bool) -> None:
    write_glb(tmp_path / "odd.glb", leafy(leaves, coplanar=coplanar))
    result = treebake("bake", tmp_path / "odd.glb", "-o", tmp_path / "out", "--billboards", 8, *COARSE, "--json")
    assert result.code == 0, result.err
    facts = json.loads(result.out)
    assert facts["leaves"] == leaves
    assert 1 <= facts["billboards"] <= min(8, leaves)
    assert ("of the 8 billboards asked for" in result.err) == (leaves < 8)


def test_unwritable_output_is_one_line(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    (tmp_path / "out").write_text("a file, not a folder")
    result = treebake("bake", tree, "-o", tmp_path / "out", "-q")
    assert (result.code, len(result.lines)) == (2, 1)
    assert "cannot be written" in result.err
    assert treebake("grow", "chestnut", "--leaves", 10, "-o", tmp_path / "out/tree.glb", "-q").code == 2


def test_no_opengl_names_the_packages_and_publishes_nothing(tmp_path: Path, tree: Path) -> None:
    command = [sys.executable, "-m", "treebake", "bake", str(tree), "-o", str(tmp_path / "out"), "-q"]
    environment = {**os.environ, "__EGL_VENDOR_LIBRARY_FILENAMES": "/dev/null"}  # the loader finds no driver
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
    assert "libegl1 libgl1 libgl1-mesa-dri" in done.stderr
    assert not (tmp_path / "out/tree/manifest.json").exists()


def test_interrupt_is_one_line_and_the_next_run_goes_on(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch
) -> None:
    def cluster(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "cluster", cluster)
        stopped = treebake("cluster", tree, "-o", tmp_path / "work")
    assert stopped.code == 130
    assert "Traceback" not in stopped.err
    assert stopped.lines[-1].startswith("treebake: interrupted")
    resumed = treebake("cluster", tree, "-o", tmp_path / "work")
    assert resumed.code == 0
    assert skipped(resumed) == [*SPLIT, "twigs"]


def test_a_real_ctrl_c_leaves_no_half_written_file(tmp_path: Path) -> None:
    write_glb(tmp_path / "tree.glb", leafy(3000))
    command = [sys.executable, "-m", "treebake", "bake", "tree.glb", "-o", "out"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        assert process.stderr.readline().startswith("load")
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
    assert process.returncode == 130, rest
    assert "Traceback" not in rest
    written = {path.name for path in (tmp_path / "out").rglob("*") if path.is_file()}
    stages = {"split", "translucency", "normals", "twigs", "cluster", "indirect_cluster", "billboards", "indirect"}
    stages |= {"trunk", "slicing_twigs", "slicing_trunk", "slicings", "views"}
    assert written <= {"source.npz"} | {f"{stage}.npz" for stage in stages}


@pytest.mark.parametrize("verbose", [False, True])
def test_an_unforeseen_error_is_one_line_and_exit_70(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome], monkeypatch: pytest.MonkeyPatch, verbose: bool
) -> None:
    def cluster(*_: object) -> None:
        raise ZeroDivisionError("by\nnought")

    monkeypatch.setattr(pipeline, "cluster", cluster)
    result = treebake("cluster", tree, "-o", tmp_path / "work", "-v" if verbose else "-q")
    assert result.code == 70
    assert result.lines[-1].startswith("treebake: internal error: ZeroDivisionError: by nought; run again with -v")
    assert ("Traceback" in result.err) == verbose
    assert verbose or len(result.lines) == 1


def test_no_command_shows_the_help(treebake: Callable[..., Outcome]) -> None:
    assert "Commands:" in treebake().out


def test_unknown_command_and_unknown_setting_exit_2(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    assert treebake("chop").code == 2
    result = treebake("cluster", tree, "-o", tmp_path, "--set", "cluster.billbords=3")
    assert result.code == 2
    assert "did you mean cluster.billboards?" in result.err


def test_flags_override_set_which_overrides_the_file(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    config = tmp_path / "config.toml"
    config.write_text("[cluster]\nbillboards = 3\n")
    base = ("cluster", tree, "-o", tmp_path / "work", "--json", "--config", config)
    assert json.loads(treebake(*base).out)["billboards"] == 3
    assert json.loads(treebake(*base, "--set", "cluster.billboards=4").out)["billboards"] == 4
    both = (*base, "--set", "cluster.billboards=4", "--billboards", 5)
    assert json.loads(treebake(*both).out)["billboards"] == 5


def test_quiet_says_nothing_where_all_is_well(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("cluster", tree, "-o", tmp_path / "work", "-q")
    assert (result.code, result.out, result.err) == (0, "", "")


def test_version(treebake: Callable[..., Outcome]) -> None:
    assert treebake("--version").out.startswith("treebake ")


def test_grow_is_seeded(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        result = treebake("grow", "maple", "--leaves", 20, "--seed", seed, "-o", tmp_path / f"{name}.glb", "--json")
        assert json.loads(result.out)["triangles"] > 20
    a, b, c = ((tmp_path / f"{name}.glb").read_bytes() for name in "abc")
    assert a == b != c


def test_grow_writes_glb_only(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("grow", "maple", "--leaves", 20, "-o", tmp_path / "tree.txt")
    assert (result.code, len(result.lines)) == (2, 1)
    assert str(tmp_path / "tree.glb") in result.err
    assert not (tmp_path / "tree.txt").exists()


SMALL = ("--set", "verify.heights=[32]", "--set", "verify.azimuths=1", "--set", "verify.elevations=[0]")


@pytest.fixture
def asset(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> Path:
    assert treebake("bake", tree, "-o", tmp_path / "out", *COARSE).code == 0
    return tmp_path / "out/tree"


def test_verify_writes_a_report_and_passes(asset: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("verify", asset, "--source", tree, *SMALL, "--json")
    assert result.code == 0, result.err
    facts = json.loads(result.out)
    assert facts["report"] == str(asset / "report")
    assert list(facts["representations"]) == ["cloud", "cloud_same_bytes", "indirect", "leaves", "slicings", "views"]
    for name, found in facts["representations"].items():
        assert [row["height"] for row in found["heights"]] == [32]
        assert found["close_up"]["height"] == CLOSE_UP
        assert {f"{name}_32px.png", f"{name}_close.png"} < {path.name for path in (asset / "report").iterdir()}
    assert json.loads((asset / "report/report.json").read_text()) == facts["representations"]


def test_verify_judges_the_representations_asked_for(asset: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    only = ("--set", 'verify.representations=["indirect"]')
    result = treebake("verify", asset, "--source", tree, *SMALL, *only, "--json")
    assert list(json.loads(result.out)["representations"]) == ["indirect"]
    assert [path.name for path in (asset / "report").glob("*_32px.png")] == ["indirect_32px.png"]
    result = treebake("verify", asset, "--source", tree, *SMALL, "--set", 'verify.representations=["indirec"]')
    assert (result.code, len(result.lines)) == (2, 1)
    assert (
        "has no indirec, only cloud, cloud_same_bytes, indirect, leaves, slicings, views; change verify.representations"
        in result.err
    )


QUICK_LIGHT = ["suns=2", "shadow_texels=256", "azimuths=1", "ground=128", "hours=2", "day_height=32", "directions=16"]
QUICK_LIGHT += ["heights={cloud=32, indirect=32, leaves=32, slicings=32, views=32}"]


def test_verify_light_judges_every_representation(asset: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    small = [part for each in QUICK_LIGHT for part in ("--set", f"light.{each}")]
    result = treebake("verify", asset, "--source", tree, "--light", *small, "--json")
    assert result.code == 0, result.err
    found = json.loads(result.out)["representations"]
    assert list(found) == ["cloud", "indirect", "leaves", "slicings", "views"]
    assert found["indirect"]["shadows"]["ground_iou"] > 0.8
    assert found["indirect"]["relit"]["flip_ratio"] < found["views"]["relit"]["flip_ratio"]
    written = {path.name for path in (asset / "report").iterdir()}
    assert written == {"light.json"} | {
        f"{name}_{sheet}.png" for name in found for sheet in ("suns", "ground", "day", "light")
    }


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--set", 'verify.representations=["cloud_same_bytes"]'], "names none of them but cloud_same_bytes"),
        (["--set", "light.heights.cloud=8"], "[light] heights"),
        (["--quick"], "--light has no thresholds"),
        (["--threshold", "flip=1"], "--light has no thresholds"),
    ],
)
def test_verify_light_is_refused_where_it_has_nothing_to_say(
    asset: Path, tree: Path, treebake: Callable[..., Outcome], arguments: list[str], told: str
) -> None:
    result = treebake("verify", asset, "--source", tree, "--light", *arguments)
    assert (result.code, len(result.lines)) == (2, 1), result.err
    assert told in result.err


def test_verify_keeps_the_source_out_of_the_asset(asset: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    treebake("verify", asset, "--source", tree, *SMALL)
    assert not list((asset / "report").rglob("*.npz"))
    assert len(list((tree.parent / "cache/treebake").iterdir())) == 2  # at 32 pixels and close up, for all candidates


@pytest.mark.parametrize(("change", "what"), [("triangles", "triangles differ"), ("up", "bounds differ")])
def test_verify_against_another_source_is_a_warning(
    asset: Path, tree: Path, treebake: Callable[..., Outcome], change: str, what: str
) -> None:
    assert treebake("verify", asset, "--source", tree, *SMALL, "-q").err == ""
    if change == "triangles":
        write_glb(tree, leafy(39))
    result = treebake("verify", asset, "--source", tree, *SMALL, "-q", *(["--up", "z"] if change == "up" else []))
    assert result.code == 0
    (line,) = result.lines
    assert line.startswith(f"treebake: warning: {tree} is not the mesh that {asset} was baked from ({what})")


def test_missed_threshold_is_named_and_exits_1(asset: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("verify", asset, "--source", tree, *SMALL, "-q", "--threshold", "ssim_min.32=1.01")
    assert result.code == 1
    assert [line.partition(": ssim at 32 px is ")[0] for line in result.lines] == [
        f"treebake: missed: {name}" for name in ("cloud", "indirect", "leaves", "slicings", "views")
    ]


def test_verify_judges_a_third_party_file(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    copy = tmp_path / "theirs/copy.glb"
    copy.parent.mkdir()
    copy.write_bytes(tree.read_bytes())
    result = treebake("verify", "--source", tree, "--candidate", copy, *SMALL, "--json")
    assert result.code == 0, result.err
    facts = json.loads(result.out)
    assert facts["report"] == str(tmp_path / "theirs/copy_report")
    assert facts["representations"]["candidate"]["heights"][0]["flip"] == 0


def test_load_settings_are_for_the_source_alone(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    (tmp_path / "bark.png").write_bytes(encode_png(np.full((1, 1, 3), 200, np.uint8)))
    positions = np.array([[0, 3, 0], [1, 3, 0], [0, 3, 1]], np.float32)
    theirs = mesh(positions, np.array([[0, 1, 2]], np.int32), Material("theirs", (0.5, 0.5, 0.5, 1.0)))
    write_glb(tmp_path / "theirs.glb", [("theirs", theirs)])
    seen = []

    def verify(_source: Mesh, candidates: dict[int, Mesh], *_: object, **__: object) -> None:
        seen.extend(candidates.values())
        raise KeyboardInterrupt

    load = ("--up", "z", "--set", "load.textures.bark=bark.png")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "verify", verify)
        result = treebake("verify", "--source", tree, "--candidate", tmp_path / "theirs.glb", *SMALL, *load)
    assert result.code == 130, result.err
    np.testing.assert_allclose(seen[0].positions, positions)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ((), "name one of: an ASSET folder"),
        (("asset", "--candidate", "file.glb"), "name one of: an ASSET folder"),
        (("asset", "--forest", "scene.glb"), "name one of: an ASSET folder"),
        (("asset", "--source", "other.glb"), "an asset or a candidate has one --source"),
        (("asset", "--threshold", "flip=abc"), "flip=abc: its bound is no number"),
        (("asset", "--thresholds", "flip=1"), "--threshold"),
    ],
)
def test_verify_called_wrongly_is_one_line(
    tree: Path, treebake: Callable[..., Outcome], arguments: tuple[str, ...], says: str
) -> None:
    result = treebake("verify", *arguments, "--source", tree)
    assert (result.code, len(result.lines)) == (2, 1)
    assert result.lines[0].startswith("treebake: error: ")
    assert says in result.lines[0]


def test_verify_of_an_unpublished_work_folder_is_one_line(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    treebake("cluster", tree, "-o", tmp_path / "work")
    result = treebake("verify", tmp_path / "work", "--source", tree, "-q")
    assert (result.code, len(result.lines)) == (2, 1)
    assert "manifest.json" in result.err


def test_inspect_tells_trees_from_assets(asset: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    assert json.loads(treebake("inspect", tree, "--json").out)["triangles"] == 52
    assert json.loads(treebake("inspect", asset, "--json").out)["source_triangles"] == 52


def test_the_source_is_never_replaced(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    source = tmp_path / "oak/oak.glb"
    source.parent.mkdir()
    source.write_bytes(tree.read_bytes())
    for command in (("bake", source, "-o", tmp_path), ("cluster", source, "-o", source.parent)):
        result = treebake(*command)
        assert result.code == 2
        assert "oak.glb is the source and would be replaced; give another folder with -o" in result.err
    assert treebake("cluster", source, "-o", tmp_path / "work").code == 0
    assert treebake("textures", tmp_path / "work", "-o", tmp_path, *TEXTURES).code == 2
    assert source.read_bytes() == tree.read_bytes()


@pytest.mark.parametrize(
    ("table", "image"),
    [
        ("indirect", "tree_placements.png"),
        ("slicings", "tree_slicings_coverage.png"),
        ("views", "tree_views_coverage.png"),
    ],
)
def test_all_but_the_cloud_can_be_left_out(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome], table: str, image: str
) -> None:
    assert treebake("bake", tree, "-o", tmp_path, *COARSE, "--set", f"{table}.enabled=false").code == 0
    manifest = json.loads((tmp_path / "tree/manifest.json").read_text())
    assert [name for name in ("indirect", "slicings", "views") if manifest[name] is None] == [table]
    pictures = {f"tree_{name}.glb" for name in ("slicings", "views") if name != table}
    assert {path.name for path in (tmp_path / "tree").glob("*.glb")} == {"tree.glb", "tree_LOD0.glb", *pictures}
    images = {path.name for path in (tmp_path / "tree/textures").iterdir()}
    others = {"tree_placements.png", "tree_slicings_coverage.png", "tree_views_coverage.png"} - {image}
    assert others < images
    assert image not in images


def test_verify_of_what_is_not_there(tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]) -> None:
    result = treebake("verify", tmp_path / "nowhere", "--source", tree)
    assert (result.code, result.lines) == (
        2,
        [f"treebake: error: {tmp_path / 'nowhere'} does not exist; check the path"],
    )


# ---- levels --------------------------------------------------------------------------------------------------------

LEVELS = [
    part
    for assignment in (
        "levels.enabled=true",
        "hierarchy.billboards=[8, 2]",
        "levels.heights=[64, 32]",
        "levels.trunk_triangles=[8, 4]",
    )
    for part in ("--set", assignment)
]


def test_levels_are_baked_verified_and_baked_again(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    result = treebake("bake", tree, "-o", tmp_path, *TEXTURES, *LEVELS, "--json")
    assert result.code == 0, result.err
    levels = json.loads(result.out)["levels"]
    assert [(level["billboards"], level["min_height"]) for level in levels] == [(40, 64), (8, 32), (2, 0)]
    again = skipped(treebake("bake", tree, "-o", tmp_path, *TEXTURES, *LEVELS))
    stages = ("twigs", "trunk", "billboards", "trunk_maps")
    assert again[-8:] == [f"{stage}_{number}" for number in (1, 2) for stage in stages]
    views = ("--set", "verify.heights=[32]", "--set", "verify.azimuths=1", "--set", 'verify.representations=["cloud"]')
    judged = treebake("verify", tmp_path / "tree", "--source", tree, *views, "--set", "verify.morph=2", "--json")
    assert judged.code == 0, judged.err
    morphs = json.loads(judged.out)["representations"]["cloud"]["morphs"]
    assert [(morph["level"], morph["height"]) for morph in morphs] == [(0, 64), (1, 32)]
    # A level is a source like any other, its morph left out, even where its cards are called the trunk.
    names = ("--set", 'split.trunk_materials=["foliage"]', "--set", 'split.foliage_materials=["trunk"]')
    assert treebake("bake", tmp_path / "tree/tree_LOD1.glb", "-o", tmp_path / "next", *TEXTURES, *names).code == 0
    assert read_mesh(tmp_path / "next/tree_LOD1/tree_LOD1_LOD0.glb").morph is None


# ---- the ladder ----------------------------------------------------------------------------------------------------

LADDER = [
    part
    for assignment in (
        "ladder.enabled=true",
        "ladder.heights=[64, 32]",
        "ladder.elevations=[0]",
        "ladder.azimuths=1",
    )
    for part in ("--set", assignment)
]


def files(folder: Path) -> dict[str, bytes]:
    """Everything in a work folder but the stages' results."""
    found = (path for path in folder.rglob("*") if path.is_file() and "stages" not in path.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_a_ladder_is_measured_once_and_ranks_all_that_is_there(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    result = treebake("bake", tree, "-o", tmp_path, *COARSE, *LADDER)
    assert result.code == 0, result.err
    manifest = read_asset(tmp_path / "tree").manifest
    assert [rung.min_height for rung in manifest.ladder] in ([0], [32, 0])
    ranked = {(one.representation, one.level) for one in (*manifest.ladder, *manifest.left_out)}
    assert ranked == {("cloud", 0), *((name, None) for name in ("leaves", "indirect", "slicings", "views"))}
    first = files(tmp_path / "tree")
    assert skipped(treebake("bake", tree, "-o", tmp_path, *COARSE, *LADDER))[-1] == "ladder"
    assert files(tmp_path / "tree") == first


def test_levels_are_told_down_to_which_height_each_is_good(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    result = treebake("bake", tree, "-o", tmp_path, *TEXTURES, *LEVELS, *LADDER)
    assert result.code == 0, result.err
    heights = [level.min_height for level in read_asset(tmp_path / "tree").manifest.levels]
    assert heights == sorted(heights, reverse=True)
    assert set(heights) <= {64, 32, 0}
    assert heights[-1] == 0
    nodes = GltfFile(tmp_path / "tree/tree.glb").json["nodes"]
    covered = [node["extras"]["MSFT_screencoverage"] for node in nodes if "extras" in node]
    assert covered == [[height / 1080 for height in heights]]  # of the node that holds cloud and trunk
    assert_valid(tmp_path / "tree/tree.glb")


def test_where_nothing_is_invisible_there_is_a_ladder_too(tmp_path: Path, treebake: Callable[..., Outcome]) -> None:
    treebake("grow", "shrub", "--leaves", 60, "-o", tmp_path / "shrub.glb")
    few = ("--billboards", 8, "--set", "views.layers=1", "--set", "views.side=2", "--set", "ladder.heights=[96, 64]")
    one = ("--set", "indirect.enabled=false", "--set", "slicings.enabled=false")
    result = treebake("bake", tmp_path / "shrub.glb", "-o", tmp_path, *COARSE, *LADDER, *few, *one)
    assert result.code == 0, result.err
    ladder = read_asset(tmp_path / "shrub").manifest.ladder
    assert ladder
    assert all(rung.flip_ratio > 1 for rung in ladder)


@pytest.mark.parametrize("kept", ["leaves", "cloud", "slicings", "views"])
def test_for_one_height_one_representation_is_kept(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome], kept: str
) -> None:
    tables = {"leaves": "indirect", "slicings": "slicings", "views": "views"}
    others = [part for name, table in tables.items() if name != kept for part in ("--set", f"{table}.enabled=false")]
    arguments = ("bake", tree, "-o", tmp_path, *COARSE, *others, "--height", 64)
    result = treebake(*arguments)
    assert result.code == 0, result.err
    asset = read_asset(tmp_path / "tree")
    (rung,) = asset.manifest.ladder
    assert rung.min_height == 0
    assert asset.manifest.left_out == ()
    assert len(asset.manifest.levels) == 1
    entries = {name for name in tables.values() if getattr(asset.manifest, name)}
    assert entries == {tables[rung.representation]} if rung.representation in tables else entries == set()
    written = files(tmp_path / "tree")
    assert set(written) == {*files_of(asset.manifest), "manifest.json"}
    assert_valid(*(tmp_path / "tree").glob("*.glb"))
    assert skipped(treebake(*arguments))[-1] == "budget"
    assert files(tmp_path / "tree") == written


def test_of_a_kept_level_the_ladder_names_the_file_that_is_there(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    only_clouds = (*NO_PICTURES, "--set", "indirect.enabled=false")
    assert treebake("bake", tree, "-o", tmp_path, *TEXTURES, *only_clouds, *LEVELS, "--height", 16).code == 0
    asset = read_asset(tmp_path / "tree")
    (rung,) = asset.manifest.ladder
    assert (rung.representation, rung.level, rung.file) == ("cloud", 0, asset.manifest.levels[0].file)
    assert (asset.folder / rung.file).is_file()


def test_a_budget_that_cannot_be_met_leaves_what_was_published(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome]
) -> None:
    assert treebake("bake", tree, "-o", tmp_path, *TEXTURES).code == 0
    before = files(tmp_path / "tree")
    assert treebake("bake", tree, "-o", tmp_path, *TEXTURES, "--height", 64, "--bytes", 1).code == 2
    assert files(tmp_path / "tree") == before
    assert not (tmp_path / "tree/stages/draft").exists()


@pytest.mark.parametrize(
    ("caps", "says"),
    [
        (
            ("--height", 64, "--bytes", 1),
            "nothing of tree is within [budget] triangles = 0, bytes = 1; the smallest has",
        ),
        (("--triangles", 100), "[budget] height is 0; it must be 16 to 2048"),
        (("--height", 8), "[budget] height is 8; it must be 16 to 2048"),
    ],
)
def test_a_budget_that_cannot_be_met_is_one_line(
    tmp_path: Path, tree: Path, treebake: Callable[..., Outcome], caps: tuple[object, ...], says: str
) -> None:
    result = treebake("bake", tree, "-o", tmp_path, *TEXTURES, *caps, "-q")
    assert result.code == 2
    (error,) = (line for line in result.lines if not line.startswith("treebake: warning: "))
    assert error.startswith(f"treebake: error: {says}")
