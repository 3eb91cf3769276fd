"""The views from which a tree is judged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from treebake.gl.view import View
from treebake.model import Doubles, Mesh

FIELD_OF_VIEW = 35.0  # degrees that the bounding sphere fills, from edge to edge
MARGIN = 32  # pixels that the window is wider than the sphere, both sides together


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
        elevation, azimuth = math.radians(self.elevation), math.radians(self.azimuth)
        back = np.array(
            [
                math.cos(elevation) * math.sin(azimuth),
                math.sin(elevation),
                math.cos(elevation) * math.cos(azimuth),
            ]
        )
        right = np.array([math.cos(azimuth), 0.0, -math.sin(azimuth)])  # level, and defined straight from above too
        turn = np.stack([right, np.cross(back, right), back])
        distance = self.radius / math.sin(math.radians(FIELD_OF_VIEW / 2))
        to_eye = np.eye(4)
        to_eye[:3, :3] = turn
        to_eye[:3, 3] = -turn @ self.center - [0.0, 0.0, distance]

        size = height + MARGIN
        scale = height / size / math.tan(math.radians(FIELD_OF_VIEW / 2))
        # A candidate may be wider than the source's sphere; twice as wide is still seen whole.
        near, far = distance - 2 * self.radius, distance + 2 * self.radius
        to_clip = np.array(
            [
                [scale, 0.0, -2 * shift / size, 0.0],
                [0.0, scale, 0.0, 0.0],
                [0.0, 0.0, (near + far) / (near - far), 2 * near * far / (near - far)],
                [0.0, 0.0, -1.0, 0.0],
            ]
        )
        return View(to_clip @ to_eye, size, near, far)


def cameras(mesh: Mesh, elevations: Sequence[float], azimuths: int) -> tuple[Camera, ...]:
    """Look at a mesh from every elevation (degrees) at `azimuths` evenly spaced azimuths.

    The sphere is centred in the mesh's bounding box and touches its farthest used vertex.
    """
    center = mesh.bounds.astype(np.float64).mean(axis=0)
    used = mesh.positions[np.unique(mesh.faces)]
    radius = float(np.linalg.norm(used - center, axis=1).max(initial=0.0)) or 1.0
    return tuple(
        Camera(elevation, 360.0 * step / azimuths, center, radius)
        for elevation in elevations
        for step in range(azimuths)
    )
