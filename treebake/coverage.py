"""Shape an atlas's alpha so that the mips a viewer makes of it keep the coverage of level 0.

A PNG carries no mips: the viewer makes them, by averaging 2x2 texels, and tests each against one cutoff. A crown of
thin leaves averages below the cutoff and disappears with distance. Only the base level can be shaped, which is enough:
the test sees the *side* of the cutoff on which a texel lies, so how far it lies on its side is free.

Every level is told which of its texels are to pass: in each block those that the leaves cover most, as many as the
block's coverage asks for. Values are then pushed to the right sides from the top of the mip chain down, each texel
taking its part of the push within the side where it must stay itself. Viewers interpolate between texels, which grows
or shrinks what passes; so the area is measured as a viewer would see it, and the quotas are corrected by what it lacks.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from treebake.model import Doubles, Floats

LOG = logging.getLogger("treebake")

_BLOCK = 4  # texels each way within which coverage is kept (remainders are dithered)
_STEP = 0.03  # mean distance from the cutoff that a block's texels aim for; more leaves less room for other levels
_MARGIN = 2 / 255  # distance from the cutoff that survives rounding to 8 bits, here and in every mip
_ROUNDS = 6  # corrections of the quotas; the area is then right within a few per cent at every level
_DAMPING = 0.8  # of a correction: levels pull at each other, and full steps swing
_FITS = 3  # pictures that are looked at
_TOLERANCE = 0.05  # of the picture's area: beyond it something else is wrong, and is told
_GAINS = (0.8, 1.25)  # of the covered area: a fit beyond these would hide that something else is wrong
_LAST_SIDE = 16  # texels on the shorter side of the last level that is shaped

# Bayer's 4x4 ordered dither, thresholds in 0..1: spreads the rounding of blocks evenly over the atlas.
_BAYER = (np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) + 0.5) / 16


def preserve_coverage(coverage: Floats, cutoff: float, drawn: Callable[[Floats], float] | None = None) -> Floats:
    """Alpha that passes `cutoff` over the same area at every mip, averaged 2x2 and interpolated linearly.

    coverage: (h, w) float32 in 0..1, sides powers of two. cutoff: between 0 and 1. drawn: tells what share of the
    wanted picture a viewer fills with such an alpha; the area is then grown or shrunk until that is 1. Returns
    (h, w) float32 in 0..1. O(h w).
    """
    total = float(coverage.mean())
    if not total:
        return coverage
    levels = [_Level.of(coverage)]
    while min(levels[-1].share.shape) > _LAST_SIDE:
        levels.append(_Level.of(_halve(levels[-1].share)))
    quotas = np.ones(len(levels))
    for _ in range(_ROUNDS):
        alpha = _shape(levels, quotas, cutoff)
        quotas *= _correction(alpha, cutoff, total, len(levels))
    return _shape(levels, quotas, cutoff) if drawn is None else _fitted(levels, quotas, cutoff, total, drawn)


def _fitted(
    levels: list["_Level"], quotas: Doubles, cutoff: float, total: float, drawn: Callable[[Floats], float]
) -> Floats:
    """The alpha whose picture comes nearest to the wanted area; quotas go on moving, so the best one seen is kept."""
    gain, best, least_error = 1.0, np.zeros(0, np.float32), np.inf
    for _ in range(_FITS):
        alpha = _shape(levels, quotas, cutoff)
        share = drawn(alpha)
        if abs(share - 1) < least_error:
            best, least_error = alpha, abs(share - 1)
        gain = float(np.clip(gain / max(share, 1e-9), *_GAINS))
        quotas = quotas * _correction(alpha, cutoff, gain * total, len(levels))
    if least_error > _TOLERANCE:
        LOG.warning(
            "the cards cover %.0f %% too much or too little of the picture; look at the report, and if leaves are "
            "single-sided make them doubleSided in the source",
            100 * least_error,
        )
    return best


def _correction(alpha: Floats, cutoff: float, total: float, levels: int) -> Doubles:
    """What to multiply the quotas with, for every level to pass over `total`."""
    lacking = total / np.maximum(_areas(alpha, cutoff, levels), 1e-9)
    return np.asarray(np.clip(lacking, 0.5, 2) ** _DAMPING)


@dataclass(frozen=True, eq=False)
class _Level:
    """One mip level of the coverage. share: (h, w). ranked: (blocks down, blocks across, 16), greatest share first."""

    share: Floats
    ranked: Floats

    @classmethod
    def of(cls, share: Floats) -> "_Level":
        rows, columns = share.shape
        padded = np.pad(share, ((0, -rows % _BLOCK), (0, -columns % _BLOCK)))
        down, across = padded.shape[0] // _BLOCK, padded.shape[1] // _BLOCK
        blocks = padded.reshape(down, _BLOCK, across, _BLOCK).transpose(0, 2, 1, 3).reshape(down, across, -1)
        return cls(share, -np.sort(-blocks, axis=2))

    def wish(self, quota: float, cutoff: float) -> Floats:
        """What each texel would like to be: as far above or below the cutoff as its share is off its block's limit.

        The limit lies between the share of the last texel that fits the block's quota and that of the next.
        """
        down, across, size = self.ranked.shape
        dither = np.tile(_BAYER, (-(-down // 4), -(-across // 4)))[:down, :across]
        count = np.clip(np.floor(self.ranked.sum(axis=2) * quota + dither), 0, size).astype(np.int64)
        fence = np.concatenate([self.ranked[..., :1] + 0.02, self.ranked, self.ranked[..., -1:] - 0.02], axis=2)
        limit = np.take_along_axis(fence, count[..., None], axis=2) + np.take_along_axis(fence, count[..., None] + 1, 2)
        limit /= 2
        spread = np.abs(self.ranked - limit).mean(axis=2, keepdims=True)
        gain = _STEP / np.maximum(spread, 1e-4)
        empty, full = self.ranked[..., :1] == 0, self.ranked[..., -1:] == 1  # nothing to choose: 0 and 1
        limit[empty | full] = 0
        gain[empty], gain[full] = 0, 1
        rows, columns = self.share.shape
        limit, gain = (x[..., 0].repeat(_BLOCK, axis=0).repeat(_BLOCK, axis=1)[:rows, :columns] for x in (limit, gain))
        wish = cutoff + np.clip((self.share - limit) * gain, -cutoff, 1 - cutoff)
        return np.where(gain > 0, wish, 0).astype(np.float32)


def _shape(levels: list[_Level], quotas: Doubles, cutoff: float) -> Floats:
    """The base alpha whose mips lie on the sides that the levels wish."""
    above, below = np.float32(cutoff + _MARGIN), np.float32(cutoff - _MARGIN)
    # Bottom up: what each texel would like, and how far it may go without any texel below changing its side.
    passing = levels[0].wish(quotas[0], cutoff) >= cutoff
    least = np.where(passing, above, 0).astype(np.float32)
    most = np.where(passing, 1, below).astype(np.float32)
    edge = np.interp(levels[0].share, [0, 0.5, 1], [0, cutoff, 1]).astype(np.float32)
    chain = [(np.clip(edge, least, most), least, most)]
    for level, quota in zip(levels[1:], quotas[1:], strict=True):
        wish = level.wish(quota, cutoff)
        least, most = _halve(least), _halve(most)
        # A side that the texels below cannot reach (all opaque, all empty) is given up.
        least = np.where((wish >= cutoff) & (most > above), np.maximum(least, above), least)
        most = np.where((wish < cutoff) & (least < below), np.minimum(most, below), most)
        chain.append((np.clip(wish, least, most), least, most))
    # Top down: hand each texel's value to its four, each by the room it has.
    value = chain[-1][0]
    for wish, least, most in chain[-2::-1]:
        push = _double(value - _halve(wish))
        room = np.where(push > 0, most - wish, wish - least)
        value = np.clip(wish + push * room / np.maximum(_double(_halve(room)), 1e-12), least, most)
    return np.asarray(value, np.float32)


def _areas(alpha: Floats, cutoff: float, levels: int) -> Doubles:
    """The share of each mip level's area that passes, sampled at four points a texel with linear interpolation."""
    areas = []
    for _ in range(levels):
        rows = [0.75 * alpha + 0.25 * np.roll(alpha, step, axis=0) for step in (-1, 1)]
        points = [0.75 * row + 0.25 * np.roll(row, step, axis=1) for row in rows for step in (-1, 1)]
        areas.append(np.mean([(point >= cutoff).mean() for point in points]))
        alpha = _halve(alpha)
    return np.array(areas)


def _halve(image: Floats) -> Floats:
    rows, columns = image.shape
    quarters = image.reshape(rows // 2, 2, columns // 2, 2)
    return (quarters[:, 0, :, 0] + quarters[:, 1, :, 0] + quarters[:, 0, :, 1] + quarters[:, 1, :, 1]) / np.float32(4)


def _double(image: Floats) -> Floats:
    return image.repeat(2, axis=0).repeat(2, axis=1)
