"""Cards: rectangles that hold their leaves, cut where that saves texels."""

import numpy as np
import pytest
from foliage import leaf_tree, planes, random_leaves
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.flatten import FlatLeaves, flatten
from treebake.model import Doubles
from treebake.stages.billboards.cards import Cards, cut_cards

SIZE = 0.2


def laid(centers: object, labels: object = None, size: float = SIZE) -> FlatLeaves:
    """Upright square leaves on planes z = 0, which differ in name only."""
    tree = leaf_tree(centers, size=size)
    plane = np.zeros(tree.leaves.count, int) if labels is None else np.array(labels)
    count = int(plane.max()) + 1
    return flatten(tree.foliage, tree.leaves, planes(plane, [(0, 0, 1)] * count, [0] * count))


def cut(centers: object, limit: int, labels: object = None, margin: float = 0.01) -> Cards:
    flat = laid(centers, labels)
    plane = np.zeros(int(flat.leaf.max()) + 1, np.int32) if labels is None else np.array(labels, np.int32)
    return cut_cards(flat, plane, limit, margin)


def overhang(flat: FlatLeaves, cards: Cards) -> float:
    """How far any corner of a leaf reaches out of its card."""
    card = cards.leaf_card[flat.leaf]
    right = cards.right[card]
    up = np.stack([-right[:, 1], right[:, 0]], axis=1)
    along = np.stack([np.einsum("mki,mi->mk", flat.corners, axis) for axis in (right, up)], axis=-1)
    out = np.maximum(cards.low[card][:, None] - along, along - cards.high[card][:, None])
    return float(out.max())


def area(cards: Cards) -> float:
    return float(cards.sizes.prod(axis=1).sum())


def row(start: float, count: int = 3) -> list[tuple[float, float, float]]:
    return [(start + SIZE * i, 0.0, 0.0) for i in range(count)]


def test_one_leaf_gets_one_tight_card() -> None:
    cards = cut([(1.0, 2.0, 0.0)], limit=100)
    assert cards.leaf_card.tolist() == [0]
    assert cards.plane.tolist() == [0]
    assert np.allclose(cards.sizes, SIZE)
    assert overhang(laid([(1.0, 2.0, 0.0)]), cards) < 1e-12


def test_two_far_islands_are_cut_apart_when_the_limit_allows() -> None:
    islands = row(0.0) + row(10.0)
    one, two = cut(islands, limit=1), cut(islands, limit=2)
    assert len(one.plane) == 1
    assert np.allclose(one.sizes, [(10 + 3 * SIZE, SIZE)])
    assert len(two.plane) == 2
    assert np.allclose(two.sizes, [(3 * SIZE, SIZE)] * 2)
    assert len(set(two.leaf_card[:3])) == len(set(two.leaf_card[3:])) == 1


def test_islands_above_each_other_are_cut_too() -> None:
    cards = cut([(0, 0, 0), (0, 10, 0), (SIZE, 0, 0), (SIZE, 10, 0)], limit=2)
    assert len(cards.plane) == 2
    assert cards.leaf_card[0] == cards.leaf_card[2] != cards.leaf_card[1] == cards.leaf_card[3]


def test_what_is_full_is_not_cut() -> None:
    assert len(cut(row(0.0, 8), limit=100).plane) == 1


def test_a_wide_margin_makes_a_cut_too_dear() -> None:
    level = row(0.0) + row(1.0)
    for islands in (level, [(0.0, x, 0.0) for x, _, _ in level]):
        assert len(cut(islands, limit=100, margin=0.001).plane) == 2
        assert len(cut(islands, limit=100, margin=1.0).plane) == 1


def test_the_cuts_that_save_most_come_first() -> None:
    near, far = row(0.0) + row(2.0), row(0.0) + row(30.0)
    cards = cut(near + far, limit=3, labels=[0] * 6 + [1] * 6)
    assert sorted(cards.plane.tolist()) == [0, 1, 1]


def test_a_slanted_row_gets_a_slanted_card() -> None:
    places = [(SIZE * i * np.cos(np.pi / 6), SIZE * i * np.sin(np.pi / 6), 0.0) for i in range(20)]
    cards = cut(places, limit=1)
    slope = np.degrees(np.arctan2(*cards.right[0, ::-1])) % 180
    assert slope == pytest.approx(30)
    assert cards.sizes[0, 0] > 10 * cards.sizes[0, 1]  # wide rather than high


def test_an_upright_row_lies_in_the_atlas() -> None:
    cards = cut([(0.0, SIZE * i, 0.0) for i in range(5)], limit=1)
    assert np.allclose(cards.sizes, [(5 * SIZE, SIZE)])
    assert np.allclose(np.abs(cards.right), [(0, 1)])


@pytest.mark.parametrize("limit", [0, 1, 2, 5])
def test_every_plane_has_a_card_whatever_the_limit(limit: int) -> None:
    places = [(x, 0.0, 0.0) for x in range(12)]
    cards = cut(places, limit=limit, labels=[0, 1, 2] * 4)
    assert len(cards.plane) == max(limit, 3)
    assert set(cards.plane.tolist()) == {0, 1, 2}


def test_identical_leaves_stay_together() -> None:
    assert len(cut([(0.0, 0.0, 0.0)] * 6, limit=100).plane) == 1


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 40), plane_count=st.integers(1, 4), limit=st.integers(1, 30))
def test_cards_hold_their_leaves(seed: int, count: int, plane_count: int, limit: int) -> None:
    leaves = random_leaves(seed, count)
    labels = np.sort(np.arange(count) % plane_count).astype(np.int32)  # every plane up to the last has a leaf
    tree = leaf_tree(leaves.centers, leaves.normals, size=SIZE)
    used = int(labels.max()) + 1
    faced = random_leaves(seed + 1, used).normals
    flat = flatten(tree.foliage, tree.leaves, planes(labels, faced, np.zeros(used)))
    cards = cut_cards(flat, labels, limit, 0.01)
    assert overhang(flat, cards) < 1e-9
    assert used <= len(cards.plane) <= max(limit, used)
    assert set(cards.leaf_card.tolist()) == set(range(len(cards.plane)))
    assert (cards.plane[cards.leaf_card] == labels).all()
    assert np.allclose(np.linalg.norm(cards.right, axis=1), 1)
    assert (cards.sizes > 0).all()
    assert area(cards) <= area(cut_cards(flat, labels, used, 0.01)) * (1 + 1e-9)  # cutting only ever saves


def corners_of(flat: FlatLeaves) -> Doubles:
    return flat.corners.reshape(-1, 2)


def test_a_card_touches_its_outermost_leaves() -> None:
    flat = laid([(0.0, 0.0, 0.0), (1.0, 0.5, 0.0), (2.0, 0.1, 0.0)])
    cards = cut_cards(flat, np.zeros(3, np.int32), 1, 0.0)
    right = cards.right[0]
    along = corners_of(flat) @ np.stack([right, (-right[1], right[0])], axis=1)
    assert np.allclose([along.min(axis=0), along.max(axis=0)], [cards.low[0], cards.high[0]])
