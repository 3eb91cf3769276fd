"""How far the published placements are from the source's leaves."""

from dataclasses import dataclass

import numpy as np

from treebake.lookup import LIST_BITS, Billboard, decode_leaves
from treebake.model import Clusters, Doubles, IndirectTextures, Tree
from treebake.stages.indirect.shapes import find_shapes


@dataclass(frozen=True, eq=False)
class Decoded:
    """Of N leaves: texels (N,), the farthest that a vertex is from the source's, in texels of the leaf's image; degrees
    (N,), how far its frame is turned; listed (N,) bool, whether some list holds it.
    """

    texels: Doubles
    degrees: Doubles
    listed: np.ndarray


def decoded(tree: Tree, clusters: Clusters, textures: IndirectTextures) -> Decoded:
    """Decode every leaf (twig pieces are left out) and hold its vertices against the source's."""
    order = np.argsort(clusters.labels, kind="stable")
    boards = [Billboard.of(row) for row in textures.billboards]
    to_cells = np.stack([board.to_cells for board in boards])[clusters.labels[order]]
    size = np.stack([board.size for board in boards])[clusters.labels[order]]
    leaves = decode_leaves(textures, np.arange(len(order), dtype=np.int32), size)
    of_leaf = np.empty(len(order), np.int64)
    of_leaf[order] = np.arange(len(order))  # the placement of each leaf

    shapes = find_shapes(tree.foliage, tree.leaves)
    leaf = tree.leaves.face_leaf
    placed = of_leaf[leaf]
    inverse = np.linalg.inv(np.concatenate([tree.leaves.transforms[:, :, :3]], axis=0))
    shape = shapes.of_leaf[leaf]
    corners = tree.foliage.positions[tree.foliage.faces].astype(np.float64)
    # Of every vertex: where its leaf's exemplar has it, in half sizes of the image ...
    home = np.einsum("fij,fkj->fki", inverse[leaf], corners - tree.leaves.transforms[leaf][:, None, :, 3])
    unit = (
        np.einsum("fij,fkj->fki", shapes.frames[shape], home - shapes.centers[shape][:, None])
        / shapes.halves[shape][:, None]
    )
    unit[..., 0] *= np.where(leaves.mirrored[placed], -1, 1)[:, None]
    # ... and where the placement takes it, in cells.
    local = unit * (leaves.halves[placed] * leaves.scales[placed, None])[:, None]
    found = np.einsum("fij,fkj->fki", leaves.frames[placed], local) + leaves.centers[placed][:, None]
    wanted = np.einsum("fij,fkj->fki", to_cells[placed][:, :, :3], corners) + to_cells[placed][:, None, :, 3]
    image = leaves.front[placed, 2:] * textures.leaf_color.pixels.shape[1::-1]
    texel = 2 * leaves.halves[placed, :2] * leaves.scales[placed, None] / image
    error = np.linalg.norm(found - wanted, axis=2).max(axis=1) / texel.min(axis=1)
    texels = np.zeros(len(order))
    np.maximum.at(texels, leaf, error)

    linear = tree.leaves.transforms[:, :, :3] @ np.swapaxes(shapes.frames, 1, 2)[shapes.of_leaf]
    linear[leaves.mirrored[of_leaf], :, 0] *= -1
    true = to_cells[of_leaf][:, :, :3] @ linear
    true /= np.cbrt(np.linalg.det(true))[:, None, None]
    cosine = (np.einsum("nij,nij->n", true, leaves.frames[of_leaf]) - 1) / 2
    real = ~tree.leaves.is_twig
    return Decoded(texels[real], np.degrees(np.arccos(np.clip(cosine, -1, 1)))[real], _listed(textures)[of_leaf][real])


def _listed(textures: IndirectTextures) -> np.ndarray:
    """Which placements some list of their own billboard holds."""
    listed = np.zeros(textures.leaves, bool)
    lists = textures.lists_texture.reshape(-1)
    for board in map(Billboard.of, textures.billboards):
        (x, y), (columns, rows) = board.origin, board.size[:2].astype(int)
        texels = textures.hash_texture[y : y + rows, x : x + columns].reshape(-1).astype(np.int64)
        count, offset = texels & (1 << LIST_BITS) - 1, texels >> LIST_BITS
        cell = np.repeat(np.arange(len(count)), count)
        step = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
        listed[board.first + lists[offset[cell] + step].astype(int)] = True
    return listed
