"""What a published asset can be drawn as: read back from files of a few cards and three leaves."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from foliage import leaf_tree, planes
from stems import empty

from tests.synthetic import quad
from treebake.asset import Asset, indirect_bytes, read_asset, write_asset
from treebake.compression import block_bytes
from treebake.errors import AssetError, SettingsError
from treebake.model import AlphaMode, BakedTree, BillboardCloud, IndirectTextures, Material, Mesh, Texture
from treebake.stages.indirect import IndirectSettings, indirect
from treebake.verify import VerifySettings, representations, verify

ALL = VerifySettings()
HEIGHTS = {64, 256}
BARK = Material("bark", base_color=(0.3, 0.2, 0.1, 1.0))


@cache
def layers() -> IndirectTextures:
    """Three leaves on two planes."""
    tree = leaf_tree([(0, 0, 0), (0.3, 0.1, 0.05), (0, 1, 0)])
    clusters = planes([0, 0, 1], [(0, 0, 1), (0, 0, 1)], [0, 0])
    return indirect(tree, clusters, IndirectSettings(leaf_texels=4, atlas=64, far_texels=1))


def cards() -> Mesh:
    """One card with an atlas that takes more than the indirect textures: 2 x 341 KiB with its mips."""
    pixels = np.full((512, 512, 4), 200, np.uint8)
    maps = {"color_map": Texture("foliage_color", pixels), "normal_map": Texture("foliage_normal", pixels)}
    return quad(Material("foliage", alpha_mode=AlphaMode.MASK, double_sided=True, **maps))


def published(folder: Path, *, foliage: bool = True, trunk: bool = True) -> Asset:
    tree = BakedTree(
        name="oak",
        cloud=BillboardCloud(cards() if foliage else empty(), np.zeros(2 if foliage else 0, np.int32)),
        indirect=layers() if foliage else None,
        trunk=quad(BARK, x=(-0.1, 0.1)) if trunk else empty(),
        source_triangles=12,
        source_bounds=np.zeros((2, 3), np.float32),
    )
    write_asset(tree, folder)
    return read_asset(folder)


def asked(*names: str) -> VerifySettings:
    return replace(ALL, representations=names)


def test_an_asset_is_drawn_as_all_that_it_is(tmp_path: Path) -> None:
    found = representations(published(tmp_path), HEIGHTS, ALL)
    assert list(found) == ["cloud", "cloud_same_bytes", "indirect", "leaves"]
    for meshes, _ in found.values():
        assert set(meshes) == HEIGHTS


def test_the_cloud_is_the_level_as_it_is_published(tmp_path: Path) -> None:
    meshes, drawn = representations(published(tmp_path), HEIGHTS, ALL)["cloud"]
    assert drawn is None
    assert meshes[64] is meshes[256]  # the only level
    assert (meshes[64].triangles, meshes[64].nodes) == (4, ("cloud", "trunk"))
    assert meshes[64].materials[0].color_map is not None
    assert meshes[64].materials[0].color_map.pixels.shape == (512, 512, 4)


def test_the_cloud_of_the_same_bytes_is_no_larger_than_the_indirect_textures(tmp_path: Path) -> None:
    asset = published(tmp_path)
    meshes, drawn = representations(asset, HEIGHTS, ALL)["cloud_same_bytes"]
    assert drawn is None
    limit = indirect_bytes(layers())
    assert 2 * block_bytes(64, 64, 16) <= limit < 2 * block_bytes(128, 128, 16)
    for mesh in meshes.values():
        image = mesh.materials[0].color_map
        assert image is not None
        assert image.pixels.shape == (64, 64, 4)
        assert mesh.triangles == 4


def test_the_indirect_textures_stand_beside_the_trunk_alone(tmp_path: Path) -> None:
    meshes, drawn = representations(published(tmp_path), HEIGHTS, ALL)["indirect"]
    assert drawn is not None
    assert drawn.leaves == 3
    assert (drawn.placements == layers().placements).all()
    for mesh in meshes.values():
        assert mesh.triangles == 2
        assert {mesh.materials[index].name for index in mesh.face_material} == {"bark"}


def test_foliage_without_a_trunk_is_drawn_from_billboards_alone(tmp_path: Path) -> None:
    meshes, drawn = representations(published(tmp_path, trunk=False), HEIGHTS, ALL)["indirect"]
    assert drawn is not None
    assert all(mesh.triangles == 0 for mesh in meshes.values())


@pytest.mark.parametrize("names", [("cloud",), ("indirect",), ("indirect", "cloud_same_bytes")])
def test_only_what_is_asked_for_is_given(tmp_path: Path, names: tuple[str, ...]) -> None:
    assert set(representations(published(tmp_path), HEIGHTS, asked(*names))) == set(names)


def test_an_asset_without_foliage_has_the_cloud_only(tmp_path: Path) -> None:
    asset = published(tmp_path, foliage=False)
    ((name, (meshes, drawn)),) = representations(asset, HEIGHTS, ALL).items()
    assert (name, drawn) == ("cloud", None)
    assert meshes[64].triangles == 2
    assert list(representations(asset, HEIGHTS, asked("cloud", "indirect"))) == ["cloud"]


def test_a_representation_that_is_not_there_is_named(tmp_path: Path) -> None:
    asset = published(tmp_path, foliage=False)
    with pytest.raises(SettingsError) as caught:
        representations(asset, HEIGHTS, asked("indirect", "cloud_same_bytes"))
    assert str(caught.value) == (
        f"{tmp_path} has no indirect or cloud_same_bytes, only cloud; change verify.representations"
    )


def test_an_unknown_representation_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="has no twigs, only cloud, cloud_same_bytes, indirect"):
        representations(published(tmp_path), HEIGHTS, asked("twigs"))
    with pytest.raises(
        SettingsError, match=r"verify\.representations: there is no twigs; known are cloud, cloud_same_bytes, indirect"
    ):
        verify(cards(), cards(), asked("cloud", "twigs"))


def test_damaged_indirect_textures_are_refused_by_name(tmp_path: Path) -> None:
    asset = published(tmp_path)
    (tmp_path / "oak.glb").write_bytes((tmp_path / "oak_LOD0.glb").read_bytes())
    with pytest.raises(AssetError, match=r"oak\.glb holds no usable indirect textures"):
        representations(asset, HEIGHTS, ALL)


def test_a_damaged_file_does_not_keep_the_cloud_from_being_judged(tmp_path: Path) -> None:
    asset = published(tmp_path)
    (tmp_path / asset.manifest.indirect.file).write_bytes(b"")
    assert list(representations(asset, HEIGHTS, asked("cloud"))) == ["cloud"]
