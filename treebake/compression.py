"""What block compression leaves of an image and what it costs, so that quality and size are those of what engines keep.

Images are encoded and decoded again: BC3, BC4 and BC5 in numpy (endpoints on the principal axis of each block's
colours, then the nearest level). PyPI's encoder was tried first: etcpak 0.9.15 crashes when it decodes, and its output
depends on the processor's instructions.
"""

from functools import lru_cache

import numpy as np

from treebake.images import mip_chain
from treebake.model import Bytes, Floats, Texture

_FIVE_SIX_FIVE = np.array([31, 63, 31], np.float32)


@lru_cache(maxsize=12)  # a few atlases: the same pictures are drawn at several heights
def compressed_mips(texture: Texture, *, srgb: bool) -> list[Bytes]:
    """A texture's mips as compression leaves them: with srgb as a colour map (BC3), else each channel alone (BC4)."""
    through = through_bc3 if srgb else through_bc4
    return [through(mip) for mip in mip_chain(texture.pixels, srgb=srgb)]


def through_bc3(pixels: Bytes) -> Bytes:
    """Colour and alpha (h, w, 4) uint8 as BC3 keeps them, 1 byte a texel."""
    return np.dstack([_colors(pixels[..., :3]), through_bc4(pixels[..., 3:])])


def through_bc4(pixels: Bytes) -> Bytes:
    """Channels (h, w, n) uint8 as BC4 keeps each alone (two of them are BC5), half a byte a texel and channel."""
    blocks = _blocks(pixels)
    low, high = blocks.min(axis=1, keepdims=True), blocks.max(axis=1, keepdims=True)
    step = np.maximum(high - low, 1) / 7
    return _image(low + np.rint((blocks - low) / step) * step, pixels.shape)


def block_bytes(width: int, height: int, block: int, mips: int | None = None) -> int:
    """Bytes of an image with its mips, at `block` bytes per 4 x 4 texels: 16 for BC3 and BC5, 8 for BC1 and BC4.

    mips: how many below the first; all by default.
    """
    total, level = 0, 0
    while True:
        total += -(-width // 4) * -(-height // 4) * block
        if max(width, height) == 1 or level == mips:
            return total
        level += 1
        width, height = max(width // 2, 1), max(height // 2, 1)


def _colors(pixels: Bytes) -> Bytes:
    """BC1's part: two RGB 565 colours a block, and two thirds between them."""
    blocks = _blocks(pixels)
    mean = blocks.mean(axis=1, keepdims=True)
    away = blocks - mean
    axis = np.linalg.eigh(np.einsum("bti,btj->bij", away, away))[1][:, :, 2]
    along = np.einsum("bti,bi->bt", away, axis)
    ends = [mean[:, 0] + extreme[:, None] * axis for extreme in (along.min(axis=1), along.max(axis=1))]
    low, high = (np.rint(np.clip(end, 0, 255) / 255 * _FIVE_SIX_FIVE) / _FIVE_SIX_FIVE * 255 for end in ends)
    span = high - low
    share = np.einsum("bti,bi->bt", blocks - low[:, None], span)
    share /= np.maximum((span**2).sum(axis=1), 1e-6)[:, None]
    level = np.rint(np.clip(share, 0, 1) * 3) / 3
    return _image(low[:, None] + level[..., None] * span[:, None], pixels.shape)


def _blocks(pixels: Bytes) -> Floats:
    """(blocks, 16, channels) of an image whose sides are filled up to multiples of 4 with its last rows and columns."""
    height, width, channels = pixels.shape
    padded = np.pad(pixels, ((0, -height % 4), (0, -width % 4), (0, 0)), mode="edge").astype(np.float32)
    tiles = padded.reshape(padded.shape[0] // 4, 4, padded.shape[1] // 4, 4, channels)
    return tiles.transpose(0, 2, 1, 3, 4).reshape(-1, 16, channels)


def _image(blocks: Floats, shape: tuple[int, ...]) -> Bytes:
    height, width, channels = shape
    tiles = blocks.reshape(-(-height // 4), -(-width // 4), 4, 4, channels).transpose(0, 2, 1, 3, 4)
    image = tiles.reshape(-(-height // 4) * 4, -(-width // 4) * 4, channels)
    return np.rint(np.clip(image[:height, :width], 0, 255)).astype(np.uint8)
