"""Levels of detail: what each is made of, and what is published of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foliage import leaf_tree, random_leaves
from gltf_validate import assert_valid
from stems import empty, mesh_of, stem, together

from treebake.asset import read_asset, write_asset
from treebake.errors import SettingsError
from treebake.levels import LevelSettings, bake_levels, check_levels
from treebake.model import BakedLevel, BakedTree, Hierarchy, MappedTrunk, Material, Mesh, Texture, Tree, TrunkMaps
from treebake.planes import with_pieces
from treebake.settings import Settings
from treebake.stages.billboards import BillboardSettings, billboards
from treebake.stages.cluster import ClusterSettings, cluster
from treebake.stages.hierarchy import HierarchySettings, hierarchy
from treebake.stages.trunk import TrunkSettings, trunk
from treebake.stages.twigs import TwigSettings, twigs
from treebake.tubes.find import find_tubes
from treebake.tubes.plan import ring_errors
from treebake.workspace import Result, Workspace

SMALL = Settings(
    cluster=ClusterSettings(billboards=12),
    hierarchy=HierarchySettings(billboards=(6, 2)),
    levels=LevelSettings(heights=(64, 32), trunk_triangles=(60, 20)),
    textures=BillboardSettings(atlas=256, supersample=1),
    twigs=TwigSettings(trunk_triangles=300),
    trunk=TrunkSettings(triangles=300),
)
NONE = TrunkMaps("none")
THIN = tuple(stem(radii=(0.04, 0.03, 0.02), sides=6, at=(0.3 * i, 0.0, 0.2)) for i in range(6))  # of 2 in height
BRANCHES = together(stem(radii=np.linspace(0.3, 0.2, 12), sides=12), *THIN)


def crowned(trunk: Mesh, leaves: int = 40) -> Tree:
    """A trunk of 2 in height below leaves that face anywhere."""
    some = random_leaves(3, max(leaves, 1))
    tree = leaf_tree(some.centers + np.array((0, 2, 0)), some.normals)
    if leaves:
        return replace(tree, trunk=trunk)
    return Tree(trunk, empty(), replace(random_leaves(3, 0), face_leaf=np.zeros(0, np.int32)), ())


def finest(tree: Tree, settings: Settings) -> tuple[Tree, Hierarchy | None, Mesh]:
    grown = twigs(tree, settings.twigs)
    solid = trunk(grown.trunk, settings.trunk)
    if not tree.leaves.count:
        return grown, None, solid
    return grown, hierarchy(grown.leaves, cluster(grown.leaves, settings.cluster), settings.hierarchy), solid


def levels_of(tree: Tree, folder: Path, settings: Settings = SMALL, maps: TrunkMaps = NONE) -> tuple[BakedLevel, ...]:
    grown, planes, solid = finest(tree, settings)
    above = Result.of(planes) if planes else None
    mapped = MappedTrunk(solid, maps)
    return bake_levels(Workspace(folder), settings, Result.of(tree), Result.of(grown), above, mapped)


def published(tree: Tree, folder: Path, settings: Settings = SMALL) -> BakedTree:
    grown, planes, solid = finest(tree, settings)
    cloud = billboards(grown, planes.levels[0], settings.textures) if planes else levels_of(tree, folder)[0].cloud
    whole = BakedTree("oak", cloud, None, solid, 1, np.zeros((2, 3), np.float32), None, None)
    return replace(whole, levels=levels_of(tree, folder, settings))


def test_each_level_has_its_planes_and_a_smaller_trunk(tmp_path: Path) -> None:
    near, far = levels_of(crowned(BRANCHES), tmp_path)
    assert [level.height for level in (near, far)] == [64, 32]
    assert [len(set(level.cloud.face_cluster.tolist())) for level in (near, far)] == [6, 2]
    assert near.cloud.mesh.triangles <= 24
    assert far.cloud.mesh.triangles <= 8
    assert near.trunk.triangles <= 60
    assert far.trunk.triangles <= 20
    sizes = [level.cloud.mesh.materials[0].color_map.pixels.shape[:2] for level in (near, far)]  # type: ignore[union-attr]
    assert np.prod(sizes[1]) < np.prod(sizes[0])
    assert all(level.trunk_iou is not None and 0.5 < level.trunk_iou <= 1 for level in (near, far))
    assert [level.silhouette_kept for level in (near, far)] == pytest.approx([1, 1], abs=0.1)


def test_branches_thinner_than_a_pixel_are_on_cards(tmp_path: Path) -> None:
    levels_of(crowned(BRANCHES), tmp_path)
    near, far = (Workspace(tmp_path).read(f"twigs_{number}", "").value for number in (1, 2))
    assert far.leaves.count >= near.leaves.count > 40
    assert near.trunk.bounds[1, 2] < 0.35  # of the stem alone: half a pixel is 0.05, and the branches are thinner
    assert (near.leaves.centers[:40] == crowned(BRANCHES).leaves.centers).all()  # pieces come after the leaves
    assert not near.leaves.is_twig[:40].any()
    assert near.leaves.is_twig[40:].all()


def test_a_trunk_that_lost_its_twigs_alone_keeps_its_maps(tmp_path: Path) -> None:
    tree = crowned(together(stem(radii=(0.3, 0.2), sides=12), *THIN))
    roomy = replace(SMALL, levels=replace(SMALL.levels, trunk_triangles=(200, 100)))
    for level in levels_of(tree, tmp_path, roomy):
        assert level.trunk.triangles == 24 < tree.trunk.triangles
        assert level.trunk_maps.kind == "tiled"


def test_all_levels_show_bark_as_the_finest_does(tmp_path: Path) -> None:
    bark = Material("bark", color_map=Texture("bark", np.full((64, 64, 4), 255, np.uint8)))
    tree = crowned(replace(stem(radii=np.linspace(0.3, 0.2, 12), sides=12), materials=(bark,)))
    for kind, density in (("unique", 1e6), ("tiled", 1e-6)):
        levels = levels_of(tree, tmp_path / kind, maps=TrunkMaps(kind, 1.0, density))
        assert [level.trunk_maps.kind for level in levels] == [kind, kind]


def test_leaves_keep_their_plane_and_pieces_go_to_the_nearest() -> None:
    tree = crowned(BRANCHES)
    grown, planes, _ = finest(tree, replace(SMALL, twigs=TwigSettings(radius=0.006)))
    assert planes is not None
    level = planes.levels[1]
    more = twigs(tree, TwigSettings(radius=0.05))
    found = with_pieces(level, grown.leaves, more.leaves, 40, 2.0, 0.0)
    assert (found.labels[:40] == level.labels[:40]).all()
    assert len(found.labels) == more.leaves.count > grown.leaves.count
    centers, axes = more.leaves.centers[40:], more.leaves.axes[40:]
    alpha = 2.0 * more.leaves.radii[40:] ** 2
    errors = (centers @ level.normals.T + level.offsets) ** 2 + alpha[:, None] * (axes @ level.normals.T) ** 2
    assert (found.labels[40:] == errors.argmin(axis=1)).all()


def test_rings_kept_for_less_are_among_those_kept_for_more() -> None:
    random = np.random.default_rng(1)
    mesh = together(*(stem(radii=random.uniform(0.1, 0.3, 30), sides=3, bend=0.3, at=(i, 0, 0)) for i in range(4)))
    tubes = find_tubes(mesh)
    assert len(ring_errors(tubes)) == 4 * 30
    heights = [set(np.unique(trunk(mesh, TrunkSettings(budget)).positions[:, 1].round(4))) for budget in (60, 200, 500)]
    assert heights[0] < heights[1] < heights[2]


@pytest.mark.parametrize(
    ("mesh", "kept"),
    [(empty(), None), (mesh_of(np.eye(3), [(0, 1, 2)]), 1.0)],
    ids=["no trunk", "trunk of one triangle"],
)
def test_little_trunk(tmp_path: Path, mesh: Mesh, kept: float | None) -> None:
    levels = levels_of(crowned(mesh), tmp_path)
    assert [level.trunk.triangles for level in levels] == [mesh.triangles] * 2
    assert [level.trunk_iou for level in levels] == [kept] * 2


def test_no_foliage_at_all(tmp_path: Path) -> None:
    levels = levels_of(crowned(BRANCHES, leaves=0), tmp_path)
    assert [level.cloud.mesh.triangles for level in levels] == [0, 0]
    assert [level.trunk.triangles <= budget for level, budget in zip(levels, (60, 20), strict=True)] == [True, True]


def test_a_bare_trunk_has_no_two_equal_levels(tmp_path: Path) -> None:
    assert levels_of(crowned(stem(sides=4), leaves=0), tmp_path) == ()


def test_levels_with_too_few_planes_are_left_out(tmp_path: Path) -> None:
    few = replace(SMALL, cluster=ClusterSettings(billboards=4))
    (level,) = levels_of(crowned(BRANCHES), tmp_path, few)
    assert level.height == 32  # it is the one of 2 planes


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"heights": (64,)}, r"\[levels\] heights has 1 entries and \[hierarchy\] billboards 2"),
        ({"trunk_triangles": (9, 8, 7)}, r"\[levels\] trunk_triangles has 3 entries"),
        ({"heights": (32, 64)}, r"\[levels\] heights is .+ it must be descending"),
        ({"heights": (64, 8)}, r"\[levels\] heights is .+ it must be descending, 16 to 2048"),
        ({"trunk_triangles": (60, 0)}, r"\[levels\] trunk_triangles is .+ 1 or more"),
    ],
)
def test_settings_out_of_range_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        check_levels(replace(SMALL, levels=replace(SMALL.levels, **changes)))


def test_what_is_published(tmp_path: Path) -> None:
    tree = published(crowned(BRANCHES), tmp_path)
    write_asset(tree, tmp_path / "oak")
    asset = read_asset(tmp_path / "oak")
    levels = asset.manifest.levels
    assert [level.file for level in levels] == [f"oak_LOD{number}.glb" for number in range(3)]
    assert [level.min_height for level in levels] == [64, 32, 0]
    assert [level.billboards for level in levels] == [12, 6, 2]
    assert [level.trunk_iou is None for level in levels] == [True, False, False]
    assert [asset.level_for(height).name[4:8] for height in (100, 64, 40, 10)] == ["LOD0", "LOD0", "LOD1", "LOD2"]
    files = [image.file for image in asset.manifest.textures]
    cards = [
        f"textures/oak{level}_foliage_{what}.png" for level in ("", "_LOD1", "_LOD2") for what in ("color", "normal")
    ]
    assert files == [*cards[:4], "textures/oak_LOD1_trunk_normal.png", *cards[4:], "textures/oak_LOD2_trunk_normal.png"]
    assert [level.trunk_maps for level in levels] == ["none", "unique", "unique"]
    assert_valid(*asset.level_paths)


def test_levels_that_are_gone_leave_no_file(tmp_path: Path) -> None:
    tree = published(crowned(BRANCHES), tmp_path)
    write_asset(tree, tmp_path / "oak")
    write_asset(replace(tree, levels=tree.levels[:1]), tmp_path / "oak")
    assert not (tmp_path / "oak/oak_LOD2.glb").exists()
    assert not (tmp_path / "oak/textures/oak_LOD2_foliage_color.png").exists()
    assert len(json.loads((tmp_path / "oak/manifest.json").read_text())["levels"]) == 2


def test_the_same_tree_gives_the_same_levels(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        write_asset(published(crowned(BRANCHES), tmp_path / f"work_{folder}"), tmp_path / folder)
    for file in (f"oak_LOD{number}.glb" for number in range(3)):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
