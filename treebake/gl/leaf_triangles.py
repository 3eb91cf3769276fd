"""Draws each leaf on a card of its own, where it is and as it is turned."""

import moderngl
import numpy as np

from treebake.gl.context import program
from treebake.gl.instances import instanced
from treebake.gl.light import Shading, transmitted
from treebake.gl.textures import upload_compressed, upload_table
from treebake.gl.view import ONE_TREE, Grove, View, column_major
from treebake.model import LeafCards

_HINT = "bake with a smaller [indirect] leaf_texels"
_ROW = 1024  # cards in a row of the table


class LeafTriangles:
    """The cards on the graphics card; the images go through block compression, as an engine would keep them."""

    def __init__(self, gl: moderngl.Context, leaves: LeafCards) -> None:
        self._gl, self._counter = gl, program("leaf_triangles_count")
        count = self._count = len(leaves.cards)
        rows = np.zeros((-(-count // _ROW) * _ROW, 3, 4), np.float32)
        rows[:count] = leaves.cards
        seen = np.full((len(rows), 4), 255, np.uint8)
        seen[:count] = leaves.ambient
        self._transmission = transmitted(leaves.transmission)
        self._textures = {
            "cards": upload_table(gl, rows.reshape(-1, 3 * _ROW, 4), "f4", _HINT),
            "ambient": upload_table(gl, seen.reshape(-1, _ROW, 4), "f1", _HINT),
            "shapes": upload_table(gl, leaves.shapes.reshape(len(leaves.shapes), -1, 4), "f4", _HINT),
            "leaf_color": upload_compressed(gl, leaves.leaf_color, _HINT, srgb=True),
            "leaf_normal": upload_compressed(gl, leaves.leaf_normal, _HINT, srgb=False),
        }

    def draw(
        self, view: View, onto: moderngl.Framebuffer, grove: Grove = ONE_TREE, shading: Shading = Shading.PLAIN
    ) -> None:
        """Draw all leaves of all trees into `onto`, the framebuffer in use; depth is tested and written."""
        onto.depth_mask = True
        self._gl.disable(self._gl.BLEND)
        variant = [*shading.value, *["FOUR_SAMPLES"] * (onto.samples > 1)]
        self._draw(program("leaf_triangles", *variant), view, grove)

    def count(self, view: View, grove: Grove = ONE_TREE) -> None:
        """Add the fragments that the cards ask for to the framebuffer in use."""
        self._draw(self._counter, view, grove)

    def calls(self, _view: View, grove: Grove) -> int:
        """Draw calls that some trees take."""
        return int(len(grove.turns) > 0)

    @property
    def triangles(self) -> int:
        """Of one tree."""
        return self._count

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()

    def _draw(self, shader: moderngl.Program, view: View, grove: Grove) -> None:
        if not len(grove.turns):
            return
        for unit, (name, texture) in enumerate(self._textures.items()):
            texture.use(unit)
            if name in shader:
                shader[name] = unit
        shader["to_clip"] = column_major(view.to_clip)
        values = {"eye": tuple(view.eye), "focus": view.focus, "transmission": self._transmission}
        for name, value in values.items():
            if name in shader:
                shader[name] = value
        self._gl.disable(self._gl.CULL_FACE)
        rows = grove.instances(view.eye, np.zeros(3))[::-1]  # the nearest first: it hides most of the others
        with instanced(self._gl, shader, rows) as array:
            array.render(moderngl.TRIANGLES, vertices=3 * self._count)
