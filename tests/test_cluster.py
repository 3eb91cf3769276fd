"""Leaves into planes: exact where the answer is known, honest where it is not."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from foliage import leaves_at, planes, random_leaves, rotation
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.errors import MeshError, SettingsError
from treebake.model import Clusters, Doubles, Leaves
from treebake.stages.cluster import ClusterSettings, cluster, cluster_statistics

PAPER = ClusterSettings(billboards=1, compactness=0)


def flat(z: float = 0.0) -> Doubles:
    """Nine places in a level of 1 x 1."""
    return np.array([(x, y, z) for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5)])


def error(leaves: Leaves, normal: Doubles, offset: float, angle_weight: float) -> float:
    """Equation 1 of [GSSK05], summed over the leaves by area: the readable twin."""
    distance = leaves.centers @ normal + offset
    alpha = angle_weight * leaves.radii**2
    return float((leaves.areas * (distance**2 + alpha * (1 - (leaves.normals @ normal) ** 2))).sum())


def assert_sound(found: Clusters, leaves: Leaves) -> None:
    assert set(found.labels.tolist()) == set(range(found.count))
    assert found.labels.shape == (leaves.count,)
    assert found.labels.dtype == np.int32
    assert found.normals.shape == (found.count, 3)
    assert np.allclose(np.linalg.norm(found.normals, axis=1), 1)
    assert (found.offsets >= 0).all()


def test_two_parallel_planes_are_found_exactly() -> None:
    found = cluster(leaves_at([*flat(1), *flat(3)]), ClusterSettings(billboards=2))
    assert len(set(found.labels[:9])) == len(set(found.labels[9:])) == 1
    first, second = found.labels[0], found.labels[9]
    assert first != second
    assert np.allclose(found.normals, (0, 0, -1))
    assert found.offsets[first] == pytest.approx(1)
    assert found.offsets[second] == pytest.approx(3)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_coplanar_leaves_have_no_error(count: int) -> None:
    tilt = rotation(3)
    leaves = leaves_at(flat(2) @ tilt.T, tilt[:, 2])
    found = cluster(leaves, ClusterSettings(billboards=count))
    assert_sound(found, leaves)
    assert found.count == count
    measured = cluster_statistics(leaves, found)
    assert measured.distance_worst < 1e-9
    assert measured.angle_worst < 1e-4


def test_one_leaf_lies_in_its_own_plane() -> None:
    found = cluster(leaves_at([(1.0, 2.0, 3.0)], (-1.0, -2.0, 2.0)), ClusterSettings())
    assert found.labels.tolist() == [0]
    assert np.allclose(found.normals, [(1 / 3, 2 / 3, -2 / 3)])  # turned so that d is positive
    assert np.allclose(found.offsets, [1 / 3])


def test_no_leaves() -> None:
    with pytest.raises(MeshError, match=r"no leaves to cluster.*foliage_materials"):
        cluster(leaves_at([]), ClusterSettings())


def test_more_billboards_than_leaves_give_one_each_and_a_note(caplog: pytest.LogCaptureFixture) -> None:
    leaves = random_leaves(1, 7)
    with caplog.at_level(logging.INFO, "treebake"):
        found = cluster(leaves, ClusterSettings(billboards=1000))
    assert found.count == 7
    assert sorted(found.labels.tolist()) == list(range(7))
    assert "7 leaves fill 7 of the 1000 billboards" in caplog.text


@pytest.mark.parametrize("compactness", [0.0, 0.005])
def test_identical_leaves_fill_every_cluster(compactness: float) -> None:
    leaves = leaves_at([(1.0, 1.0, 1.0)] * 9)
    found = cluster(leaves, ClusterSettings(billboards=5, compactness=compactness))
    assert_sound(found, leaves)
    assert found.count == 5
    assert cluster_statistics(leaves, found).distance_worst < 1e-12


def test_twig_fits_every_plane_that_holds_its_axis() -> None:
    # A twig in the leaves' plane, whose own normal is at right angles to it, costs nothing; a leaf so placed does.
    places = [*flat(), (0.2, 0.1, 0.0)]
    axes = np.array([(0.0, 0.0, 0.0)] * 9 + [(1.0, 0.0, 0.0)])
    normals = [(0.0, 0.0, 1.0)] * 9 + [(0.0, 1.0, 0.0)]
    for leaves, angle in ((leaves_at(places, normals, axes=axes), 0.0), (leaves_at(places, normals), 90.0)):
        found = cluster(leaves, ClusterSettings(billboards=1))
        assert np.abs(found.normals[0]) @ (0, 0, 1) == pytest.approx(1)
        assert cluster_statistics(leaves, found).angle_worst == pytest.approx(angle, abs=1e-4)


@given(turn=st.floats(0, 2 * np.pi))
def test_one_twig_costs_nothing_on_a_plane_turned_about_it(turn: float) -> None:
    twig = leaves_at([(0.0, 0.0, 0.0)], (0.0, 1.0, 0.0), axes=(1.0, 0.0, 0.0))
    held = planes([0], (0, np.cos(turn), np.sin(turn)), 0)
    assert cluster_statistics(twig, held).angle_worst < 1e-6


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("billboards", 0),
        ("angle_weight", 0.0),
        ("angle_weight", float("nan")),
        ("compactness", -0.1),
        ("compactness", float("nan")),
        ("iterations", 0),
        ("seed", -1),
    ],
)
def test_setting_out_of_range_is_named(name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=rf"\[cluster\] {name} is {value}; it must be"):
        cluster(leaves_at(flat()), replace(ClusterSettings(), **{name: value}))


def test_same_seed_same_bytes_and_the_seed_counts() -> None:
    leaves = random_leaves(2, 120)
    first, second, other = (cluster(leaves, ClusterSettings(billboards=12, seed=seed)) for seed in (5, 5, 6))
    for name in ("labels", "normals", "offsets"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.labels.tobytes() != other.labels.tobytes()


def test_a_tree_in_centimetres_clusters_like_one_in_metres() -> None:
    metres = random_leaves(3, 200)
    centimetres = replace(metres, centers=100 * metres.centers, radii=100 * metres.radii, areas=100**2 * metres.areas)
    one, hundred = (cluster(leaves, ClusterSettings(billboards=20)) for leaves in (metres, centimetres))
    assert (one.labels == hundred.labels).all()
    assert np.allclose(hundred.offsets, 100 * one.offsets)


def test_a_moved_tree_keeps_its_clusters() -> None:
    # Far from the origin, as in a scene with map coordinates, squares of positions would lose their digits.
    here = random_leaves(3, 200)
    there = replace(here, centers=here.centers + np.array((5e5, 300.0, 5e6)))
    settings_ = ClusterSettings(billboards=20)
    assert (cluster(here, settings_).labels == cluster(there, settings_).labels).all()


def test_rotating_the_tree_rotates_the_planes() -> None:
    turn, leaves = rotation(7), random_leaves(4, 200)
    turned = replace(leaves, centers=leaves.centers @ turn.T, normals=leaves.normals @ turn.T)
    before, after = (cluster(some, ClusterSettings(billboards=20)) for some in (leaves, turned))
    assert (before.labels == after.labels).all()
    assert np.allclose(after.normals, before.normals @ turn.T)
    assert np.allclose(after.offsets, before.offsets)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), leaves=st.integers(1, 60), billboards=st.integers(1, 2000), copies=st.integers(1, 3)
)
def test_every_cluster_has_a_leaf(seed: int, leaves: int, billboards: int, copies: int) -> None:
    drawn = np.random.default_rng(seed).integers(0, -(-leaves // copies), leaves)  # some leaves lie on one another
    base = random_leaves(seed, leaves)
    some = replace(base, centers=base.centers[drawn], normals=base.normals[drawn])
    found = cluster(some, ClusterSettings(billboards=billboards, seed=seed))
    assert found.count == min(billboards, leaves)
    assert_sound(found, some)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    step=st.floats(1e-4, 0.5),
    shift=st.floats(-0.1, 0.1),
    angle_weight=st.sampled_from([0.25, 2.0, 30.0]),
)
def test_no_nearby_plane_fits_better(seed: int, step: float, shift: float, angle_weight: float) -> None:
    base = random_leaves(seed, 12)
    random = np.random.default_rng(seed)
    leaves = replace(base, areas=random.uniform(0.5, 2, 12), radii=random.uniform(0.05, 0.5, 12))
    found = cluster(leaves, replace(PAPER, angle_weight=angle_weight))
    normal, offset = found.normals[0], float(found.offsets[0])
    other = normal + step * random.normal(size=3)
    other /= np.linalg.norm(other)
    best = error(leaves, normal, offset, angle_weight)
    assert best <= error(leaves, other, -float(other @ leaves.centers.mean(axis=0)) + shift, angle_weight) * (1 + 1e-9)
    assert best <= error(leaves, other, offset + shift, angle_weight) * (1 + 1e-9)
    assert best <= error(leaves, normal, offset + shift, angle_weight) * (1 + 1e-9)


def test_more_billboards_fit_better() -> None:
    leaves = random_leaves(5, 300)
    distances = [
        cluster_statistics(leaves, cluster(leaves, ClusterSettings(billboards=count))).distance_mean
        for count in (1, 10, 100)
    ]
    assert distances[0] > 1.5 * distances[1] > 1.5**2 * distances[2]


def test_compactness_gathers_near_leaves() -> None:
    leaves = random_leaves(6, 300)

    def reach(compactness: float) -> float:
        found = cluster(leaves, ClusterSettings(billboards=20, compactness=compactness))
        centers = np.stack([leaves.centers[found.labels == k].mean(axis=0) for k in range(found.count)])
        return float(np.linalg.norm(leaves.centers - centers[found.labels], axis=1).mean())

    assert reach(1.0) < 0.7 * reach(0.0)


def test_large_leaves_decide_the_plane() -> None:
    # 2 large leaves in one plane against 3 small ones across it: the error counts by area.
    base = leaves_at([(0, 0, 0)] * 5, [(0, 0, 1)] * 2 + [(1, 0, 0)] * 3)
    large = replace(base, areas=np.array([10.0, 10.0, 1.0, 1.0, 1.0]))
    assert np.abs(cluster(large, PAPER).normals[0]) @ (0, 0, 1) == pytest.approx(1)
    assert np.abs(cluster(base, PAPER).normals[0]) @ (1, 0, 0) == pytest.approx(1)


def test_statistics_against_hand_numbers() -> None:
    tilted = (np.sin(np.radians(30)), 0.0, np.cos(np.radians(30)))
    leaves = leaves_at([(0, 0, 1.3), (5, 5, 0.9), (0, 2, 0)], [tilted, (0, 0, -1), (1, 0, 0)], radius=0.5)
    found = cluster_statistics(leaves, planes([0, 0, 1], [(0, 0, -1), (0, -1, 0)], [1, 2]))
    assert (found.leaves, found.billboards) == (3, 2)
    assert found.distance_mean == pytest.approx((0.3 + 0.1 + 0) / 3)
    assert found.distance_worst == pytest.approx(0.3)
    assert found.distance_percent == pytest.approx(100 * 0.4 / 3)  # a leaf's diameter is 1
    assert found.angle_mean == pytest.approx((30 + 0 + 90) / 3)
    assert found.angle_worst == pytest.approx(90)
