"""Draws billboards of multi-layered indirect textures from their published tables, one box each ([GPSS07] 5)."""

from typing import Any

import moderngl
import numpy as np

from treebake.compression import compressed_mips
from treebake.errors import GraphicsError
from treebake.gl.context import program
from treebake.gl.view import View, column_major
from treebake.model import IndirectTextures, Texture

_SRGB8_ALPHA8 = 0x8C43
_DEPTH_CLAMP = 0x864F
_CORNERS = 36  # vertices of a box

# Width of a hash cell on screen in pixels: nothing is looked up at the first, everything from the second on.
FADE = (0.5, 1.0)


class IndirectBillboards:
    """The tables on the graphics card; the images go through block compression, as an engine would keep them."""

    def __init__(self, gl: moderngl.Context, textures: IndirectTextures) -> None:
        self._gl, self._program = gl, program("indirect")
        self._billboards = len(textures.billboards)
        self._largest = textures.largest
        tables = {
            "billboards": (textures.billboards.reshape(self._billboards, -1, 4), "f4"),
            "shapes": (textures.shapes.reshape(len(textures.shapes), -1, 4), "f4"),
            "hash_texture": (textures.hash_texture[..., None], "u4"),
            "lists_texture": (textures.lists_texture[..., None], "u2"),
            "placements": (textures.placements, "u4"),
        }
        self._textures = {name: self._table(*table) for name, table in tables.items()}
        for name in ("leaf_color", "leaf_normal", "far_color", "far_normal"):
            self._textures[name] = self._image(getattr(textures, name), srgb=name.endswith("color"))
        self._counter = program("indirect_count")
        self._array, self._count_array = (gl.vertex_array(each, []) for each in (self._program, self._counter))

    def draw(self, view: View) -> None:
        """Draw all billboards into the framebuffer in use; depth is tested and written."""
        shader = self._program
        for unit, (name, texture) in enumerate(self._textures.items()):
            texture.use(unit)
            shader[name] = unit
        shader["largest"] = self._largest
        shader["from_clip"] = column_major(np.asarray(np.linalg.inv(view.to_clip), np.float64))
        shader["window"] = (view.size, view.size)
        shader["fade"] = FADE
        self._gl.disable(self._gl.BLEND)
        self._boxes(self._array, view)

    def count(self, view: View) -> None:
        """Add the rays that every fragment of the billboards casts to the framebuffer in use."""
        self._textures["billboards"].use(0)
        self._counter["billboards"] = 0
        self._boxes(self._count_array, view)

    def _boxes(self, array: moderngl.VertexArray, view: View) -> None:
        gl = self._gl
        array.program["to_clip"] = column_major(view.to_clip)
        gl.enable(gl.CULL_FACE)
        gl.cull_face = "front"  # a viewer inside a box sees its far sides only
        gl.enable_direct(_DEPTH_CLAMP)  # of which some may lie beyond what the view sees
        array.render(moderngl.TRIANGLES, vertices=_CORNERS * self._billboards)
        gl.disable_direct(_DEPTH_CLAMP)
        gl.cull_face = "back"

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()
        self._array.release()
        self._count_array.release()

    def _check(self, width: int, height: int) -> None:
        limit = self._gl.info["GL_MAX_TEXTURE_SIZE"]
        if max(width, height) > limit:
            raise GraphicsError(
                f"the indirect textures need {width} x {height} texels, this OpenGL takes {limit}; bake fewer "
                "billboards or a greater [indirect] cell"
            )

    def _table(self, values: Any, dtype: str) -> moderngl.Texture:
        height, width, channels = values.shape
        self._check(width, height)
        table = self._gl.texture((width, height), channels, np.ascontiguousarray(values), dtype=dtype, alignment=1)
        table.filter = moderngl.NEAREST, moderngl.NEAREST
        return table

    def _image(self, texture: Texture, *, srgb: bool) -> moderngl.Texture:
        mips = compressed_mips(texture, srgb=srgb)
        height, width = mips[0].shape[:2]
        self._check(width, height)
        options = {"internal_format": _SRGB8_ALPHA8} if srgb else {}
        image = self._gl.texture((width, height), 4, np.ascontiguousarray(mips[0]), **options)
        image.build_mipmaps(0, len(mips) - 1)
        for level, pixels in enumerate(mips):
            image.write(np.ascontiguousarray(pixels), level=level)
        image.filter = moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR
        image.repeat_x = image.repeat_y = False
        return image
