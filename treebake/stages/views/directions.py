"""From where the pictures are taken."""

import numpy as np

from treebake.geometry import turn_to
from treebake.model import Doubles


def ring(count: int) -> list[Doubles]:
    """Frames (3, 3), rows right, up, towards the viewer, evenly spaced around the tree from +Z towards +X ([I11])."""
    return [turn_to(0.0, 360.0 * number / count) for number in range(count)]


def hemi_octahedron(side: int) -> list[Doubles]:
    """Frames of a square grid over the upper half of all directions, row after row.

    Column i and row j, both 0..side-1, stand for u and v = -1..1; the direction is (u - v) / 2 along X, (u + v) / 2
    along Z and, up, what these leave of 1, then made unit: an octahedron's upper half unfolded, so neighbours in the
    grid are neighbours on the sphere.
    """
    steps = np.linspace(-1.0, 1.0, side)
    v, u = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    x, z = (u - v) / 2, (u + v) / 2
    y = np.maximum(1 - np.abs(x) - np.abs(z), 0)
    elevations, azimuths = np.degrees(np.arctan2(y, np.hypot(x, z))), np.degrees(np.arctan2(x, z))
    return [turn_to(float(e), float(a)) for e, a in zip(elevations, azimuths, strict=True)]
