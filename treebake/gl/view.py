"""From where a picture is taken."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.model import Doubles, Floats

_AFAR = 1e9  # units, where the eye of parallel rays is


@dataclass(frozen=True, eq=False)
class View:
    """Where from and how large.

    to_clip: (4, 4) float64, takes a world position (column) to OpenGL clip space, whose w is the depth along the
    optical axis. size: pixels from top to bottom. near, far: the depths between which it sees. aspect: of the picture,
    its width over its height.
    """

    to_clip: Doubles
    size: int
    near: float
    far: float
    aspect: float = 1.0

    @property
    def window(self) -> tuple[int, int]:
        """Pixels from left to right, and from top to bottom."""
        return round(self.size * self.aspect), self.size

    @property
    def eye(self) -> Doubles:
        """(3,) float64, the viewer's place; where all rays are parallel, which has none, one very far away."""
        eye, w = self._where_rays_meet
        return eye / np.linalg.norm(eye) * _AFAR if self._parallel else eye / w

    @property
    def forward(self) -> Doubles:
        """(3,) float64, unit, the way that the viewer looks."""
        way = self.to_clip[3, :3] if self.to_clip[3, :3].any() else self.to_clip[2, :3]
        return np.asarray(way / np.linalg.norm(way))

    @property
    def focus(self) -> float:
        """Pixels that a unit takes up where w is one: at a depth of one, or anywhere in a parallel projection."""
        return float(self.size / 2 * np.linalg.norm(self.to_clip[1, :3]))

    @property
    def eye_focus(self) -> float:
        """Pixels that a unit takes up at a distance of one from the eye."""
        return self.focus * (_AFAR if self._parallel else 1.0)

    @property
    def _where_rays_meet(self) -> tuple[Doubles, float]:
        """Times w, and w."""
        place = np.linalg.inv(self.to_clip) @ [0.0, 0.0, -1.0, 0.0]
        return place[:3], float(place[3])

    @property
    def _parallel(self) -> bool:
        place, w = self._where_rays_meet
        return bool(np.linalg.norm(place) > _AFAR * abs(w))


def looking(
    turn: Doubles,
    eye: Doubles,
    scale: float,
    depths: tuple[float, float],
    size: int,
    shift: float,
    aspect: float = 1.0,
) -> View:
    """A perspective view from `eye`.

    turn: (3, 3), rows right, up, towards the viewer. scale: of what lies at a depth of one, to half the picture's
    height. depths: that it sees, near and far. size: pixels from top to bottom. shift: pixels by which the picture is
    moved to the right. aspect: width over height.
    """
    to_eye = np.eye(4)
    to_eye[:3, :3] = turn
    to_eye[:3, 3] = -turn @ eye
    near, far = depths
    to_clip = np.array(
        [
            [scale / aspect, 0.0, -2 * shift / (aspect * size), 0.0],
            [0.0, scale, 0.0, 0.0],
            [0.0, 0.0, (near + far) / (near - far), 2 * near * far / (near - far)],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )
    return View(to_clip @ to_eye, size, near, far, aspect)


@dataclass(frozen=True, eq=False)
class Grove:
    """Where trees of one kind stand.

    places: (n, 4) float32, the tree's origin in the world, and its scale. turns: (n,) float32, radians about +Y, from
    +Z towards +X. opacities: (n,) float32, 0 to 1, of trees that are changing their representation; None: 1 for all.
    """

    places: Floats
    turns: Floats
    opacities: Floats | None = None

    def where(self, point: Doubles) -> Doubles:
        """The place of one point (3,) of the tree in the world, for each of the trees: (n, 3) float64."""
        x, y, z = point
        cosine, sine = np.cos(self.turns), np.sin(self.turns)
        turned = np.stack([cosine * x + sine * z, np.full_like(cosine, y), cosine * z - sine * x], axis=1)
        return np.asarray(self.places[:, :3] + self.places[:, 3:] * turned, np.float64)

    def away(self, eye: Doubles, point: Doubles) -> Doubles:
        """How far a point (3,) of each tree is from the eye: (n,) float64."""
        return np.asarray(np.linalg.norm(self.where(point) - eye, axis=1))

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Grove":
        """Some of the trees: chosen (n,) bool, or their numbers."""
        opacities = None if self.opacities is None else self.opacities[chosen]
        return Grove(self.places[chosen], self.turns[chosen], opacities)

    def whole_and_fading(self) -> "tuple[Grove, Grove]":
        """Those that are drawn whole, and those that are changing."""
        whole = np.ones(len(self.turns), bool) if self.opacities is None else self.opacities >= 1
        return self.select(whole), self.select(~whole)

    def instances(self, eye: Doubles, center: Doubles) -> Floats:
        """Rows for `grove.glsl`, (n, 7) float32, the tree whose center is farthest from `eye` first."""
        opacities = np.ones(len(self.turns)) if self.opacities is None else self.opacities
        rows = np.column_stack([self.places, np.cos(self.turns), np.sin(self.turns), opacities])
        return np.ascontiguousarray(rows[np.argsort(-self.away(eye, center), kind="stable")], np.float32)


ONE_TREE = Grove(np.array([[0, 0, 0, 1]], np.float32), np.zeros(1, np.float32))


def column_major(matrix: Doubles) -> tuple[float, ...]:
    """A matrix as OpenGL takes it."""
    return tuple(matrix.T.ravel().tolist())
