"""Draws view impostors: a card per tree that faces the viewer ([I11])."""

import moderngl

from treebake.gl.cards import draw_cards, far_and_near
from treebake.gl.context import program
from treebake.gl.light import Shading, transmitted
from treebake.gl.textures import upload_atlas, upload_table
from treebake.gl.view import ONE_TREE, Grove, View
from treebake.model import Views

_HINT = "bake with fewer [views] texels"
_FLAT_LAYERS = 9  # of all views together: what a vertex can tell its fragments

# Texels by which depth may be off, so that a view does not shade itself. Part of the sunlight that its own shadow takes
# from a chestnut, an oak and a cypress' closed hull (the sources': 0.51, 0.58, 0.02): 0 texels 0.52, 0.57, 0.58; 1
# 0.48, 0.51, 0.25; 2 0.45, 0.46, 0.12.
_VAGUE = 1.0

# Pixels of a tree's bounding sphere from which on each layer of a view is looked into; below it is flat.
RELIEF_HEIGHT = 40.0


class ViewCards:
    """Views of a tree on the graphics card."""

    def __init__(self, gl: moderngl.Context, views: Views) -> None:
        self._gl, self._views = gl, views
        self._counter = program("views_count")
        self._textures = {
            "pictures": upload_table(gl, views.pictures, "f4", _HINT),
            **upload_atlas(gl, views.atlas, _HINT),
        }
        shown = views.pictures[views.pictures[:, 3, 2] > views.pictures[:, 3, 0]][
            :1
        ]  # texels are alike on all pictures
        width = views.atlas.coverage.pixels.shape[1]
        self._density = float(((shown[:, 4, 2] - shown[:, 4, 0]) * width / (shown[:, 3, 2] - shown[:, 3, 0])).sum())

    def draw(
        self, view: View, onto: moderngl.Framebuffer, grove: Grove = ONE_TREE, shading: Shading = Shading.PLAIN
    ) -> None:
        """Draw all trees over what is in `onto`, the framebuffer in use; depth is tested and written.

        Two calls: one for the trees that are looked into, over one for those that are too far away for that.
        """
        gl = self._gl
        casts = shading is Shading.CASTER
        (gl.disable if casts else gl.enable)(gl.BLEND)
        gl.blend_func = gl.ONE, gl.ONE_MINUS_SRC_ALPHA
        # One that is vanishing must not hide what is drawn in its place; its shadow falls all the same.
        for trees, hides in zip(grove.whole_and_fading(), (True, False), strict=True):
            onto.depth_mask = hides or casts
            far, near = self._far_and_near(view, trees)
            self._draw(program("views_plain", *shading.value), view, far)
            self._draw(program("views", *shading.value), view, near)
        onto.depth_mask = True

    def count(self, view: View, grove: Grove = ONE_TREE) -> None:
        """Add the fragments that the card asks for to the framebuffer in use."""
        self._draw(self._counter, view, grove)

    def calls(self, view: View, grove: Grove) -> int:
        """Draw calls that some trees take."""
        parts = [part for trees in grove.whole_and_fading() for part in self._far_and_near(view, trees)]
        return sum(len(part.turns) > 0 for part in parts)

    @property
    def triangles(self) -> int:
        """Of one tree."""
        return self._views.triangles

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()

    def _far_and_near(self, view: View, grove: Grove) -> tuple[Grove, Grove]:
        views = self._views
        at_once = (3 if views.layout == "hemi" else 2) * views.layers
        pixels = RELIEF_HEIGHT if at_once <= _FLAT_LAYERS else 0.0
        return far_and_near(view, grove, views.center, 2 * views.radius, pixels)

    def _draw(self, shader: moderngl.Program, view: View, grove: Grove) -> None:
        views = self._views
        values = {
            "hemi": views.layout == "hemi",
            "side": views.side,
            "layers": views.layers,
            "radius": views.radius,
            "density": self._density,
            "brightness": views.brightness,
            "transmission": transmitted(views.transmission),
            "exposure": views.exposure,
            "vague": _VAGUE / self._density if self._density else 0.0,
            "support": views.support.tolist(),
        }
        draw_cards(self._gl, shader, self._textures, values, view, grove, views.center, 3 * views.triangles)
