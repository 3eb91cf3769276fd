"""Planes into fewer planes: nested, and as good as the leaves say."""

import logging
from dataclasses import replace

import numpy as np
import pytest
from foliage import leaves_at, random_leaves, rotation
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.errors import SettingsError
from treebake.model import Clusters, Hierarchy, Leaves
from treebake.planes import centered, features, fit, least_error, nearest, summed, weights
from treebake.stages.cluster import ClusterSettings, cluster
from treebake.stages.hierarchy import HierarchySettings, hierarchy

FEW = HierarchySettings(billboards=(12, 5, 2))


def fine(leaves: Leaves, count: int = 40) -> Clusters:
    return cluster(leaves, ClusterSettings(billboards=count))


def assert_nested(found: Hierarchy, leaves: Leaves) -> None:
    assert len(found.parents) == len(found.levels) - 1
    for child, parent, coarser in zip(found.levels[:-1], found.parents, found.levels[1:], strict=True):
        assert parent.shape == (child.count,)
        assert parent.dtype == coarser.labels.dtype == np.int32
        assert (coarser.labels == parent[child.labels]).all()  # all leaves of a plane go the same way
        assert set(coarser.labels.tolist()) == set(range(coarser.count))
        assert coarser.labels.shape == (leaves.count,)
        assert np.allclose(np.linalg.norm(coarser.normals, axis=1), 1)
        assert (coarser.offsets >= 0).all()


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    leaves=st.integers(1, 60),
    start=st.integers(1, 40),
    counts=st.sets(st.integers(1, 30), max_size=4),
    copies=st.integers(1, 3),
    compactness=st.sampled_from([0.0, 0.005, 1.0]),
)
def test_levels_nest(seed: int, leaves: int, start: int, counts: set[int], copies: int, compactness: float) -> None:
    drawn = np.random.default_rng(seed).integers(0, -(-leaves // copies), leaves)  # some leaves lie on one another
    base = random_leaves(seed, leaves)
    some = replace(base, centers=base.centers[drawn], normals=base.normals[drawn])
    first = fine(some, start)
    levels = tuple(sorted(counts, reverse=True))
    found = hierarchy(some, first, HierarchySettings(billboards=levels, compactness=compactness))
    assert found.levels[0] is first
    assert [level.count for level in found.levels[1:]] == [count for count in levels if count < first.count]
    assert_nested(found, some)


def test_a_leaf_goes_one_way_down() -> None:
    leaves = leaves_at([(0, 0, 1), (1, 0, 1.01), (0, 0, 3), (1, 0, 3.01), (0, 0, 9)], radius=1)
    found = hierarchy(leaves, fine(leaves, 5), HierarchySettings(billboards=(3, 2), compactness=0))
    ways = np.stack([level.labels for level in found.levels[1:]], axis=1)
    near, far, single = ways[0], ways[2], ways[4]
    assert (ways[1] == near).all()
    assert (ways[3] == far).all()
    assert len({near[0], far[0], single[0]}) == 3
    assert near[1] == far[1] != single[1]  # 2 apart, against 6


def test_sums_know_what_a_fit_of_the_leaves_finds() -> None:
    base = random_leaves(8, 30)
    leaves = replace(base, areas=np.linspace(0.5, 2, 30), radii=np.linspace(0.1, 0.4, 30))
    labels = (np.arange(30) % 3).astype(np.int32)
    rows, weight = features(leaves, leaves.centers.mean(axis=0), 2.0), weights(leaves)
    halves = summed(rows, (np.arange(30) % 6).astype(np.int32), 6, weight)
    sums = summed(halves, np.array([0, 1, 2, 0, 1, 2], np.int32), 3)  # merged from two each
    coefficients, normals, _ = fit(sums, 0.0)
    errors = least_error(centered(sums)[2].T)
    for k in range(3):
        mine = labels == k
        places, share = leaves.centers[mine], weight[mine]
        normal = normals[k]
        distance = (places - np.average(places, axis=0, weights=share)) @ normal
        angle = 2.0 * leaves.radii[mine] ** 2 * (1 - (leaves.normals[mine] @ normal) ** 2)
        assert errors[k] == pytest.approx((share * (distance**2 + angle)).sum())
        assert errors[k] == pytest.approx((weight * (rows @ coefficients[k]))[mine].sum())


@given(seed=st.integers(0, 10**6), rank=st.integers(0, 3))
def test_the_least_error_is_the_smallest_eigenvalue(seed: int, rank: int) -> None:
    half = np.random.default_rng(seed).normal(size=(3, rank))
    matrix = half @ half.T
    upper = matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    assert least_error(upper) == pytest.approx(np.linalg.eigvalsh(matrix)[0], abs=1e-7 * max(np.trace(matrix), 1))


def test_one_plane_has_no_level_below_it(caplog: pytest.LogCaptureFixture) -> None:
    leaves = leaves_at([(0, 0, 1), (1, 0, 1), (0, 1, 1)])
    with caplog.at_level(logging.INFO, "treebake"):
        found = hierarchy(leaves, fine(leaves, 1), FEW)
    assert [level.count for level in found.levels] == [1]
    assert found.parents == ()
    assert "there are 1 planes, so the level of 12 is left out" in caplog.text


def test_fewer_leaves_than_billboards() -> None:
    leaves = random_leaves(1, 7)
    found = hierarchy(leaves, fine(leaves), FEW)
    assert [level.count for level in found.levels] == [7, 5, 2]
    assert_nested(found, leaves)


@pytest.mark.parametrize("compactness", [0.0, 0.005])
def test_coplanar_leaves_stay_in_their_plane(compactness: float) -> None:
    tilt = rotation(3)
    places = np.array([(x, y, 2.0) for x in range(10) for y in range(10)])
    leaves = leaves_at(places @ tilt.T, tilt[:, 2])
    found = hierarchy(leaves, fine(leaves), replace(FEW, compactness=compactness))
    assert_nested(found, leaves)
    for level in found.levels:
        assert np.allclose(np.abs(level.normals @ tilt[:, 2]), 1)
        assert np.allclose(level.offsets, 2)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("billboards", (5, 12)),
        ("billboards", (5, 5)),
        ("billboards", (5, 0)),
        ("angle_weight", 0.0),
        ("compactness", -0.1),
    ],
)
def test_setting_out_of_range_is_named(name: str, value: object) -> None:
    leaves = leaves_at([(0, 0, 0), (1, 0, 0)])
    with pytest.raises(SettingsError, match=rf"\[hierarchy\] {name} is .+; it must be"):
        hierarchy(leaves, fine(leaves), replace(FEW, **{name: value}))


def test_same_input_same_bytes() -> None:
    leaves = random_leaves(2, 120)
    one, two = (hierarchy(leaves, fine(leaves), FEW) for _ in range(2))
    for first, second in zip(one.levels, two.levels, strict=True):
        assert first.labels.tobytes() == second.labels.tobytes()
        assert first.normals.tobytes() == second.normals.tobytes()


def test_merging_is_nearly_as_good_as_the_nearest_of_all_planes() -> None:
    # 6 bundles of parallel planes: what belongs together is found again however many planes lie between.
    random = np.random.default_rng(5)
    turns = [rotation(seed)[:, 2] for seed in range(6)]
    places = [turn * (1 + 0.01 * random.normal()) + np.cross(turn, random.normal(size=3)) for turn in turns * 30]
    leaves = leaves_at(places, turns * 30, radius=0.5)
    found = hierarchy(leaves, fine(leaves, 60), HierarchySettings(billboards=(6,)))
    assert [len(set(found.levels[1].labels[bundle::6])) for bundle in range(6)] == [1] * 6
    rows = features(leaves, leaves.centers.mean(axis=0), 2.0)
    planes = fit(summed(rows, found.levels[1].labels, 6), 0.005)[0]
    assert (nearest(rows, planes)[0] == found.levels[1].labels).all()
