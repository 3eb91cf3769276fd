"""The atlas: cards side by side, none on another."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.errors import BudgetError
from treebake.model import Doubles, Ints
from treebake.packing import pack, pack_cells, texel_sizes

ENOUGH = 100.0  # texels per unit


def assert_packed(sizes: Doubles, limit: int, density_limit: float, padding: int) -> tuple[float, tuple[int, int]]:
    """Pack, check everything that must hold of any packing, and return the density and the atlas's size."""
    origins, density, (width, height) = pack(sizes, limit, density_limit, padding)
    assert 0 < density <= density_limit
    for side in (width, height):
        assert side & (side - 1) == 0
        assert side <= limit
    taken = np.zeros((height, width), np.int32)
    for (x, y), (w, h) in zip(origins, texel_sizes(sizes, density), strict=True):
        assert padding <= x <= width - padding - w
        assert padding <= y <= height - padding - h
        taken[y - padding : y + h + padding, x - padding : x + w + padding] += 1
    assert taken.max() == 1  # no card within another's padding
    return density, (width, height)


def test_one_card() -> None:
    assert assert_packed(np.array([[0.5, 0.25]]), 2048, ENOUGH, 2) == (ENOUGH, (64, 32))


@pytest.mark.parametrize(("count", "size"), [(1, (64, 32)), (2, (64, 64)), (3, (128, 64)), (60, (512, 256))])
def test_small_sets_get_small_atlases(count: int, size: tuple[int, int]) -> None:
    assert assert_packed(np.tile([0.4, 0.3], (count, 1)), 2048, ENOUGH, 1) == (ENOUGH, size)


def test_what_does_not_fit_loses_density_until_it_does() -> None:
    sizes = np.random.default_rng(1).uniform(0.5, 5, (40, 2))
    density, size = assert_packed(sizes, 256, ENOUGH, 2)
    assert size == (256, 256)
    assert density < ENOUGH
    with pytest.raises(AssertionError):  # a little more does not fit: the limit is what holds it back
        assert pack(sizes, 256, density * 1.01, 2)[1] == pytest.approx(density * 1.01)


@pytest.mark.parametrize("enough", [1e6, 1e12, 1e30])
def test_as_sharp_as_the_atlas_allows(enough: float) -> None:
    # A user who wants all the atlas has to give names a density beyond any: neither overflow nor a coarse search.
    sizes = np.array([[1.0, 0.5], [2.0, 0.7]])
    assert assert_packed(sizes, 128, enough, 1)[0] == pytest.approx(assert_packed(sizes, 128, 1000.0, 1)[0], rel=1e-4)


def test_many_cards_may_shrink_to_a_texel_each() -> None:
    density, size = assert_packed(np.full((441, 2), 0.5), 64, 100.0, 1)
    assert size == (64, 64)
    assert density <= 2  # 21 x 21 cells of one texel and its padding fill the atlas


def test_too_many_cards_name_the_settings() -> None:
    with pytest.raises(BudgetError) as error:
        pack(np.full((442, 2), 0.5), 64, 100.0, 1)
    assert str(error.value) == (
        "442 cards do not fit into an atlas of 64 x 64 texels; "
        "raise [textures] atlas, or lower [textures] triangles or [cluster] billboards"
    )


def test_padding_alone_can_be_too_much() -> None:
    with pytest.raises(BudgetError):
        pack(np.array([[0.5, 0.5]]), 64, 100.0, 32)


def test_a_long_thin_card() -> None:
    assert_packed(np.array([[1000.0, 0.001]]), 256, ENOUGH, 2)


@settings(deadline=None, max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    count=st.integers(1, 50),
    limit=st.sampled_from([64, 128, 512]),
    padding=st.integers(1, 3),
    scale=st.sampled_from([1e-3, 1.0, 1e4]),
)
def test_packing_keeps_its_promises(seed: int, count: int, limit: int, padding: int, scale: float) -> None:
    sizes = scale * np.random.default_rng(seed).lognormal(0, 1, (count, 2))
    assert_packed(sizes, limit, 50.0 / scale, padding)


# ---- cells ---------------------------------------------------------------------------------------------------------


def cells(*sizes: tuple[int, int]) -> Ints:
    return np.array(sizes, np.int32)


@settings(deadline=None, max_examples=100)
@given(
    sizes=st.lists(st.tuples(st.integers(1, 20), st.integers(1, 20)), min_size=1, max_size=40),
    limit=st.sampled_from([16, 32, 64, 128]),
)
def test_cells_are_packed_apart_and_inside(sizes: list[tuple[int, int]], limit: int) -> None:
    packed = pack_cells(cells(*sizes), limit)
    area = sum(w * h for w, h in sizes)
    if packed is None:
        # Shelves waste less than half and a last row, so only what is nearly full or too long may be refused.
        assert max(max(size) for size in sizes) > limit or 2 * area > limit * (limit - 20)
        return
    origins, (width, height) = packed
    assert width & (width - 1) == 0
    assert max(width, height) <= limit
    taken = np.zeros((height, width), np.int32)
    for (x, y), (w, h) in zip(origins.tolist(), sizes, strict=True):
        assert x >= 0
        assert y >= 0
        assert x + w <= width
        assert y + h <= height
        taken[y : y + h, x : x + w] += 1
    assert taken.max() == 1
    assert taken.sum() == area
    assert taken[-1].any()  # no empty row below


@pytest.mark.parametrize(
    ("sizes", "size"),
    [
        (cells((1, 1)), (1, 1)),
        (cells((3, 5)), (4, 5)),  # the width is a power of two, the height is not
        (cells((3, 5), (1, 5)), (4, 5)),
        (cells((4, 4), (4, 4), (4, 4)), (4, 12)),  # all of it used; a square would have a hole
        (cells((16, 1), (1, 1)), (16, 2)),
        (cells(*[(3, 1)] * 5), (16, 1)),  # 4 x 5 and 8 x 3 would do, and leave more empty
    ],
)
def test_cells_get_the_smallest_atlas(sizes: Ints, size: tuple[int, int]) -> None:
    packed = pack_cells(sizes, 16)
    assert packed is not None
    assert packed[1] == size


@pytest.mark.parametrize("sizes", [cells((17, 1)), cells((1, 17)), cells(*[(16, 1)] * 17), cells((9, 9), (9, 9))])
def test_cells_that_do_not_fit_are_told_apart(sizes: Ints) -> None:
    assert pack_cells(sizes, 16) is None


def test_cells_may_fill_the_limit() -> None:
    packed = pack_cells(cells(*[(4, 4)] * 16), 16)
    assert packed is not None
    assert packed[1][0] * packed[1][1] == 256
    assert len(set(map(tuple, packed[0].tolist()))) == 16


def test_cells_are_left_alone() -> None:
    sizes = cells((3, 1), (1, 2))
    pack_cells(sizes, 16)
    assert sizes.tolist() == [[3, 1], [1, 2]]
