import logging
from dataclasses import replace

import numpy as np
import pytest
from stems import empty, flat_shaded, mesh_of, sphere, stem, together
from trees import tree as file_of

from treebake.errors import SettingsError
from treebake.meshes import read_mesh
from treebake.model import Material, Texture
from treebake.stages.trunk import TrunkSettings, compare, trunk


def test_within_the_budget_nothing_changes():
    mesh = stem()
    assert trunk(mesh, TrunkSettings(triangles=mesh.triangles)) is mesh


def test_a_budget_of_nothing():
    with pytest.raises(SettingsError, match="it must be above 0"):
        trunk(stem(), TrunkSettings(triangles=0))


@pytest.mark.parametrize("mesh", [empty(), mesh_of(np.eye(3), [(0, 1, 2)])], ids=["no trunk", "one triangle"])
def test_nothing_to_simplify(mesh):
    assert trunk(mesh, TrunkSettings(triangles=1)) is mesh


@pytest.mark.parametrize(
    "mesh",
    [
        stem(radii=(0.1, 0.1), sides=16),
        stem(radii=[0.1] * 20, sides=16, capped=True),
        stem(radii=[*[0.1] * 20, 0], sides=16),
        stem(radii=[0.1] * 20, sides=16, mirrored=True),
        flat_shaded(stem(radii=[0.1] * 20, sides=16)),
        stem(radii=np.linspace(0.3, 0.05, 40), sides=16, bend=0.5),
    ],
    ids=["one section", "capped", "pointed", "mirrored uvs", "flat-shaded", "bent"],
)
@pytest.mark.parametrize("budget", [12, 25])
def test_a_tube_keeps_its_silhouette(mesh, budget):
    simple = trunk(mesh, TrunkSettings(triangles=budget))
    assert 6 <= simple.triangles <= budget
    found = compare(mesh, simple)
    assert found.silhouette_kept == pytest.approx(1, abs=0.05)
    assert np.isfinite(simple.positions).all()
    np.testing.assert_allclose(np.linalg.norm(simple.normals, axis=1), 1, atol=1e-5)
    low, high = mesh.bounds
    assert (simple.positions >= low - 0.1).all()
    assert (simple.positions <= high + 0.1).all()


def test_mirrored_texture_shows_both_halves():
    simple = trunk(stem(radii=[0.1] * 20, sides=16, mirrored=True), TrunkSettings(triangles=12))
    u = simple.uvs[simple.faces][..., 0]
    np.testing.assert_allclose([u.min(), u.max()], [0, 1], atol=1e-5)  # an odd number of sides misses the middle


def test_triangles_go_where_the_silhouette_needs_them():
    thick, thin = stem(radii=[0.5] * 9, sides=24), stem(radii=[0.02] * 9, sides=24, at=(3, 0, 0))
    simple = trunk(together(thick, thin), TrunkSettings(triangles=40))
    is_thin = simple.positions[simple.faces].mean(axis=1)[:, 0] > 2
    assert (~is_thin).sum() > 2 * is_thin.sum()
    bent, straight = stem(radii=[0.1] * 30, bend=1.0), stem(radii=[0.1] * 30, at=(5, 0, 0))
    simple = trunk(together(bent, straight), TrunkSettings(triangles=80))
    is_straight = simple.positions[simple.faces].mean(axis=1)[:, 0] > 3
    assert (~is_straight).sum() > 2 * is_straight.sum()


def test_repeated_texture_survives():
    mesh = stem(radii=[0.1] * 40, sides=12, length=8)
    simple = trunk(mesh, TrunkSettings(triangles=60))
    np.testing.assert_allclose(simple.uvs.min(axis=0), mesh.uvs.min(axis=0), atol=1e-5)
    np.testing.assert_allclose(simple.uvs.max(axis=0), mesh.uvs.max(axis=0), atol=1e-5)
    edges = simple.positions[simple.faces[:, [0, 1, 2]]], simple.uvs[simple.faces]
    steps = np.ptp(edges[0][..., 1], axis=1), np.ptp(edges[1][..., 1], axis=1)
    np.testing.assert_allclose(steps[1], steps[0] / 8 * 39, atol=1e-3)  # v runs evenly with height


def test_materials_and_nodes_are_kept():
    one, other = stem(radii=[0.1] * 9), stem(radii=[0.1] * 9, at=(1, 0, 0))
    both = together(one, other)
    second = np.repeat([0, 1], one.triangles).astype(np.int32)
    mesh = replace(
        both, face_material=second, face_node=second, materials=(Material("a"), Material("b")), nodes=("m", "n")
    )
    simple = trunk(mesh, TrunkSettings(triangles=40))
    right = (simple.positions[simple.faces].mean(axis=1)[:, 0] > 0.5).astype(np.int32)
    np.testing.assert_array_equal(simple.face_material, right)
    np.testing.assert_array_equal(simple.face_node, right)


@pytest.mark.parametrize("mesh", [stem(radii=[0.1] * 20, sides=16), sphere()], ids=["tube", "solid"])
def test_an_occlusion_map_is_never_looked_up_elsewhere(mesh):
    shade = Texture("shade", np.full((4, 4, 4), 128, np.uint8))
    mesh = replace(mesh, materials=(Material("bark", color_map=shade, occlusion_map=shade),))
    simple = trunk(mesh, TrunkSettings(triangles=60))
    assert simple.materials == mesh.materials  # looked up where colours are
    apart = replace(mesh, occlusion_uvs=mesh.uvs * 0.5)
    assert trunk(apart, TrunkSettings(triangles=mesh.triangles)) is apart
    (material,) = trunk(apart, TrunkSettings(triangles=60)).materials
    assert (material.occlusion_map, material.color_map) == (None, shade)


def test_a_solid_is_collapsed():
    ball = sphere(4)
    simple = trunk(ball, TrunkSettings(triangles=200))
    assert 150 < simple.triangles <= 200
    assert compare(ball, simple).silhouette_worst == pytest.approx(1, abs=0.05)
    points = simple.positions[simple.faces]
    out = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    assert (np.einsum("ij,ij->i", out, points.mean(axis=1)) > 0).all()
    toward = simple.positions / np.linalg.norm(simple.positions, axis=1, keepdims=True)
    assert np.einsum("ij,ij->i", simple.normals, toward).min() > 0.95


def test_a_solid_keeps_its_texture_across_the_seam():
    ball = sphere(4)
    corners = ball.positions[ball.faces].astype(np.float64)
    u = np.arctan2(corners[..., 0], corners[..., 2]) / (2 * np.pi)
    u += np.round(u.mean(axis=1, keepdims=True) - u)  # no face runs back across the tile
    uvs = np.stack([2 * u, np.arccos(np.clip(corners[..., 1], -1, 1)) / np.pi], axis=-1)
    wrapped = replace(flat_shaded(ball), uvs=uvs.reshape(-1, 2).astype(np.float32))
    simple = trunk(wrapped, TrunkSettings(triangles=400))
    points, found = simple.positions[simple.faces], simple.uvs[simple.faces]
    equator = np.abs(points[..., 1]).max(axis=1) < 0.5
    assert equator.sum() > 50
    assert np.ptp(found[equator][..., 0], axis=1).max() < 0.4
    expected = np.arctan2(points[..., 0], points[..., 2]) / np.pi
    off = found[..., 0] - expected
    assert np.abs(off - 2 * np.round(off / 2))[equator].max() < 0.05


def test_solid_and_tubes_share_the_budget():
    both = together(sphere(4), stem(radii=np.linspace(0.5, 0.1, 40), sides=24, length=9, at=(3, 0, 0)))
    simple = trunk(both, TrunkSettings(triangles=300))
    is_ball = simple.positions[simple.faces].mean(axis=1)[:, 0] < 1.5
    assert simple.triangles <= 300
    assert is_ball.sum() > 50
    assert (~is_ball).sum() > 50
    mostly_ball = trunk(together(sphere(4), stem(radii=(0.01, 0.01), at=(3, 0, 0))), TrunkSettings(triangles=300))
    assert mostly_ball.triangles > 280  # what the tube has no use for is the ball's


def test_a_budget_below_three_sides_each_drops_the_smallest_and_warns(caplog):
    tubes = together(*[stem(radii=(0.02 * i, 0.02 * i), at=(i, 0, 0)) for i in range(1, 11)])
    with caplog.at_level(logging.WARNING, "treebake"):
        simple = trunk(tubes, TrunkSettings(triangles=30))
    assert simple.triangles == 30
    assert simple.bounds[0, 0] > 5  # the five thickest
    assert "left out the 5 smallest" in caplog.text


def test_a_budget_of_one_triangle_leaves_nothing_and_warns(caplog):
    assert trunk(together(stem(), sphere(2)), TrunkSettings(triangles=1)).triangles == 0
    assert "left out" in caplog.text


def test_thousands_of_tubes():
    rng = np.random.default_rng(5)
    tubes = [stem(radii=np.full(4, r), at=(i % 50, 0, i // 50)) for i, r in enumerate(rng.uniform(0.01, 0.1, 2000))]
    mesh = together(*tubes)
    simple = trunk(mesh, TrunkSettings(triangles=13000))
    assert 12000 <= simple.triangles <= 13000
    assert compare(mesh, simple).area_kept == pytest.approx(1, abs=0.01)


def test_mesh_is_not_changed_and_the_result_is_always_the_same():
    mesh = together(stem(radii=[0.2] * 20), sphere(3))
    before = mesh.positions.copy(), mesh.faces.copy()
    first, second = (trunk(mesh, TrunkSettings(triangles=150)) for _ in range(2))
    np.testing.assert_array_equal(before[0], mesh.positions)
    np.testing.assert_array_equal(before[1], mesh.faces)
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_compare_of_itself_and_of_nothing():
    mesh = stem()
    same = compare(mesh, mesh)
    assert (same.area_kept, same.silhouette_kept, same.silhouette_worst) == (1, 1, 1)
    assert compare(mesh, empty()).silhouette_kept == 0
    assert compare(empty(), empty()).silhouette_kept == 1


def test_compare_sees_a_loss_from_one_side():
    flat = mesh_of([[-1, 0, 0], [1, 0, 0], [1, 4, 0], [-1, 4, 0]], [(0, 1, 2), (0, 2, 3)])
    found = compare(together(flat, stem(sides=24)), together(stem(sides=24)))
    assert found.silhouette_worst < found.silhouette_kept < 1


def test_cypress_is_solid_and_small_enough():
    mesh = read_mesh(file_of("cypress_tree.glb"))
    assert trunk(mesh, TrunkSettings()) is mesh
    fewer = trunk(mesh, TrunkSettings(triangles=150))
    assert 100 < fewer.triangles <= 150
    assert compare(mesh, fewer).silhouette_kept == pytest.approx(1, abs=0.05)
    low, high = mesh.uvs.min(axis=0), mesh.uvs.max(axis=0)
    assert ((fewer.uvs >= low - 0.05) & (fewer.uvs <= high + 0.05)).all()
