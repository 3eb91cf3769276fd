"""How much of the picture a foliage covers, as a viewer draws it: what the atlas's alpha is fitted to."""

from contextlib import closing

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.draw import Drawing
from treebake.gl.view import View
from treebake.model import Doubles, Mesh

_DIRECTIONS = tuple((elevation, azimuth) for elevation in (0.0, 25.0, 60.0) for azimuth in (20.0, 110.0))  # degrees


def covered_area(mesh: Mesh, bounds: Mesh, height: int, *, exact: bool) -> float:
    """Pixels covered by a mesh in parallel views, summed over six directions and two sizes.

    bounds: the mesh whose bounding box frames the views. height: pixels of the larger views, twice the smaller's.
    exact: cut leaves out as if they were modelled, free of what mips do to them; that is for a source.
    """
    low, high = bounds.bounds.astype(np.float64)
    center, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    with closing(Drawing(mesh, exact_cutouts=exact)) as drawing:
        pictures = [
            drawing.picture(View(_parallel(center, radius, *direction), size, 0.0, 1.0))
            for size in (height, height // 2)
            for direction in _DIRECTIONS
        ]
    return float(sum(picture.color[..., 3].sum(dtype=np.float64) for picture in pictures))


def _parallel(center: Doubles, radius: float, elevation: float, azimuth: float) -> Doubles:
    """Parallel projection of a sphere onto the whole picture, from a direction in degrees: (4, 4) float64."""
    turn = turn_to(elevation, azimuth) * np.array([[1.0], [1.0], [-1.0]]) / radius
    to_clip = np.eye(4)
    to_clip[:3, :3] = turn
    to_clip[:3, 3] = -turn @ center
    return to_clip
