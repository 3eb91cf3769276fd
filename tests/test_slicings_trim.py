"""Cutting the empty parts off a slice: a few rectangles hold all that it shows."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from treebake.pictures import trimmed
from treebake.stages.slicings.trim import trim


def scattered(shape: tuple[int, int], cells: list[tuple[float, float]]) -> np.ndarray:
    """A few texels in a large picture."""
    used = np.zeros(shape, bool)
    for y, x in cells:
        used[int(y * shape[0]), int(x * shape[1])] = True
    return used


pictures = arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=12)) | st.builds(
    scattered,
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.lists(st.tuples(st.floats(0, 0.999), st.floats(0, 0.999)), max_size=6),
)


def area(rectangles: np.ndarray, gutter: int) -> int:
    """Texels of an atlas that rectangles take up."""
    return sum(int((r - l + 2 * gutter) * (b - t + 2 * gutter)) for l, t, r, b in rectangles if r > l)  # noqa: E741


def times_held(shape: tuple[int, int], rectangles: np.ndarray) -> np.ndarray:
    held = np.zeros(shape, int)
    for left, top, right, bottom in rectangles:
        held[top:bottom, left:right] += 1
    return held


# ---- properties ----------------------------------------------------------------------------------------------------


@given(pictures, st.integers(1, 5), st.integers(0, 4))
def test_every_texel_in_use_is_in_exactly_one_rectangle(used: np.ndarray, count: int, gutter: int) -> None:
    found = trim(used, count, gutter)
    held = times_held(used.shape, found)
    assert (held[used] == 1).all()
    assert held.max(initial=0) <= 1  # and none overlap where nothing is either
    assert (found >= 0).all()
    assert (found[:, 2] <= used.shape[1]).all()
    assert (found[:, 3] <= used.shape[0]).all()


@given(pictures, st.integers(1, 5), st.integers(0, 4))
def test_rectangles_fit_tightly_and_empty_ones_are_zero(used: np.ndarray, count: int, gutter: int) -> None:
    found = trim(used, count, gutter)
    assert found.shape == (count, 4)
    assert found.dtype == np.int32
    for left, top, right, bottom in found:
        if right > left:
            assert trimmed(used[top:bottom, left:right]) == (0, 0, right - left, bottom - top)
        else:
            assert (left, top, right, bottom) == (0, 0, 0, 0)
    full = found[:, 2] > found[:, 0]
    assert (np.diff(full.astype(int)) <= 0).all()  # the empty ones come last


@given(pictures, st.integers(1, 5), st.integers(0, 4))
def test_more_rectangles_never_take_more_texels(used: np.ndarray, count: int, gutter: int) -> None:
    fewer, more = (area(trim(used, n, gutter), gutter) for n in (count, count + 1))
    assert more <= fewer <= area(np.array([trimmed(used)]), gutter)


@given(pictures, st.integers(0, 4))
def test_the_one_cut_is_the_best_of_all_straight_cuts(used: np.ndarray, gutter: int) -> None:
    left, top, right, bottom = whole = trimmed(used)
    tries = [area(np.array([whole]), gutter)]
    for x in range(left + 1, right):
        parts = (
            np.where(np.arange(used.shape[1]) < x, used, False),
            np.where(np.arange(used.shape[1]) >= x, used, False),
        )
        tries.append(area(np.array([trimmed(part) for part in parts]), gutter))
    for y in range(top + 1, bottom):
        upper = np.arange(used.shape[0])[:, None] < y
        tries.append(area(np.array([trimmed(used & upper), trimmed(used & ~upper)]), gutter))
    assert area(trim(used, 2, gutter), gutter) == min(tries)


# ---- by hand -------------------------------------------------------------------------------------------------------


def test_nothing_in_use_is_all_zero() -> None:
    assert (trim(np.zeros((5, 7), bool), 3, 1) == 0).all()


@pytest.mark.parametrize("count", [1, 3])
def test_a_single_texel(count: int) -> None:
    used = np.zeros((5, 7), bool)
    used[2, 3] = True
    assert trim(used, count, 4).tolist() == [[3, 2, 4, 3], *[[0] * 4] * (count - 1)]


def test_what_is_full_is_not_cut() -> None:
    assert trim(np.ones((6, 6), bool), 4, 0).tolist() == [[0, 0, 6, 6], *[[0] * 4] * 3]


@pytest.mark.parametrize("turn", range(4))
def test_an_l_is_cut_where_that_saves_most(turn: int) -> None:
    # A stem of 2 x 12 on a foot of 10 x 4: cut level with the foot's top, 62 texels of 160 are left.
    used = np.zeros((16, 10), bool)
    used[:, :2] = used[12:] = True
    found = trim(np.rot90(used, turn), 2, 0)
    assert area(found, 0) == 2 * 12 + 10 * 4 == used.sum()


def test_a_cut_that_its_gutters_would_eat_up_is_not_made() -> None:
    used = np.zeros((3, 9), bool)
    used[:, :4] = used[:, 5:] = True  # a gap of a column
    assert area(trim(used, 2, 0), 0) == 24
    assert trim(used, 2, 1).tolist() == [[0, 0, 9, 3], [0, 0, 0, 0]]


def test_cuts_go_on_where_most_is_to_be_saved() -> None:
    # Three blobs in a row: the wide gap is cut first, the narrow one next.
    used = np.zeros((2, 40), bool)
    used[:, :2] = used[:, 8:10] = used[:, 38:] = True
    assert sorted(trim(used, 2, 0)[:, [0, 2]].tolist()) == [[0, 10], [38, 40]]
    assert sorted(trim(used, 3, 0)[:, [0, 2]].tolist()) == [[0, 2], [8, 10], [38, 40]]
