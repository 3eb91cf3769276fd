"""Measures what a simplified trunk kept of its source."""

from dataclasses import dataclass

import numpy as np

from treebake.model import Doubles, Mesh

_ELEVATIONS, _AZIMUTHS = (0.0, 25.0, 60.0), 8  # degrees and number of the verifier's views


@dataclass(frozen=True)
class TrunkReport:
    """A simplified trunk next to its source; ratios are 1 where nothing was lost."""

    source_triangles: int
    triangles: int  # of the trunk alone, without the pieces that the foliage took over
    area_kept: float  # surface of trunk and pieces, over the source's
    silhouette_kept: float  # area of the silhouette of trunk and pieces, over the source's, mean of 24 directions
    silhouette_worst: float  # the same in the direction where it is farthest from 1


def compare(source: Mesh, trunk: Mesh, pieces: Mesh | None = None) -> TrunkReport:
    """Compare a simplified trunk, and the pieces that the foliage took over, with the source's trunk.

    The silhouette is half the projected area of all faces, front and back: exact for branches that are convex in
    section, each taken alone. What they hide of each other is left to the verifier, which draws. O(24 F).
    """
    after = [trunk] if pieces is None else [trunk, pieces]
    had, has = _silhouettes(source), np.sum([_silhouettes(mesh) for mesh in after], axis=0)
    area = float(source.face_areas.sum())
    ratios = np.where(had > 0, has / np.where(had > 0, had, 1), 1.0)
    return TrunkReport(
        source_triangles=source.triangles,
        triangles=trunk.triangles,
        area_kept=sum(float(mesh.face_areas.sum()) for mesh in after) / area if area else 1.0,
        silhouette_kept=float(ratios.mean()),
        silhouette_worst=float(ratios[np.abs(ratios - 1).argmax()]),
    )


def _silhouettes(mesh: Mesh) -> Doubles:
    """(24,) area of the silhouette in each direction."""
    a, b, c = (mesh.positions[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    areas = np.cross(b - a, c - a) / 2
    elevation, azimuth = np.meshgrid(np.radians(_ELEVATIONS), np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS)
    level = np.cos(elevation)
    views = np.stack([level * np.sin(azimuth), np.sin(elevation), level * np.cos(azimuth)], axis=-1)
    projected: Doubles = np.array([np.abs(areas @ view).sum() / 2 for view in views.reshape(-1, 3)])
    return projected
