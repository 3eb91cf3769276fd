"""Tiny trees from leaves to cards: what a viewer sees of the cloud is what it saw of the leaves."""

from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foliage import GREEN, PAINTED, leaf_tree, planes, random_leaves, rotation
from stems import empty
from synthetic import SUN_DIRECTION

from treebake.errors import BudgetError, SettingsError
from treebake.flatten import plane_frames
from treebake.gl.draw import Drawing
from treebake.gl.target import Picture
from treebake.gl.view import View
from treebake.images import to_linear
from treebake.model import AlphaMode, BillboardCloud, Clusters, Doubles, Material, Mesh, Texture, Transmission, Tree
from treebake.stages.billboards import BillboardSettings, billboards, silhouette
from treebake.stages.billboards.silhouette import covered_area
from treebake.stages.cluster import ClusterSettings, cluster
from treebake.stages.translucency import TranslucencySettings, translucency

FINE, COARSE = BillboardSettings(leaf_texels=64), BillboardSettings(leaf_texels=12)
PIXELS = 128
DIAGONAL = (0.48, 0.6, 0.64)


def own_planes(tree: Tree) -> Clusters:
    """Every leaf on the plane in which it lies."""
    offsets = -np.einsum("ij,ij->i", tree.leaves.normals, tree.leaves.centers)
    side = np.where(offsets < 0, -1.0, 1.0)
    return planes(np.arange(tree.leaves.count), tree.leaves.normals * side[:, None], offsets * side)


def facing(normal: object, center: object, reach: float) -> View:
    """Straight at a plane, from the side to which `normal` points; `reach` is half of what is seen."""
    frame = plane_frames(np.array([normal], np.float64))[0] * np.array([[1], [1], [-1]])
    to_clip = np.eye(4)
    to_clip[:3, :3] = frame / reach
    to_clip[:3, 3] = -frame @ np.array(center, np.float64) / reach
    return View(to_clip, PIXELS, 0.0, 2.0)


def draw(mesh: Mesh, view: View, *, exact: bool = False) -> Picture:
    with closing(Drawing(mesh, exact_cutouts=exact)) as drawing:
        return drawing.picture(view)


def assert_alike(cloud: BillboardCloud, tree: Tree, view: View, within: float = 0.04) -> None:
    source, card = draw(tree.foliage, view, exact=True).color, draw(cloud.mesh, view).color
    assert card[..., 3].sum() == pytest.approx(source[..., 3].sum(), rel=within)
    assert np.minimum(card, source)[..., 3].sum() > (1 - within) * source[..., 3].sum()  # in the same place
    deep = (source[..., 3] == 1) & (card[..., 3] == 1)
    assert deep.sum() > 0.7 * source[..., 3].sum()
    error = np.abs(card - source)[deep][:, :3]
    assert error.mean() < 0.02  # the edges between colours are as soft as texels
    assert np.allclose(card[deep].mean(axis=0), source[deep].mean(axis=0), atol=0.01)


def color_map(cloud: BillboardCloud) -> np.ndarray:
    texture = cloud.mesh.materials[0].color_map
    assert texture is not None
    return texture.pixels


def normal_map(cloud: BillboardCloud) -> np.ndarray:
    texture = cloud.mesh.materials[0].normal_map
    assert texture is not None
    return texture.pixels


@pytest.fixture(scope="module")
def five() -> tuple[Tree, Clusters, BillboardCloud]:
    """Five leaves in two parallel planes, two of them seen from behind."""
    centers = [(-0.3, 0.2, 1.0), (0.0, -0.2, 1.0), (0.3, 0.1, 1.0), (-0.15, 0.0, 2.0), (0.2, -0.1, 2.0)]
    fronts = np.array([(0.0, 0.0, s) for s in (1, 1, -1, 1, -1)])
    tree = leaf_tree(centers, fronts, material=PAINTED, shading=fronts * 0.8 + (0.0, 0.6, 0.0))
    clusters = cluster(tree.leaves, ClusterSettings(billboards=2))
    return tree, clusters, billboards(tree, clusters, FINE)


# ---- what is seen --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0, 1, 0), (0, -1, 0), DIAGONAL])
def test_one_leaf_looks_the_same_from_both_sides(normal: tuple[float, float, float]) -> None:
    tree = leaf_tree([(1.0, 2.0, 3.0)], normal, material=PAINTED)
    cloud = billboards(tree, own_planes(tree), FINE)
    assert cloud.mesh.triangles == 2
    for side in (1, -1):
        assert_alike(cloud, tree, facing(side * np.array(normal), (1, 2, 3), 0.15))


@pytest.mark.parametrize("shading", [(0.0, 0.8, 0.6), (0.6, 0.0, 0.8), (-0.6, -0.48, 0.64)])
def test_light_falls_as_on_the_source(shading: tuple[float, float, float]) -> None:
    # The source's normals lean away from its surface, as artists bend them to round a crown.
    tree = leaf_tree([(0.0, 0.0, 1.0)], (0, 0, 1), material=PAINTED, shading=shading)
    cloud = billboards(tree, own_planes(tree), FINE)
    for side in (1, -1):
        assert_alike(cloud, tree, facing((0, 0, side), (0, 0, 1), 0.15))


@pytest.mark.parametrize("through", [None, Transmission(0.6, (0.8, 1.0, 0.3))], ids=["opaque", "translucent"])
@pytest.mark.parametrize("material", [GREEN, PAINTED], ids=["green", "painted"])
def test_a_card_lit_from_behind_looks_as_its_leaf_does(material: Material, through: Transmission | None) -> None:
    # The front is in the full sun, its normal leans away from it, and it is the back that is looked at.
    shading = SUN_DIRECTION + np.array([0.3, -0.2, 0.0])
    leaf = replace(material, transmission=through)
    tree = leaf_tree([(1.0, 2.0, 3.0)], SUN_DIRECTION, material=leaf, shading=shading / np.linalg.norm(shading))
    tree = translucency(tree, TranslucencySettings(enabled=through is not None))
    cloud = billboards(tree, own_planes(tree), FINE)
    assert (cloud.mesh.materials[0].transmission is None) == (through is None)
    assert_alike(cloud, tree, facing(-SUN_DIRECTION, (1, 2, 3), 0.15))


@pytest.mark.parametrize("side", [1, -1], ids=["front", "back"])
@pytest.mark.parametrize("plane", [0, 1])
def test_five_leaves_look_the_same(five: tuple[Tree, Clusters, BillboardCloud], plane: int, side: int) -> None:
    tree, clusters, cloud = five
    one_plane = replace(tree, foliage=tree.foliage.select(clusters.labels[tree.leaves.face_leaf] == plane))
    cards = replace(cloud, mesh=cloud.mesh.select(cloud.face_cluster == plane))
    assert_alike(cards, one_plane, facing((0, 0, side), (0, 0, clusters.offsets[plane]), 0.45), within=0.06)


def test_turned_leaves_are_seen_whole() -> None:
    # Four leaves 30 degrees off their common plane: projected, a cosine of each would be lost.
    tilts = [(s * 0.5 * c, s * 0.5 * d, np.sqrt(0.75)) for s in (1, -1) for c, d in ((1, 0), (0, 1))]
    tree = leaf_tree([(x, y, 1.0) for x in (-0.15, 0.15) for y in (-0.15, 0.15)], tilts)
    cloud = billboards(tree, planes([0] * 4, (0, 0, -1), 1), FINE)
    fit = covered_area(cloud.mesh, tree.foliage, 384, exact=False) / covered_area(
        tree.foliage, tree.foliage, 384, exact=True
    )
    area = draw(cloud.mesh, facing((0, 0, 1), (0, 0, 1), 0.4)).color[..., 3].mean() * 0.8**2
    assert area > 1.02 * np.sqrt(0.75) * tree.leaves.areas.sum()
    assert fit == pytest.approx(1, abs=0.15)


def test_a_crown_covers_what_it_covered() -> None:
    leaves = random_leaves(1, 60, spread=0.5)
    tree = leaf_tree(leaves.centers, leaves.normals, material=PAINTED)
    cloud = billboards(tree, cluster(tree.leaves, ClusterSettings(billboards=20)), FINE)
    wanted, found = (
        covered_area(tree.foliage, tree.foliage, 384, exact=True),
        covered_area(cloud.mesh, tree.foliage, 384, exact=False),
    )
    assert found == pytest.approx(wanted, rel=0.03)


def test_the_nearer_leaf_hides_the_other() -> None:
    # Two leaves of one plane, half over each other: the one farther along the plane's normal is whole.
    red, blue = (
        Material(name, base_color=(r, 0.0, b, 1.0), double_sided=True) for name, r, b in (("red", 1, 0), ("blue", 0, 1))
    )
    tree = leaf_tree([(0.0, 0.0, 1.05), (0.1, 0.0, 1.0)])
    tree = replace(
        tree, foliage=replace(tree.foliage, materials=(red, blue), face_material=np.array([0, 0, 1, 1], np.int32))
    )
    cloud = billboards(tree, planes([0, 0], (0, 0, -1), 1.02), FINE)
    picture = draw(cloud.mesh, facing((0, 0, -1), (0.05, 0, 1), 0.2)).color
    is_red, is_blue = (picture[..., channel] > 0.2 for channel in (0, 2))
    assert is_blue.sum() == pytest.approx(2 * is_red.sum(), rel=0.06)


# ---- the atlas -----------------------------------------------------------------------------------------------------


def test_no_black_lies_under_the_clear_texels(five: tuple[Tree, Clusters, BillboardCloud]) -> None:
    # The source is black where it is clear; every texel of the atlas has a colour of a leaf, or a mix of them.
    texels = to_linear(color_map(five[2])[..., :3])
    assert texels.max(axis=2).min() > to_linear(np.array(130, np.uint8))


def test_normals_are_unit_and_face_the_viewer(five: tuple[Tree, Clusters, BillboardCloud]) -> None:
    texels = normal_map(five[2])
    assert (texels[..., 3] == 255).all()
    normals = texels[..., :3] / 127.5 - 1
    assert np.allclose(np.linalg.norm(normals, axis=2), 1, atol=0.01)
    assert (normals[..., 2] > 0).all()


def test_normals_that_point_away_are_bent_to_the_rim() -> None:
    tree = leaf_tree([(0.0, 0.0, 1.0)], (0, 0, 1), shading=(0.6, 0.0, -0.8))
    normals = normal_map(billboards(tree, planes([0], (0, 0, 1), -1), FINE))[..., :3] / 127.5 - 1
    assert np.allclose(normals[normals.shape[0] // 2, normals.shape[1] // 2], (1, 0, 0.08), atol=0.02)


def test_nothing_of_a_leaf_is_cut_off(five: tuple[Tree, Clusters, BillboardCloud]) -> None:
    # Cards reach `padding` texels past their leaves: what passes the test never touches a card's edge.
    alpha = color_map(five[2])[..., 3]
    height, width = alpha.shape
    for first in range(0, len(five[2].mesh.uvs), 4):
        corners = five[2].mesh.uvs[first : first + 4] * (width, height)
        (left, top), (right, bottom) = (
            np.rint(corners.min(axis=0)).astype(int),
            np.rint(corners.max(axis=0)).astype(int),
        )
        card = alpha[top:bottom, left:right] >= 128
        assert card.any()
        assert card.sum() == card[1:-1, 1:-1].sum()


def test_two_bakes_give_the_same_bytes(five: tuple[Tree, Clusters, BillboardCloud]) -> None:
    tree, clusters, cloud = five
    again = billboards(tree, clusters, FINE)
    for name in ("positions", "normals", "uvs", "faces"):
        assert getattr(cloud.mesh, name).tobytes() == getattr(again.mesh, name).tobytes()
    assert color_map(cloud).tobytes() == color_map(again).tobytes()
    assert normal_map(cloud).tobytes() == normal_map(again).tobytes()


def test_a_tree_in_centimetres_has_the_same_atlas(five: tuple[Tree, Clusters, BillboardCloud]) -> None:
    tree, clusters, cloud = five
    leaves = tree.leaves
    large = replace(
        tree,
        foliage=replace(tree.foliage, positions=tree.foliage.positions * 128),
        leaves=replace(leaves, centers=leaves.centers * 128, radii=leaves.radii * 128, areas=leaves.areas * 128**2),
    )
    other = billboards(large, replace(clusters, offsets=clusters.offsets * 128), FINE)
    assert np.allclose(other.mesh.positions, 128 * cloud.mesh.positions, rtol=1e-5, atol=1e-4)
    assert np.abs(color_map(other).astype(int) - color_map(cloud)).mean() < 0.5


@pytest.mark.parametrize("leaf_texels", [8.0, 32.0])
def test_a_leaf_gets_its_texels(leaf_texels: float) -> None:
    tree = leaf_tree([(0.0, 0.0, 1.0)])
    alpha = color_map(billboards(tree, own_planes(tree), BillboardSettings(leaf_texels=leaf_texels)))[..., 3]
    assert np.sqrt((alpha >= 128).sum()) == pytest.approx(leaf_texels, rel=0.15)


def test_an_opaque_material_keeps_its_corners() -> None:
    clear = Material(
        "leaf", color_map=Texture("clear", np.full((4, 4, 4), (60, 120, 40, 0), np.uint8)), double_sided=True
    )
    tree = leaf_tree([(0.0, 0.0, 1.0)], material=clear)
    assert_alike(billboards(tree, own_planes(tree), FINE), tree, facing((0, 0, 1), (0, 0, 1), 0.15))


# ---- the cards -----------------------------------------------------------------------------------------------------


@cache
def random_cloud(settings: BillboardSettings) -> tuple[Clusters, Mesh, Doubles]:
    """30 leaves on 8 planes, and the plane's number of each vertex of the cards."""
    leaves = random_leaves(2, 30)
    tree = leaf_tree(leaves.centers, leaves.normals)
    clusters = cluster(tree.leaves, ClusterSettings(billboards=8))
    cloud = billboards(tree, clusters, settings)
    return clusters, cloud.mesh, cloud.face_cluster[::2].repeat(4)


def test_cards_lie_on_their_planes() -> None:
    clusters, mesh, plane = random_cloud(COARSE)
    off = np.einsum("vi,vi->v", clusters.normals[plane], mesh.positions.astype(float)) + clusters.offsets[plane]
    assert np.abs(off).max() < 1e-6
    assert np.allclose(mesh.normals, clusters.normals[plane], atol=1e-6)
    a, b, c = (mesh.positions[mesh.faces[:, i]] for i in range(3))
    turn = np.cross(b - a, c - a)
    assert (np.einsum("fi,fi->f", turn, mesh.normals[mesh.faces[:, 0]]) > 0).all()  # fronts show the normal's side


def test_all_texels_are_the_same_size() -> None:
    mesh = random_cloud(COARSE)[1]
    material = mesh.materials[0]
    assert material.color_map is not None
    height, width = material.color_map.pixels.shape[:2]
    p, uv = mesh.positions.reshape(-1, 4, 3), mesh.uvs.reshape(-1, 4, 2) * (width, height)
    sides = np.linalg.norm(np.roll(p, -1, axis=1) - p, axis=2) / np.linalg.norm(np.roll(uv, -1, axis=1) - uv, axis=2)
    assert np.allclose(sides, sides.mean(), rtol=1e-4)
    assert np.allclose(uv, np.rint(uv), atol=1e-3)  # cards begin and end between texels
    assert mesh.uvs.min() >= 0
    assert mesh.uvs.max() <= 1


def test_the_material_is_what_every_viewer_draws() -> None:
    mesh = random_cloud(replace(COARSE, cutoff=0.3))[1]
    (material,) = mesh.materials
    assert material.alpha_mode is AlphaMode.MASK
    assert material.alpha_cutoff == 0.3
    assert material.double_sided
    assert material.base_color == (1, 1, 1, 1)
    assert material.color_map is not None
    assert material.normal_map is not None
    assert material.color_map.pixels.shape == material.normal_map.pixels.shape


@pytest.mark.parametrize(("triangles", "cards"), [(2, 8), (20, 10)])
def test_the_triangle_limit_holds_but_every_plane_has_a_card(triangles: int, cards: int) -> None:
    mesh = random_cloud(replace(COARSE, triangles=triangles))[1]
    assert mesh.triangles == 2 * cards


def test_a_small_atlas_is_filled_not_exceeded() -> None:
    mesh = random_cloud(replace(COARSE, atlas=64))[1]
    assert mesh.materials[0].color_map is not None
    assert mesh.materials[0].color_map.pixels.shape == (64, 64, 4)
    assert np.isfinite(mesh.positions).all()


def test_twig_pieces_alone_make_a_cloud() -> None:
    tree = leaf_tree([(0.0, 0.0, 1.0), (0.3, 0.0, 1.0)], (0.0, 1.0, 0.0), axes=(1.0, 0.0, 0.0))
    cloud = billboards(tree, planes([0, 0], (0, 1, 0), 0), FINE)
    assert cloud.mesh.triangles >= 2
    assert (color_map(cloud)[..., 3] >= 128).any()


# ---- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("atlas", 0),
        ("atlas", -64),
        ("atlas", 32),
        ("atlas", 1000),
        ("atlas", 32768),
        ("leaf_texels", 0.0),
        ("leaf_texels", float("nan")),
        ("triangles", 1),
        ("padding", 0),
        ("supersample", 0),
        ("supersample", 9),
        ("cutoff", 0.05),
        ("cutoff", 0.95),
        ("height", 8),
    ],
)
def test_setting_out_of_range_is_named(name: str, value: float) -> None:
    tree = leaf_tree([(0.0, 0.0, 1.0)])
    with pytest.raises(SettingsError, match=rf"\[textures\] {name} is {value}; it must be"):
        billboards(tree, own_planes(tree), replace(BillboardSettings(), **{name: value}))


def test_too_many_planes_for_the_atlas() -> None:
    leaves = random_leaves(1, 300)
    tree = leaf_tree(leaves.centers, leaves.normals)
    with pytest.raises(BudgetError, match="300 cards do not fit into an atlas of 64 x 64 texels"):
        billboards(tree, own_planes(tree), BillboardSettings(atlas=64))


# ---- the silhouette ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_covered_area_of_a_square_is_its_projection(seed: int) -> None:
    normal = rotation(seed)[0]
    square = leaf_tree([(3.0, -2.0, 1.0)], normal).foliage
    low, high = square.bounds.astype(float)
    expected = 0.0
    for elevation, azimuth in np.radians(silhouette._DIRECTIONS):
        up = np.cos(elevation)
        towards = np.array([up * np.sin(azimuth), np.sin(elevation), up * np.cos(azimuth)])
        for height in (384, 192):
            pixel = np.linalg.norm(high - low) / height
            expected += 0.04 * abs(normal @ towards) / pixel**2
    assert covered_area(square, square, 384, exact=True) == pytest.approx(expected, rel=0.01)
    assert covered_area(square, square, 384, exact=False) == pytest.approx(expected, rel=0.01)


def test_covered_area_of_nothing_is_zero() -> None:
    assert covered_area(empty(), leaf_tree([(0.0, 0.0, 0.0)], material=GREEN).foliage, 384, exact=True) == 0
