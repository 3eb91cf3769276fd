"""Draws slicings, those nearest the viewer blended ([J00] 2.3)."""

import moderngl
import numpy as np

from treebake.gl.context import program
from treebake.gl.textures import upload_atlas, upload_table
from treebake.gl.view import ONE_TREE, Grove, View, column_major
from treebake.model import Slicings

_HINT = "bake with fewer [slicings] texels"
_ABOVE = 30.0  # degrees of elevation from which a slicing seen from above is blended in

# Pixels of a crown's height from which on each slice is looked into as a stack of thinner ones; below it is flat.
RELIEF_HEIGHT = 40.0


class SlicingCards:
    """Slicings on the graphics card."""

    def __init__(self, gl: moderngl.Context, slicings: Slicings) -> None:
        self._gl, self._slicings = gl, slicings
        self._programs = program("slicings_plain"), program("slicings")
        self._counter = program("slicings_count")
        self._textures = {
            "slices": upload_table(gl, slicings.slices, "f4", _HINT),
            **upload_atlas(gl, slicings.atlas, _HINT),
        }

    def draw(self, view: View, onto: moderngl.Framebuffer, grove: Grove = ONE_TREE) -> None:
        """Draw all trees over what is in `onto`, the framebuffer in use; depth is tested, not written.

        Two calls: one for the trees that are looked into, over one for those that are too far away for that.
        """
        gl = self._gl
        gl.enable(gl.BLEND)
        gl.blend_func = gl.ONE, gl.ONE_MINUS_SRC_ALPHA
        onto.depth_mask = False
        away = np.linalg.norm(grove.where(self._slicings.center) - view.eye, axis=1)
        near = self._slicings.height * grove.places[:, 3] * view.focus >= RELIEF_HEIGHT * away
        for shader, chosen in zip(self._programs, (~near, near), strict=True):
            self._render(shader, view, grove.select(chosen))
        onto.depth_mask = True

    def count(self, view: View) -> None:
        """Add the fragments that every slice asks for to the framebuffer in use."""
        self._render(self._counter, view, ONE_TREE)

    def triangles(self, view: View) -> int:
        """How many triangles are drawn for a tree."""
        return 2 * self._quads(view, ONE_TREE)

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()

    def _blended(self, view: View, grove: Grove) -> int:
        seen = view.eye - grove.where(self._slicings.center)
        elevations = np.degrees(np.arctan2(seen[:, 1], np.linalg.norm(seen[:, ::2], axis=1)))
        return 3 if self._slicings.above and (elevations > _ABOVE).any() else 2

    def _quads(self, view: View, grove: Grove) -> int:
        rectangles = int((self._slicings.slices.shape[1] - 3) // 2)
        return self._blended(view, grove) * self._slicings.count * rectangles

    def _render(self, shader: moderngl.Program, view: View, grove: Grove) -> None:
        gl, slicings = self._gl, self._slicings
        if not len(grove.turns):
            return
        for unit, (name, texture) in enumerate(self._textures.items()):
            texture.use(unit)
            if name in shader:
                shader[name] = unit
        values = {
            "to_clip": column_major(view.to_clip),
            "eye": tuple(view.eye),
            "center": tuple(slicings.center),
            "orientations": slicings.orientations,
            "count": slicings.count,
            "rectangles": (slicings.slices.shape[1] - 3) // 2,
            "blended": self._blended(view, grove),
            "dropped": slicings.dropped,
            "far_row": slicings.far_row,
            "far_height": slicings.far_height,
            "box_height": slicings.height,
            "brightness": slicings.brightness,
            "exposure": slicings.exposure,
            "focus": view.focus,
        }
        for name, value in values.items():
            if name in shader:
                shader[name] = value
        instances = gl.buffer(grove.instances(view.eye, slicings.center))
        array = gl.vertex_array(shader, [(instances, "4f 2f/i", "in_place", "in_turn")])
        gl.disable(gl.CULL_FACE)
        array.render(moderngl.TRIANGLES, vertices=6 * self._quads(view, grove), instances=len(grove.turns))
        array.release()
        instances.release()
