import numpy as np
import pytest
from gltf_validate import assert_valid
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from treebake.errors import SettingsError
from treebake.glb import encode_glb, write_glb
from treebake.grow import grow, species
from treebake.model import AlphaMode

# [GPSS07] Table 1: leaves, and triangles per leaf.
TABLE_1 = {
    "chestnut": (11291, 10),
    "oak": (23660, 2),
    "cork": (20144, 4),
    "horse-chestnut": (9366, 18),
    "shrub": (2388, 2),
    "maple": (3662, 2),
    "alder": (1049, 2),
}


def foliage(mesh):
    return mesh.select(mesh.face_node == mesh.nodes.index("leaves"))


def welded_components(mesh):
    """How many connected components the faces form once vertices at equal positions are one."""
    _, weld = np.unique(mesh.positions, axis=0, return_inverse=True)
    faces = weld.reshape(-1)[mesh.faces]
    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    n = faces.max() + 1
    graph = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
    return connected_components(graph, directed=False)[0]


def copies(mesh, leaves):
    """(leaves, vertices of one, 3) positions of the foliage; a leaf's vertices follow each other."""
    return foliage(mesh).positions.astype(np.float64).reshape(leaves, -1, 3)


def distance_to_segments(point, start, end):
    along = ((point - start) * (end - start)).sum(axis=1) / ((end - start) ** 2).sum(axis=1)
    return np.linalg.norm(start + np.clip(along, 0, 1)[:, None] * (end - start) - point, axis=1)


@pytest.fixture(scope="module")
def trees():
    return {name: grow(name) for name in TABLE_1}


def test_species_are_the_table():
    assert set(species()) == set(TABLE_1)


@pytest.mark.parametrize("name", TABLE_1)
def test_leaf_counts_are_the_table(trees, name):
    leaves, triangles = TABLE_1[name]
    mesh = foliage(trees[name])
    assert mesh.triangles == leaves * triangles
    assert welded_components(mesh) == leaves


@pytest.mark.parametrize("name", TABLE_1)
def test_leaves_are_congruent_up_to_scale(trees, name):
    leaves = copies(trees[name], TABLE_1[name][0])
    distances = np.linalg.norm(leaves[:, :, None] - leaves[:, None], axis=-1)
    scale = distances[:, 0, -1:, None] / distances[0, 0, -1]
    np.testing.assert_allclose(distances / scale, np.broadcast_to(distances[0], distances.shape), atol=2e-5)
    assert 0.5 < scale.min() < scale.max() < 1.5


@pytest.mark.parametrize("name", TABLE_1)
def test_a_tree_is_a_sound_mesh(trees, name):
    mesh = trees[name]
    assert mesh.nodes == ("trunk", "leaves")
    bark, leaf = mesh.materials
    assert (bark.name, bark.alpha_mode, bark.double_sided) == ("bark", AlphaMode.OPAQUE, False)
    assert (leaf.name, leaf.alpha_mode, leaf.alpha_cutoff, leaf.double_sided) == ("leaf", AlphaMode.MASK, 0.5, True)
    np.testing.assert_array_equal(mesh.face_material, mesh.face_node)
    assert (mesh.face_areas > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    leaves = foliage(mesh)
    assert leaves.uvs.min() >= 0
    assert leaves.uvs.max() <= 1
    low, high = mesh.bounds
    assert low[1] > -0.05  # nothing grows underground
    assert 0.5 < np.ptp(mesh.bounds[:, 0]) / np.ptp(mesh.bounds[:, 2]) < 2
    assert abs(low + high)[[0, 2]].max() < (high - low)[1]  # stands over the origin


@pytest.mark.parametrize("name", TABLE_1)
def test_faces_look_where_their_normals_point(trees, name):
    mesh = trees[name]
    a, b, c = (mesh.positions[corner] for corner in mesh.faces.T)
    along = (np.cross(b - a, c - a) * mesh.normals[mesh.faces[:, 0]]).sum(axis=1)
    assert (along > 0).mean() > 0.999  # the inside of a sharp bend may fold


@pytest.mark.parametrize("name", TABLE_1)
def test_leaves_sit_on_twigs_and_fill_the_crown(trees, name):
    mesh = trees[name]
    bark = mesh.select(mesh.face_node == 0)
    leaves = copies(mesh, TABLE_1[name][0])
    crown = np.percentile(leaves.mean(axis=1), [1, 99], axis=0)
    assert (np.ptp(crown, axis=0) > 0.6 * np.ptp(mesh.bounds, axis=0)).all()
    upright = np.linalg.norm(foliage(mesh).normals[:, 1:2], axis=1).mean()
    assert upright > 0.5
    start, end = (bark.positions[bark.faces[:, corner]] for corner in (0, 2))
    at_foot = foliage(mesh).uvs[: leaves.shape[1], 1] == 1
    for foot in leaves[:: len(leaves) // 40, at_foot].mean(axis=1):
        assert distance_to_segments(foot, start, end).min() < 0.02


def test_the_chestnut_is_the_one_that_the_benchmarks_know(trees):
    mesh = trees["chestnut"]
    assert abs((mesh.face_node == 0).sum() - 46_000) < 500
    assert abs(np.ptp(mesh.bounds[:, 1]) - 10) < 0.5
    lengths = np.ptp(copies(mesh, 11291), axis=1)
    assert abs(np.median(np.linalg.norm(lengths, axis=1)) - 0.2) < 0.05


def test_same_seed_gives_the_same_bytes_and_another_does_not():
    def glb(seed):
        return encode_glb([("tree", grow("shrub", seed=seed))])

    assert glb(3) == glb(3)
    assert glb(3) != glb(4)


@settings(max_examples=15, deadline=None)
@given(name=st.sampled_from(species()), leaves=st.integers(1, 3000), seed=st.integers(0, 2**31))
def test_any_count_is_met(name, leaves, seed):
    mesh = grow(name, seed=seed, leaves=leaves)
    assert (mesh.face_node == 1).sum() == leaves * TABLE_1[name][1]
    assert np.isfinite(mesh.positions).all()


@pytest.mark.parametrize("name", TABLE_1)
def test_one_leaf(name):
    mesh = foliage(grow(name, leaves=1))
    assert welded_components(mesh) == 1
    assert mesh.triangles == TABLE_1[name][1]


def test_a_hundred_thousand_leaves():
    mesh = grow("maple", leaves=100_000)
    assert foliage(mesh).triangles == 200_000
    assert np.ptp(mesh.bounds[:, 1]) > 20  # an older tree is a taller one


@pytest.mark.parametrize("leaves", [0, -1, 1_000_001])
def test_numbers_of_leaves_out_of_range_are_refused(leaves):
    with pytest.raises(SettingsError, match="ask for 1 to 1000000"):
        grow("oak", leaves=leaves)


def test_negative_seeds_are_refused():
    with pytest.raises(SettingsError, match="seed -1 is negative"):
        grow("oak", seed=-1)


@pytest.mark.parametrize(("typed", "meant"), [("chesnut", "chestnut"), ("Oak", "oak"), ("xyz", "")])
def test_unknown_species_name_the_nearest_and_all(typed, meant):
    with pytest.raises(SettingsError, match=f"unknown species '{typed}'; did you mean {meant}") as caught:
        grow(typed)
    assert all(name in str(caught.value) for name in species())


def test_validator_finds_nothing(trees, tmp_path):
    paths = [tmp_path / f"{name}.glb" for name in TABLE_1]
    for path, mesh in zip(paths, trees.values(), strict=True):
        write_glb(path, [(node, mesh.select(mesh.face_node == i)) for i, node in enumerate(mesh.nodes)])
    assert_valid(*paths)
