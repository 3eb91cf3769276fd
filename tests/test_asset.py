"""The published asset: what is written is what is read, and what is damaged is refused by name."""

import json
import re
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from gltf_validate import assert_valid
from stems import empty, stem
from synthetic import quad

import treebake
from treebake.asset import Asset, Level, Manifest, read_asset, write_asset
from treebake.errors import AssetError, WorkspaceError
from treebake.images import read_image
from treebake.meshes import read_mesh
from treebake.model import AlphaMode, BakedTree, BillboardCloud, Material, Mesh, Texture

FORMAT_MD = Path(treebake.__file__).parent / "asset/FORMAT.md"


def cards() -> Mesh:
    """Two cards, with an atlas of 8 x 4 texels whose clear texels keep a colour."""
    random = np.random.default_rng(0)
    color = random.integers(0, 256, (4, 8, 4), np.uint8)
    color[0, :, 3] = 0
    normal = np.full((4, 8, 4), (128, 128, 255, 255), np.uint8)
    material = Material(
        "foliage",
        color_map=Texture("foliage_color", color),
        normal_map=Texture("foliage_normal", normal),
        alpha_mode=AlphaMode.MASK,
        alpha_cutoff=0.4,
        double_sided=True,
    )
    first, second = quad(material, x=(-1, 1), y=(2, 3)), quad(material, x=(-1, 1), y=(2, 3), z=0.5)
    return replace(
        first,
        positions=np.concatenate([first.positions, second.positions]),
        normals=np.concatenate([first.normals, second.normals]),
        uvs=np.concatenate([first.uvs, second.uvs]),
        faces=np.concatenate([first.faces, second.faces + np.int32(4)]),
        face_material=np.zeros(4, np.int32),
        face_node=np.zeros(4, np.int32),
        nodes=("foliage",),
    )


def baked(name: str = "oak", *, foliage: bool = True, trunk: bool = True) -> BakedTree:
    cloud = BillboardCloud(cards(), np.array([0, 0, 7, 7], np.int32))
    return BakedTree(
        name=name,
        cloud=cloud if foliage else BillboardCloud(empty(), np.zeros(0, np.int32)),
        trunk=stem() if trunk else empty(),
        source_triangles=12345,
        source_bounds=np.array([(-1, 0, -2), (1, 3.5, 2)], np.float32),
    )


@pytest.fixture
def oak(tmp_path: Path) -> Path:
    write_asset(baked(), tmp_path / "oak")
    return tmp_path / "oak"


def edit(folder: Path, **changes: object) -> None:
    """Change keys of a manifest on disk; None removes the key."""
    path = folder / "manifest.json"
    values = json.loads(path.read_text()) | changes
    path.write_text(json.dumps({key: value for key, value in values.items() if value is not None}))


# ---- written and read ----------------------------------------------------------------------------------------------


def test_what_is_written_is_read(tmp_path: Path) -> None:
    tree = baked()
    manifest = write_asset(tree, tmp_path / "a" / "oak")  # the folders are made
    asset = read_asset(tmp_path / "a" / "oak")
    assert asset.manifest == manifest
    assert manifest.generator == f"treebake {treebake.__version__}"
    assert (manifest.name, manifest.source.triangles) == ("oak", 12345)
    assert manifest.source.bounds == ((-1, 0, -2), (1, 3.5, 2))
    (level,) = manifest.levels
    assert level.representations == ("cloud", "trunk")
    assert (level.billboards, level.foliage_triangles, level.trunk_triangles) == (2, 4, tree.trunk.triangles)
    assert level.min_height == 0
    (path,) = asset.level_paths
    assert path.stat().st_size == level.bytes
    mesh = read_mesh(path)
    assert mesh.nodes == ("cloud", "trunk")
    assert mesh.triangles == 4 + tree.trunk.triangles
    assert np.array_equal(mesh.bounds, np.array([(-1, 0, -0.1), (1, 3, 0.5)], np.float32))
    foliage = mesh.materials[mesh.face_material[0]]
    assert (foliage.alpha_mode, foliage.alpha_cutoff, foliage.double_sided) == (AlphaMode.MASK, 0.4, True)


def test_loose_textures_are_the_same_pixels(oak: Path) -> None:
    color, normal = read_asset(oak).manifest.textures
    assert (color.file, color.size, color.color_space) == ("textures/oak_foliage_color.png", (8, 4), "sRGB")
    assert (normal.file, normal.size, normal.color_space) == ("textures/oak_foliage_normal.png", (8, 4), "linear")
    material = cards().materials[0]
    assert material.color_map is not None
    assert material.normal_map is not None
    assert (read_image(oak / color.file) == material.color_map.pixels).all()
    assert (read_image(oak / normal.file) == material.normal_map.pixels).all()


def test_the_folder_holds_what_the_manifest_names_and_nothing_else(oak: Path) -> None:
    manifest = read_asset(oak).manifest
    named = {level.file for level in manifest.levels} | {image.file for image in manifest.textures}
    found = {path.relative_to(oak).as_posix() for path in oak.rglob("*") if path.is_file()}
    assert found == named | {"manifest.json"}


@pytest.mark.parametrize("name", ["oak", "Quercus robur 1.2", "Bäume", "a'b"])
def test_any_name_of_a_file_will_do(name: str, tmp_path: Path) -> None:
    write_asset(baked(name), tmp_path)
    asset = read_asset(tmp_path)
    assert asset.level_paths == (tmp_path / f"{name}_LOD0.glb",)
    assert read_mesh(asset.level_paths[0]).triangles > 4


def test_the_same_tree_gives_the_same_bytes(oak: Path, tmp_path: Path) -> None:
    write_asset(baked(), tmp_path / "again")
    for path in oak.rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(oak)).read_bytes(), path.name


def test_the_glbs_are_valid(tmp_path: Path) -> None:
    write_asset(baked("both"), tmp_path)
    write_asset(baked("bare", foliage=False), tmp_path)
    write_asset(baked("fern", trunk=False), tmp_path)
    assert_valid(*sorted(tmp_path.glob("*.glb")))


def test_a_tree_without_leaves(tmp_path: Path) -> None:
    write_asset(baked(foliage=False), tmp_path)
    manifest = read_asset(tmp_path).manifest
    (level,) = manifest.levels
    assert (level.representations, level.billboards, level.foliage_triangles) == (("trunk",), 0, 0)
    assert manifest.textures == ()
    assert not (tmp_path / "textures").exists()


def test_foliage_without_a_trunk(tmp_path: Path) -> None:
    (level,) = write_asset(baked(trunk=False), tmp_path).levels
    assert (level.representations, level.trunk_triangles) == (("cloud",), 0)
    assert read_mesh(tmp_path / level.file).triangles == 4


def test_nothing_left_is_not_published(tmp_path: Path) -> None:
    with pytest.raises(WorkspaceError, match="oak has neither foliage nor trunk left; there is nothing to publish"):
        write_asset(baked(foliage=False, trunk=False), tmp_path / "oak")
    assert not (tmp_path / "oak").exists()


def test_the_manifest_is_written_last(tmp_path: Path) -> None:
    # An asset that could not be finished is none: without a manifest nobody takes it for one.
    (tmp_path / "textures").write_text("in the way")
    with pytest.raises(WorkspaceError, match=r"textures/oak_foliage_color\.png cannot be written"):
        write_asset(baked(), tmp_path)
    assert not (tmp_path / "manifest.json").exists()
    with pytest.raises(AssetError, match="is no published asset"):
        read_asset(tmp_path)


def test_baking_again_replaces_the_asset(oak: Path) -> None:
    write_asset(baked(trunk=False), oak)
    assert read_asset(oak).manifest.levels[0].trunk_triangles == 0
    assert read_mesh(oak / "oak_LOD0.glb").triangles == 4


# ---- refused -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 2, 99])
def test_an_unknown_format_is_named(oak: Path, number: int) -> None:
    # A later format may look like anything: its number is read before the rest.
    (oak / "manifest.json").write_text(json.dumps({"format": number, "levels": "elsewhere"}))
    with pytest.raises(
        AssetError,
        match=rf"manifest\.json is of format {number}, and this treebake reads format 1; bake the tree again",
    ):
        read_asset(oak)


@pytest.mark.parametrize(
    "text",
    [b"", b"{", b"[]", b"null", b'"format"', b'{"format": "1"}', b'{"name": "oak"}', b'{"format": 1, "name": "\xff"}'],
)
def test_damaged_json(oak: Path, text: bytes) -> None:
    (oak / "manifest.json").write_bytes(text)
    with pytest.raises(AssetError, match=r"manifest\.json is damaged \(.+\); bake the tree again"):
        read_asset(oak)


@pytest.mark.parametrize("cut", [10, 100, -3])
def test_truncated_json(oak: Path, cut: int) -> None:
    path = oak / "manifest.json"
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(AssetError, match=r"manifest\.json is damaged"):
        read_asset(oak)


@pytest.mark.parametrize("key", ["generator", "name", "source", "levels", "textures"])
def test_a_missing_key_is_named(oak: Path, key: str) -> None:
    edit(oak, **{key: None})
    with pytest.raises(AssetError, match=rf"manifest\.json is damaged \(.*{key}.*\)"):
        read_asset(oak)


def test_a_manifest_without_levels(oak: Path) -> None:
    edit(oak, levels=[])
    with pytest.raises(AssetError, match=r"manifest\.json is damaged \(.+levels.+\); bake the tree again"):
        read_asset(oak)


@pytest.mark.parametrize("file", ["oak_LOD0.glb", "textures/oak_foliage_color.png", "textures/oak_foliage_normal.png"])
def test_a_missing_file_is_named(oak: Path, file: str) -> None:
    (oak / file).unlink()
    with pytest.raises(AssetError, match=rf"{re.escape(file)} is named by the manifest and is missing"):
        read_asset(oak)


def test_a_folder_that_is_no_asset(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path, tmp_path / "nowhere", tmp_path / "file"):
        with pytest.raises(AssetError, match=rf"{folder} is no published asset: manifest\.json cannot be read \(.+\)"):
            read_asset(folder)


def test_keys_of_a_newer_treebake_are_passed_over(oak: Path) -> None:
    # The number is raised only where an older reader could misread the files.
    edit(oak, quality={"flip": 0.1})
    assert read_asset(oak).manifest.name == "oak"


# ---- levels --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "level"), [(10_000, 0), (300, 0), (299, 1), (50, 1), (49, 2), (20, 2), (1, 2)])
def test_a_level_for_each_height(height: int, level: int) -> None:
    levels = tuple(Level(f"oak_LOD{i}.glb", ("cloud",), 1, 2, 0, 100, h) for i, h in enumerate((300, 50, 20)))
    source = example_manifest().source
    asset = Asset(Path("oak"), Manifest(1, "treebake", "oak", source, levels, ()))
    assert asset.level_for(height) == Path(f"oak/oak_LOD{level}.glb")


def example_manifest() -> Manifest:
    """The worked example of FORMAT.md."""
    (example,) = re.findall(r"```json\n(.*?)```", FORMAT_MD.read_text(encoding="utf-8"), re.DOTALL)
    return msgspec.json.decode(example, type=Manifest, strict=True)


# ---- FORMAT.md -----------------------------------------------------------------------------------------------------


def test_the_example_is_a_manifest(tmp_path: Path) -> None:
    example = example_manifest()
    for file in [level.file for level in example.levels] + [image.file for image in example.textures]:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    (tmp_path / "manifest.json").write_bytes(msgspec.json.encode(example))
    assert read_asset(tmp_path).manifest == example


def test_the_example_has_the_files_that_are_written(oak: Path) -> None:
    example, written = example_manifest(), read_asset(oak).manifest
    assert [level.file for level in example.levels] == [level.file for level in written.levels]
    assert [(image.file, image.color_space) for image in example.textures] == [
        (image.file, image.color_space) for image in written.textures
    ]


def keys(value: object, prefix: str = "") -> set[str]:
    """Every key of a JSON value, as `levels[].file`."""
    if isinstance(value, dict):
        return set().union(*({prefix + key} | keys(part, f"{prefix}{key}.") for key, part in value.items()))
    if isinstance(value, list):
        return set().union(*(keys(part, f"{prefix[:-1]}[].") for part in value))
    return set()


def test_every_key_is_described_and_no_other(oak: Path) -> None:
    rows = re.findall(
        r"^\| `([^`]+)` \|", FORMAT_MD.read_text(encoding="utf-8").split("## manifest.json")[1], re.MULTILINE
    )
    assert set(rows) == keys(json.loads((oak / "manifest.json").read_text()))
    assert len(rows) == len(set(rows))
