import numpy as np
import pytest
from stems import empty, mesh_of, sphere, stem, together, tree_of
from trees import tree as file_of

from treebake.errors import SettingsError
from treebake.geometry import components, weld
from treebake.meshes import read_mesh
from treebake.stages.split import SplitSettings, split
from treebake.stages.trunk import TrunkSettings, compare, trunk
from treebake.stages.twigs import TwigSettings, twigs


def forest(count: int, *, radii=(0.02, 0.01, 0.005)) -> list:
    """Thin tubes of 0.8 in length in a row."""
    return [stem(radii=radii, length=0.8, at=(0.5 * i, 1.0, 0.5)) for i in range(count)]


THICK = stem(radii=(0.4, 0.35, 0.3), sides=12)
ALL_THIN = TwigSettings(radius=0.05)  # of 3 in height: every tube but the thick one


def moved_part(before, after):
    """The foliage that the twigs stage added, and its rows' numbers."""
    return after.foliage.select(after.leaves.face_leaf >= before.leaves.count), slice(before.leaves.count, None)


def test_thin_tubes_move_and_thick_ones_stay():
    tree = tree_of(together(THICK, *forest(20)))
    after = twigs(tree, TwigSettings(trunk_triangles=THICK.triangles))
    assert after.trunk.triangles == THICK.triangles
    assert after.foliage.triangles > tree.foliage.triangles
    assert trunk(after.trunk, TrunkSettings(triangles=THICK.triangles)).triangles <= THICK.triangles


def test_rows_describe_the_pieces():
    tree = tree_of(together(THICK, *forest(20)))
    after = twigs(tree, ALL_THIN)
    leaves, added = after.leaves, slice(3, None)
    count = leaves.count - 3
    assert count == 20 * round(0.8 / (2 * np.hypot(0.1, 0.05)))
    assert (np.bincount(leaves.face_leaf) > 0).all()
    assert leaves.is_twig.tolist() == [False] * 3 + [True] * count
    np.testing.assert_allclose(np.abs(leaves.axes[added]), np.tile([0, 1, 0], (count, 1)), atol=1e-6)
    np.testing.assert_allclose(np.einsum("ij,ij->i", leaves.axes[added], leaves.normals[added]), 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(leaves.normals, axis=1), 1)
    mean_width = 8 / np.pi * np.sin(np.pi / 8) * 0.02 * 1.125  # of the three rings' mean radius 0.01125
    assert leaves.areas[added].sum() == pytest.approx(20 * 0.8 * mean_width, rel=1e-3)
    assert (leaves.shape[added] == np.arange(count) + 1).all()
    assert (leaves.exemplars[1:] == np.arange(count) + 3).all()
    mesh = after.foliage
    for element in (0, 3, leaves.count - 1):
        corners = mesh.positions[mesh.faces[leaves.face_leaf == element]].reshape(-1, 3)
        away = np.linalg.norm(corners - leaves.centers[element], axis=1).max()
        assert away <= leaves.radii[element] * (1 + 1e-5)
        assert away > 0.8 * leaves.radii[element]


def test_pieces_keep_surface_and_bark():
    tree = tree_of(together(THICK, *forest(5)))
    after = twigs(tree, ALL_THIN)
    pieces, _ = moved_part(tree, after)
    assert pieces.face_areas.sum() == pytest.approx(sum(t.face_areas.sum() for t in forest(5)), rel=2e-3)
    assert {after.foliage.materials[m].name for m in after.foliage.face_material[tree.foliage.triangles :]} == {"bark"}
    assert {after.foliage.nodes[n] for n in after.foliage.face_node[tree.foliage.triangles :]} == {"tree"}
    np.testing.assert_allclose([pieces.uvs[:, 0].min(), pieces.uvs[:, 0].max()], [0, 1], atol=1e-6)
    np.testing.assert_allclose([pieces.uvs[:, 1].min(), pieces.uvs[:, 1].max()], [0, 2], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(pieces.normals, axis=1), 1, atol=1e-5)


def test_only_the_thin_end_of_a_tube_moves():
    tapering = stem(radii=np.linspace(0.4, 0.01, 14), sides=12, length=6)
    tree = tree_of(tapering)
    after = twigs(tree, TwigSettings(radius=0.03))  # of a height of 6
    assert after.trunk.bounds[1, 1] == pytest.approx(after.foliage.select(after.leaves.face_leaf >= 3).bounds[0, 1])
    assert 0 < after.trunk.triangles < tapering.triangles
    welded = weld(after.trunk.positions)[after.trunk.faces]
    assert len(np.unique(components(welded, int(welded.max()) + 1))) == 1


def test_length_sets_the_number_of_pieces():
    tree = tree_of(together(THICK, *forest(5)))
    short, long = (twigs(tree, TwigSettings(radius=0.05, length=length)).leaves.count for length in (0.5, 4.0))
    assert (short - 3, long - 3) == (5 * round(0.8 / np.hypot(0.1, 0.05)), 5 * 1)


def test_capped_and_pointed_tips_move_whole():
    tips = together(THICK, stem(radii=(0.02, 0.01), capped=True, at=(1, 0, 0)), stem(radii=(0.02, 0), at=(2, 0, 0)))
    after = twigs(tree_of(tips), ALL_THIN)
    assert after.trunk.triangles == THICK.triangles
    assert np.isfinite(after.foliage.positions).all()
    assert (after.leaves.areas > 0).all()


@pytest.mark.parametrize(
    "settings",
    [TwigSettings(radius=0), TwigSettings(trunk_triangles=10**6), TwigSettings(radius=1e-6)],
    ids=["off", "within the budget", "all thicker"],
)
def test_nothing_moves(settings):
    tree = tree_of(together(THICK, *forest(3)))
    assert twigs(tree, settings) is tree


@pytest.mark.parametrize(
    "mesh",
    [empty(), mesh_of(np.eye(3), [(0, 1, 2)]), sphere(3)],
    ids=["no trunk", "one triangle", "solid"],
)
def test_no_tubes_to_move(mesh):
    tree = tree_of(mesh)
    assert twigs(tree, TwigSettings(trunk_triangles=1)) is tree


def test_the_thinnest_move_even_within_the_budget():
    tree = tree_of(together(THICK, *forest(3)))
    plenty = TwigSettings(trunk_triangles=10**6, thinnest=0.05)
    assert twigs(tree, plenty).trunk.triangles == THICK.triangles
    tight, both = TwigSettings(trunk_triangles=20), TwigSettings(trunk_triangles=20, thinnest=1e-6)
    left = twigs(tree, tight).trunk.triangles  # the budget asks for more than the thinnest
    assert twigs(tree, both).trunk.triangles == left < tree.trunk.triangles


def test_without_foliage_nothing_moves():
    tree = tree_of(together(THICK, *forest(3)), leaves=0)
    assert twigs(tree, TwigSettings(trunk_triangles=10)) is tree


@pytest.mark.parametrize(
    "settings",
    [
        TwigSettings(trunk_triangles=0),
        TwigSettings(radius=2),
        TwigSettings(thinnest=-0.1),
        TwigSettings(detail=0),
        TwigSettings(length=-1),
    ],
    ids=["trunk_triangles", "radius", "thinnest", "detail", "length"],
)
def test_settings_out_of_range(settings, request):
    with pytest.raises(SettingsError, match=rf"\[twigs\] {request.node.callspec.id} is"):
        twigs(tree_of(THICK), settings)


def test_tree_is_not_changed():
    tree = tree_of(together(THICK, *forest(3)))
    before = tree.trunk.positions.copy(), tree.leaves.centers.copy(), tree.foliage.faces.copy()
    twigs(tree, TwigSettings(trunk_triangles=100))
    for was, now in zip(before, (tree.trunk.positions, tree.leaves.centers, tree.foliage.faces), strict=True):
        np.testing.assert_array_equal(was, now)


def test_more_budget_moves_less():
    tree = tree_of(
        together(*[stem(radii=(r, r / 2, r / 4), at=(i, 0, 0)) for i, r in enumerate(np.geomspace(0.01, 0.3, 40))])
    )
    left = [twigs(tree, TwigSettings(trunk_triangles=budget)).trunk.triangles for budget in (60, 200, 500)]
    assert left == sorted(left)
    assert left[0] < left[-1]


@pytest.mark.parametrize(
    ("name", "triangles"),
    [
        ("sapling_white_birch.glb", 8000),
        ("sapling_white_birch.glb", 3500),
        ("ez_oak_large.glb", 8000),
        ("ez_oak_large.glb", 2000),
        ("treegen_palm.glb", 8000),
        ("quaternius_tree_1/Tree_1.obj", 300),
    ],
)
def test_real_trees_keep_their_silhouette(name, triangles):
    tree = split(read_mesh(file_of(name)), SplitSettings())
    after = twigs(tree, TwigSettings(trunk_triangles=triangles))
    simple = trunk(after.trunk, TrunkSettings(triangles=triangles))
    pieces, _ = moved_part(tree, after)
    found = compare(tree.trunk, simple, pieces)
    assert 0.9 * triangles < found.triangles <= triangles
    assert found.area_kept == pytest.approx(1, abs=0.02)
    assert found.silhouette_kept == pytest.approx(1, abs=0.02)
    assert found.silhouette_worst == pytest.approx(1, abs=0.04)
