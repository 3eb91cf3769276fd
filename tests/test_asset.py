"""The published asset: what is written is what is read, and what is damaged is refused by name."""

import json
import re
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its documentation uses
import pytest
from foliage import frozen, leaf_tree, planes
from gltf_validate import assert_valid
from stems import empty, stem
from synthetic import quad

import treebake
from treebake.asset import (
    Asset,
    LeftOut,
    Level,
    Manifest,
    Rung,
    indirect_bytes,
    read_asset,
    read_indirect,
    write_asset,
)
from treebake.asset.extras import Extras, extras_schema
from treebake.asset.indirect import IMAGES, TABLES, indirect_extras
from treebake.errors import AssetError, WorkspaceError
from treebake.formats.gltf_file import GltfFile
from treebake.glb import write_glb
from treebake.images import read_image
from treebake.lookup import LIST_BITS
from treebake.meshes import read_mesh
from treebake.model import (
    AlphaMode,
    BakedLevel,
    BakedTree,
    BillboardCloud,
    Impostor,
    IndirectTextures,
    Material,
    Mesh,
    SlicedFoliage,
    Texture,
    Translucency,
    Transmission,
)
from treebake.placements import unpack
from treebake.stages.indirect import IndirectSettings, indirect
from treebake.stages.slicings import SlicingSettings, slicings
from treebake.stages.views import ViewSettings, views

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
        occlusion_map=Texture("foliage_occlusion", np.full((2, 4, 4), (90, 90, 90, 255), np.uint8)),
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


@cache
def layers() -> IndirectTextures:
    """The smallest indirect textures: three leaves on two planes."""
    tree = leaf_tree([(0, 0, 0), (0.3, 0.1, 0.05), (0, 1, 0)])
    clusters = planes([0, 0, 1], [(0, 0, 1), (0, 0, 1)], [0, 0])
    made = indirect(tree, clusters, IndirectSettings(leaf_texels=4, atlas=64, far_texels=1))
    return frozen(replace(made, transmission=Transmission(0.25, (0.5, 1.5, 0.1))))


@cache
def sliced() -> SlicedFoliage:
    """The coarsest slicings of three leaves."""
    tree = leaf_tree([(0, 0, 0), (0.3, 0.1, 0.05), (0, 1, 0)])
    coarse = SlicingSettings(orientations=4, slices=1, texels=16, far_texels=16, supersample=1, gutter=1)
    return frozen(slicings(tree, coarse))


@cache
def impostor() -> Impostor:
    """Two views of three leaves."""
    tree = leaf_tree([(0, 0, 0), (0.3, 0.1, 0.05), (0, 1, 0)])
    return views([tree], ViewSettings(layout="ring", count=2, layers=1, texels=16, supersample=1, gutter=1))[0]


def baked(name: str = "oak", *, foliage: bool = True, trunk: bool = True) -> BakedTree:
    cloud = BillboardCloud(cards(), np.array([0, 0, 7, 7], np.int32))
    return BakedTree(
        name=name,
        cloud=cloud if foliage else BillboardCloud(empty(), np.zeros(0, np.int32)),
        indirect=layers() if foliage else None,
        trunk=stem() if trunk else empty(),
        slicings=sliced() if foliage else None,
        views=impostor() if foliage else None,
        source_triangles=12345,
        source_bounds=np.array([(-1, 0, -2), (1, 3.5, 2)], np.float32),
        translucency=Translucency(Transmission(0.25, (0.5, 1.5, 0.1)), "needle, source") if foliage else None,
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
    assert manifest.translucency
    assert msgspec.to_builtins(manifest.translucency, builtin_types=(tuple,)) == {
        "factor": 0.25,
        "color": (0.5, 1.5, 0.1),
        "origin": "needle, source",
    }
    (path,) = asset.level_paths
    assert path.stat().st_size == level.bytes
    mesh = read_mesh(path)
    assert mesh.nodes == ("cloud", "trunk")
    assert mesh.triangles == 4 + tree.trunk.triangles
    assert np.array_equal(mesh.bounds, np.array([(-1, 0, -0.1), (1, 3, 0.5)], np.float32))
    foliage = mesh.materials[mesh.face_material[0]]
    assert (foliage.alpha_mode, foliage.alpha_cutoff, foliage.double_sided) == (AlphaMode.MASK, 0.4, True)


def test_loose_textures_are_the_same_pixels(oak: Path) -> None:
    color, normal, *_ = read_asset(oak).manifest.textures
    assert (color.file, color.size, color.color_space) == ("textures/oak_foliage_color.png", (8, 4), "sRGB")
    assert (normal.file, normal.size, normal.color_space) == ("textures/oak_foliage_normal.png", (8, 4), "linear")
    material = cards().materials[0]
    assert material.color_map is not None
    assert material.normal_map is not None
    assert (read_image(oak / color.file) == material.color_map.pixels).all()
    assert (read_image(oak / normal.file) == material.normal_map.pixels).all()


def test_loose_images_of_the_indirect_textures_are_the_same_pixels(oak: Path) -> None:
    listed = {image.file: image for image in read_asset(oak).manifest.textures}
    for name, space in zip(IMAGES, ("sRGB", "linear") * 2, strict=True):
        texture, image = getattr(layers(), name), listed[f"textures/oak_{name}.png"]
        assert (image.size, image.color_space) == (texture.pixels.shape[1::-1], space)
        assert (read_image(oak / image.file) == texture.pixels).all()


@pytest.mark.parametrize("name", TABLES)
def test_loose_tables_are_the_same_bits(oak: Path, name: str) -> None:
    table = getattr(layers(), name)
    (image,) = (image for image in read_asset(oak).manifest.textures if Path(image.file).stem == f"oak_{name}")
    assert image.color_space == "data"
    file = oiio.ImageInput.open(str(oak / image.file))
    bits = np.asarray(file.read_image(oiio.FLOAT if image.file.endswith(".exr") else oiio.UINT16))
    assert image.size == bits.shape[1::-1]
    assert len(bits) == len(table)  # a row of the table is a row of the image
    assert bits.tobytes() == table.tobytes()


def test_the_manifest_says_what_the_indirect_textures_are(oak: Path) -> None:
    found = read_asset(oak).manifest.indirect
    assert found is not None
    assert (found.file, found.billboards, found.leaves) == ("oak.glb", 2, 3)
    assert found.gpu_bytes == indirect_bytes(layers())


def test_the_full_glb_holds_the_standard_meshes_too(oak: Path) -> None:
    full, level = read_mesh(oak / "oak.glb"), read_mesh(oak / "oak_LOD0.glb")
    assert full.nodes == level.nodes == ("cloud", "trunk")
    for name in ("positions", "normals", "uvs", "faces", "face_material", "face_node"):
        assert np.array_equal(getattr(full, name), getattr(level, name))


def test_the_folder_holds_what_the_manifest_names_and_nothing_else(oak: Path) -> None:
    manifest = read_asset(oak).manifest
    assert manifest.indirect is not None
    named = {level.file for level in manifest.levels} | {image.file for image in manifest.textures}
    assert manifest.slicings is not None
    assert manifest.views is not None
    named |= {manifest.file, manifest.indirect.file, manifest.slicings.file, manifest.views.file}
    found = {path.relative_to(oak).as_posix() for path in oak.rglob("*") if path.is_file()}
    assert found == named | {"manifest.json"}


@pytest.mark.parametrize("name", ["oak", "Quercus robur 1.2", "Bäume", "a'b"])
def test_any_name_of_a_file_will_do(name: str, tmp_path: Path) -> None:
    write_asset(baked(name), tmp_path)
    asset = read_asset(tmp_path)
    assert asset.level_paths == (tmp_path / f"{name}_LOD0.glb",)
    assert read_mesh(asset.level_paths[0]).triangles > 4
    assert asset.manifest.indirect is not None
    assert asset.manifest.indirect.file == f"{name}.glb"
    assert read_indirect(tmp_path / f"{name}.glb").leaves == 3


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
    assert (manifest.indirect, manifest.slicings, manifest.views) == (None, None, None)
    assert read_mesh(tmp_path / manifest.file).nodes == ("trunk",)
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


@pytest.mark.parametrize(
    "file",
    [
        "oak_LOD0.glb",
        "oak.glb",
        "textures/oak_foliage_color.png",
        "textures/oak_foliage_normal.png",
        "textures/oak_placements.png",
    ],
)
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


# ---- the indirect textures -----------------------------------------------------------------------------------------


def indirect_glb(folder: Path, **changes: object) -> Path:
    """A GLB of the indirect textures, some of them changed."""
    write_glb(folder / "oak.glb", [], {"treebake": indirect_extras(replace(layers(), **changes))})
    return folder / "oak.glb"


def rewritten(path: Path, change: Callable[[Any], object]) -> Path:
    """The same GLB with its JSON changed."""
    data = path.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    document = json.loads(data[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)
    return path


def changed(name: str, index: object, value: float) -> dict[str, object]:
    """One table with some of its values set."""
    table = getattr(layers(), name).copy()
    table[index] = value
    return {name: table}


def test_indirect_textures_come_back_to_the_bit(tmp_path: Path) -> None:
    found = read_indirect(indirect_glb(tmp_path))
    for name in TABLES:
        stored, table = getattr(found, name), getattr(layers(), name)
        assert (stored.dtype, stored.shape) == (table.dtype, table.shape)
        assert stored.tobytes() == table.tobytes(), name
    for name in IMAGES:
        assert (getattr(found, name).pixels == getattr(layers(), name).pixels).all()
    assert (found.leaves, found.largest) == (layers().leaves, layers().largest)
    assert found.transmission == layers().transmission
    assert read_indirect(indirect_glb(tmp_path, transmission=None)).transmission is None


def test_the_hash_texture_keeps_its_shape(tmp_path: Path) -> None:
    wide = np.zeros((2, 8), np.uint32)
    wide[:2, :2] = layers().hash_texture
    assert (read_indirect(indirect_glb(tmp_path, hash_texture=wide)).hash_texture == wide).all()
    # Columns come first in a billboard's place, and rows in the texture's shape.
    read_indirect(indirect_glb(tmp_path, hash_texture=wide, **changed("billboards", (1, 16), 6)))
    with pytest.raises(AssetError, match="a billboard leaves the hash texture"):
        read_indirect(indirect_glb(tmp_path, hash_texture=wide, **changed("billboards", (1, 17), 6)))


def test_indirect_bytes_are_the_tables_and_the_compressed_images() -> None:
    # Two planes of one cell row each; images of 16 x 16 texels (5 mips: 16, 4, 1, 1, 1 blocks), far ones of one block.
    far = layers().far_color.pixels.shape[:2]
    assert (far, layers().hash_texture.size) == ((2, 2), 4)
    tables = 2 * 80 + 64 + 4 * 4 + 1024 * (2 + 16 + 4)
    assert indirect_bytes(layers()) == tables + 23 * (16 + 24) + 2 * (16 + 24)


@pytest.mark.parametrize(
    ("table", "index", "value", "says"),
    [
        ("billboards", (0, 0), np.nan, "a table holds no numbers"),
        ("shapes", (0, 3), np.inf, "a table holds no numbers"),
        ("hash_texture", (0, 0), 1023 << 10 | 2, "a list leaves its texture"),
        ("billboards", (0, 16), -1, "a billboard leaves the hash texture"),
        ("billboards", (1, 16), 2, "a billboard leaves the hash texture"),
        ("billboards", (1, 17), 2, "a billboard leaves the hash texture"),
        ("billboards", (0, 13), 3, "a billboard leaves the hash texture"),
        ("billboards", (1, 18), -1, "a billboard has no placements"),
        ("billboards", (1, 18), 1024, "a list names a leaf that is not there"),
        ("lists_texture", (0, 0), 65535, "a list names a leaf that is not there"),
        ("billboards", (0, 12), 0, "a billboard has no size"),
        ("billboards", (0, 14), -1, "a billboard has no size"),
        ("shapes", (0, 1), 0, "a shape has no size"),
        ("placements", (0, 2, 3), 1 << 16, "a placement has an unknown shape"),
    ],
)
def test_a_damaged_table_is_named(tmp_path: Path, table: str, index: tuple[int, ...], value: float, says: str) -> None:
    path = indirect_glb(tmp_path, **changed(table, index, value))
    with pytest.raises(AssetError) as caught:
        read_indirect(path)
    assert str(caught.value) == f"{path} is damaged: {says}; bake the tree again"


def test_the_last_list_and_the_last_placement_are_inside(tmp_path: Path) -> None:
    read_indirect(indirect_glb(tmp_path, **changed("hash_texture", (0, 0), 1022 << 10 | 2)))
    last = layers().leaves - 1
    read_indirect(indirect_glb(tmp_path, **changed("billboards", (1, 18), last)))
    with pytest.raises(AssetError, match="a list names a leaf that is not there"):
        read_indirect(indirect_glb(tmp_path, **changed("billboards", (1, 18), last + 1)))


def test_more_leaves_than_placements(tmp_path: Path) -> None:
    path = rewritten(indirect_glb(tmp_path), pointing("leaves", 10**6))
    with pytest.raises(AssetError, match="is damaged: there are fewer placements than leaves; bake the tree again"):
        read_indirect(path)


def test_an_empty_table_is_named(tmp_path: Path) -> None:
    for gone in ({"shapes": layers().shapes[:0]}, {"billboards": layers().billboards[:0]}):
        with pytest.raises(AssetError, match="is damaged: a table is empty; bake the tree again"):
            read_indirect(indirect_glb(tmp_path, **gone))


def test_ambient_light_without_its_placement_is_named(tmp_path: Path) -> None:
    twice = np.concatenate([layers().ambient] * 2)
    with pytest.raises(AssetError, match="is damaged: there is not one ambient entry per placement; bake the tree ag"):
        read_indirect(indirect_glb(tmp_path, ambient=twice))


@pytest.mark.parametrize("name", IMAGES)
def test_a_missing_image_is_named(tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture) -> None:
    def without(document: Any) -> None:
        del document["textures"][document["extras"]["treebake"]["indirect"][name]]["source"]

    with pytest.raises(AssetError, match="is damaged: an image is missing; bake the tree again"):
        read_indirect(rewritten(indirect_glb(tmp_path), without))
    assert "going on without it" in caplog.text


@pytest.mark.parametrize("number", [0, 2, 99])
def test_an_unknown_format_of_indirect_textures_is_named(tmp_path: Path, number: int) -> None:
    path = rewritten(indirect_glb(tmp_path), lambda document: document["extras"]["treebake"].update(format=number))
    with pytest.raises(AssetError) as caught:
        read_indirect(path)
    assert str(caught.value) == f"{path} is of format {number}, and this treebake reads 1; bake the tree again"


def pointing(name: str, to: object) -> Callable[[Any], object]:
    return lambda document: document["extras"]["treebake"]["indirect"].update({name: to})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda document: document.pop("extras"), "extras"),
        (lambda document: document["extras"].pop("treebake"), "treebake"),
        (lambda document: document["extras"].update(treebake=[]), "list indices"),
        (lambda document: document["extras"]["treebake"]["indirect"].pop("leaves"), "leaves"),
        (pointing("placements", "5"), "Expected `int`"),
        (pointing("placements", 99), "out of range"),
        (pointing("far_color", 99), "out of range"),
        (pointing("placements", 0), "table placements has values of another kind"),  # floats
        (pointing("hash_width", 3), "reshape"),
        (pointing("hash_width", 0), "`int` >= 1"),
        (pointing("placements", -1), "`int` >= 0"),
        (pointing("leaves", -5), "`int` >= 1"),
        (pointing("largest", 0), "`float` > 0"),
        (lambda document: document.update(bufferViews=[[]] * 40), "list"),
        (lambda document: document.update(textures=[[]] * 40), "list"),
        (lambda document: document["bufferViews"][0].update(byteLength=10**9), "truncated"),
        (lambda document: document["accessors"][0].update(count=10**9), "leaves buffer view"),
        (lambda document: document["accessors"][0].update(count=3), "reshape"),
        (lambda document: document.pop("accessors"), "accessors"),
    ],
)
def test_extras_that_do_not_hold_together_are_one_line(
    tmp_path: Path, change: Callable[[Any], object], says: str
) -> None:
    path = rewritten(indirect_glb(tmp_path), change)
    with pytest.raises(AssetError) as caught:
        read_indirect(path)
    text = str(caught.value)
    assert text.startswith(f"{path} holds no usable indirect textures (")
    assert text.endswith("); bake the tree again")
    assert says in text
    assert "\n" not in text


def test_a_file_that_is_none_or_cut_off_is_one_line(tmp_path: Path) -> None:
    path = indirect_glb(tmp_path)
    path.write_bytes(path.read_bytes()[:-100])
    for damaged in (path, tmp_path / "nowhere.glb", tmp_path):
        with pytest.raises(AssetError, match=rf"^{damaged} holds no usable indirect textures \([^\n]+\); bake"):
            read_indirect(damaged)


# ---- levels --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "level"), [(10_000, 0), (300, 0), (299, 1), (50, 1), (49, 2), (20, 2), (1, 2)])
def test_a_level_for_each_height(height: int, level: int) -> None:
    levels = tuple(Level(f"oak_LOD{i}.glb", ("cloud",), 1, 2, 0, 100, h) for i, h in enumerate((300, 50, 20)))
    source = example_manifest().source
    asset = Asset(Path("oak"), Manifest(1, "treebake", "oak", source, "oak.glb", levels, ()))
    assert asset.level_for(height) == Path(f"oak/oak_LOD{level}.glb")


def section(heading: str) -> str:
    """What FORMAT.md says below one of its headings."""
    return re.split(r"^#+ ", FORMAT_MD.read_text(encoding="utf-8").split(f"# {heading}\n")[1], flags=re.MULTILINE)[0]


def example(heading: str) -> str:
    """The one JSON example of a section."""
    (found,) = re.findall(r"```json\n(.*?)```", section(heading), re.DOTALL)
    return str(found)


def example_manifest() -> Manifest:
    """The worked example of FORMAT.md."""
    return msgspec.json.decode(example("manifest.json"), type=Manifest, strict=True)


def further(manifest: Manifest) -> list[str]:
    """The files of what is not a level."""
    entries = manifest.indirect, manifest.slicings, manifest.views
    assert None not in entries
    return [manifest.file, *(entry.file for entry in entries if entry)]


# ---- FORMAT.md -----------------------------------------------------------------------------------------------------


def test_the_example_is_a_manifest(tmp_path: Path) -> None:
    told = example_manifest()
    files = [each.file for each in (*told.levels, *told.textures, *told.ladder, *told.left_out)] + further(told)
    for file in files:
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).touch()
    (tmp_path / "manifest.json").write_bytes(msgspec.json.encode(told))
    assert read_asset(tmp_path).manifest == told


def test_the_example_has_the_files_that_are_written(tmp_path: Path) -> None:
    tree = baked()
    coarser = BakedLevel(tree.cloud, tree.trunk, 256, 0.81)
    told, written = example_manifest(), write_asset(replace(tree, levels=(coarser,)), tmp_path)
    assert [level.file for level in told.levels] == [level.file for level in written.levels]
    assert further(told) == further(written)
    assert [(image.file, image.color_space) for image in told.textures] == [
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
    rungs, left_out = (Rung("cloud", "oak_LOD0.glb", 0, 0, 0.9, 4, 100),), (LeftOut("views", "v.glb", None, ""),)
    told = replace(read_asset(oak).manifest, ladder=rungs, left_out=left_out)
    (oak / "manifest.json").write_bytes(msgspec.json.encode(told))
    rows = re.findall(r"^\| `([^`]+)` \|", section("manifest.json"), re.MULTILINE)
    assert set(rows) == keys(json.loads((oak / "manifest.json").read_text()))
    assert len(rows) == len(set(rows))


def test_the_example_of_the_extras_is_one_and_names_every_key() -> None:
    told = json.loads(example("Where the data is"))
    assert json.loads(msgspec.json.encode(msgspec.convert(told, Extras, strict=True))) == told


def test_the_schema_of_the_extras_is_that_of_their_type() -> None:
    assert (FORMAT_MD.parent / "extras.schema.json").read_text(encoding="utf-8") == extras_schema(), (
        "renew it from treebake.asset.extras.extras_schema"
    )


def test_tables_are_stored_as_described(oak: Path, tmp_path: Path) -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\w+) (\w+) \|.*?\| `(\S+)` \|", section("Where the data is"), re.MULTILINE)
    assert [name for name, *_ in rows] == list(TABLES)
    document = GltfFile(indirect_glb(tmp_path)).json
    kinds = {"float": 5126, "uint32": 5125, "uint16": 5123, "uint8": 5121}
    for name, shape, kind, loose in rows:
        accessor = document["accessors"][document["extras"]["treebake"]["indirect"][name]]
        assert (accessor["type"], accessor["componentType"]) == (shape, kinds[kind])
        assert (oak / f"textures/oak{loose}").is_file()


def test_the_example_of_a_placement_is_what_its_words_say() -> None:
    told = json.loads(example("placements"))
    found = unpack(np.array([[int(word, 16) for word in told["words"]]], np.uint32))
    assert found.positions[0] == pytest.approx(told["position"], abs=1e-5)
    assert found.scales[0] * told["largest"] == told["scale"]
    assert found.narrowings[0] == told["narrowing"]
    assert np.allclose(found.rotations[0], told["rotation"], atol=1e-3)
    assert (found.mirrored[0], found.shape[0]) == (told["mirrored"], told["shape"])
    assert divmod(told["entry"], 1024) == (told["row"], told["column"])
    assert divmod(int(told["hash_texel"], 16), 1 << LIST_BITS) == (told["offset"], told["count"])
