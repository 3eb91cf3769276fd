"""Draws slicings, those nearest the viewer blended ([J00] 2.3)."""

import moderngl
import numpy as np

from treebake.gl.cards import draw_cards, far_and_near
from treebake.gl.context import program
from treebake.gl.light import Shading, transmitted
from treebake.gl.textures import upload_atlas, upload_table
from treebake.gl.view import ONE_TREE, Grove, View
from treebake.model import Slicings

_HINT = "bake with fewer [slicings] texels"
_ABOVE = 30.0  # degrees of elevation from which a slicing seen from above is blended in

# Texels by which depth may be off, so that a slice does not shade itself. Part of the sunlight that its own shadow
# takes from a chestnut and an oak (the sources': 0.50, 0.58): 0 texels 0.53, 0.64; 1 0.51, 0.61; 2 0.50, 0.58; 4 0.47,
# 0.53.
_VAGUE = 2.0

# Pixels of a crown's size from which on each slice is looked into as a stack of thinner ones; below it is flat.
RELIEF_HEIGHT = 40.0


def _texel(slicings: Slicings) -> float:
    """The width of a texel of a picture, in the tree's unit; 0 where none shows anything."""
    shown = slicings.slices[slicings.slices[:, 3, 2] > slicings.slices[:, 3, 0]][:1]
    width = slicings.atlas.coverage.pixels.shape[1]
    across = (shown[:, 3, 2] - shown[:, 3, 0]) / np.maximum((shown[:, 4, 2] - shown[:, 4, 0]) * width, 1e-12)
    return float(across.sum())


class SlicingCards:
    """Slicings on the graphics card."""

    def __init__(self, gl: moderngl.Context, slicings: Slicings) -> None:
        self._gl, self._slicings = gl, slicings
        self._texel = _texel(slicings)
        self._counter = program("slicings_count")
        self._textures = {
            "slices": upload_table(gl, slicings.slices, "f4", _HINT),
            **upload_atlas(gl, slicings.atlas, _HINT),
        }

    def draw(
        self, view: View, onto: moderngl.Framebuffer, grove: Grove = ONE_TREE, shading: Shading = Shading.PLAIN
    ) -> None:
        """Draw all trees over what is in `onto`, the framebuffer in use; depth is tested, and written by casters alone.

        Two calls: one for the trees that are looked into, over one for those that are too far away for that.
        """
        gl = self._gl
        casts = shading is Shading.CASTER
        (gl.disable if casts else gl.enable)(gl.BLEND)
        gl.blend_func = gl.ONE, gl.ONE_MINUS_SRC_ALPHA
        onto.depth_mask = casts
        far, near = self._far_and_near(view, grove)
        self._draw(program("slicings_plain", *shading.value), view, far)
        self._draw(program("slicings", *shading.value), view, near)
        onto.depth_mask = True

    def count(self, view: View, grove: Grove = ONE_TREE) -> None:
        """Add the fragments that every slice asks for to the framebuffer in use."""
        self._draw(self._counter, view, grove)

    def calls(self, view: View, grove: Grove) -> int:
        """Draw calls that some trees take."""
        return sum(len(trees.turns) > 0 for trees in self._far_and_near(view, grove))

    @property
    def triangles(self) -> int:
        """Of one tree."""
        return self._slicings.triangles

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()

    def _far_and_near(self, view: View, grove: Grove) -> tuple[Grove, Grove]:
        return far_and_near(view, grove, self._slicings.center, self._slicings.size, RELIEF_HEIGHT)

    def _draw(self, shader: moderngl.Program, view: View, grove: Grove) -> None:
        slicings = self._slicings
        seen = view.eye - grove.where(slicings.center)
        elevations = np.degrees(np.arctan2(seen[:, 1], np.hypot(seen[:, 0], seen[:, 2])))
        blended = 3 if slicings.above and (elevations > _ABOVE).any() else 2
        values = {
            "orientations": slicings.orientations,
            "count": slicings.count,
            "rectangles": slicings.rectangles,
            "blended": blended,
            "dropped": slicings.dropped,
            "far_row": slicings.far_row,
            "far_height": slicings.far_height,
            "size": slicings.size,
            "brightness": slicings.brightness,
            "transmission": transmitted(slicings.transmission),
            "exposure": slicings.exposure,
            "vague": _VAGUE * self._texel,
        }
        vertices = 6 * blended * slicings.count * slicings.rectangles
        draw_cards(self._gl, shader, self._textures, values, view, grove, slicings.center, vertices)
