"""Draws billboards of multi-layered indirect textures from their published tables, one box each ([GPSS07] 5)."""

import moderngl
import numpy as np

from treebake.gl.context import program
from treebake.gl.instances import instanced
from treebake.gl.light import Shading, transmitted
from treebake.gl.textures import upload_compressed, upload_table
from treebake.gl.view import ONE_TREE, Grove, View, column_major
from treebake.model import IndirectTextures

_DEPTH_CLAMP = 0x864F
_CORNERS = 36  # vertices of a box
_HINT = "bake fewer billboards or a greater [indirect] cell"

# Width of a hash cell on screen in pixels: nothing is looked up at the first, everything from the second on.
FADE = (0.5, 1.0)


class IndirectBillboards:
    """The tables on the graphics card; the images go through block compression, as an engine would keep them."""

    def __init__(self, gl: moderngl.Context, textures: IndirectTextures) -> None:
        self._gl = gl
        self._billboards = len(textures.billboards)
        self._largest, self._transmission = textures.largest, transmitted(textures.transmission)
        tables = {
            "billboards": (textures.billboards.reshape(self._billboards, -1, 4), "f4"),
            "shapes": (textures.shapes.reshape(len(textures.shapes), -1, 4), "f4"),
            "hash_texture": (textures.hash_texture[..., None], "u4"),
            "lists_texture": (textures.lists_texture[..., None], "u2"),
            "placements": (textures.placements, "u4"),
            "ambient": (textures.ambient, "f1"),
        }
        self._textures = {name: upload_table(gl, *table, _HINT) for name, table in tables.items()}
        for name in ("leaf_color", "leaf_normal", "far_color", "far_normal"):
            self._textures[name] = upload_compressed(gl, getattr(textures, name), _HINT, srgb=name.endswith("color"))
        self._counter = program("indirect_count")

    def draw(
        self, view: View, onto: moderngl.Framebuffer, grove: Grove = ONE_TREE, shading: Shading = Shading.PLAIN
    ) -> None:
        """Draw all billboards of all trees into `onto`, the framebuffer in use; depth is tested and written."""
        onto.depth_mask = True
        shader = program("indirect", *shading.value)
        for unit, (name, texture) in enumerate(self._textures.items()):
            texture.use(unit)
            if name in shader:
                shader[name] = unit
        if "transmission" in shader:
            shader["transmission"] = self._transmission
        shader["largest"] = self._largest
        shader["from_clip"] = column_major(np.asarray(np.linalg.inv(view.to_clip), np.float64))
        shader["window"] = view.window
        shader["fade"] = FADE
        self._gl.disable(self._gl.BLEND)
        self._boxes(shader, view, grove)

    def count(self, view: View, grove: Grove = ONE_TREE) -> None:
        """Add the rays that every fragment of the billboards casts to the framebuffer in use."""
        self._textures["billboards"].use(0)
        self._counter["billboards"] = 0
        self._boxes(self._counter, view, grove)

    def _boxes(self, shader: moderngl.Program, view: View, grove: Grove) -> None:
        if not len(grove.turns):
            return
        gl = self._gl
        shader["to_clip"] = column_major(view.to_clip)
        gl.enable(gl.CULL_FACE)
        gl.cull_face = "front"  # a viewer inside a box sees its far sides only
        gl.enable_direct(_DEPTH_CLAMP)  # of which some may lie beyond what the view sees
        with instanced(gl, shader, grove.instances(view.eye, np.zeros(3))[::-1]) as array:  # the nearest first
            array.render(moderngl.TRIANGLES, vertices=_CORNERS * self._billboards)
        gl.disable_direct(_DEPTH_CLAMP)
        gl.cull_face = "back"

    def calls(self, _view: View, grove: Grove) -> int:
        """Draw calls that some trees take."""
        return int(len(grove.turns) > 0)

    @property
    def triangles(self) -> int:
        """Of one tree."""
        return _CORNERS // 3 * self._billboards

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()
