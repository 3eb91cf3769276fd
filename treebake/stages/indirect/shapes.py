"""The shapes whose images the leaves share, and the frame in which each is drawn.

All copies of a leaf share its exemplar's image. A twig piece is a copy too: of one piece of its bark, stretched.
"""

from dataclasses import dataclass

import numpy as np

from treebake.model import Doubles, Ints, Leaves, Mesh

_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Shapes:
    """S leaf shapes and which of them each of N leaves has.

    of_leaf: (N,) int32. exemplars: (S,) int32, the leaf that is drawn for each shape. is_twig: (S,) bool.
    centers: (S, 3) float64, middle of the exemplar's box. frames: (S, 3, 3) float64, rows right, down, away of its
    image's viewer. halves: (S, 3) float64, half the exemplar's extent along those, in the tree's unit.
    """

    of_leaf: Ints
    exemplars: Ints
    is_twig: np.ndarray
    centers: Doubles
    frames: Doubles
    halves: Doubles


def find_shapes(foliage: Mesh, leaves: Leaves) -> Shapes:
    """The shapes of a foliage: the split's, and one for the twig pieces of each material. O(F)."""
    of_leaf, exemplars = _with_common_twigs(foliage, leaves)
    faces, shape = faces_of(leaves, exemplars)
    frames = _frames(foliage, leaves, faces, shape, exemplars)
    along = np.einsum("sij,skj->ski", frames[shape], foliage.positions[foliage.faces[faces]].astype(np.float64))
    starts = np.searchsorted(shape, np.arange(len(exemplars)))
    low = np.minimum.reduceat(along.min(axis=1), starts)
    high = np.maximum.reduceat(along.max(axis=1), starts)
    return Shapes(
        of_leaf=of_leaf,
        exemplars=exemplars,
        is_twig=leaves.is_twig[exemplars],
        centers=np.einsum("sij,si->sj", frames, (low + high) / 2),
        frames=frames,
        halves=np.maximum((high - low) / 2, 1e-9 * (high - low).max(axis=1, keepdims=True)),
    )


def faces_of(leaves: Leaves, exemplars: Ints) -> tuple[Ints, Ints]:
    """The faces of some leaves, leaf by leaf in their order, and the row in `exemplars` of each."""
    row = np.full(leaves.count, -1, np.int32)
    row[exemplars] = np.arange(len(exemplars), dtype=np.int32)
    shape = row[leaves.face_leaf]
    faces = np.flatnonzero(shape >= 0)
    faces = faces[np.argsort(shape[faces], kind="stable")]
    return faces.astype(np.int32), shape[faces]


def _with_common_twigs(foliage: Mesh, leaves: Leaves) -> tuple[Ints, Ints]:
    """The shape of each leaf and the exemplars; of the twigs of one material, the one with the median area."""
    shape = leaves.exemplars[leaves.shape]  # named by its exemplar
    material = np.zeros(leaves.count, np.int32)
    material[leaves.face_leaf] = foliage.face_material
    for index in np.unique(material[leaves.is_twig]):
        twigs = np.flatnonzero(leaves.is_twig & (material == index))
        shape[twigs] = twigs[np.argsort(leaves.areas[twigs], kind="stable")[len(twigs) // 2]]
    exemplars, of_leaf = np.unique(shape, return_inverse=True)
    return of_leaf.astype(np.int32), exemplars.astype(np.int32)


def _frames(foliage: Mesh, leaves: Leaves, faces: Ints, shape: Ints, exemplars: Ints) -> Doubles:
    """Image frames: away from the leaf's front; right along its texture's u, or else along its greatest extent."""
    normals = leaves.normals[exemplars]
    corners = foliage.positions[foliage.faces[faces]].astype(np.float64)
    uvs = foliage.uvs[foliage.faces[faces]].astype(np.float64)
    (e1, e2), (d1, d2) = ((x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (corners, uvs))
    winding = np.sign(d2[:, 0] * d1[:, 1] - d1[:, 0] * d2[:, 1])
    along_u = (e2 * d1[:, 1:] - e1 * d2[:, 1:]) * winding[:, None]
    textured = _sums(shape, along_u, len(exemplars))
    spokes = corners - leaves.centers[exemplars[shape], None]
    spokes -= normals[shape, None] * np.einsum("fki,fi->fk", spokes, normals[shape])[..., None]
    # Twelve times the second moment of a triangle over its area: of its corners, and of their sum.
    sums = spokes.sum(axis=1)
    moments = np.einsum("fki,fkj->fij", spokes, spokes) + sums[:, :, None] * sums[:, None, :]
    weighted = (foliage.face_areas[faces][:, None, None] * moments).reshape(-1, 9)
    longest = np.linalg.eigh(_sums(shape, weighted, len(exemplars)).reshape(-1, 3, 3))[1][:, :, 2]
    # An image's twig runs down the image, so that the shader knows its axis.
    right = np.where(leaves.is_twig[exemplars, None], np.cross(normals, leaves.axes[exemplars]), textured)
    right -= normals * (right * normals).sum(axis=1, keepdims=True)
    lengths = np.linalg.norm(right, axis=1, keepdims=True)
    scale = np.linalg.norm(_sums(shape, np.abs(along_u), len(exemplars)), axis=1, keepdims=True)
    lost = lengths <= np.where(leaves.is_twig[exemplars, None], 0, 1e-3 * scale)
    right = np.where(lost, longest - normals * (longest * normals).sum(axis=1, keepdims=True), right)
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), _TINY)
    return np.stack([right, np.cross(-normals, right), -normals], axis=1)


def _sums(labels: Ints, values: Doubles, count: int) -> Doubles:
    return np.stack([np.bincount(labels, column, count) for column in values.T], axis=1)
