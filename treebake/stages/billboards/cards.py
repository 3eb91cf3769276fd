"""Cut the leaves of each plane into cards: tight rectangles, split where that saves texels.

A card is the smallest rectangle, over 12 turns within the plane, around some leaves of one plane. Splitting a card in
two costs two triangles and saves the empty texels between and beside its halves. The best cut of every card is found
for all cards at once, and the cuts that save most are made, until the triangle budget is spent or no cut pays.
"""

from dataclasses import dataclass

import numpy as np

from treebake.flatten import FlatLeaves
from treebake.model import Doubles, Ints

_TURN = 12  # directions in a right angle: a rectangle's turn is a multiple of 7.5 degrees
_WORTHWHILE = 0.1  # a cut must save this share of its card's texels


@dataclass(frozen=True, eq=False)
class Cards:
    """Rectangles on planes. C cards.

    leaf_card: (N,) int32, the card of each leaf. plane: (C,) int32. right: (C, 2) float64, unit, the card's horizontal
    axis in its plane; its vertical axis is that turned left by a right angle. low, high: (C, 2) float64, the corners
    along those axes.
    """

    leaf_card: Ints
    plane: Ints
    right: Doubles
    low: Doubles
    high: Doubles

    @property
    def sizes(self) -> Doubles:
        """(C, 2) float64, width and height."""
        return self.high - self.low


def cut_cards(flat: FlatLeaves, labels: Ints, limit: int, margin: float) -> Cards:
    """Cut the planes' leaves into at most `limit` cards (but one per plane at least).

    labels: (N,) int32, the plane of each leaf. margin: empty border that every card pays for, in the tree's unit.
    O(F + rounds * N log N); rounds is about the logarithm of the cards per plane.
    """
    reach = _reach(flat, len(labels))
    card = np.unique(labels, return_inverse=True)[1].astype(np.int32)
    while (count := int(card.max()) + 1) < limit:
        halves, saved = _best_cuts(reach, card, count, margin)
        chosen = np.flatnonzero(saved > 0)
        if not len(chosen):
            break
        chosen = chosen[np.argsort(-saved[chosen], kind="stable")][: limit - count]
        number = np.full(count, -1, np.int32)
        number[chosen] = count + np.arange(len(chosen))
        card = np.where(halves & (number[card] >= 0), number[card], card)
    return _rectangles(reach, card, labels)


def _reach(flat: FlatLeaves, count: int) -> Doubles:
    """How far each leaf extends in each of 48 directions of its plane: (N, 48)."""
    starts = np.searchsorted(flat.leaf, np.arange(count))
    reach = np.empty((count, 4 * _TURN))
    for step, angle in enumerate(np.arange(4 * _TURN) * (np.pi / 2 / _TURN)):
        along = flat.corners @ np.array([np.cos(angle), np.sin(angle)])
        reach[:, step] = np.maximum.reduceat(along.max(axis=1), starts)
    return reach


def _turned(reach: Doubles, turn: Ints) -> Doubles:
    """Reach to the right, top, left and bottom in each row's own turn: (N, 4)."""
    sides = (turn[:, None] + np.arange(4) * _TURN) % (4 * _TURN)
    return np.take_along_axis(reach, sides, axis=1)


def _area(box: Doubles, margin: float) -> Doubles:
    width = box[..., 0] + box[..., 2] + 2 * margin
    height = box[..., 1] + box[..., 3] + 2 * margin
    return np.asarray(width * height)


def _best_turn(reach: Doubles, margin: float) -> tuple[Ints, Doubles]:
    """The turn of the smallest rectangle around each row's reach, and its area."""
    areas = np.stack([_area(reach[:, turn::_TURN], margin) for turn in range(_TURN)])
    turn = areas.argmin(axis=0)
    return turn.astype(np.int32), areas.min(axis=0)


def _best_cuts(reach: Doubles, card: Ints, count: int, margin: float) -> tuple[np.ndarray, Doubles]:
    """The best straight cut of every card along either axis of its rectangle.

    Returns which leaves lie beyond their card's cut, (N,) bool, and the area that each cut saves, (C,), 0 where none
    is worthwhile.
    """
    by_card = np.argsort(card, kind="stable")
    starts = np.searchsorted(card[by_card], np.arange(count))
    turn, area = _best_turn(np.maximum.reduceat(reach[by_card], starts), margin)
    boxes = _turned(reach, turn[card])
    best = np.full(count, np.inf)
    beyond = np.zeros(len(card), bool)
    for axis in range(2):
        middle = boxes[:, axis] - boxes[:, axis + 2]
        order = np.lexsort((middle, card))
        before = _running_max(boxes[order], card[order])
        after = _running_max(boxes[order][::-1], -card[order][::-1])[::-1]
        after = np.concatenate([after[1:], np.zeros((1, 4))])  # the cut falls after each leaf
        cost = _area(before, margin) + _area(after, margin)
        ends = np.append(starts[1:], len(card)) - 1
        cost[ends] = np.inf  # nothing lies beyond the last leaf
        least = np.minimum.reduceat(cost, starts)
        better = least < best
        position = np.empty(len(card), np.int64)
        position[order] = np.arange(len(card))
        # The first leaf, in this order, whose cut costs least.
        at_least = np.where(cost == least[card[order]], np.arange(len(card)), len(card))
        cut = np.minimum.reduceat(at_least, starts)
        beyond = np.where(better[card], position > cut[card], beyond)
        best = np.minimum(best, least)
    saved = area - best
    return beyond, np.where(saved > _WORTHWHILE * area, saved, 0.0)


def _running_max(boxes: Doubles, card: Ints) -> Doubles:
    """The greatest reach so far within each card; rows are sorted by ascending `card`."""
    # Lifting each card above all before it lets one running maximum serve all cards.
    lift = (card - card[0]).astype(np.float64)[:, None] * (2 * np.abs(boxes).max() + 1)
    return np.asarray(np.maximum.accumulate(boxes + lift, axis=0) - lift)


def _rectangles(reach: Doubles, card: Ints, labels: Ints) -> Cards:
    count = int(card.max()) + 1
    by_card = np.argsort(card, kind="stable")
    first = by_card[np.searchsorted(card[by_card], np.arange(count))]
    card_reach = np.maximum.reduceat(reach[by_card], np.searchsorted(card[by_card], np.arange(count)))
    turn = _best_turn(card_reach, 0.0)[0]
    box = _turned(card_reach, turn)
    # Wide rather than high: shelves of the atlas then waste least.
    upright = box[:, 1] + box[:, 3] > box[:, 0] + box[:, 2]
    turn = np.where(upright, turn + _TURN, turn).astype(np.int32)
    box = _turned(card_reach, turn)
    angle = turn * (np.pi / 2 / _TURN)
    return Cards(
        leaf_card=card,
        plane=labels[first],
        right=np.stack([np.cos(angle), np.sin(angle)], axis=1),
        low=-box[:, 2:],
        high=box[:, :2],
    )
