"""A tree in full light: drawn with its own shadow map, on itself and on the ground."""

from dataclasses import replace

import numpy as np

from treebake.gl.draw import Drawing
from treebake.gl.light import DARK, Light
from treebake.gl.scene import Stand
from treebake.gl.shadow import ShadowMap, sun_view
from treebake.gl.target import Picture
from treebake.gl.view import ONE_TREE, View
from treebake.model import EMPTY_MESH, Doubles, Floats, Layers, Material, Mesh

_ROUNDING = 1e-3  # of colours, which are kept in half floats


class Shaded:
    """A tree, its drawing and its shadows, to be drawn until `close`. Raises GraphicsError."""

    def __init__(
        self, mesh: Mesh, layers: Layers | None, points: Doubles, texels: int, *, exact_cutouts: bool = False
    ) -> None:
        """points: (N, 3) around what casts shadows, the same for all that are compared. texels: of the shadow map."""
        self._points, self._texels = points, texels
        self._drawing = Drawing(mesh, layers, exact_cutouts=exact_cutouts)
        self._shadows, self._none = ShadowMap(texels), ShadowMap(1)

    def picture(self, view: View, light: Light, *, shadows: bool = True) -> Picture:
        """What the view sees; without shadows the sun shines on all that is turned to it."""
        if not shadows or not any(light.sun):
            return self._drawing.picture(view, light, self._none)
        self._cast(light, view)
        return self._drawing.picture(view, light, self._shadows)

    def shadow(self, light: Light, ground: "Ground") -> tuple[Floats, Floats]:
        """What of the sun does not reach the ground, and where it is stopped.

        Gives (h, w) float32, 0 to 1, from above; and (texels, texels) float32 as the sun sees it, in parallel: how far
        behind the first plane that touches the points, in the tree's unit, infinite where nothing stops it.
        """
        view = self._cast(light, None)
        depths = self._shadows.depths()
        stopped = np.where(depths < 1, depths * np.float32(2 / np.linalg.norm(view.to_clip[2, :3])), np.inf)
        sun = replace(light, sun=(1.0, 1.0, 1.0), sky=DARK, ground=DARK)
        lit = ground.drawing.picture(ground.view, sun, self._shadows).color[..., 0]
        shade = 1 - lit / light.sun_direction[1]
        return np.where(shade > _ROUNDING, np.minimum(shade, 1), 0).astype(np.float32), stopped

    def wireframe(self, view: View) -> Picture:
        """The edges of all triangles, black."""
        return self._drawing.wireframe(view)

    def close(self) -> None:
        """Free everything on the graphics card."""
        for each in (self._shadows, self._none, self._drawing):
            each.close()

    def _cast(self, light: Light, viewer: View | None) -> View:
        view = sun_view(light.sun_direction, self._points, self._texels, viewer)
        self._shadows.cast([Stand(self._drawing, ONE_TREE)], view)
        return view


class Ground:
    """The level ground below a tree, as far as its shadow falls, seen straight from above, until `close`."""

    def __init__(self, points: Doubles, light: Light, pixels: int) -> None:
        """points: as of `Shaded`; the ground is where the lowest are. pixels: a side of the picture."""
        level = float(points[:, 1].min())
        sun = light.sun_direction
        shadow = points[:, [0, 2]] - sun[[0, 2]] * ((points[:, 1] - level) / sun[1])[:, None]
        low, high = shadow.min(axis=0), shadow.max(axis=0)
        middle, half = (low + high) / 2, float((high - low).max()) / 2
        self.drawing = Drawing(_square(middle, level, half))
        self.view = _from_above(middle, level, half, pixels)

    def close(self) -> None:
        """Free everything on the graphics card."""
        self.drawing.close()


def _square(middle: Doubles, level: float, half: float) -> Mesh:
    corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * half + middle
    positions = np.column_stack([corners[:, 0], np.full(4, level), corners[:, 1]]).astype(np.float32)
    return replace(
        EMPTY_MESH,
        positions=positions,
        normals=np.tile(np.array([[0, 1, 0]], np.float32), (4, 1)),
        uvs=np.zeros((4, 2), np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        face_material=np.zeros(2, np.int32),
        face_node=np.zeros(2, np.int32),
        materials=(Material("ground"),),
        nodes=("ground",),
    )


def _from_above(middle: Doubles, level: float, half: float, pixels: int) -> View:
    """+X to the right, +Z down."""
    to_clip = np.array(
        [
            [1 / half, 0, 0, -middle[0] / half],
            [0, 0, -1 / half, middle[1] / half],
            [0, -1 / half, 0, level / half],
            [0, 0, 0, 1.0],
        ]
    )
    return View(to_clip, pixels, 0.0, np.inf)
