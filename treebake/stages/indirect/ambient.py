"""The ambient table: the sky that each leaf sees, at the corners of its rectangle ([GPSS07] 5.2, Figure 11).

Four corners cannot tell all: fitted to what 1,024 rays tell, they differ at the vertices by 0.034 of the sky on the
chestnut (10 vertices a leaf), 0.016 on the oak (4) and 0.039 on the birch (6), of which 0.012 is the rays' own noise.
As baked, by the ridge, at the vertices and at the corners:

| ridge | chestnut | oak | birch |
|---|---|---|---|
| 0.02 | 0.035, 0.040 | 0.022, 0.024 | 0.044, 0.065 |
| 0.1 | 0.036, 0.033 | 0.024, 0.023 | 0.044, 0.055 |
| 0.3 | 0.037, 0.026 | 0.032, 0.021 | 0.046, 0.044 |

Vertices weighted by the area around them: 0.037, 0.033 on the chestnut and 0.047, 0.068 on the birch, with 0.1.
"""

import numpy as np

from treebake.model import Bytes, Leaves, Mesh
from treebake.stages.indirect.poses import Poses

_RIDGE = 0.1  # of a vertex: pulls corners, of which too few vertices tell, to the leaf's mean
_CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # left top, right top, right bottom, left bottom


def ambient(foliage: Mesh, leaves: Leaves, poses: Poses) -> Bytes:
    """Fit the corners of each leaf's rectangle to the occlusion of its vertices: (N, 4) uint8, 255 for the whole sky.

    poses: of the leaves in the source, whose right and down name the corners: left top, right top, right bottom, left
    bottom, whether or not the image is mirrored. Between corners the value is bilinear, as the shader has it; the sum
    of squared differences at the vertices is least. A twig's varies along its axis only. All 255 where the foliage's
    occlusion is not known. O(F log F).
    """
    if foliage.occlusion is None:
        return np.full((leaves.count, 4), 255, np.uint8)
    pairs = np.unique(np.column_stack([leaves.face_leaf.repeat(3), foliage.faces.reshape(-1)]), axis=0)
    leaf, vertex = pairs.T
    first = np.flatnonzero(np.diff(leaf, prepend=-1))
    spokes = foliage.positions[vertex].astype(np.float64) - poses.centers[leaf]
    place = np.einsum("nij,nj->ni", poses.frames[leaf, :2], spokes) / np.maximum(poses.halves[leaf, :2], 1e-300)
    place[leaves.is_twig[leaf], 0] = 0
    share = (1 + np.clip(place, -1, 1)[:, None] * _CORNERS).prod(axis=2) / 4
    seen = foliage.occlusion[vertex].astype(np.float64)
    mean = np.add.reduceat(seen, first) / np.diff(first, append=len(seen))
    known = np.add.reduceat(share[:, :, None] * share[:, None], first) + _RIDGE * np.eye(4)
    wanted = np.add.reduceat(share * (seen - mean[leaf])[:, None], first)
    corners = mean[:, None] + np.linalg.solve(known, wanted[..., None])[..., 0]
    return np.asarray(np.rint(np.clip(corners, 0, 1) * 255), np.uint8)
