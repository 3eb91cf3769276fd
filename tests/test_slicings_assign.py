"""Which slice a primitive goes to ([J00] 2.2): the nearest, by its centroid."""

from dataclasses import replace

import numpy as np
import pytest
from foliage import leaf_tree
from hypothesis import assume, given
from hypothesis import strategies as st

from treebake.geometry import turn_to
from treebake.model import Doubles, Tree
from treebake.stages.slicings.assign import Slicing, assign

FRONT = turn_to(0.0, 0.0)
ORIGIN = np.zeros(3)
depths = st.lists(st.floats(-2.0, 2.0, width=32), min_size=1, max_size=12)


def at_depths(*depths: float, size: float = 0.01) -> Tree:
    """Upright leaves that face +Z, one at each depth."""
    return leaf_tree([(0.1 * i, 0.0, z) for i, z in enumerate(depths)], size=size)


def sliced(tree: Tree, count: int, turn: Doubles = FRONT, center: Doubles = ORIGIN) -> Slicing:
    return assign(tree.foliage, tree.leaves, center, turn, count)


def moved(tree: Tree, slicing: Slicing, spacing: float) -> float:
    """Area times squared distance that leaves are moved, were the slices `spacing` apart."""
    count = len(slicing.offsets)
    planes = (np.arange(count) - (count - 1) / 2) * spacing
    along = tree.leaves.centers @ slicing.turn[2]
    return float((tree.leaves.areas * ((along[:, None] - planes) ** 2).min(axis=1)).sum())


# ---- the nearest ---------------------------------------------------------------------------------------------------


@given(depths, st.integers(1, 7))
def test_every_leaf_is_on_the_nearest_slice(depths: list[float], count: int) -> None:
    slicing = sliced(at_depths(*depths), count)
    off = np.abs(np.array(depths)[:, None] - slicing.offsets)
    chosen = np.take_along_axis(off, slicing.slice[:, None], axis=1)[:, 0]
    np.testing.assert_allclose(chosen, off.min(axis=1), atol=1e-6)


@given(depths, st.integers(1, 7))
def test_within_the_box_no_leaf_is_off_by_more_than_half_the_spacing(depths: list[float], count: int) -> None:
    slicing = sliced(at_depths(*depths), count)
    off = np.abs(np.array(depths) - slicing.offsets[slicing.slice])
    within = np.abs(depths) <= slicing.offsets[-1] + slicing.spacing / 2
    assert (2 * off <= slicing.spacing + 1e-6)[within].all()


def test_what_lies_beyond_the_ends_goes_to_the_last_slice() -> None:
    # The heavy middle draws the slices together, and leaves the two ends outside the box.
    tree = at_depths(*np.linspace(-0.3, 0.3, 61), -1.0, 1.0)
    slicing = sliced(tree, 3)
    assert slicing.offsets[-1] + slicing.spacing / 2 < 1
    assert slicing.slice[-2:].tolist() == [0, 2]


def test_slices_are_given_from_the_furthest_to_the_nearest() -> None:
    slicing = sliced(at_depths(-1.0, 0.0, 1.0), 3)
    assert slicing.slice.tolist() == [0, 1, 2]
    assert slicing.offsets.tolist() == sorted(slicing.offsets)
    np.testing.assert_allclose(np.diff(slicing.offsets), slicing.spacing)


@pytest.mark.parametrize(("azimuth", "slices"), [(0, [0, 2]), (180, [2, 0])])
def test_depth_is_along_the_way_to_the_viewer(azimuth: float, slices: list[int]) -> None:
    tree = leaf_tree([(0, 0, -1), (0, 0, 1)], size=0.01)
    assert sliced(tree, 3, turn_to(0.0, azimuth)).slice.tolist() == slices


def test_depth_from_above_is_height() -> None:
    tree = leaf_tree([(0, -1, 5), (0, 1, -5)], (0, 1, 0), size=0.01)
    assert sliced(tree, 2, turn_to(90.0, 0.0)).slice.tolist() == [0, 1]


# ---- where the slices stand ----------------------------------------------------------------------------------------


@given(depths, st.integers(1, 7))
def test_slices_stand_symmetrically_about_the_center(depths: list[float], count: int) -> None:
    slicing = sliced(at_depths(*depths), count)
    np.testing.assert_allclose(slicing.offsets, -slicing.offsets[::-1], atol=1e-12)


def test_the_center_is_shared_and_not_the_origin() -> None:
    tree = at_depths(-1.0, 0.0, 1.0)
    center = np.array([3.0, -2.0, 5.0])
    moved_tree = at_depths(4.0, 5.0, 6.0)
    here, there = sliced(tree, 3), sliced(moved_tree, 3, center=center)
    np.testing.assert_allclose(here.offsets, there.offsets)
    assert here.slice.tolist() == there.slice.tolist()


@given(depths, st.integers(1, 7))
def test_no_other_spacing_moves_less_area(depths: list[float], count: int) -> None:
    tree = at_depths(*depths)
    slicing = sliced(tree, count)
    leaf = 2 * float(tree.leaves.radii.max())
    assume(2 * np.abs(depths).max() >= 0.4 * leaf)  # else there is nothing to slice
    even = 2 * np.abs(depths).max() / count
    others = [moved(tree, slicing, share * even) for share in np.geomspace(0.4, 1, 25)]
    least = moved(tree, slicing, slicing.spacing)
    assert least <= 1.05 * min(others) + 1e-3 * float(tree.leaves.areas.sum()) * even**2


@pytest.mark.parametrize(("ends", "inner", "spacing"), [(100.0, 1.0, 2 / 3), (1.0, 100.0, 0.5)])
def test_large_leaves_weigh_more_than_small_ones(ends: float, inner: float, spacing: float) -> None:
    # Three slices: at -1/2, 0 and 1/2 they meet the inner leaves, and 2/3 is as far out as they go.
    tree = at_depths(-1.0, 1.0, -0.5, 0.5)
    leaves = replace(tree.leaves, areas=np.array([ends, ends, inner, inner]))
    assert assign(tree.foliage, leaves, ORIGIN, FRONT, 3).spacing == pytest.approx(spacing, abs=0.01)


# ---- large primitives, and what is between slices ------------------------------------------------------------------


def test_large_are_those_that_reach_farther_than_the_spacing() -> None:
    # Leaves on edge: their sides of 0.2 and 2.0 lie along the way to the viewer.
    small, long = (leaf_tree([(0, 0, -1), (0, 0, 1)], (1, 0, 0), size=size) for size in (0.2, 2.0))
    assert not sliced(small, 3).large.any()
    assert sliced(long, 3).large.all()
    flat = leaf_tree([(0, 0, -1), (0, 0, 1)], size=2.0)
    assert not sliced(flat, 3).large.any()


def test_a_leaf_as_long_as_the_spacing_is_not_large() -> None:
    tree = leaf_tree([(0, 0, -1), (0, 0, 0), (0, 0, 1)], (1, 0, 0), size=0.5)
    spacing = sliced(tree, 2).spacing
    for factor, large in ((0.999, False), (1.001, True)):
        scaled = replace(tree.foliage, positions=tree.foliage.positions.copy())
        along = scaled.positions[:, 2] - tree.leaves.centers[:, 2].repeat(4)
        scaled.positions[:, 2] += along * (factor * spacing / 0.5 - 1)
        assert (assign(scaled, tree.leaves, ORIGIN, FRONT, 2).large == large).all()


@given(depths, st.integers(1, 7), st.floats(-10, 10))
def test_slabs_part_all_of_space(depths: list[float], count: int, somewhere: float) -> None:
    slicing = sliced(at_depths(*depths), count)
    slabs = [slicing.slab(index) for index in range(count)]
    assert (slabs[0][0], slabs[-1][1]) == (-np.inf, np.inf)
    assert [end for _, end in slabs[:-1]] == [start for start, _ in slabs[1:]]
    (index,) = (i for i, (start, end) in enumerate(slabs) if start <= somewhere < end)
    off = np.abs(somewhere - slicing.offsets)
    assert off[index] == pytest.approx(off.min(), abs=1e-9)


# ---- degenerate ----------------------------------------------------------------------------------------------------


def test_one_slice_takes_everything_at_the_center() -> None:
    slicing = sliced(at_depths(-1.0, 0.2, 1.0), 1)
    assert slicing.offsets.tolist() == [0.0]
    assert slicing.slice.tolist() == [0, 0, 0]
    assert slicing.slab(0) == (-np.inf, np.inf)


@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.parametrize("depths", [(0.0,), (0.0, 0.0, 0.0)], ids=["a single leaf", "all in one plane"])
def test_no_depth_at_all(depths: tuple[float, ...], count: int) -> None:
    slicing = sliced(at_depths(*depths), count)
    assert slicing.spacing > 0
    assert np.isfinite(slicing.offsets).all()
    assert len(set(slicing.slice.tolist())) == 1
    assert not slicing.large.any()


def test_all_in_one_plane_away_from_the_center() -> None:
    slicing = sliced(at_depths(1.0, 1.0), 4)
    assert slicing.slice[0] == slicing.slice[1]
    assert slicing.offsets[slicing.slice[0]] == pytest.approx(0.75, abs=0.02)  # half a spacing off, as far as allowed


@pytest.mark.parametrize("azimuth", [60.0, 90.0, 120.0])
def test_no_depth_but_by_rounding(azimuth: float) -> None:
    # A hedge one leaf thick, seen straight from before it.
    turn = turn_to(0.0, azimuth)
    tree = leaf_tree([[x, y] @ turn[:2] for x in (-1.1, 0.3, 1.7) for y in (0.2, 1.3)], turn[2], size=0.2)
    slicing = sliced(tree, 3, turn)
    assert not slicing.large.any()
    assert len(set(slicing.slice.tolist())) == 1
