"""The views from which a tree is judged: from far enough to see it whole, and close up."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.view import View, looking
from treebake.model import Doubles, Mesh

FIELD_OF_VIEW = 35.0  # degrees that the bounding sphere fills, from edge to edge
MARGIN = 32  # pixels that the window is wider than the sphere, both sides together
CLOSE_UP = 363  # pixels a side of a close-up, in which a leaf at the crown's edge is CLOSE_LEAF pixels long
CLOSE_LEAF = 64


@dataclass(frozen=True, eq=False)
class Camera:
    """A direction to look from at a bounding sphere.

    elevation: degrees above the horizon. azimuth: degrees from +Z towards +X. center: (3,) float64, radius: > 0, the
    sphere, in the mesh's unit and frame.
    """

    elevation: float
    azimuth: float
    center: Doubles
    radius: float

    def view(self, height: int, shift: float = 0.0) -> View:
        """The window of height + MARGIN pixels a side in which the sphere is `height` pixels high.

        The picture is moved to the right by `shift` pixels through the projection; the camera stays where it is.
        """
        turn = turn_to(self.elevation, self.azimuth)
        distance = self.radius / math.sin(math.radians(FIELD_OF_VIEW / 2))
        size = height + MARGIN
        scale = height / size / math.tan(math.radians(FIELD_OF_VIEW / 2))
        # A candidate may be wider than the source's sphere; twice as wide is still seen whole.
        near, far = distance - 2 * self.radius, distance + 2 * self.radius
        return looking(turn, self.center + distance * turn[2], scale, (near, far), size, shift)


@dataclass(frozen=True, eq=False)
class CloseUp:
    """A direction to look from at the edge of a crown, at leaves as large as someone standing there sees them.

    elevation, azimuth: as in Camera. edge: (3,) float64, the crown's nearest point near its middle line. leaf: length
    of a leaf. depth: of what can be seen behind the edge. Lengths in the mesh's unit.
    """

    elevation: float
    azimuth: float
    edge: Doubles
    leaf: float
    depth: float

    def view(self, height: int = CLOSE_UP, shift: float = 0.0) -> View:
        """The square window of `height` pixels in which a leaf at the edge is CLOSE_LEAF pixels long."""
        turn = turn_to(self.elevation, self.azimuth)
        scale = 1 / math.tan(math.radians(FIELD_OF_VIEW / 2))
        distance = height / 2 * scale * self.leaf / CLOSE_LEAF
        eye = self.edge + distance * turn[2]
        return looking(turn, eye, scale, (distance / 8, distance + self.depth), height, shift)


def bounding_sphere(mesh: Mesh) -> tuple[Doubles, float]:
    """Center (3,) float64 and radius: centred in the mesh's bounding box, it touches the farthest used vertex."""
    center = mesh.bounds.astype(np.float64).mean(axis=0)
    return center, float(np.linalg.norm(mesh.positions[mesh.used] - center, axis=1).max(initial=0.0)) or 1.0


def cameras(mesh: Mesh, elevations: Sequence[float], azimuths: int) -> tuple[Camera, ...]:
    """Look at a mesh from every elevation (degrees) at `azimuths` evenly spaced azimuths."""
    center, radius = bounding_sphere(mesh)
    return tuple(
        Camera(elevation, 360.0 * step / azimuths, center, radius)
        for elevation in elevations
        for step in range(azimuths)
    )


def close_ups(foliage: Mesh, leaf: float, elevations: Sequence[float], azimuths: int) -> tuple[CloseUp, ...]:
    """Look at the edge of a crown from every elevation (degrees) at `azimuths` evenly spaced azimuths.

    foliage: the crown, with at least one face. leaf: length of a leaf in its unit, above 0.
    """
    points = foliage.positions[np.unique(foliage.faces)].astype(np.float64)
    center = foliage.bounds.astype(np.float64).mean(axis=0)
    reach = float(np.linalg.norm(points - center, axis=1).max())
    found = []
    for elevation in elevations:
        for azimuth in 360.0 * np.arange(azimuths) / azimuths:
            right, up, back = turn_to(elevation, azimuth)
            aside = np.hypot((points - center) @ right, (points - center) @ up)
            middle = points[aside <= max(2 * leaf, float(aside.min()))]
            edge = center + back * float(((middle - center) @ back).max())
            found.append(CloseUp(elevation, float(azimuth), edge, leaf, 2 * reach))
    return tuple(found)
