"""Shape an atlas's alpha so that its box-filtered mips keep the coverage of level 0.

A PNG carries no mips: the viewer makes them, by averaging 2x2 texels, and tests each against one cutoff. A crown of
thin leaves averages below the cutoff and disappears with distance. Only the base level can be shaped, which is enough:
what the test sees of a texel is the *side* of the cutoff, so how far it lies on its side is free. A mip texel is to
pass the test or not as its share of the coverage asks; the averages are then pushed to the right side from the top of
the mip chain down, each texel taking its part of the push within the side where it must stay itself.
"""

import numpy as np
from numpy.typing import NDArray

from treebake.model import Floats

_BLOCK = 4  # texels each way within which coverage is kept exactly (a remainder is dithered)
_MARGIN = 6 / 255  # distance from the cutoff that survives rounding to 8 bits, with room for a sampler's own rounding

# Bayer's 4x4 ordered dither, thresholds in 0..1: spreads the rounding of blocks evenly over the atlas.
_BAYER = (np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) + 0.5) / 16


def preserve_coverage(coverage: Floats, cutoff: float, levels: int) -> Floats:
    """Alpha whose mips 0..levels, averaged 2x2, pass `cutoff` over the area that `coverage` says.

    coverage: (h, w) float32 in 0..1, sides divisible by 2**levels. cutoff: between 0 and 1.
    Returns (h, w) float32 in 0..1. O(h w).
    """
    shares = [coverage]
    for _ in range(levels):
        shares.append(_halve(shares[-1]))
    passes = [_passing(share) for share in shares]
    # Bottom up: what each texel would like, and how far it may go without any texel below changing its side.
    wish: Floats = np.interp(coverage, [0, 0.5, 1], [0, cutoff, 1]).astype(np.float32)
    above, below = np.float32(cutoff + _MARGIN), np.float32(cutoff - _MARGIN)
    least = np.where(passes[0], above, 0).astype(np.float32)
    most = np.where(passes[0], 1, below).astype(np.float32)
    chain = [(np.clip(wish, least, most), least, most)]
    for passing in passes[1:]:
        wish, least, most = (_halve(image) for image in chain[-1])
        # A side that the texels below cannot reach (all opaque, all empty) is given up.
        least = np.where(passing & (most > above), np.maximum(least, above), least)
        most = np.where(~passing & (least < below), np.minimum(most, below), most)
        chain.append((np.clip(wish, least, most), least, most))
    # Top down: hand each texel's value to its four, each by the room it has.
    value = chain[-1][0]
    for wish, least, most in chain[-2::-1]:
        push = _double(value - _halve(wish))
        room = np.where(push > 0, most - wish, wish - least)
        value = wish + push * room / np.maximum(_double(_halve(room)), 1e-12)
        value = np.clip(value, least, most)
    return np.asarray(value, np.float32)


def _passing(share: Floats) -> NDArray[np.bool_]:
    """Which texels pass, so that every block of them passes by as much area as it covers: those that cover most."""
    rows, columns = share.shape
    padded = np.pad(share, ((0, -rows % _BLOCK), (0, -columns % _BLOCK)))
    down, across = padded.shape[0] // _BLOCK, padded.shape[1] // _BLOCK
    blocks = padded.reshape(down, _BLOCK, across, _BLOCK).transpose(0, 2, 1, 3).reshape(down, across, -1)
    dither = np.tile(_BAYER, (-(-down // 4), -(-across // 4)))[:down, :across]
    quota = np.floor(blocks.sum(axis=2) + dither)
    rank = np.argsort(np.argsort(-blocks, axis=2, kind="stable"), axis=2, kind="stable")
    passing = (rank < quota[..., None]) & (blocks > 0)
    passing = passing.reshape(down, across, _BLOCK, _BLOCK).transpose(0, 2, 1, 3).reshape(padded.shape)
    return np.asarray(passing[:rows, :columns])


def _halve(image: Floats) -> Floats:
    rows, columns = image.shape
    return np.asarray(image.reshape(rows // 2, 2, columns // 2, 2).mean(axis=(1, 3)), np.float32)


def _double(image: Floats) -> Floats:
    return image.repeat(2, axis=0).repeat(2, axis=1)
