"""Slicings and views as files: what is written is what is read, and what is damaged is refused in one line."""

import json
import struct
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import numpy as np
import pytest
from gltf_validate import assert_valid
from stems import stem

from tests.synthetic import quad, texture
from treebake.asset import (
    atlas_bytes,
    read_asset,
    read_slicings,
    read_views,
    write_asset,
    write_shared_views,
)
from treebake.asset.pictures import ATLAS, write_slicings, write_views
from treebake.errors import AssetError
from treebake.images import read_image
from treebake.meshes import read_mesh
from treebake.model import (
    AlphaMode,
    BakedTree,
    BillboardCloud,
    Impostor,
    Material,
    Mesh,
    PictureAtlas,
    SlicedFoliage,
    Slicings,
    Texture,
    Transmission,
    Views,
)
from treebake.stages.views.directions import hemi_octahedron, ring
from treebake.verify import VerifySettings, representations

BARK = Material("bark", base_color=(0.3, 0.2, 0.1, 1.0))
SHARED = Path("../shared_views/shared_views.glb")


def atlas(name: str, seed: int = 0) -> PictureAtlas:
    """8 x 8 texels of noise, and fewer of the rest."""
    random = np.random.default_rng(seed)

    def noise(image: str, side: int) -> Texture:
        pixels = random.integers(0, 256, (side, side, 4), np.uint8)
        pixels[..., 3] = 255
        return Texture(f"{name}_{image}", pixels)

    images = (noise(name, side) for name, side in (("coverage", 8), ("albedo", 4), ("relief", 4), ("occlusion", 1)))
    return PictureAtlas(*images, mips=2)


def standard(name: str) -> Mesh:
    """A card as any viewer draws it."""
    image = texture(np.random.default_rng(1).integers(0, 256, (4, 4, 4)))
    material = Material(name, color_map=image, alpha_mode=AlphaMode.MASK, double_sided=True)
    return replace(quad(material), nodes=(name,))


@cache
def foliage() -> SlicedFoliage:
    """Two slicings of three slices and one from above, two rectangles each, and a far slice of each."""
    random = np.random.default_rng(2)
    slices = random.normal(size=(3 * 3 + 3, 3 + 2 * 2, 4)).astype(np.float32)
    slices[:, 4::2] = random.uniform(0, 1, slices[:, 4::2].shape)
    slicings = Slicings(
        slices=slices,
        orientations=2,
        count=3,
        center=np.array([0.1, 2.3, -0.7]),
        size=1.7,
        above=True,
        far_row=9,
        far_height=32.0,
        dropped=1,
        brightness=0.6,
        exposure=1.1,
        atlas=atlas("slices"),
        untrimmed=100,
        transmission=Transmission(0.5, (0.75, 1.0, 0.5)),
    )
    return SlicedFoliage(slicings, quad(BARK, x=(-0.1, 0.1)), standard("slices"))


@cache
def impostor(layout: str = "ring", side: int = 4, seed: int = 3, shared: bool = False) -> Impostor:
    random = np.random.default_rng(seed)
    frames = ring(side) if layout == "ring" else hemi_octahedron(side)
    pictures = random.normal(size=(2 * len(frames), 5, 4)).astype(np.float32)
    pictures[:, :3, :3] = np.repeat(frames, 2, axis=0)
    pictures[:, 4] = random.uniform(0, 1, pictures[:, 4].shape)
    views = Views(
        pictures=pictures,
        layout=layout,
        side=side,
        layers=2,
        center=np.array([0.1, 2.3, -0.7]),
        radius=2.5,
        support=random.uniform(0, 2.5, 33).astype(np.float32),
        brightness=0.6,
        exposure=1.1,
        atlas=one_atlas() if shared else atlas("views", seed),
        transmission=None if layout == "ring" else Transmission(0.5, (0.75, 2.0, 0.5)),
    )
    return Impostor(views, standard("views"))


@cache
def one_atlas() -> PictureAtlas:
    return atlas("views", 7)


def baked(name: str = "oak", **more: Any) -> BakedTree:
    cloud = BillboardCloud(standard("foliage"), np.zeros(2, np.int32))
    corners = np.array([(-1, 0, -2), (1, 3.5, 2)], np.float32)
    whole = {"slicings": foliage(), "views": impostor()} | more
    return BakedTree(
        name=name, cloud=cloud, indirect=None, trunk=stem(), source_triangles=12345, source_bounds=corners, **whole
    )


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


def slicings_glb(folder: Path, **changes: object) -> Path:
    made = replace(foliage(), slicings=replace(foliage().slicings, **changes))
    write_slicings(folder / "oak_slicings.glb", made)
    return folder / "oak_slicings.glb"


def views_glb(folder: Path, **changes: object) -> Path:
    made = replace(impostor(), views=replace(impostor().views, **changes))
    write_views(folder / "oak_views.glb", [("oak", made)])
    return folder / "oak_views.glb"


def assert_same(found: Slicings | Views, wanted: Slicings | Views) -> None:
    """To the bit."""
    for field in fields(wanted):
        one, other = getattr(found, field.name), getattr(wanted, field.name)
        if isinstance(other, PictureAtlas):
            assert one.mips == other.mips
            for image in ATLAS:
                np.testing.assert_array_equal(getattr(one, image).pixels, getattr(other, image).pixels)
                assert getattr(one, image).name == getattr(other, image).name
        elif isinstance(other, np.ndarray):
            assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), field.name
        else:
            assert (type(one), one) == (type(other), other), field.name


# ---- written and read ----------------------------------------------------------------------------------------------


def test_slicings_come_back_to_the_bit(tmp_path: Path) -> None:
    assert_same(read_slicings(slicings_glb(tmp_path)), foliage().slicings)


def test_slicings_without_far_ones_and_none_from_above_come_back(tmp_path: Path) -> None:
    bare = replace(foliage().slicings, slices=foliage().slicings.slices[:6], above=False, far_row=6, far_height=0.0)
    made = replace(foliage(), slicings=bare)
    write_slicings(tmp_path / "oak.glb", made)
    assert_same(read_slicings(tmp_path / "oak.glb"), bare)


@pytest.mark.parametrize(("layout", "side"), [("ring", 4), ("hemi", 3)])
def test_views_come_back_to_the_bit(tmp_path: Path, layout: str, side: int) -> None:
    made = impostor(layout, side)
    write_views(tmp_path / "oak.glb", [("oak", made)])
    assert_same(read_views(tmp_path / "oak.glb", "oak"), made.views)


def test_of_several_trees_each_is_found_by_its_name(tmp_path: Path) -> None:
    trees = [("oak", impostor(shared=True)), ("a'sh é", impostor("hemi", 3, seed=5, shared=True))]
    path = write_shared_views(trees, tmp_path)
    for name, made in trees:
        assert_same(read_views(path, name), made.views)
    with pytest.raises(AssetError, match=r"holds no usable views \(there are none of elm\); bake the tree again"):
        read_views(path, "elm")


def test_a_viewer_without_slicings_sees_cards_and_what_is_solid(tmp_path: Path) -> None:
    mesh = read_mesh(slicings_glb(tmp_path))
    assert (mesh.nodes, mesh.triangles) == (("slices", "trunk"), 4)
    np.testing.assert_array_equal(mesh.positions[:4], foliage().standard.positions)


def test_a_viewer_without_views_sees_cards_of_a_single_tree(tmp_path: Path) -> None:
    mesh = read_mesh(views_glb(tmp_path))
    assert (mesh.nodes, mesh.triangles) == (("views",), 2)


def test_the_same_trees_give_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_asset(baked(), tmp_path / folder)
    for path in (tmp_path / "a").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes(), path.name


def test_the_glbs_are_valid(tmp_path: Path) -> None:
    write_asset(baked(), tmp_path / "oak")
    shared = write_shared_views([("oak", impostor(shared=True)), ("ash", impostor(seed=5, shared=True))], tmp_path)
    assert_valid(tmp_path / "oak/oak_slicings.glb", tmp_path / "oak/oak_views.glb", shared)


# ---- the manifest --------------------------------------------------------------------------------------------------

# 8 x 8 texels of coverage and 2 mips are 4, 1 and 1 blocks of 8 bytes; 4 x 4 of albedo and a mip 1 and 1; of relief
# three times as many bytes; 1 x 1 of occlusion.
BYTES = 6 * 8 + 2 * 8 + 2 * (16 + 8) + 8


def test_bytes_are_those_of_what_drawing_looks_up() -> None:
    assert atlas_bytes(atlas("views")) == BYTES


def test_the_manifest_says_what_the_slicings_are(tmp_path: Path) -> None:
    manifest = write_asset(baked(), tmp_path)
    assert read_asset(tmp_path).manifest == manifest
    assert msgspec.to_builtins(manifest.slicings) == {
        "file": "oak_slicings.glb",
        "slicings": 3,
        "slices": 3,
        "triangles": 2 * 2 * 2 * 2,  # two slicings, the nearer two of three slices, two rectangles each
        "trunk_triangles": 2,
        "texels_kept": 0.64,
        "gpu_bytes": BYTES + foliage().slicings.slices.nbytes,
    }


@pytest.mark.parametrize(("layout", "side"), [("ring", 4), ("ring", 7), ("hemi", 3)])
def test_the_manifest_says_where_each_picture_is_and_whence_it_was_taken(
    tmp_path: Path, layout: str, side: int
) -> None:
    made = impostor(layout, side)
    found = write_asset(baked(views=made), tmp_path).views
    assert found is not None
    assert (found.file, found.layout, found.layers, found.triangles) == ("oak_views.glb", layout, 2, 6)
    assert found.gpu_bytes == BYTES + made.views.pictures.nbytes
    assert read_asset(tmp_path).manifest.views == found
    frames = ring(side) if layout == "ring" else hemi_octahedron(side)
    assert len(found.pictures) == 2 * len(frames)
    for number, picture in enumerate(found.pictures):
        row = made.views.pictures[number]
        assert picture.layer == number % 2
        # The table has left, bottom, right and top.
        assert picture.uv == pytest.approx([row[4, 0], row[4, 3], row[4, 2], row[4, 1]], abs=1e-6)
        assert 0 <= picture.azimuth < 360
        up, around = np.radians([picture.elevation, picture.azimuth])
        towards = [np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)]
        assert np.allclose(towards, frames[number // 2][2], atol=1e-5)


def test_azimuths_of_a_ring_go_round() -> None:
    entry = write_asset_views(impostor("ring", 4))
    assert [(picture.azimuth, picture.elevation) for picture in entry] == [
        (90.0 * (number // 2), 0.0) for number in range(8)
    ]


def write_asset_views(made: Impostor) -> tuple[Any, ...]:
    with TemporaryDirectory() as folder:
        found = write_asset(baked(views=made), Path(folder)).views
    assert found is not None
    return found.pictures


def test_a_view_straight_from_above_keeps_its_azimuth() -> None:
    assert [picture.elevation for picture in write_asset_views(impostor("hemi", 3))][8:10] == [90, 90]


def test_the_folder_holds_what_the_manifest_names_and_nothing_else(tmp_path: Path) -> None:
    manifest = write_asset(baked(), tmp_path)
    assert manifest.slicings is not None
    assert manifest.views is not None
    named = {level.file for level in manifest.levels} | {image.file for image in manifest.textures}
    named |= {manifest.file, manifest.slicings.file, manifest.views.file, "manifest.json"}
    assert named == {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}


def test_loose_images_are_the_same_pixels(tmp_path: Path) -> None:
    listed = {image.file: image for image in write_asset(baked(), tmp_path).textures}
    for made in (foliage().slicings.atlas, impostor().views.atlas):
        for name, space in ATLAS.items():
            wanted = getattr(made, name)
            image = listed[f"textures/oak_{wanted.name}.png"]
            assert (image.size, image.color_space) == (wanted.pixels.shape[1::-1], space)
            np.testing.assert_array_equal(read_image(tmp_path / image.file), wanted.pixels)


@pytest.mark.parametrize("left_out", ["slicings", "views"])
def test_what_was_not_baked_is_not_published(tmp_path: Path, left_out: str) -> None:
    manifest = write_asset(baked(**{left_out: None}), tmp_path)
    assert getattr(manifest, left_out) is None
    assert not list(tmp_path.glob(f"*{left_out}*"))
    read_asset(tmp_path)


@pytest.mark.parametrize("file", ["oak_slicings.glb", "oak_views.glb", "textures/oak_views_relief.png"])
def test_a_missing_file_is_named(tmp_path: Path, file: str) -> None:
    write_asset(baked(), tmp_path)
    (tmp_path / file).unlink()
    with pytest.raises(AssetError, match=f"{file} is named by the manifest and is missing; bake the tree again"):
        read_asset(tmp_path)


# ---- shared by several trees ---------------------------------------------------------------------------------------


def test_views_that_trees_share_are_in_one_file_that_each_manifest_names(tmp_path: Path) -> None:
    trees = {"oak": impostor(shared=True), "ash": impostor("hemi", 3, seed=5, shared=True)}
    path = write_shared_views(list(trees.items()), tmp_path)
    assert path == tmp_path / "shared_views/shared_views.glb"
    for name, made in trees.items():
        write_asset(baked(name, views=made, slicings=None), tmp_path / name, SHARED)
        asset = read_asset(tmp_path / name)
        entry = asset.manifest.views
        assert entry is not None
        assert entry.file == SHARED.as_posix()
        assert (asset.folder / entry.file).resolve() == path.resolve()
        assert entry.gpu_bytes == BYTES + made.views.pictures.nbytes
        assert not list((tmp_path / name).rglob("*views*"))
        assert_same(read_views(asset.folder / entry.file, name), made.views)
        drawn = representations(asset, {64}, replace(VerifySettings(), representations=("views",)))
        ((meshes, layers),) = drawn.values()
        assert meshes[64].triangles == 0
        assert isinstance(layers, Views)
        assert_same(layers, made.views)
    assert [found.name for found in tmp_path.rglob("*views*.glb")] == ["shared_views.glb"]


def test_the_shared_atlas_lies_beside_as_loose_images(tmp_path: Path) -> None:
    write_shared_views([("oak", impostor(shared=True)), ("ash", impostor(seed=5, shared=True))], tmp_path)
    for name in ATLAS:
        loose = read_image(tmp_path / f"shared_views/textures/shared_views_{name}.png")
        np.testing.assert_array_equal(loose, getattr(one_atlas(), name).pixels)


def test_shared_views_that_are_gone_are_named(tmp_path: Path) -> None:
    path = write_shared_views([("oak", impostor(shared=True))], tmp_path)
    write_asset(baked(views=impostor(shared=True)), tmp_path / "oak", SHARED)
    path.unlink()
    with pytest.raises(AssetError, match=r"shared_views\.glb is named by the manifest and is missing; bake the tree"):
        read_asset(tmp_path / "oak")


# ---- refused -------------------------------------------------------------------------------------------------------


def changed(table: np.ndarray, index: object, value: float) -> np.ndarray:
    made = table.copy()
    made[index] = value
    return made


def slices_with(index: object, value: float) -> dict[str, object]:
    return {"slices": changed(foliage().slicings.slices, index, value)}


def pictures_with(index: object, value: float) -> dict[str, object]:
    return {"pictures": changed(impostor().views.pictures, index, value)}


LEAVES = "leaves the atlas, or holds no numbers"
ODD = texture(np.zeros((4, 8, 3)))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (slices_with((0, 4, 2), 1.01), f"a slice {LEAVES}"),
        (slices_with((11, 6, 3), -0.01), f"a slice {LEAVES}"),
        (slices_with((3, 0, 0), np.nan), f"a slice {LEAVES}"),
        (slices_with((3, 4, 0), np.nan), f"a slice {LEAVES}"),
        (slices_with((3, 3, 1), np.inf), f"a slice {LEAVES}"),
        ({"atlas": replace(atlas("slices"), relief=ODD)}, f"a slice {LEAVES}"),
        ({"slices": foliage().slicings.slices[:-1]}, "there are more or fewer slices than it says"),
        ({"count": 4}, "there are more or fewer slices than it says"),
        ({"above": False}, "there are more or fewer slices than it says"),
        ({"far_height": 0.0}, "there are more or fewer slices than it says"),
        ({"far_row": 8}, "its far slices start elsewhere"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_damaged_slicings_are_named(tmp_path: Path, changes: dict[str, object], says: str) -> None:
    path = slicings_glb(tmp_path, **changes)
    with pytest.raises(AssetError) as caught:
        read_slicings(path)
    assert str(caught.value) == f"{path} is damaged: {says}; bake the tree again"


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (pictures_with((0, 4, 0), 1.01), f"a picture {LEAVES}"),
        (pictures_with((7, 4, 3), -0.01), f"a picture {LEAVES}"),
        (pictures_with((3, 0, 0), np.nan), f"a picture {LEAVES}"),
        (pictures_with((3, 4, 0), np.nan), f"a picture {LEAVES}"),
        (pictures_with((3, 3, 1), np.inf), f"a picture {LEAVES}"),
        ({"atlas": replace(atlas("views"), albedo=ODD)}, f"a picture {LEAVES}"),
        ({"pictures": impostor().views.pictures[:-1]}, "there are more or fewer pictures than it says"),
        ({"layers": 3}, "there are more or fewer pictures than it says"),
        ({"side": 5}, "there are more or fewer pictures than it says"),
        ({"layout": "hemi"}, "there are more or fewer pictures than it says"),
        ({"layout": "cube"}, "its layout is cube"),
        ({"support": np.ones(32, np.float32)}, "its support is of another length"),
        ({"support": changed(impostor().views.support, 4, np.nan)}, "its support is of another length"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_damaged_views_are_named(tmp_path: Path, changes: dict[str, object], says: str) -> None:
    path = views_glb(tmp_path, **changes)
    with pytest.raises(AssetError) as caught:
        read_views(path, "oak")
    assert str(caught.value) == f"{path} is damaged: {says}; bake the tree again"


def test_the_edges_of_the_atlas_are_inside(tmp_path: Path) -> None:
    read_views(views_glb(tmp_path, **pictures_with((0, 4), 1.0)), "oak")
    read_views(views_glb(tmp_path, **pictures_with((0, 4), 0.0)), "oak")
    read_slicings(slicings_glb(tmp_path, **slices_with((0, 4), 1.0)))


KINDS = pytest.mark.parametrize("kind", ["slicings", "views"])


def file_of(folder: Path, kind: str) -> Path:
    return slicings_glb(folder) if kind == "slicings" else views_glb(folder)


def read(path: Path, kind: str) -> object:
    return read_slicings(path) if kind == "slicings" else read_views(path, "oak")


def entry(document: Any, kind: str) -> Any:
    """What the extras say of the slicings, or of the one tree's views."""
    found = document["extras"]["treebake"][kind]
    return found if kind == "slicings" else found["trees"][0]


@KINDS
@pytest.mark.parametrize("number", [0, 2, 99])
def test_an_unknown_format_is_named(tmp_path: Path, kind: str, number: int) -> None:
    path = rewritten(file_of(tmp_path, kind), lambda document: document["extras"]["treebake"].update(format=number))
    with pytest.raises(AssetError) as caught:
        read(path, kind)
    assert str(caught.value) == f"{path} is of format {number}, and this treebake reads 1; bake the tree again"


TABLE = {"slicings": "slices", "views": "pictures"}


@KINDS
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda document, _: document.pop("extras"), "extras"),
        (lambda document, _: document["extras"].pop("treebake"), "treebake"),
        (lambda document, kind: document["extras"]["treebake"].pop(kind), "there are none"),
        (lambda document, kind: document["extras"]["treebake"][kind].pop("atlas"), "atlas"),
        (lambda document, kind: entry(document, kind).pop("center"), "center"),
        (lambda document, kind: entry(document, kind).pop(TABLE[kind]), TABLE),
        (lambda document, kind: entry(document, kind).update(center=[0, 1]), "length 3"),
        (lambda document, kind: entry(document, kind).update(exposure=0), "`float` > 0"),
        (lambda document, kind: entry(document, kind).update(exposure="1"), "Expected `float`"),
        (lambda document, kind: entry(document, kind).update({TABLE[kind]: 99}), "out of range"),
        (lambda document, kind: entry(document, kind).update({TABLE[kind]: -1}), "`int` >= 0"),
        (lambda document, kind: entry(document, kind).update({TABLE[kind]: 0}), "a table has values of another kind"),
        (
            lambda document, kind: document["accessors"][entry(document, kind)[TABLE[kind]]].update(componentType=5125),
            "a table has values of another kind",
        ),
        (
            lambda document, kind: document["accessors"][entry(document, kind)[TABLE[kind]]].update(count=13),
            "reshape",
        ),
        (
            lambda document, kind: document["accessors"][entry(document, kind)[TABLE[kind]]].update(count=10**9),
            "leaves buffer view",
        ),
        (lambda document, kind: document["extras"]["treebake"][kind]["atlas"].update(relief=99), "out of range"),
        (lambda document, _: document["textures"][0].pop("source"), "an image is missing"),
        (lambda document, _: document.pop("accessors"), "accessors"),
    ],
)
def test_extras_that_do_not_hold_together_are_one_line(
    tmp_path: Path, kind: str, change: Callable[[Any, str], object], says: str | dict[str, str]
) -> None:
    # The first texture belongs to a standard card in the file, unless there is none.
    if kind == "slicings":
        path = tmp_path / "oak.glb"
        write_slicings(path, replace(foliage(), standard=quad(BARK)))
    else:
        path = tmp_path / "oak.glb"
        write_views(path, [("oak", replace(impostor(), standard=quad(BARK)))])
    rewritten(path, lambda document: change(document, kind))
    with pytest.raises(AssetError) as caught:
        read(path, kind)
    text = str(caught.value)
    assert text.startswith(f"{path} holds no usable {kind} (")
    assert text.endswith("); bake the tree again")
    assert (says if isinstance(says, str) else says[kind]) in text
    assert "\n" not in text


@pytest.mark.parametrize("name", ["brightness", "exposure", "center", "radius"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_views_that_hold_no_numbers_are_refused(tmp_path: Path, name: str, value: float) -> None:
    # JSON as Python reads it has NaN and Infinity; drawn, they would be pictures of nothing.
    told = [0.0, value, 0.0] if name == "center" else value
    path = rewritten(views_glb(tmp_path), lambda document: entry(document, "views").update({name: told}))
    with pytest.raises(AssetError, match=r"^[^\n]+; bake the tree again$"):
        read_views(path, "oak")


@pytest.mark.parametrize("name", ["brightness", "exposure", "center", "size", "far_height"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_slicings_that_hold_no_numbers_are_refused(tmp_path: Path, name: str, value: float) -> None:
    told = [0.0, value, 0.0] if name == "center" else value
    path = rewritten(slicings_glb(tmp_path), lambda document: entry(document, "slicings").update({name: told}))
    with pytest.raises(AssetError, match=r"^[^\n]+; bake the tree again$"):
        read_slicings(path)


def test_views_of_no_tree_are_refused(tmp_path: Path) -> None:
    path = rewritten(views_glb(tmp_path), lambda document: document["extras"]["treebake"]["views"].update(trees=[]))
    with pytest.raises(AssetError, match="length >= 1"):
        read_views(path, "oak")


def test_a_grid_of_one_view_has_none_to_mix(tmp_path: Path) -> None:
    # The grid's cells lie between two views each way; the shader would look beside the table.
    path = views_glb(tmp_path, layout="hemi", side=1, pictures=impostor().views.pictures[:2])
    with pytest.raises(AssetError, match="is damaged: "):
        read_views(path, "oak")


@KINDS
def test_a_file_of_the_other_kind_holds_none(tmp_path: Path, kind: str) -> None:
    other = "views" if kind == "slicings" else "slicings"
    with pytest.raises(AssetError, match=rf"holds no usable {kind} \(there are none\); bake the tree again"):
        read(file_of(tmp_path, other), kind)


@KINDS
def test_a_file_that_is_none_or_cut_off_is_one_line(tmp_path: Path, kind: str) -> None:
    path = file_of(tmp_path, kind)
    path.write_bytes(path.read_bytes()[:-100])
    for damaged in (path, tmp_path / "nowhere.glb", tmp_path):
        with pytest.raises(AssetError, match=rf"^{damaged} holds no usable {kind} \([^\n]+\); bake"):
            read(damaged, kind)


def test_what_an_earlier_bake_left_is_removed(tmp_path: Path) -> None:
    write_asset(baked(), tmp_path)
    kept = tmp_path / "notes.txt"
    kept.write_text("mine")
    write_asset(replace(baked(), slicings=None, views=None), tmp_path)
    assert not list(tmp_path.rglob("*slicings*")) + list(tmp_path.rglob("*views*"))
    assert kept.exists()
    assert read_asset(tmp_path).manifest.slicings is None
