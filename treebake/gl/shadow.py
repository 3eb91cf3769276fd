"""Shadow maps: the depth of what the sun sees, in light-space perspective ([WSP04])."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import moderngl
import numpy as np

from treebake.geometry import reject
from treebake.gl.context import SHADOW_UNIT, context, leave_framebuffer
from treebake.gl.light import Light, Shading, shine
from treebake.gl.target import check
from treebake.gl.view import View
from treebake.model import Doubles, Floats

if TYPE_CHECKING:
    from treebake.gl.scene import Stand

_MARGIN = 2  # texels that stay empty around what casts a shadow, so that nothing outside the map is in one
_LEAST_SINE = 0.05  # of the angle between view and light, below which perspective has nothing to give


def sun_view(towards: Doubles, points: Doubles, texels: int, viewer: View | None = None) -> View:
    """The view along the light onto all that lies between some points, `texels` square.

    towards: (3,) float64, unit, the direction of the sun. points: (N, 3) float64, around what casts shadows. viewer:
    whose picture the shadows are for: what is near it gets more texels, by a perspective whose rays stay parallel to
    the light ([WSP04] 3). Without one, or where it looks along the light, all get the same.
    """
    back = np.array([0.0, 0.0, 1.0]) if viewer is None else -viewer.forward
    sine = float(np.linalg.norm(reject(back[None], towards[None])))
    if sine < _LEAST_SINE:
        back, sine = np.eye(3)[np.abs(towards).argmin()], 0.0
    behind = reject(back[None], towards[None])[0]
    behind /= np.linalg.norm(behind)
    across = np.cross(behind, towards)
    z = points @ behind  # grows towards the viewer
    w, down = np.array([0.0, 0.0, 0.0, 1.0]), np.array([*behind, 0.0])
    if viewer is not None and sine > 0:
        depths = np.maximum((points - viewer.eye) @ viewer.forward, viewer.near)
        before = (depths.min() + np.sqrt(depths.min() * depths.max())) / sine  # n of [WSP04]: spreads the error evenly
        # w grows with the distance from a point that lies so far before the nearest of them; it is 1 in the middle.
        w = np.array([*-behind, z.max() + before]) / (before + np.ptp(z) / 2)
        down = np.array([0.0, 0.0, 0.0, 1.0])  # over w it falls with that distance, and lines stay lines
    rows = np.stack([np.append(across, 0.0), down, np.append(-towards, 0.0), w])
    return View(_fitted(rows, points, texels), texels, 0.0, np.inf)


def _fitted(rows: Doubles, points: Doubles, texels: int) -> Doubles:
    """Rows of a projection, scaled and moved so that the points fill the clip space but for a margin."""
    places = np.column_stack([points, np.ones(len(points))]) @ rows.T
    low, high = ((places[:, :3] / places[:, 3:]).min(axis=0), (places[:, :3] / places[:, 3:]).max(axis=0))
    room = np.array([1 - 2 * _MARGIN / texels] * 2 + [1.0])
    scale = 2 * room / np.maximum(high - low, 1e-30)
    fitted = rows.copy()
    fitted[:3] = scale[:, None] * (rows[:3] - (low + high)[:, None] / 2 * rows[3])
    return fitted


class ShadowMap:
    """The depth of what the sun sees on the graphics card, to be drawn on until `close`.

    Raises GraphicsError where there is no OpenGL.
    """

    def __init__(self, texels: int) -> None:
        self._gl = context()
        self._texels = texels
        self._view: View | None = None  # nothing was cast yet
        self._depth = self._gl.depth_texture((texels, texels))
        self._depth.repeat_x = self._depth.repeat_y = False
        self._framebuffer = self._gl.framebuffer(depth_attachment=self._depth)
        self._framebuffer.clear()

    def cast(self, stands: "Sequence[Stand]", view: View) -> None:
        """Let trees cast their shadows, as `view`, of `sun_view` and as many texels as these, sees them."""
        self._view = view
        self._framebuffer.depth_mask = True
        self._framebuffer.clear()
        with self._gl.scope(self._framebuffer, self._gl.DEPTH_TEST):
            for stand in stands:
                stand.drawing.draw_solid(view, self._framebuffer, stand.grove, Shading.CASTER)
                stand.drawing.draw_blended(view, self._framebuffer, stand.grove, Shading.CASTER)
        check(self._gl)

    def shine(self, light: Light) -> None:
        """Light everything that is drawn from now on, behind these shadows."""
        to_texture = np.array([[0.5, 0, 0, 0.5], [0, 0.5, 0, 0.5], [0, 0, 0.5, 0.5], [0, 0, 0, 1]])
        to_clip = np.eye(4) if self._view is None else self._view.to_clip
        texel = 0.0 if self._view is None else self._widest(self._view)
        self._depth.compare_func = "<="
        self._depth.filter = moderngl.LINEAR, moderngl.LINEAR
        self._depth.use(SHADOW_UNIT)
        shine(light, to_texture @ to_clip, texel)

    def _widest(self, view: View) -> float:
        """Of a texel's sides where w is one: the map is fitted to what casts shadows, each way by itself."""
        return 2 / self._texels / float(np.linalg.norm(view.to_clip[:2, :3], axis=1).min())

    def depths(self) -> Floats:
        """(h, w) float32, the depth of each texel in 0..1, row 0 on top; 1 where there is nothing."""
        raw = np.frombuffer(self._depth.read(alignment=1), np.float32).reshape(self._texels, self._texels)
        return np.ascontiguousarray(raw[::-1])

    def close(self) -> None:
        """Free everything on the graphics card."""
        leave_framebuffer()
        self._framebuffer.release()
        self._depth.release()


def shine_through(shadows: ShadowMap | None, light: Light) -> Shading:
    """Light everything that is drawn from now on, with shadows or without; returns how it must be drawn then."""
    if shadows is None:
        shine(light)
        return Shading.PLAIN
    shadows.shine(light)
    return Shading.SHADED
