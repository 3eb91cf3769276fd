import numpy as np
import pytest
from stems import empty, flat_shaded, mesh_of, sphere, stem, together
from trees import tree

from treebake.geometry import weld
from treebake.meshes import read_mesh
from treebake.tubes.find import find_tubes
from treebake.tubes.loft import loft
from treebake.tubes.plan import cost, keep_area, plan, ring_errors


def test_reads_back_what_made_the_tube():
    tubes = find_tubes(stem(radii=(0.3, 0.2, 0.1, 0.05), sides=9, length=3, at=(5, 0, 0)))
    assert tubes.count == 1
    assert tubes.rings.sides.tolist() == [9] * 4
    np.testing.assert_allclose(tubes.rings.centers, [[5, y, 0] for y in range(4)], atol=1e-6)
    regular = 9 / np.pi * np.sin(np.pi / 9)  # mean width of a polygon of 9 sides over its circle's
    np.testing.assert_allclose(tubes.rings.radii, np.array([0.3, 0.2, 0.1, 0.05]) * regular, rtol=1e-5)
    np.testing.assert_allclose(tubes.along, range(4), atol=1e-5)
    assert (tubes.face_ring == np.repeat([0, 1, 2], 18)).all()


def test_rings_start_on_the_seam():
    rings = find_tubes(stem(radii=(0.1, 0.1, 0))).rings
    for ring in range(3):
        u = rings.uvs[rings.first[ring] : rings.first[ring + 1], 0]
        np.testing.assert_allclose([u[0], u[-1]], [0, 1], atol=1e-6)


def test_without_a_seam_rings_start_one_above_the_other():
    straight = stem(radii=[0.1] * 6)
    bare = mesh_of(straight.positions, straight.faces)  # one texture coordinate everywhere
    rings = find_tubes(bare).rings
    starts = rings.positions[rings.first[:-1]]
    assert np.ptp(starts[:, [0, 2]], axis=0).max() < 1e-6


def test_flat_shading_splits_nothing():
    tubes = find_tubes(flat_shaded(stem()))
    assert tubes.count == 1
    assert len(tubes.rings.sides) == 3


def test_a_pointed_tip_is_a_ring_of_one():
    tubes = find_tubes(stem(radii=(0.2, 0.1, 0)))
    assert tubes.rings.sides.tolist() == [8, 8, 1]
    assert tubes.rings.radii[-1] == 0


def test_a_cap_is_found_with_its_ring():
    capped = find_tubes(stem(capped=True))
    assert capped.cap_ring.tolist() == [2]
    assert (capped.face_ring[-6:] == 2).all()


def test_closed_at_both_ends():
    capped = stem(radii=[0.1] * 4, capped=True)
    both = together(capped, mesh_of(capped.positions[:9], [(0, side + 1, side) for side in range(1, 7)]))
    tubes = find_tubes(both)
    assert tubes.count == 1
    assert tubes.rings.sides.tolist() == [8] * 4
    assert tubes.cap_ring.tolist() == [0, 3]
    spindle = stem(radii=(0, 0.1, 0.1, 0))
    faces = [face for face in spindle.faces if len({int(v) if v > 8 else 0 for v in face}) == 3]
    assert find_tubes(mesh_of(spindle.positions, faces)).rings.sides.tolist() == [1, 8, 8, 1]


def test_rings_of_different_sizes():
    lower, upper = (
        np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 0]]),
        np.array([[0, 2, 0.5], [0.5, 2, -0.5], [-0.5, 2, -0.5]]),
    )
    faces = [(0, 1, 4), (1, 5, 4), (1, 2, 5), (2, 6, 5), (2, 3, 6), (3, 4, 6), (3, 0, 4)]
    assert find_tubes(mesh_of(np.concatenate([lower, upper]), faces)).rings.sides.tolist() == [4, 3]


def test_tubes_that_touch_stay_apart():
    both = together(stem(), stem(at=(0.2, 0, 0)))
    assert len(np.unique(weld(both.positions))) == 48 - 3  # one vertex on every ring is the other's
    assert find_tubes(both).count == 2


def test_one_tube_inside_another():
    assert find_tubes(together(stem(), stem(radii=(0.05, 0.05)))).count == 2


def test_texture_mirrored_from_section_to_section_is_unfolded():
    rings = find_tubes(stem(radii=[0.1] * 5, flip_sections=True)).rings
    np.testing.assert_allclose(rings.uvs[rings.first[:-1], 1], range(5), atol=1e-6)


def test_texture_mirrored_around_asks_for_even_sides():
    tubes = find_tubes(stem(radii=[0.1] * 3, sides=12, mirrored=True))
    assert tubes.mirrored.tolist() == [True]
    assert plan(tubes, np.array([0, 2]), 0.1).sides.tolist() == [4, 4]
    assert find_tubes(stem()).mirrored.tolist() == [False]


@pytest.mark.parametrize(
    "mesh",
    [
        empty(),
        mesh_of(np.eye(3), [(0, 1, 2)]),
        mesh_of(np.eye(3), [(0, 1, 1), (0, 0, 0)]),
        mesh_of(np.zeros((3, 3)), [(0, 1, 2)]),
        mesh_of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [(0, 1, 2), (0, 2, 3)]),
        mesh_of([[0, 0, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1]], [(0, 1, 2), (1, 0, 3), (0, 1, 4)]),
        sphere(2),
        together(stem(), mesh_of(np.eye(3), [(0, 1, 2)])).select(np.arange(33) != 5),
    ],
    ids=["empty", "one triangle", "repeated corners", "no area", "quad", "three faces on an edge", "sphere", "hole"],
)
def test_what_is_no_tube(mesh):
    tubes = find_tubes(mesh)
    assert tubes.count == 0
    assert (tubes.face_ring == -1).all()
    assert (
        loft(mesh, tubes, keep_area(tubes, plan(tubes, np.flatnonzero(ring_errors(tubes) > 0), 1.0)))[0].triangles == 0
    )


def test_all_rings_and_sides_give_the_mesh_back():
    source = stem(radii=(0.3, 0.2, 0.25, 0.1, 0), bend=0.4)
    tubes = find_tubes(source)
    every = plan(tubes, np.arange(5), 0.0)
    built, _ = loft(source, tubes, keep_area(tubes, every))
    assert built.triangles == source.triangles == cost(tubes, every).sum()
    np.testing.assert_allclose(built.face_areas.sum(), source.face_areas.sum(), rtol=1e-5)
    corners = np.concatenate([source.positions, source.uvs], axis=1)[:36]
    found = np.concatenate([built.positions, built.uvs], axis=1)
    nearest = np.abs(corners[:, None] - found[None]).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-5


@pytest.mark.parametrize("sides", [3, 5, 7])
def test_fewer_sides_keep_mean_width_and_face_outwards(sides):
    source = stem(radii=[0.1] * 4, sides=16)
    tubes = find_tubes(source)
    chosen = plan(tubes, np.array([0, 3]), 0.1 / 3 * (np.pi / (sides - 0.5)) ** 2)
    assert chosen.sides.tolist() == [sides, sides]
    built, _ = loft(source, tubes, chosen)
    np.testing.assert_allclose(built.face_areas.sum(), source.face_areas.sum(), rtol=1e-4)
    centroid = built.positions[built.faces].mean(axis=1)
    points = built.positions[built.faces]
    out = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    assert (np.einsum("ij,ij->i", out, centroid * [1, 0, 1]) > 0).all()
    away = built.positions * [1, 0, 1]
    np.testing.assert_allclose(built.normals, away / np.linalg.norm(away, axis=1, keepdims=True), atol=0.02)


def test_seam_survives_with_fewer_sides():
    source = stem(radii=[0.1] * 3, sides=9)
    tubes = find_tubes(source)
    built, _ = loft(source, tubes, plan(tubes, np.array([0, 2]), 0.1))
    u = built.uvs[built.faces][..., 0]
    assert np.ptp(u, axis=1).max() < 0.34  # a third of the way around, nowhere back across the whole tile
    np.testing.assert_allclose([u.min(), u.max()], [0, 1], atol=1e-6)


def test_caps_come_back():
    source = stem(capped=True, sides=9)
    tubes = find_tubes(source)
    chosen = plan(tubes, np.array([0, 2]), 0.1)
    built, _ = loft(source, tubes, chosen)
    assert built.triangles == cost(tubes, chosen).sum() == 6 + 1
    np.testing.assert_allclose(built.normals[built.faces[-1]], np.tile([0, 1, 0], (3, 1)), atol=1e-6)


def test_ring_errors_rank_the_bend():
    errors = ring_errors(find_tubes(stem(radii=[0.1] * 5, bend=0.5)))
    assert np.isinf(errors[[0, 4]]).all()
    assert errors[2] == pytest.approx(0.5, rel=1e-3)
    assert (errors[[1, 3]] < errors[2]).all()
    straight = ring_errors(find_tubes(stem(radii=(0.1, 0.1, 0.3, 0.1, 0.1))))
    assert straight[2] == pytest.approx(0.2, rel=0.05)  # the radius counts, not only the centreline


def test_ring_errors_never_rise_towards_finer_rings():
    rng = np.random.default_rng(3)
    errors = ring_errors(find_tubes(stem(radii=rng.uniform(0.05, 0.2, 40), length=8)))
    order = np.argsort(-errors)
    kept = {0, 39}
    for ring in order[2:]:  # each ring splits a gap made by rings of no smaller error
        low, high = max(k for k in kept if k < ring), min(k for k in kept if k > ring)
        assert errors[ring] <= min(errors[low], errors[high])
        kept.add(int(ring))


def test_area_of_the_silhouette_is_kept_without_the_rings_between():
    source = stem(radii=[0.1, 0.3] * 10 + [0.1], sides=12, length=10)
    tubes = find_tubes(source)
    ends = plan(tubes, np.array([0, 20]), 0.0)
    silhouette = (tubes.steps * (tubes.rings.radii + np.append(tubes.rings.radii[1:], 0))).sum()
    built, _ = loft(source, tubes, keep_area(tubes, ends))
    assert built.face_areas.sum() / np.pi == pytest.approx(silhouette, rel=0.01)


@pytest.mark.parametrize(
    ("name", "material", "count"),
    [
        ("sapling_white_birch.glb", "bark", 2138),
        ("ez_oak_large.glb", "branches", 240),
        ("treegen_palm.glb", "Bark", 26),
        ("cypress_tree.glb", "CypressTree_mat", 0),
    ],
)
def test_real_trees(name, material, count):
    mesh = read_mesh(tree(name))
    names = [found.name for found in mesh.materials]
    bark = mesh.select(np.isin(mesh.face_material, [i for i, found in enumerate(names) if found == material]))
    tubes = find_tubes(bark)
    assert tubes.count == count
    if count:
        areas = bark.face_areas
        assert areas[tubes.face_ring < 0].sum() == 0
