"""The hash and lists textures against twins that ask, cell by cell, what a list should hold."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from treebake.errors import BudgetError
from treebake.model import Doubles
from treebake.stages.indirect import lists
from treebake.stages.indirect.lists import LIST_BITS, Footprints, in_rows, list_leaves

seeds = st.integers(0, 2**32 - 1)
SIZES = np.array([(4, 3), (2, 5), (3, 3)], np.int32)
ORIGINS = np.array([(0, 0), (4, 0), (0, 3)], np.int32)
ATLAS = (6, 6)
FLAT = ((0.4, 0.0), (0.0, 0.4), (0.0, 0.0))  # half the edges of a square leaf that faces the viewer


def footprints(
    middles: object, edges: object = FLAT, *, billboard: object | None = None, depths: object | None = None
) -> Footprints:
    """Leaves of the first billboard one behind the other, unless told otherwise; edges: one leaf's, or one each."""
    points = np.array(middles, np.float64).reshape(-1, 2)
    count = len(points)
    boards = np.zeros(count, np.int32) if billboard is None else np.array(billboard, np.int32)
    made = Footprints(
        billboard=boards,
        number=(np.arange(count) - np.searchsorted(boards, boards)).astype(np.int32),
        middles=points,
        edges=np.broadcast_to(np.array(edges, np.float64), (count, 3, 2)).copy(),
        depths=np.arange(count, dtype=np.float64) if depths is None else np.array(depths, np.float64),
    )
    for array in vars(made).values():
        array.flags.writeable = False
    return made


def random_footprints(seed: int, count: int = 12) -> Footprints:
    """Boxes turned anyhow, on three billboards, at few different depths; some of them stick out of their grid."""
    random = np.random.default_rng(seed)
    board = np.sort(random.integers(0, len(SIZES), count))
    turned = np.linalg.qr(random.normal(size=(count, 3, 3)))[0] * random.uniform(0.05, 1.2, (count, 3, 1))
    return footprints(
        random.uniform(0, 1, (count, 2)) * SIZES[board],
        turned[:, :, :2],
        billboard=board,
        depths=random.integers(0, 4, count),
    )


def excess(middle: Doubles, edges: Doubles, low: Doubles, high: Doubles) -> float:
    """By how much a rectangle must grow until it meets a box seen from above; below 0 where it does already.

    The box is every middle + t @ edges with t in -1..1: a linear program in t and the growth.
    """
    grow = -np.ones((2, 1))
    above, below = np.hstack([edges.T, grow]), np.hstack([-edges.T, grow])
    limits = np.concatenate([high - middle, middle - low])
    bounds = [(-1, 1)] * 3 + [(None, None)]
    return float(linprog([0, 0, 0, 1], np.vstack([above, below]), limits, bounds=bounds).fun)


def wanted(leaves: Footprints, board: int, cell: tuple[int, int]) -> tuple[list[int], list[int]]:
    """The leaves that a cell's list must hold, in order, and those so near its border that either answer is right."""
    found, unsure = [], []
    for leaf in np.flatnonzero(leaves.billboard == board):
        low = np.array(cell, np.float64)
        away = excess(leaves.middles[leaf], leaves.edges[leaf], low, low + 1)
        if away <= 0:
            found.append(leaf)
        if abs(away) < 1e-6:
            unsure.append(int(leaves.number[leaf]))
    found.sort(key=lambda leaf: (leaves.depths[leaf], leaves.number[leaf]))
    return [int(leaves.number[leaf]) for leaf in found], unsure


def read(leaves: Footprints, *, single: bool = False) -> dict[tuple[int, int, int], list[int]]:
    """Billboard, column and row -> the list of that cell."""
    hashes, table = list_leaves(leaves, SIZES, ORIGINS, ATLAS, single=single)
    assert hashes.shape == ATLAS
    assert hashes.dtype == np.uint32
    assert table.dtype == np.uint16
    entries = table.reshape(-1)
    result = {}
    for board, ((columns, rows), (x, y)) in enumerate(zip(SIZES.tolist(), ORIGINS.tolist(), strict=True)):
        for column, row in product(range(columns), range(rows)):
            texel = int(hashes[y + row, x + column])
            first, count = texel >> LIST_BITS, texel & (1 << LIST_BITS) - 1
            result[board, column, row] = entries[first : first + count].tolist()
    return result


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_a_leaf_is_listed_in_the_cells_that_it_meets_front_to_back(seed: int) -> None:
    leaves = random_footprints(seed)
    for (board, column, row), found in read(leaves).items():
        expected, unsure = wanted(leaves, board, (column, row))
        assert [n for n in found if n not in unsure] == [n for n in expected if n not in unsure]


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_a_single_leaf_is_the_front_one_at_the_cells_centre(seed: int) -> None:
    leaves = random_footprints(seed)
    for (board, column, row), found in read(leaves, single=True).items():
        centre = np.array([column, row]) + 0.5
        covers = [
            leaf
            for leaf in np.flatnonzero(leaves.billboard == board)
            if excess(leaves.middles[leaf], leaves.edges[leaf], centre, centre) <= 0
        ]
        covers.sort(key=lambda leaf: (leaves.depths[leaf], leaf))
        assert found == leaves.number[covers[:1]].tolist()


def test_a_leaf_within_a_cell_is_listed_there_only() -> None:
    assert {cell: found for cell, found in read(footprints([(2.5, 1.5)])).items() if found} == {(0, 2, 1): [0]}


def test_a_turned_leaf_leaves_out_the_corners_of_its_bounding_box() -> None:
    diamond = ((0.7, 0.7), (-0.7, 0.7), (0.0, 0.0))
    found = {cell[1:] for cell, found in read(footprints([(1.5, 1.5)], diamond)).items() if found}
    assert found == {(column, row) for column in range(3) for row in range(3)}
    small = ((0.45, 0.45), (-0.45, 0.45), (0.0, 0.0))
    found = {cell[1:] for cell, found in read(footprints([(1.5, 1.5)], small)).items() if found}
    assert found == {(1, 1), (0, 1), (2, 1), (1, 0), (1, 2)}


def test_a_leaf_seen_edge_on_is_listed_along_its_line() -> None:
    line = ((1.2, 0.0), (0.0, 0.0), (0.0, 0.0))
    found = {cell[1:] for cell, found in read(footprints([(1.5, 1.5)], line)).items() if found}
    assert found == {(0, 1), (1, 1), (2, 1)}


def test_a_single_leaf_seen_edge_on_ends_where_it_ends() -> None:
    line = ((0.6, 0.0), (0.3, 0.0), (0.0, 0.0))  # up to 0.9 away; the centres of the next cells are 1 away
    found = {cell[1:] for cell, found in read(footprints([(1.5, 1.5)], line), single=True).items() if found}
    assert found == {(1, 1)}


def test_the_thickness_of_a_leaf_counts_as_well() -> None:
    thick = ((0.0, 0.3), (0.0, 0.0), (1.2, 0.0))
    found = {cell[1:] for cell, found in read(footprints([(1.5, 1.5)], thick)).items() if found}
    assert found == {(0, 1), (1, 1), (2, 1)}


def test_lists_run_front_to_back_and_equal_depths_by_number() -> None:
    leaves = footprints([(0.5, 0.5)] * 5, depths=(3, 1, 2, 1, 0))
    assert read(leaves)[0, 0, 0] == [4, 1, 3, 2, 0]


def test_only_the_order_of_depths_matters() -> None:
    leaves = random_footprints(5)
    assert read(leaves) == read(replace(leaves, depths=leaves.depths * 10 + 3))


@pytest.mark.parametrize("single", [False, True])
def test_cells_without_a_leaf_are_zero(single: bool) -> None:
    hashes, _ = list_leaves(footprints([(2.5, 1.5)]), SIZES, ORIGINS, ATLAS, single=single)
    assert np.argwhere(hashes).tolist() == [[1, 2]]


def test_a_footprint_is_clipped_to_its_own_grid() -> None:
    huge = ((9.0, 0.0), (0.0, 9.0), (0.0, 0.0))
    leaves = footprints([(1.0, 2.0)], huge, billboard=[1])
    assert {cell[0] for cell, found in read(leaves).items() if found} == {1}
    assert sum(map(bool, read(leaves).values())) == np.prod(SIZES[1])


def test_a_leaf_on_the_far_border_of_the_grid_is_listed() -> None:
    point = np.zeros((3, 2))
    assert read(footprints([(4.0, 3.0)], point))[0, 3, 2] == [0]


def test_leaves_are_numbered_within_their_billboard() -> None:
    leaves = footprints([(0.5, 0.5), (1.5, 0.5), (0.5, 0.5), (0.5, 1.5)], billboard=[0, 0, 1, 1])
    found = {cell: found for cell, found in read(leaves).items() if found}
    assert found == {(0, 0, 0): [0], (0, 1, 0): [1], (1, 0, 0): [0], (1, 0, 1): [1]}


def test_equal_lists_are_stored_once_across_billboards() -> None:
    leaves = footprints([(0.5, 0.5), (0.5, 0.5)] * 3, billboard=[0, 0, 1, 1, 2, 2])
    hashes, table = list_leaves(leaves, SIZES, ORIGINS, ATLAS, single=False)
    assert len(np.unique(hashes[hashes > 0])) == 1
    assert (hashes > 0).sum() == 3
    assert table.reshape(-1)[:2].tolist() == [0, 1]
    assert not table.reshape(-1)[2:].any()


def test_lists_of_other_leaves_or_another_order_are_stored_apart() -> None:
    leaves = footprints([(0.5, 0.5)] * 4, billboard=[0, 0, 1, 1], depths=(0, 1, 1, 0))
    hashes, table = list_leaves(leaves, SIZES, ORIGINS, ATLAS, single=False)
    assert len(np.unique(hashes[hashes > 0])) == 2
    assert sorted(table.reshape(-1)[:4].tolist()) == [0, 0, 1, 1]


def test_no_leaf_gives_empty_cells() -> None:
    hashes, table = list_leaves(footprints(np.zeros((0, 2))), SIZES, ORIGINS, ATLAS, single=False)
    assert not hashes.any()
    assert not table.any()


# ---- what is refused -----------------------------------------------------------------------------------------------


def test_too_many_leaves_in_a_billboard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "_LEAVES", 3)
    leaves = footprints([(0.5, 0.5)] * 6, billboard=[0, 0, 0, 1, 1, 1])
    list_leaves(leaves, SIZES, ORIGINS, ATLAS, single=False)
    with pytest.raises(BudgetError, match=r"need 4 leaves in one billboard and can hold 3; raise \[indirect_cluster\]"):
        list_leaves(footprints([(0.5, 0.5)] * 4), SIZES, ORIGINS, ATLAS, single=False)


def test_too_many_leaves_in_a_list(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "LIST_BITS", 2)
    list_leaves(footprints([(0.5, 0.5)] * 3), SIZES, ORIGINS, ATLAS, single=False)
    with pytest.raises(BudgetError, match=r"need 4 leaves in one list and can hold 3; lower \[indirect\] cell"):
        list_leaves(footprints([(0.5, 0.5)] * 4), SIZES, ORIGINS, ATLAS, single=False)


def test_too_many_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "LIST_BITS", 30)
    places = [(column + 0.5, row + 0.5) for row in range(3) for column in range(4)]
    list_leaves(footprints(places[:4]), SIZES, ORIGINS, ATLAS, single=False)
    with pytest.raises(BudgetError, match=r"need 5 entries in the lists and can hold 4; raise \[indirect\] cell"):
        list_leaves(footprints(places[:5]), SIZES, ORIGINS, ATLAS, single=False)


def test_equal_lists_count_once_against_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "LIST_BITS", 30)
    all_over = ((9.0, 0.0), (0.0, 9.0), (0.0, 0.0))
    list_leaves(footprints([(1.0, 1.0)] * 4, all_over), SIZES, ORIGINS, ATLAS, single=False)


def test_a_single_leaf_a_cell_is_within_every_limit_of_a_list(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lists, "LIST_BITS", 1)
    list_leaves(footprints([(0.5, 0.5)] * 9), SIZES, ORIGINS, ATLAS, single=True)


# ---- tables addressed by a number ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("count", "rows"), [(0, 1), (1, 1), (1024, 1), (1025, 2), (4096, 4)])
def test_a_number_lies_in_its_row_and_column(count: int, rows: int) -> None:
    table = in_rows(np.arange(count, dtype=np.uint32) + 1)
    assert table.shape == (rows, 1024)
    assert table.dtype == np.uint32
    for number in {0, 1023, 1024, count - 1} & set(range(count)):
        assert table[number >> 10, number & 1023] == number + 1
    assert (table > 0).sum() == count


def test_a_number_may_have_several_values() -> None:
    values = np.arange(1030 * 4, dtype=np.uint8).reshape(-1, 4)
    table = in_rows(values)
    assert table.shape == (2, 1024, 4)
    np.testing.assert_array_equal(table[1, 5], values[1029])
