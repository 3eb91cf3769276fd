"""Draws a scene of many trees, each kind by a drawing of its own, into one picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import moderngl

from treebake.gl.context import context, leave_framebuffer
from treebake.gl.draw import Drawing
from treebake.gl.light import DAYLIGHT, Light, Shading
from treebake.gl.shadow import ShadowMap, shine_through
from treebake.gl.target import Picture, Target
from treebake.gl.view import Grove, View


@dataclass(frozen=True, eq=False)
class Stand:
    """Trees that one drawing draws."""

    drawing: Drawing
    grove: Grove


class Scene:
    """A window onto stands of trees, to be drawn on until `close`. Raises GraphicsError where there is no OpenGL.

    Stands are given farthest first, as far as they are blended: what is drawn later lies over what is there.
    """

    def __init__(self, window: tuple[int, int]) -> None:
        self._gl = context()
        self._target = Target(self._gl, window)
        self._plain = self._gl.framebuffer([self._gl.renderbuffer(window, 4)], self._gl.depth_renderbuffer(window))

    def picture(
        self, view: View, stands: Sequence[Stand], light: Light = DAYLIGHT, shadows: ShadowMap | None = None
    ) -> Picture:
        """What the view sees, over nothing, with 4 samples a pixel, lit as `Drawing.picture` is."""
        self._draw(self._target.samples, view, stands, shine_through(shadows, light))
        return self._target.picture(view)

    def draw(self, view: View, stands: Sequence[Stand]) -> None:
        """Draw with one sample a pixel and keep nothing; returns when all is done, so that it can be timed."""
        self._draw(self._plain, view, stands, shine_through(None, DAYLIGHT))
        self._gl.finish()

    def fragments(self, view: View, stands: Sequence[Stand]) -> float:
        """How many fragments the view asks to be shaded, whether or not they end up hidden or cut out."""
        target = self._target
        target.count.clear()
        with self._gl.scope(target.count, self._gl.BLEND):
            self._gl.blend_func = self._gl.ONE, self._gl.ONE
            for stand in stands:
                stand.drawing.count(view, stand.grove)
        return target.total()

    def close(self) -> None:
        """Free everything on the graphics card."""
        leave_framebuffer()
        self._plain.release()
        self._target.release()

    def _draw(self, onto: moderngl.Framebuffer, view: View, stands: Sequence[Stand], shading: Shading) -> None:
        onto.depth_mask = True
        onto.clear()
        with self._gl.scope(onto, self._gl.DEPTH_TEST):
            for stand in reversed(stands):  # the nearest first: they hide much of the others
                stand.drawing.draw_solid(view, onto, stand.grove, shading)
            for stand in stands:
                stand.drawing.draw_blended(view, onto, stand.grove, shading)
