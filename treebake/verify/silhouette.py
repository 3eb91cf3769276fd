"""How much of a silhouette is kept, as a stock client draws it."""

from collections.abc import Sequence
from contextlib import closing

import numpy as np

from treebake.gl.draw import Drawing
from treebake.model import Floats, Mesh
from treebake.verify.cameras import Camera


def silhouette_iou(source: Mesh, candidate: Mesh, views: Sequence[Camera], height: int) -> float | None:
    """Intersection over union of two silhouettes by covered area, mean of the views in which either is seen.

    height: pixels of the cameras' sphere. None where neither is seen. Raises GraphicsError.
    """
    drawn = zip(_covered(source, views, height), _covered(candidate, views, height), strict=True)
    shares = [float(np.minimum(a, b).sum() / np.maximum(a, b).sum()) for a, b in drawn if a.any() or b.any()]
    return float(np.mean(shares)) if shares else None


def _covered(mesh: Mesh, views: Sequence[Camera], height: int) -> list[Floats]:
    with closing(Drawing(mesh, exact_cutouts=True)) as drawing:
        return [drawing.picture(view.view(height)).color[..., 3] for view in views]
