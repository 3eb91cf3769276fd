"""The lookup of a view ray in indirect textures, in numpy: the readable twin of gl/shaders/indirect_lookup.glsl.

Frames and names are those of the shader; asset/FORMAT.md gives the tables. The rays of one billboard are looked up at
once: a loop over the cells that they walk through, within it one over the entries of the cells' lists.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.model import Bytes, Doubles, Floats, IndirectTextures, Ints, Longs
from treebake.placements import unpack

Mask = NDArray[np.bool_]

LIST_BITS = 10  # of a hash texel: the length of the list; the bits above are its offset
ROW_BITS = 10  # of the number of an entry of a table: its column
SOFTNESS = 0.0625  # of the alpha test in mips
RELIEF_STEPS = 8  # in which a ray looks for the relief of a leaf
MOST_LOD = 4.0


@dataclass(frozen=True, eq=False)
class Images:
    """The leaves textures with their mips, mip 0 first: color with alpha, and normal, whose third channel is height."""

    color: Sequence[Bytes]
    normal: Sequence[Bytes]


@dataclass(frozen=True, eq=False)
class Rays:
    """R view rays, start + t * way. start, way: (R, 3). spread: (R, 2), distance of samples at t = 1 and at 0."""

    start: Doubles
    way: Doubles
    spread: Doubles

    def of(self, rows: Longs) -> "Rays":
        """Some of them."""
        return Rays(self.start[rows], self.way[rows], self.spread[rows])

    def turned(self, matrix: Doubles) -> "Rays":
        """In another frame: matrix (3, 4), a similarity."""
        linear = matrix[:, :3].T
        return Rays(self.start @ linear + matrix[:, 3], self.way @ linear, self.spread * np.linalg.norm(linear[0]))


@dataclass(frozen=True, eq=False)
class Billboard:
    """One row of the billboards table. to_cells: (3, 4), from the tree's frame. Lengths in hash cells."""

    to_cells: Doubles
    size: Doubles  # (3,)
    plane: float
    origin: Ints  # (2,)
    first: int
    reach: float

    @classmethod
    def of(cls, row: Floats) -> "Billboard":
        """Take a row (20,) of the table apart."""
        values = row.astype(np.float64)
        origin, first = values[16:18].astype(np.int32), int(values[18])
        return cls(values[:12].reshape(3, 4), values[12:15], float(values[15]), origin, first, float(values[19]))


@dataclass(frozen=True, eq=False)
class Leaves:
    """Decoded placements of N leaves, in cells of their billboard.

    centers: (N, 3). frames: (N, 3, 3), columns right, down, away. scales: (N,), cells per half height. halves: (N, 3),
    half the leaf's box in half heights. rod, mirrored: (N,) bool. front, back: (N, 4), places in texture coordinates.
    thresholds: (N, 5), of the mips 0 to 4.
    """

    centers: Doubles
    frames: Doubles
    scales: Doubles
    halves: Doubles
    rod: Mask
    mirrored: Mask
    front: Doubles
    back: Doubles
    thresholds: Doubles


@dataclass(frozen=True, eq=False)
class Hits:
    """What R rays meet.

    along: (R,), the ray's parameter. placement: (R,) int32, -1 for nothing. place: (R, 2) in the leaf, -1..1 of its
    half sizes. uv: (R, 2) in the leaves texture. lod: (R,). away: (R,), cells behind the front. behind: (R,) bool,
    whether the leaf's back is seen.
    """

    along: Doubles
    placement: Ints
    place: Doubles
    uv: Doubles
    lod: Doubles
    away: Doubles
    behind: Mask


def decode_leaves(textures: IndirectTextures, placement: Ints, size: Doubles) -> Leaves:
    """Decode placements (N,) of a billboard whose box has `size` (3,) or, one each, (N, 3)."""
    placed = unpack(textures.placements.reshape(-1, 4)[placement])
    shape = textures.shapes[placed.shape].astype(np.float64)
    return Leaves(
        centers=placed.positions * size,
        frames=placed.rotations,
        scales=placed.scales * textures.largest,
        halves=shape[:, :3] * np.stack([placed.narrowings, np.ones(len(shape)), np.ones(len(shape))], axis=1),
        rod=shape[:, 3] > 0.5,
        mirrored=placed.mirrored,
        front=shape[:, 4:8],
        back=shape[:, 8:12],
        thresholds=np.column_stack([np.full(len(shape), 0.5), shape[:, 12:]]),
    )


def look_up(
    textures: IndirectTextures, images: Images, number: int, rays: Rays, share: float = 1.0, dither: float = 0.0
) -> Hits:
    """The nearest leaf of billboard `number` that each ray meets.

    rays: in the tree's frame and unit. share: of each list that is looked up, from the viewer's end. dither: 0..1, by
    which what is true in part is decided: a broken number of entries, alpha in mips.
    """
    board = Billboard.of(textures.billboards[number])
    rays = rays.turned(board.to_cells)
    start, way = rays.start, rays.way
    front = way[:, 2] > 0
    lists = textures.lists_texture.reshape(-1)
    hits = _nothing(len(start))

    inverse = 1 / np.where(np.abs(way) < 1e-12, 1e-12, way)
    ends = np.stack([-start * inverse, (board.size - start) * inverse])
    enter, leave = np.maximum(ends.min(axis=0).max(axis=1), 0), ends.max(axis=0).min(axis=1)
    if board.size[2] == 0:
        enter = leave = ends[0, :, 2]
    grid = board.size[:2].astype(int)
    cell = np.clip(np.floor(start[:, :2] + enter[:, None] * way[:, :2]).astype(int), 0, grid - 1)
    step = np.sign(inverse[:, :2]).astype(int)
    following = (cell + np.maximum(step, 0) - start[:, :2]) * inverse[:, :2]
    inside = enter <= leave
    while inside.any():
        here = board.origin + np.clip(cell, 0, grid - 1)
        texel = np.where(inside, textures.hash_texture[here[:, 1], here[:, 0]].astype(np.int64), 0)
        count, offset = texel & (1 << LIST_BITS) - 1, texel >> LIST_BITS
        wanted = (share * count + dither).astype(int)
        for entry in range(int(wanted.max())):
            ray = np.flatnonzero(entry < wanted)
            place = offset[ray] + np.where(front[ray], entry, count[ray] - 1 - entry)
            placement = board.first + lists[place].astype(np.int32)
            leaves = decode_leaves(textures, placement, board.size)
            _meet(leaves, images, rays.of(ray), dither, placement, ray, hits)
        turn, axis = following.min(axis=1), (following[:, 0] >= following[:, 1]).astype(int)
        rows = np.arange(len(cell))
        inside &= (turn <= leave) & (hits.along > turn)
        cell[rows, axis] += step[rows, axis]
        following[rows, axis] += np.abs(inverse[rows, axis])
        inside &= ((cell >= 0) & (cell < grid)).all(axis=1)
    return hits


def ambient_at(textures: IndirectTextures, placement: Ints, place: Doubles) -> Doubles:
    """The part of the sky that is seen at places (R, 2) of placements (R,), as in `Hits`: (R,) float64, 0 to 1."""
    left_top, right_top, right_bottom, left_bottom = textures.ambient.reshape(-1, 4)[placement].T / 255
    x, y = np.clip(place.T * 0.5 + 0.5, 0, 1)
    top, bottom = left_top + x * (right_top - left_top), left_bottom + x * (right_bottom - left_bottom)
    return np.asarray(top + y * (bottom - top))


def _nothing(count: int) -> Hits:
    return Hits(
        along=np.ones(count),
        placement=np.full(count, -1, np.int32),
        place=np.zeros((count, 2)),
        uv=np.zeros((count, 2)),
        lod=np.zeros(count),
        away=np.zeros(count),
        behind=np.zeros(count, bool),
    )


def _meet(leaves: Leaves, images: Images, rays: Rays, dither: float, placement: Ints, ray: Longs, hits: Hits) -> None:
    """Move hits to leaves that lie before them: one leaf and placement for each of the rays, numbers `ray` (N,)."""
    origin = np.einsum("ni,nij->nj", rays.start - leaves.centers, leaves.frames) / leaves.scales[:, None]
    go = np.einsum("ni,nij->nj", rays.way, leaves.frames) / leaves.scales[:, None]
    origin, go, enter, leave = _meet_box(leaves, origin, go)
    behind = go[:, 2] < 0
    size = leaves.halves[:, :2]

    image = np.where(behind[:, None], leaves.back, leaves.front)
    height, width = images.color[0].shape[:2]
    texels = image[:, 2:] * (width, height)
    sample = (rays.spread[:, 1] + (rays.spread[:, 0] - rays.spread[:, 1]) * enter) / leaves.scales
    most = np.clip(np.log2(np.maximum(texels.min(axis=1), 1)) - 2, 0, MOST_LOD)  # the image is four texels wide there
    lod = np.clip(np.log2(np.maximum(sample * (texels / size).max(axis=1) / 2, 1e-6)), 0, most)
    inner = np.minimum(0.5 * np.exp2(np.ceil(lod))[:, None] / (width, height), image[:, 2:] / 2)
    flip = np.where(leaves.mirrored[:, None], (-0.5, 0.5), (0.5, 0.5))

    def in_image(place: Doubles) -> Doubles:
        unit = np.clip(flip * place / size + 0.5, 0, 1)
        return np.asarray(image[:, :2] + np.clip(unit * image[:, 2:], inner, image[:, 2:] - inner))

    def behind_relief(along: Doubles) -> Doubles:
        point = origin + along[:, None] * go
        bump = sample_texture(images.normal, in_image(point[:, :2]), np.zeros(len(point)))[:, 2]
        return np.asarray(point[:, 2] + (bump * 2 - 1) * leaves.halves[:, 2])

    # The first step in which the ray changes sides of the relief, and where in it.
    flat = leaves.rod | (leaves.halves[:, 2] == 0)
    along, found, before = enter.copy(), flat.copy(), behind_relief(enter)
    stride = (leave - enter) / RELIEF_STEPS
    for _ in range(RELIEF_STEPS):
        after = behind_relief(along + stride)
        turns = ~found & ((before < 0) != (after < 0))
        behind = np.where(turns, before > 0, behind)
        along += stride * np.where(turns, before / np.where(turns, before - after, 1), np.where(found, 0, 1))
        found |= turns
        before = after
    place = origin[:, :2] + along[:, None] * go[:, :2]
    uv = in_image(place)
    level = np.minimum(lod.astype(int), 3)
    rows = np.arange(len(lod))
    low, high = leaves.thresholds[rows, level], leaves.thresholds[rows, level + 1]
    threshold = low + (high - low) * (lod - level) + (2 * dither - 1) * SOFTNESS * np.minimum(lod, 1)
    opaque = leaves.rod | (sample_texture(images.color, uv, lod)[:, 3] >= threshold)
    meets = found & opaque & (enter <= leave) & (image[:, 2] > 0) & (along > 0) & (along < hits.along[ray])
    meets &= (np.abs(place) <= size).all(axis=1)
    away = rays.start[:, 2] + along * rays.way[:, 2]
    met = Hits(along, placement, place / size, uv, lod, away, behind)
    for name, values in vars(met).items():
        getattr(hits, name)[ray[meets]] = values[meets]


def _meet_box(leaves: Leaves, origin: Doubles, go: Doubles) -> tuple[Doubles, Doubles, Doubles, Doubles]:
    """Where rays in leaves' frames are in their boxes: origin and way (N, 3), and the parameters in and out (N,).

    Of a rod, which turns about its axis until it faces the ray, both parameters are where it stands, and the ray is
    that of a flat leaf across it.
    """
    inverse = 1 / np.where(np.abs(go) < 1e-12, 1e-12, go)
    ends = np.sort(np.stack([(-leaves.halves - origin) * inverse, (leaves.halves - origin) * inverse]), axis=0)
    enter, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    across = go[:, [0, 2]]
    facing = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    stands = -(origin[:, [0, 2]] * facing).sum(axis=1) / np.maximum((across * facing).sum(axis=1), 1e-12)
    point = origin + stands[:, None] * go
    aside = point[:, 0] * facing[:, 1] - point[:, 2] * facing[:, 0]
    rod, towards = leaves.rod[:, None], np.array([0.0, 0.0, 1.0])
    return (
        np.where(rod, np.stack([aside, point[:, 1], np.zeros(len(point))], axis=1), origin),
        np.where(rod, towards, go),
        np.where(leaves.rod, stands, enter),
        np.where(leaves.rod, stands, leave),
    )


def sample_texture(mips: Sequence[Bytes], uv: Doubles, lod: Doubles) -> Doubles:
    """Texture values (N, 4) in 0..1 at uv (N, 2), trilinear, clamped to the edge; sRGB is not decoded."""
    low = np.minimum(np.floor(lod).astype(int), len(mips) - 1)
    high = np.minimum(low + 1, len(mips) - 1)
    result = np.zeros((len(uv), 4))
    for level in np.unique(np.concatenate([low, high])):
        for at, weight in ((low, 1 - (lod - low)), (high, lod - low)):
            rows = np.flatnonzero(at == level)
            result[rows] += weight[rows, None] * _bilinear(mips[level], uv[rows])
    return result


def _bilinear(pixels: Bytes, uv: Doubles) -> Doubles:
    height, width = pixels.shape[:2]
    place = uv * (width, height) - 0.5
    corner = np.floor(place).astype(int)
    blend = place - corner
    x, y = (np.clip(np.stack([corner[:, i], corner[:, i] + 1]), 0, side - 1) for i, side in enumerate((width, height)))
    top, bottom = ((pixels[row, x].astype(np.float64) / 255) for row in y)
    rows = [(1 - blend[:, :1]) * each[0] + blend[:, :1] * each[1] for each in (top, bottom)]
    return np.asarray((1 - blend[:, 1:]) * rows[0] + blend[:, 1:] * rows[1])
