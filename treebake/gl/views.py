"""Draws view impostors: a card per tree that faces the viewer ([I11])."""

import moderngl
import numpy as np

from treebake.gl.context import program
from treebake.gl.textures import upload_atlas, upload_table
from treebake.gl.view import ONE_TREE, Grove, View, column_major
from treebake.model import Views

_HINT = "bake with fewer [views] texels"
_TRIANGLES = 6  # of a card
_FLAT_LAYERS = 9  # of all views together: what a vertex can tell its fragments

# Pixels of a tree's height from which on each layer of a view is looked into; below it is flat.
RELIEF_HEIGHT = 56.0


class ViewCards:
    """Pictures of a tree on the graphics card."""

    def __init__(self, gl: moderngl.Context, views: Views) -> None:
        self._gl, self._views = gl, views
        self._programs = program("views_plain"), program("views")
        self._counter = program("views_count")
        self._textures = {
            "pictures": upload_table(gl, views.pictures, "f4", _HINT),
            **upload_atlas(gl, views.atlas, _HINT),
        }

    def draw(self, view: View, onto: moderngl.Framebuffer, grove: Grove = ONE_TREE) -> None:
        """Draw all trees over what is in `onto`, the framebuffer in use; depth is tested and written.

        Two calls: one for the trees that are looked into, over one for those that are too far away for that.
        """
        gl, views = self._gl, self._views
        onto.depth_mask = True
        gl.enable(gl.BLEND)
        gl.blend_func = gl.ONE, gl.ONE_MINUS_SRC_ALPHA
        away = np.linalg.norm(grove.where(views.center) - view.eye, axis=1)
        near = 2 * views.radius * grove.places[:, 3] * view.focus >= RELIEF_HEIGHT * away
        if (3 if views.layout == "hemi" else 2) * views.layers > _FLAT_LAYERS:
            near[:] = True
        for shader, chosen in zip(self._programs, (~near, near), strict=True):
            self._render(shader, view, grove.select(chosen))

    def count(self, view: View) -> None:
        """Add the fragments that the card asks for to the framebuffer in use."""
        self._render(self._counter, view, ONE_TREE)

    def triangles(self, _view: View) -> int:
        """How many triangles are drawn for a tree."""
        return _TRIANGLES

    def release(self) -> None:
        """Free everything on the graphics card."""
        for texture in self._textures.values():
            texture.release()

    def _render(self, shader: moderngl.Program, view: View, grove: Grove) -> None:
        gl, views = self._gl, self._views
        if not len(grove.turns):
            return
        for unit, (name, texture) in enumerate(self._textures.items()):
            texture.use(unit)
            if name in shader:
                shader[name] = unit
        values = {
            "to_clip": column_major(view.to_clip),
            "eye": tuple(view.eye),
            "center": tuple(views.center),
            "hemi": views.layout == "hemi",
            "side": views.side,
            "layers": views.layers,
            "radius": views.radius,
            "brightness": views.brightness,
            "exposure": views.exposure,
            "focus": view.focus,
            "support": views.support.tolist(),
        }
        for name, value in values.items():
            if name in shader:
                shader[name] = value
        instances = gl.buffer(grove.instances(view.eye, views.center))
        array = gl.vertex_array(shader, [(instances, "4f 2f/i", "in_place", "in_turn")])
        gl.disable(gl.CULL_FACE)
        array.render(moderngl.TRIANGLES, vertices=3 * _TRIANGLES, instances=len(grove.turns))
        array.release()
        instances.release()
