"""Every leaf of indirect textures on a card of its own: the placements are all that is needed."""

import numpy as np

from treebake.lookup import Billboard, decode_leaves
from treebake.model import IndirectTextures, LeafCards


def leaf_cards(textures: IndirectTextures) -> LeafCards:
    """Decode the placements into cards in the tree's frame. O(leaves)."""
    boards = [Billboard.of(row) for row in textures.billboards]
    first = np.array([*(board.first for board in boards), textures.leaves])
    of = np.repeat(np.arange(len(boards)), np.diff(first))
    to_cells = np.stack([board.to_cells for board in boards])[of]
    leaves = decode_leaves(
        textures, np.arange(textures.leaves, dtype=np.int32), np.stack([board.size for board in boards])[of]
    )
    from_cells = np.linalg.inv(to_cells[:, :, :3])
    half = leaves.scales[:, None] * leaves.halves[:, :2]  # cells
    sides = from_cells @ leaves.frames[:, :, :2] * half[:, None]
    center = np.einsum("nij,nj->ni", from_cells, leaves.centers - to_cells[:, :, 3])
    shape = textures.placements.reshape(-1, 4)[: textures.leaves, 3] >> 16
    cards = np.empty((textures.leaves, 3, 4), np.float32)
    cards[:, 0] = np.column_stack([center, shape])
    cards[:, 1] = np.column_stack([sides[:, :, 0], np.where(leaves.mirrored, -1, 1)])
    cards[:, 2] = np.column_stack([sides[:, :, 1], leaves.rod])
    ambient = textures.ambient.reshape(-1, 4)[: textures.leaves]
    return LeafCards(cards, textures.shapes, textures.leaf_color, textures.leaf_normal, ambient, textures.transmission)
