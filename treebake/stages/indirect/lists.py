"""The hash and lists textures: which leaves each cell of a billboard holds, front to back ([GPSS07] 4.2)."""

from dataclasses import dataclass

import numpy as np

from treebake.errors import BudgetError
from treebake.lookup import LIST_BITS, ROW_BITS
from treebake.model import Doubles, Ints, Longs, Words

_LEAVES = 1 << 16  # that a lists entry can name
_WIDTH = 1 << ROW_BITS


@dataclass(frozen=True, eq=False)
class Footprints:
    """N leaves on the grids of their billboards, sorted by billboard, in cells.

    billboard: (N,) int32. number: (N,) int32, of the leaf within its billboard. middles: (N, 2) float64. edges:
    (N, 3, 2) float64, half the edges of its box as seen along the billboard's normal. depths: (N,) float64, of the
    leaf's centre behind the front.
    """

    billboard: Ints
    number: Ints
    middles: Doubles
    edges: Doubles
    depths: Doubles


def list_leaves(
    leaves: Footprints, sizes: Ints, origins: Ints, shape: tuple[int, int], *, single: bool
) -> tuple[Words, np.ndarray]:
    """Fill the hash atlas of (height, width) cells and the lists.

    sizes, origins: (K, 2) int32, columns and rows of each billboard's grid, and its first texel in the atlas. single:
    at most one leaf a cell, the front one at the cell's centre: the leaf distribution impostor of [GSSK05] 2.3.
    Returns the hash texture (height, width) uint32 and the lists (h, w) uint16; equal lists are stored once.
    O(E log E) for E pairs of leaf and cell.

    Raises BudgetError where a number does not fit into its bits.
    """
    leaf, cell = _touched(leaves, sizes, origins, shape[1], centers_only=single)
    order = np.lexsort((leaf, leaves.depths[leaf], cell))
    leaf, cell = leaf[order], cell[order]
    if single:
        first = np.flatnonzero(np.diff(cell, prepend=-1))
        leaf, cell = leaf[first], cell[first]
    cells, starts, counts = np.unique(cell, return_index=True, return_counts=True)
    entries, offsets = _shared(leaves.number[leaf].astype(np.int64), starts.astype(np.int64), counts)
    _check(leaves, counts, entries)
    hashes = np.zeros(shape, np.uint32)
    hashes.reshape(-1)[cells] = (offsets << LIST_BITS | counts).astype(np.uint32)
    return hashes, in_rows(entries.astype(np.uint16))


def in_rows(values: np.ndarray) -> np.ndarray:
    """A table (N, ...) as a texture (height, width, ...): number i lies in row i // width, column i % width."""
    rows = -(-max(len(values), 1) // _WIDTH)
    padded = np.zeros((rows * _WIDTH, *values.shape[1:]), values.dtype)
    padded[: len(values)] = values
    return padded.reshape(rows, _WIDTH, *values.shape[1:])


def _touched(leaves: Footprints, sizes: Ints, origins: Ints, width: int, *, centers_only: bool) -> tuple[Longs, Longs]:
    """Every pair of a leaf and a cell that its footprint meets; cells are numbered through the atlas."""
    reach = np.abs(leaves.edges).sum(axis=1)
    grid = sizes[leaves.billboard]
    low = np.clip(np.floor(leaves.middles - reach), 0, grid - 1).astype(np.int64)
    high = np.clip(np.floor(leaves.middles + reach), 0, grid - 1).astype(np.int64)
    across, down = (high - low + 1).T
    number = across * down
    leaf = np.repeat(np.arange(len(number), dtype=np.int64), number)
    step = np.arange(len(leaf)) - np.repeat(np.cumsum(number) - number, number)
    place = low[leaf] + np.stack([step % across[leaf], step // across[leaf]], axis=1)
    # Boxes seen along the normal are hexagons: apart from a cell where a normal of their edges tells them apart.
    away = place + 0.5 - leaves.middles[leaf]
    half = 0.0 if centers_only else 0.5
    meets = np.ones(len(leaf), bool)
    for edge in range(3):
        normal = leaves.edges[:, edge, ::-1] * (1, -1)
        theirs = np.abs(np.einsum("nei,ni->ne", leaves.edges, normal)).sum(axis=1)
        ours = half * np.abs(normal).sum(axis=1)
        meets &= np.abs(np.einsum("pi,pi->p", away, normal[leaf])) <= (theirs + ours)[leaf] * (1 + 1e-9)
    if centers_only:
        meets &= (np.abs(away) <= reach[leaf]).all(axis=1)
    leaf, place = leaf[meets], place[meets] + origins[leaves.billboard[leaf[meets]]]
    return leaf, place[:, 1] * width + place[:, 0]


def _shared(entries: Longs, starts: Longs, counts: Longs) -> tuple[Longs, Longs]:
    """The lists with equal ones stored once, and the offset of each: one pass per length of list."""
    stored, offsets, end = [np.zeros(0, np.int64)], np.zeros(len(starts), np.int64), 0
    for count in np.unique(counts):
        which = np.flatnonzero(counts == count)
        lists, inverse = np.unique(entries[starts[which, None] + np.arange(count)], axis=0, return_inverse=True)
        offsets[which] = end + inverse.reshape(-1) * count
        stored.append(lists.reshape(-1))
        end += lists.size
    return np.concatenate(stored), offsets


def _check(leaves: Footprints, counts: Longs, entries: Longs) -> None:
    for found, most, what, mend in (
        (
            int(leaves.number.max(initial=0)) + 1,
            _LEAVES,
            "leaves in one billboard",
            "raise [indirect_cluster] billboards",
        ),
        (int(counts.max(initial=0)), (1 << LIST_BITS) - 1, "leaves in one list", "lower [indirect] cell"),
        (len(entries), 1 << (32 - LIST_BITS), "entries in the lists", "raise [indirect] cell"),
    ):
        if found > most:
            raise BudgetError(f"the indirect textures need {found:,} {what} and can hold {most:,}; {mend}")
