"""Draws billboards of multi-layered indirect textures from their published tables, one box each ([GPSS07] 5)."""

from typing import Any

import moderngl
import numpy as np

from treebake.compression import through_bc3, through_bc4
from treebake.gl.context import program
from treebake.gl.view import View, column_major
from treebake.images import to_linear, to_srgb
from treebake.model import Bytes, IndirectTextures, Texture

_SRGB8_ALPHA8 = 0x8C43
_CORNERS = 36  # vertices of a box

# Width of a hash cell on screen in pixels: nothing is looked up at the first, everything from the second on.
FADE = (0.75, 1.5)


class IndirectBillboards:
    """The tables on the graphics card; the images go through block compression, as an engine would keep them."""

    def __init__(self, gl: moderngl.Context, textures: IndirectTextures) -> None:
        self._gl, self._program = gl, program("indirect")
        self.count = len(textures.billboards)
        self._largest = textures.largest
        tables = {
            "billboards": (textures.billboards.reshape(self.count, -1, 4), "f4"),
            "shapes": (textures.shapes.reshape(len(textures.shapes), -1, 4), "f4"),
            "hash_texture": (textures.hash_texture[..., None], "u4"),
            "lists_texture": (textures.lists_texture[..., None], "u2"),
            "placements": (textures.placements, "u4"),
        }
        self._textures = {name: self._table(*table) for name, table in tables.items()}
        self._textures["leaf_color"] = self._image(_color_mips(textures.leaf_color), srgb=True)
        self._textures["leaf_normal"] = self._image(_normal_mips(textures.leaf_normal), srgb=False)
        self._textures["far_color"] = self._image(_color_mips(textures.far_color), srgb=True)
        self._textures["far_normal"] = self._image(_normal_mips(textures.far_normal), srgb=False)
        self._array = gl.vertex_array(self._program, [])

    def draw(self, view: View) -> None:
        """Draw all billboards into the framebuffer in use; depth is tested and written."""
        gl, shader = self._gl, self._program
        for unit, (name, texture) in enumerate(self._textures.items()):
            texture.use(unit)
            if name in shader:
                shader[name] = unit
        shader["largest"] = self._largest
        shader["to_clip"] = column_major(view.to_clip)
        shader["from_clip"] = column_major(np.linalg.inv(view.to_clip))
        shader["window"] = (view.size, view.size)
        if "fade" in shader:
            shader["fade"] = FADE
        gl.disable(gl.BLEND)
        gl.enable(gl.CULL_FACE)
        gl.cull_face = "front"  # a viewer inside a box sees its far sides only
        self._array.render(moderngl.TRIANGLES, vertices=_CORNERS * self.count)
        gl.cull_face = "back"

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()
        self._array.release()

    def _table(self, values: Any, dtype: str) -> moderngl.Texture:
        height, width, channels = values.shape
        table = self._gl.texture((width, height), channels, np.ascontiguousarray(values), dtype=dtype, alignment=1)
        table.filter = moderngl.NEAREST, moderngl.NEAREST
        return table

    def _image(self, mips: list[Bytes], *, srgb: bool) -> moderngl.Texture:
        height, width = mips[0].shape[:2]
        options = {"internal_format": _SRGB8_ALPHA8} if srgb else {}
        image = self._gl.texture((width, height), 4, np.ascontiguousarray(mips[0]), **options)
        image.build_mipmaps(0, len(mips) - 1)
        for level, pixels in enumerate(mips):
            image.write(np.ascontiguousarray(pixels), level=level)
        image.filter = moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR
        image.repeat_x = image.repeat_y = False
        return image


def _color_mips(texture: Texture) -> list[Bytes]:
    """BC3 mips, averaged in linear light."""
    mips = [texture.pixels]
    light = np.dstack([to_linear(texture.pixels[..., :3]), texture.pixels[..., 3] / 255]).astype(np.float32)
    while min(light.shape[:2]) > 1:
        light = _halved(light)
        mips.append(np.dstack([to_srgb(light[..., :3]), np.rint(light[..., 3] * 255).astype(np.uint8)]))
    return [through_bc3(mip) for mip in mips]


def _normal_mips(texture: Texture) -> list[Bytes]:
    """BC5 mips of RG, BC4 mips of B."""
    mips = [texture.pixels.astype(np.float32)]
    while min(mips[-1].shape[:2]) > 1:
        mips.append(_halved(mips[-1]))
    return [np.dstack([through_bc4(np.rint(mip[..., :3]).astype(np.uint8)), mip[..., 3].astype(np.uint8)]) for mip in mips]


def _halved(image: Any) -> Any:
    rows, columns = (size // 2 * 2 for size in image.shape[:2])
    image = image[:rows, :columns]
    return (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) / 4
