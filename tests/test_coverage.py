"""Alpha that passes its test over the same area at every mip, as a viewer samples them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.coverage import preserve_coverage
from treebake.model import Doubles, Floats

WITHIN = 0.1  # of the coverage


def halved(image: Doubles) -> Doubles:
    return (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) / 4


def bilinear(image: Doubles, u: Doubles, v: Doubles) -> Doubles:
    """A texture's value where it repeats: u and v in 0..1, texel centres at halves."""
    height, width = image.shape
    x, y = u * width - 0.5, v * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = x - column, y - row
    top, bottom = (
        (1 - fx) * image[r % height, column % width] + fx * image[r % height, (column + 1) % width]
        for r in (row, row + 1)
    )
    return (1 - fy) * top + fy * bottom


def passing(alpha: Floats, lod: float, cutoff: float = 0.5) -> float:
    """The share of the texture that passes the test at a level of detail, trilinear over 8-bit mips."""
    chain = [np.rint(alpha.astype(np.float64) * 255) / 255]
    while len(chain) <= lod + 1:
        chain.append(np.rint(halved(chain[-1]) * 255) / 255)
    u, v = np.random.default_rng(0).random((2, 40_000))
    lower, fraction = int(lod), lod - int(lod)
    near, far = (bilinear(chain[level], u, v) for level in (lower, lower + 1))
    return float(((1 - fraction) * near + fraction * far >= cutoff).mean())


def leaves(seed: int, size: int = 512, count: int = 60, radius: float = 9.0) -> Floats:
    """Small ellipses scattered far apart, with the soft edge of a supersampled bake."""
    coverage = np.zeros((size, size))
    reach = int(radius) + 2
    for cx, cy, turn, stretch in np.random.default_rng(seed).random((count, 4)) * (size, size, np.pi, 3):
        part = tuple(slice(max(int(c) - reach, 0), min(int(c) + reach, size)) for c in (cy, cx))
        dy, dx = np.mgrid[part] + 0.5 - np.array([cy, cx])[:, None, None]
        along, across = dx * np.cos(turn) + dy * np.sin(turn), dy * np.cos(turn) - dx * np.sin(turn)
        inside = radius - np.hypot(along, across * (2 + stretch))
        coverage[part] = np.maximum(coverage[part], np.clip(inside + 0.5, 0, 1))
    return coverage.astype(np.float32)


@pytest.mark.parametrize("shape", [(64, 64), (256, 256), (256, 512)])
@pytest.mark.parametrize("cutoff", [0.1, 0.5, 0.9])
def test_full_stays_full_and_empty_stays_empty(shape: tuple[int, int], cutoff: float) -> None:
    assert not preserve_coverage(np.zeros(shape, np.float32), cutoff).any()
    full = preserve_coverage(np.ones(shape, np.float32), cutoff)
    assert (full >= cutoff + 1 / 255).all()
    assert full.max() <= 1


@pytest.mark.parametrize("lod", [0, 0.5, 1, 1.5, 2])
def test_sparse_leaves_keep_their_area_at_every_shaped_mip(lod: float) -> None:
    coverage = leaves(1)
    shaped = preserve_coverage(coverage, 0.5)
    assert passing(shaped, lod) == pytest.approx(coverage.mean(), rel=WITHIN)


def test_plain_alpha_loses_what_shaped_alpha_keeps() -> None:
    thin = leaves(5, count=200, radius=6.0)  # 3 to 4 texels wide
    shaped = preserve_coverage(thin, 0.5)
    plain, kept = ([passing(alpha, lod) / thin.mean() for lod in (1.5, 2)] for alpha in (thin, shaped))
    assert plain[0] < 0.75
    assert plain[1] < 0.45
    assert kept == pytest.approx([1, 1], rel=WITHIN)


def test_small_leaves_still_cover_far_away() -> None:
    # 16 times smaller than the atlas, a leaf is a texel wide: plain alpha has nothing left.
    small = leaves(8, count=400)
    shaped = preserve_coverage(small, 0.5)
    assert passing(small, 4) < 0.1 * small.mean()
    assert passing(shaped, 3) == pytest.approx(small.mean(), rel=WITHIN)
    assert passing(shaped, 4) == pytest.approx(small.mean(), rel=3 * WITHIN)


@pytest.mark.parametrize("gain", [0.8, 1.25])
def test_gain_asks_for_more_or_less_area(gain: float) -> None:
    coverage = leaves(5, count=200, radius=6.0)
    shaped = preserve_coverage(coverage, 0.5, lambda alpha: float((alpha >= 0.5).mean() / coverage.mean()) / gain)
    for lod in (1, 2, 3):
        assert passing(shaped, lod) == pytest.approx(gain * coverage.mean(), rel=1.5 * WITHIN), f"lod {lod}"


@pytest.mark.parametrize(("width", "within"), [(1, 0.2), (2, 0.35), (3, 0.2), (8, 0.05), (16, 0.05), (32, 0.05)])
def test_stripes_keep_half_of_the_area(width: int, within: float) -> None:
    # Narrow ones are the hardest case: all texels of a mip tie, so that plain alpha passes everywhere or nowhere.
    stripes = np.tile(((np.arange(512) // width) % 2).astype(np.float32), (512, 1))
    shaped = preserve_coverage(stripes, 0.5)
    for lod in (0, 0.5, 1, 1.5, 2):
        assert passing(shaped, lod) == pytest.approx(0.5, rel=within), f"lod {lod}"


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10**6), radius=st.floats(7, 16), cutoff=st.sampled_from([0.3, 0.5, 0.7]))
def test_area_is_kept_whatever_the_leaves(seed: int, radius: float, cutoff: float) -> None:
    coverage = leaves(seed, size=256, count=30, radius=radius)
    shaped = preserve_coverage(coverage, cutoff)
    assert shaped.dtype == np.float32
    assert shaped.min() >= 0
    assert shaped.max() <= 1
    for lod in (0, 0.5, 1):
        assert passing(shaped, lod, cutoff) == pytest.approx(coverage.mean(), rel=2 * WITHIN), f"lod {lod}"


def test_the_base_level_keeps_its_shape() -> None:
    # Shaping moves the edge by a texel at most: deep inside passes, far outside does not.
    coverage = leaves(3, count=20, radius=20.0)
    alpha = preserve_coverage(coverage, 0.5)
    near = np.lib.stride_tricks.sliding_window_view(np.pad(coverage, 3, mode="edge"), (7, 7))
    assert (alpha[near.min(axis=(2, 3)) == 1] >= 0.5).all()
    assert (alpha[near.max(axis=(2, 3)) == 0] < 0.5).all()


def test_the_coverage_is_not_changed_in_place() -> None:
    coverage = leaves(4, size=256)
    coverage.flags.writeable = False
    assert preserve_coverage(coverage, 0.5).tobytes() == preserve_coverage(coverage, 0.5).tobytes()
