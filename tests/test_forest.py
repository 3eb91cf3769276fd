"""`treebake forest`: published assets scattered into one GLB, as any viewer and as renderers of ours read it."""

import io
import json
import os
import shutil
import struct
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_validate import assert_valid
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from synthetic import quad, small_tree

from treebake import cli
from treebake.asset import Asset, asset_bounds, read_asset, read_forest, write_asset, write_forest
from treebake.errors import AssetError, MeshError, WorkspaceError
from treebake.formats.gltf_file import GltfFile
from treebake.glb import write_glb
from treebake.meshes import read_mesh
from treebake.model import BakedTree, BillboardCloud, Forest, Material
from treebake.stages.scatter import ForestSettings, scatter

QUICK = ["--atlas", "64"]
UNUSED = ("indirect", "slicings", "views", "ladder")
for setting in ("textures.supersample=1", *(f"{kind}.enabled=false" for kind in UNUSED)):
    QUICK += ["--set", setting]


def asset(folder: Path, name: str) -> Asset:
    """Four quads with two materials, that reach out of the source's bounds."""
    nothing = BillboardCloud(quad(Material("none")).select(np.zeros(2, bool)), np.zeros(0, np.int32))
    bounds = np.array([(-0.5, 0, -0.5), (0.5, 2, 0.5)], np.float32)
    write_asset(BakedTree(name, nothing, None, small_tree(), 1000, bounds), folder / name)
    return read_asset(folder / name)


def with_levels(made: Asset) -> Asset:
    """The same with a coarser level, a single quad, below 270 pixels."""
    name = made.manifest.name
    write_glb(made.folder / f"{name}_LOD1.glb", [("trunk", quad(Material("far", (0, 1, 0, 1)), y=(0, 2)))])
    path = made.folder / "manifest.json"
    manifest = json.loads(path.read_text())
    (near,) = manifest["levels"]
    manifest["levels"] = [near | {"min_height": 270}, near | {"file": f"{name}_LOD1.glb", "trunk_triangles": 2}]
    path.write_text(json.dumps(manifest))
    return read_asset(made.folder)


@pytest.fixture
def assets(tmp_path: Path) -> list[Asset]:
    return [with_levels(asset(tmp_path, "oak")), asset(tmp_path, "birch")]


def planted(assets: list[Asset], trees: int, **others: Any) -> Forest:
    sizes = {each.manifest.name: asset_bounds(each) for each in assets}
    return scatter(sizes, ForestSettings(trees=trees, **others))


def arrays(forest: Forest) -> list[np.ndarray]:
    return [forest.species, forest.places, forest.turns, *astuple(forest.cells)]


def instances(file: GltfFile, node: dict[str, Any]) -> dict[str, np.ndarray]:
    attributes = node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]
    return {name: file.accessor(index) for name, index in attributes.items()}


def edited(path: Path, change: Any) -> None:
    """Rewrite the JSON of a GLB."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    path.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest)


# ---- the file ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("trees", [0, 1, 500])
def test_what_is_written_is_read(tmp_path: Path, assets: list[Asset], trees: int) -> None:
    forest = planted(assets, trees, cell=3)
    write_forest(tmp_path / "out/scene.glb", forest, assets)
    found, folders = read_forest(tmp_path / "out/scene.glb")
    assert [folder.resolve() for folder in folders] == [each.folder.resolve() for each in assets]
    assert found.names == ("oak", "birch")
    for ours, theirs in zip(arrays(forest), arrays(found), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("trees", [1, 500])
def test_the_instances_of_the_nodes_are_the_trees_of_the_table(tmp_path: Path, assets: list[Asset], trees: int) -> None:
    forest = planted(assets, trees, cell=3)
    write_forest(tmp_path / "scene.glb", forest, assets)
    file = GltfFile(tmp_path / "scene.glb")
    nodes = [file.json["nodes"][index] for index in file.json["scenes"][0]["nodes"]]
    found = [instances(file, node) for node in nodes]
    joined = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    names = np.repeat([node["name"] for node in nodes], [len(each["SCALE"]) for each in found])
    np.testing.assert_array_equal(joined["TRANSLATION"], forest.places[:, :3])
    np.testing.assert_array_equal(joined["SCALE"], forest.places[:, 3:].repeat(3, axis=1))
    rotations = Rotation.from_euler("y", forest.turns[:, None].astype(np.float64))
    assert (Rotation.from_quat(joined["ROTATION"]) * rotations.inv()).magnitude().max() < 1e-6
    assert names.tolist() == [forest.names[species] for species in forest.species]


def test_a_viewer_sees_every_tree_at_its_place(tmp_path: Path, assets: list[Asset]) -> None:
    forest = planted(assets, 5, seed=2)
    write_forest(tmp_path / "scene.glb", forest, assets)
    seen = read_mesh(tmp_path / "scene.glb")
    tree = small_tree()
    expected = []
    for x, y, z, scale, turn in np.column_stack([forest.places, forest.turns]).astype(np.float64):
        cosine, sine = np.cos(turn), np.sin(turn)  # from +Z towards +X
        p = tree.positions[tree.faces].reshape(-1, 3) * scale
        turned = [p[:, 0] * cosine + p[:, 2] * sine, p[:, 1], p[:, 2] * cosine - p[:, 0] * sine]
        expected.append(np.column_stack(turned) + np.array([x, y, z]))
    ours, theirs = np.concatenate(expected), seen.positions[seen.faces].reshape(-1, 3)
    assert seen.triangles == 5 * tree.triangles
    for some, others in ((ours, theirs), (theirs, ours)):
        assert cKDTree(some).query(others)[0].max() < 1e-5
    bounds = forest.cells.bounds
    assert (seen.bounds[0] >= bounds[:, 0].min(axis=0) - 1e-5).all()
    assert (seen.bounds[1] <= bounds[:, 1].max(axis=0) + 1e-5).all()


def test_all_levels_have_the_same_instances_and_switch_where_the_manifest_says(
    tmp_path: Path, assets: list[Asset]
) -> None:
    write_forest(tmp_path / "scene.glb", planted(assets, 60, cell=3), assets)
    file = GltfFile(tmp_path / "scene.glb")
    nodes = file.json["nodes"]
    oaks = [node for node in nodes if node["name"] == "oak"]
    assert len(oaks) > 1
    for oak in oaks:
        (far,) = (nodes[index] for index in oak["extensions"]["MSFT_lod"]["ids"])
        assert oak["extras"]["MSFT_screencoverage"] == [0.25, 0]
        assert far["name"] == "oak_LOD1"
        key = "EXT_mesh_gpu_instancing"
        assert far["extensions"][key] == oak["extensions"][key]
    assert {node["name"] for node in nodes if "MSFT_lod" in node["extensions"]} == {"oak"}  # a birch has one level
    assert len(file.json["meshes"]) == 3


def test_a_hundred_thousand_trees_cost_their_table_and_not_a_mesh_each(tmp_path: Path, assets: list[Asset]) -> None:
    forest = planted(assets, 100_000)
    write_forest(tmp_path / "scene.glb", forest, assets)
    meshes = sum(level.stat().st_size for each in assets for level in each.level_paths)
    size = (tmp_path / "scene.glb").stat().st_size
    assert size < meshes + 80 * 100_000
    assert size < meshes * 100_000 / 50
    assert len(GltfFile(tmp_path / "scene.glb").json["meshes"]) == 3
    found, _ = read_forest(tmp_path / "scene.glb")
    np.testing.assert_array_equal(found.places, forest.places)


def test_the_files_are_valid(tmp_path: Path, assets: list[Asset]) -> None:
    paths = [tmp_path / f"scene{trees}.glb" for trees in (0, 1, 100)]
    for trees, path in zip((0, 1, 100), paths, strict=True):
        write_forest(path, planted(assets, trees, cell=3), assets)
    assert_valid(*paths)


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path, assets: list[Asset]) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_forest(tmp_path / f"{name}.glb", planted(assets, 50, seed=seed), assets)
    first, again, other = ((tmp_path / f"{name}.glb").read_bytes() for name in "abc")
    assert first == again != other


def test_bounds_hold_what_the_levels_show_and_the_source(tmp_path: Path) -> None:
    low, high = asset_bounds(asset(tmp_path, "oak"))
    np.testing.assert_allclose(low, [-0.8, 0, -0.5])
    np.testing.assert_allclose(high, [0.9, 2.4, 0.5])


# ---- what is wrong -------------------------------------------------------------------------------------------------


def test_a_species_without_an_asset_is_named(tmp_path: Path, assets: list[Asset]) -> None:
    with pytest.raises(AssetError, match="no asset is named oak, as a species of the forest is; there are birch"):
        write_forest(tmp_path / "scene.glb", planted(assets, 3), assets[1:])
    assert not (tmp_path / "scene.glb").exists()


@pytest.mark.parametrize("file", ["birch_LOD0.glb", "oak_LOD1.glb", "link.glb"])
def test_no_file_of_an_asset_is_replaced(tmp_path: Path, assets: list[Asset], file: str) -> None:
    path = tmp_path / file.split("_")[0] / file
    if file == "link.glb":
        path = tmp_path / file
        path.symlink_to(assets[0].level_paths[0])
    before = path.read_bytes()
    with pytest.raises(WorkspaceError, match=f"{file} is a file of the asset .*; give another name with -o"):
        write_forest(path, planted(assets, 3), assets)
    assert path.read_bytes() == before


def test_a_damaged_level_leaves_no_file(tmp_path: Path, assets: list[Asset]) -> None:
    forest = planted(assets, 3)
    os.truncate(assets[0].level_paths[0], 100)
    with pytest.raises(MeshError, match=r"oak_LOD0\.glb is truncated"):
        write_forest(tmp_path / "scene.glb", forest, assets)
    assert not (tmp_path / "scene.glb").exists()


def extras(change: Any) -> Any:
    return lambda document: change(document["extras"]["treebake"])


def counts_for(table: str) -> Any:
    """Let a table be that of the cells' counts."""
    return extras(lambda found: found["forest"]["table"].update({table: found["forest"]["table"]["count"]}))


def shorter(table: str) -> Any:
    """Let a table end early."""

    def change(document: Any) -> None:
        document["accessors"][document["extras"]["treebake"]["forest"]["table"][table]]["count"] -= 1

    return change


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (extras(lambda found: found.update(format=99)), "is of format 99, and this treebake reads 1"),
        (extras(lambda found: found.pop("forest")), "holds no usable forest .there is none."),
        (extras(lambda found: found["forest"].pop("assets")), "holds no usable forest .*assets"),
        (extras(lambda found: found["forest"]["assets"].pop()), "a tree is of a species that it does not name"),
        (extras(lambda found: found["forest"]["table"].update(turns=10**6)), "holds no usable forest"),
        (counts_for("places"), "table places has values of another kind"),
        (counts_for("turns"), "table turns has values of another kind"),
        (counts_for("first"), "its cells do not hold its trees"),
        (shorter("turns"), "its tables are of different lengths"),
        (shorter("bounds"), "it has more or fewer bounds than cells"),
        (shorter("first"), "its cells do not hold its trees"),
    ],
)
def test_a_damaged_forest_is_one_line(tmp_path: Path, assets: list[Asset], change: Any, says: str) -> None:
    write_forest(tmp_path / "scene.glb", planted(assets, 50, cell=3), assets)
    edited(tmp_path / "scene.glb", change)
    with pytest.raises(AssetError, match=says):
        read_forest(tmp_path / "scene.glb")


def test_a_file_that_is_no_forest(tmp_path: Path, assets: list[Asset]) -> None:
    with pytest.raises(AssetError, match="holds no usable forest"):
        read_forest(tmp_path / "missing.glb")
    with pytest.raises(AssetError, match="holds no usable forest"):
        read_forest(assets[0].level_paths[0])


# ---- the command ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


def treebake(*arguments: object) -> Outcome:
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["treebake", *map(str, arguments)])
        with pytest.raises(SystemExit) as exit_:
            cli.main()
    return Outcome(int(exit_.value.code or 0), out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the baked shrubs a and b."""
    folder = tmp_path_factory.mktemp("forest")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        for seed, name in enumerate("ab"):
            assert treebake("grow", "shrub", "--leaves", 60, "--seed", seed, "-o", folder / f"{name}.glb").code == 0
            done = treebake("bake", folder / f"{name}.glb", "-o", folder, "--billboards", 4, *QUICK)
            assert done.code == 0, done.err
        yield folder


def test_a_forest_of_two_baked_trees(grown: Path, tmp_path: Path) -> None:
    done = treebake(
        "forest", grown / "a", grown / "b", "--trees", 40, "--seed", 1, "-o", tmp_path / "scene.glb", "--json"
    )
    assert done.code == 0, done.err
    told = json.loads(done.out)
    forest, _ = read_forest(tmp_path / "scene.glb")
    trees = np.bincount(forest.species).tolist()
    assert told["species"] == [{"name": name, "trees": trees[i], "levels": 1} for i, name in enumerate("ab")]
    assert told["instances"] == sum(trees) == 40
    assert told["cells"] == len(forest.cells.first)
    assert told["bytes"] == (tmp_path / "scene.glb").stat().st_size
    assert told["triangles"] == read_mesh(tmp_path / "scene.glb").triangles
    again = treebake("forest", grown / "a", grown / "b", "--trees", 40, "--seed", 1, "-o", tmp_path / "again.glb")
    assert again.code == 0
    assert (tmp_path / "scene.glb").read_bytes() == (tmp_path / "again.glb").read_bytes()
    assert_valid(tmp_path / "scene.glb")


def test_no_trees_are_a_forest_too(grown: Path, tmp_path: Path) -> None:
    done = treebake("forest", grown / "a", "--trees", 0, "-o", tmp_path / "scene.glb", "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert (told["instances"], told["cells"], told["triangles"]) == (0, 0, 0)


def newer(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"format": 7}))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["A", "A"], "two assets are named a; give each species once, under a name of its own"),
        (["A", "MISSING"], "MISSING is no published asset: manifest.json cannot be read"),
        (["A", "NEWER"], "NEWER/manifest.json is of format 7, and this treebake reads format 1"),
        (["A", "--trees", "-1"], "[forest] trees is -1; it must be 0 to 1,000,000"),
        (["A", "--set", "forest.weights.oak=2"], "[forest] weights names oak, which is no species here; there are a"),
        (["A", "-o", "scene.gltf"], "a forest is written as GLB; name it scene.glb instead of scene.gltf"),
        (["A", "-o", "A/a_LOD0.glb"], "A/a_LOD0.glb is a file of the asset A; give another name with -o"),
    ],
)
def test_called_wrongly_is_one_line_and_writes_nothing(
    grown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(grown / "a", tmp_path / "A")
    shutil.copytree(grown / "a", tmp_path / "NEWER")
    newer(tmp_path / "NEWER")
    before = (tmp_path / "A/a_LOD0.glb").read_bytes()
    result = treebake("forest", "-o", "scene.glb", *arguments, "-q")
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    assert result.err.startswith(f"treebake: error: {says}")
    assert not list(tmp_path.glob("scene*"))
    assert (tmp_path / "A/a_LOD0.glb").read_bytes() == before
