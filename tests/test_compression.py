"""What block compression keeps: checked by what each format can hold, not by another encoder."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from treebake.compression import block_bytes, compressed_mips, through_bc3, through_bc4
from treebake.images import mip_chain
from treebake.model import Bytes, Texture

FIVE_SIX_FIVE = np.array([31, 63, 31])
HALF_STEP = 255 / 31 / 2  # of five bits
SQUARE = (4, 4)


def kept(color: object) -> Bytes:
    """A colour at 5, 6 and 5 bits."""
    return np.rint(np.rint(np.asarray(color) / 255 * FIVE_SIX_FIVE) / FIVE_SIX_FIVE * 255).astype(np.uint8)


def block(*texels: object) -> Bytes:
    """4 x 4 texels that repeat these."""
    return np.resize(np.array(texels, np.uint8), (4, 4, 4))


def noise(size: tuple[int, int], channels: int = 4, seed: int = 0) -> Bytes:
    return np.random.default_rng(seed).integers(0, 256, (*size, channels), np.uint8)


# ---- constant and two-valued blocks --------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0, 1, 127, 200, 255])
def test_a_constant_block_survives_bc4(value: int) -> None:
    assert (through_bc4(np.full((4, 4, 2), value, np.uint8)) == value).all()


@settings(max_examples=40, deadline=None)
@given(st.tuples(*[st.integers(0, 255)] * 4))
def test_a_constant_block_survives_bc3_as_565(texel: tuple[int, int, int, int]) -> None:
    found = through_bc3(block(texel))
    assert (found[..., :3] == kept(texel[:3])).all()
    assert (found[..., 3] == texel[3]).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 255), st.integers(0, 255), arrays(np.bool_, (4, 4, 1)))
def test_a_block_of_two_values_survives_bc4(one: int, other: int, which: np.ndarray) -> None:
    pixels = np.where(which, one, other).astype(np.uint8)
    assert (through_bc4(pixels) == pixels).all()


@pytest.mark.parametrize("pair", [((0, 0, 0), (255, 255, 255)), ((200, 30, 10), (20, 120, 240)), ((9, 99, 9),) * 2])
def test_a_block_of_two_colours_survives_bc3_as_565(pair: tuple[tuple[int, int, int], ...]) -> None:
    pixels = block(*((*color, alpha) for color, alpha in zip(pair, (0, 255), strict=True)))
    found = through_bc3(pixels)
    assert (found[..., :3] == kept(pixels[..., :3])).all()
    assert (found[..., 3] == pixels[..., 3]).all()


# ---- bounds --------------------------------------------------------------------------------------------------------


@settings(max_examples=80, deadline=None)
@given(arrays(np.uint8, (4, 4, 3)))
def test_bc4_is_off_by_a_fourteenth_of_the_blocks_range_at_most(pixels: Bytes) -> None:
    error = np.abs(through_bc4(pixels).astype(float) - pixels)
    span = np.ptp(pixels.astype(float), axis=(0, 1))
    assert (error <= span / 14 + 0.5 + 1e-3).all()


@settings(max_examples=80, deadline=None)
@given(arrays(np.uint8, (4, 4, 4)))
def test_a_block_has_no_more_values_than_its_format_can_tell_apart(pixels: Bytes) -> None:
    found = through_bc3(pixels)
    assert len(np.unique(found[..., :3].reshape(-1, 3), axis=0)) <= 4
    assert len(np.unique(found[..., 3])) <= 8


@settings(max_examples=80, deadline=None)
@given(
    ends=st.tuples(*[st.tuples(*[st.integers(0, 255)] * 3)] * 2),
    shares=st.lists(st.floats(0, 1), min_size=14, max_size=14),
)
def test_colours_on_a_line_are_off_by_a_sixth_of_it_at_most(
    ends: tuple[tuple[int, int, int], ...], shares: list[float]
) -> None:
    low, high = np.array(ends, float)
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[..., :3] = np.rint(low + np.array([0, 1, *shares])[:, None] * (high - low)).reshape(4, 4, 3)
    error = np.linalg.norm(through_bc3(pixels)[..., :3].astype(float) - pixels[..., :3], axis=2)
    rounding = np.sqrt(3) * (HALF_STEP + 1)  # of the ends to 565, and of the texels
    assert error.max() <= (np.linalg.norm(high - low) + 2 * rounding) / 6 + rounding


def test_channels_of_bc4_are_apart() -> None:
    pixels = noise(SQUARE, 2)
    alone = [through_bc4(pixels[..., channel : channel + 1]) for channel in range(2)]
    assert (through_bc4(pixels) == np.concatenate(alone, axis=2)).all()


def test_bc3_has_alpha_as_bc4_and_colour_apart_from_it() -> None:
    pixels = noise((8, 8))
    clear = pixels.copy()
    clear[..., 3] = 0
    assert (through_bc3(pixels)[..., 3:] == through_bc4(pixels[..., 3:])).all()
    assert (through_bc3(pixels)[..., :3] == through_bc3(clear)[..., :3]).all()


# ---- blocks in an image --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("through", [through_bc3, through_bc4])
def test_blocks_are_apart(through: object) -> None:
    assert callable(through)
    pixels = noise((8, 12))
    other = pixels.copy()
    other[4:, 4:8] = 0
    changed = (through(pixels) != through(other)).any(axis=2)
    assert changed[4:, 4:8].any()
    changed[4:, 4:8] = False
    assert not changed.any()


def test_a_blocks_texels_are_its_own() -> None:
    # Every block has a value of its own, so a block that ends up elsewhere shows.
    values = np.arange(6, dtype=np.uint8).reshape(2, 3) * 40
    pixels = np.kron(values, np.ones(SQUARE, np.uint8))[..., None]
    assert (through_bc4(pixels) == pixels).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 3), (6, 9), (4, 5)])
@pytest.mark.parametrize("through", [through_bc3, through_bc4])
def test_other_sizes_are_filled_up_with_their_last_row_and_column(size: tuple[int, int], through: object) -> None:
    assert callable(through)
    pixels = noise(size)
    height, width = size
    full = pixels[np.minimum(np.arange(-(-height // 4) * 4), height - 1)]
    full = full[:, np.minimum(np.arange(-(-width // 4) * 4), width - 1)]
    found = through(pixels)
    assert found.shape == pixels.shape
    assert found.dtype == np.uint8
    assert (found == through(full)[:height, :width]).all()


def test_the_input_is_left_alone() -> None:
    pixels = noise((5, 5))
    before = pixels.copy()
    through_bc3(pixels)
    through_bc4(pixels)
    assert (pixels == before).all()


@pytest.mark.parametrize(("srgb", "through"), [(True, through_bc3), (False, through_bc4)])
def test_every_mip_is_compressed_by_itself(srgb: bool, through: object) -> None:
    assert callable(through)
    texture = Texture("leaf", noise((8, 5)))
    chain = mip_chain(texture.pixels, srgb=srgb)
    found = compressed_mips(texture, srgb=srgb)
    assert [mip.shape for mip in found] == [(8, 5, 4), (4, 2, 4), (2, 1, 4), (1, 1, 4)]
    for mip, plain in zip(found, chain, strict=True):
        assert (mip == through(plain)).all()


# ---- bytes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("width", "height", "blocks"),
    [
        (1, 1, 1),
        (4, 4, 1 + 1 + 1),
        (8, 4, 2 + 1 + 1 + 1),
        (4, 8, 2 + 1 + 1 + 1),
        (5, 9, 2 * 3 + 1 + 1 + 1),  # 5 x 9, 2 x 4, 1 x 2, 1 x 1
        (16, 16, 16 + 4 + 1 + 1 + 1),
        (64, 1, 16 + 8 + 4 + 2 + 1 + 1 + 1),
    ],
)
def test_block_bytes_count_every_mips_blocks(width: int, height: int, blocks: int) -> None:
    assert block_bytes(width, height, 8) == 8 * blocks
    assert block_bytes(width, height, 16) == 16 * blocks
