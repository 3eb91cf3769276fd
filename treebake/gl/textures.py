"""Puts tables and images on the graphics card; images go through block compression, as an engine would keep them."""

from typing import Any

import moderngl
import numpy as np

from treebake.compression import compressed_mips
from treebake.errors import GraphicsError
from treebake.model import PictureAtlas, Texture

_SRGB8_ALPHA8 = 0x8C43

WHITE = Texture("white", np.full((1, 1, 4), 255, np.uint8))  # in place of a map that there is not


def upload_plain(gl: moderngl.Context, texture: Texture | None, *, srgb: bool) -> moderngl.Texture:
    """A material's image as it is, without mips; a white texel where there is none."""
    pixels = np.full((1, 1, 4), 255, np.uint8) if texture is None else texture.pixels
    options = {"internal_format": _SRGB8_ALPHA8} if srgb else {}
    made = gl.texture((pixels.shape[1], pixels.shape[0]), 4, np.ascontiguousarray(pixels), **options)
    made.filter = moderngl.LINEAR, moderngl.LINEAR
    return made


def upload_table(gl: moderngl.Context, values: Any, dtype: str, hint: str) -> moderngl.Texture:
    """A table (h, w, channels) as an unfiltered texture. hint: what to do where it is too large for the driver."""
    height, width, channels = values.shape
    _check(gl, width, height, hint)
    table = gl.texture((width, height), channels, np.ascontiguousarray(values), dtype=dtype, alignment=1)
    table.filter = moderngl.NEAREST, moderngl.NEAREST
    return table


def upload_compressed(
    gl: moderngl.Context, texture: Texture, hint: str, *, srgb: bool, mips: int | None = None
) -> moderngl.Texture:
    """An image with the mips that block compression leaves of it, filtered trilinearly, clamped at its edges.

    mips: how many below the first one; all by default.
    """
    levels = compressed_mips(texture, srgb=srgb)[: None if mips is None else mips + 1]
    height, width = levels[0].shape[:2]
    _check(gl, width, height, hint)
    options = {"internal_format": _SRGB8_ALPHA8} if srgb else {}
    image = gl.texture((width, height), 4, np.ascontiguousarray(levels[0]), **options)
    image.build_mipmaps(0, len(levels) - 1)
    for level, pixels in enumerate(levels):
        image.write(np.ascontiguousarray(pixels), level=level)
    image.filter = moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR
    image.repeat_x = image.repeat_y = False
    return image


def upload_atlas(gl: moderngl.Context, atlas: PictureAtlas, hint: str) -> dict[str, moderngl.Texture]:
    """The images that pictures are looked up in, by the names of their samplers."""
    half = max(atlas.mips - 1, 0)
    eighth = max(atlas.mips - 3, 0)
    return {
        "coverage": upload_compressed(gl, atlas.coverage, hint, srgb=False, mips=atlas.mips),
        "albedo": upload_compressed(gl, atlas.albedo, hint, srgb=True, mips=half),
        "relief": upload_compressed(gl, atlas.relief, hint, srgb=False, mips=half),
        "occlusion": upload_compressed(gl, atlas.occlusion, hint, srgb=False, mips=eighth),
    }


def _check(gl: moderngl.Context, width: int, height: int, hint: str) -> None:
    limit = gl.info["GL_MAX_TEXTURE_SIZE"]
    if max(width, height) > limit:
        raise GraphicsError(f"a texture of {width} x {height} texels is needed, this OpenGL takes {limit}; {hint}")
