"""Tubes: the grids of vertices that tree generators sweep along every branch, read back from a mesh.

A tube is told by topology alone (`ladder.py`). Texture seams and flat shading split a vertex in the index buffer and
vanish in the weld (`surface.py`). Everything is vectorised over tubes; time and memory are O(V log V + F).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from treebake.model import Doubles, Ints, Longs, Mesh
from treebake.tubes.ladder import Mask, find_ladder
from treebake.tubes.surface import Surface, find_surface, scatter

_SEAM = 1e-5  # texture coordinates farther apart than this are different


@dataclass(frozen=True, eq=False)
class Rings:
    """R closed polygons, each a run of samples whose last repeats the first, with its own texture coordinates there.

    first: (R + 1,) offsets into the samples. positions, normals: (S, 3) float64. uvs: (S, 2) float64. occlusion: (S,)
    float64, as in Mesh; ones where it is not known.
    fractions: (S,) float64, part of the perimeter walked, 0 to 1. centers: (R, 3) float64, of the perimeter.
    perimeters: (R,) float64; 0 for a ring that is a point, which has two equal samples.
    """

    first: Longs
    positions: Doubles
    normals: Doubles
    uvs: Doubles
    occlusion: Doubles
    fractions: Doubles
    centers: Doubles
    perimeters: Doubles

    @property
    def sides(self) -> Longs:
        """(R,) number of sides, 1 for a point."""
        return np.diff(self.first) - 1

    @property
    def radii(self) -> Doubles:
        """(R,) half the mean width over all directions: the perimeter over 2 pi for a convex ring (Cauchy)."""
        return self.perimeters / (2 * np.pi)


@dataclass(frozen=True, eq=False)
class Tubes:
    """T tubes of a mesh; the rings of a tube follow each other from base to tip.

    rings: all rings. first: (T + 1,) offsets into the rings. mirrored: (T,) bool, the texture runs around and back
    again, so that only an even number of sides can show it. caps: the rings of closed ends once more, with the cap's
    attributes. cap_ring: (K,) the ring that each cap closes. material, node: (T,) int32 into the mesh's. face_ring:
    (F,) int64, the base ring of each face's section, a cap's own ring, -1 for the faces of no tube.
    """

    rings: Rings
    first: Longs
    mirrored: Mask
    caps: Rings
    cap_ring: Longs
    material: Ints
    node: Ints
    face_ring: Longs

    @property
    def count(self) -> int:
        """The number of tubes."""
        return len(self.first) - 1

    @cached_property
    def tube(self) -> Longs:
        """(R,) the tube of each ring."""
        return np.repeat(np.arange(self.count), np.diff(self.first))

    @cached_property
    def steps(self) -> Doubles:
        """(R,) length from each ring's centre to the next one's; 0 at the last ring of a tube."""
        step = np.zeros(len(self.tube))
        step[:-1] = np.linalg.norm(np.diff(self.rings.centers, axis=0), axis=1)
        step[self.first[1:] - 1] = 0
        return step

    @cached_property
    def along(self) -> Doubles:
        """(R,) length of the centreline from the tube's base."""
        total = np.cumsum(self.steps) - self.steps
        return np.asarray(total - total[self.first[:-1]][self.tube])


def find_tubes(mesh: Mesh) -> Tubes:
    """Find the tubes among the components of a mesh.

    Rings run as their faces are wound: counter-clockwise seen from the tip where faces point outwards. Each starts on
    the texture's seam or, without one, straight above the start of the ring below. Texture coordinates that restart or
    turn back on the way along (some generators mirror the tile on every section) are unfolded, which a repeating
    texture allows.
    """
    surface = find_surface(mesh)
    ladder = find_ladder(surface)
    on = np.flatnonzero(ladder.level >= 0)
    members, owner = np.unique(surface.comp[on], return_inverse=True)
    depth = np.zeros(len(members), np.int64)
    np.maximum.at(depth, owner, ladder.level[on] + 1)
    first = np.concatenate([[0], np.cumsum(depth)])
    ring = np.full(len(surface.positions), -1)
    ring[on] = first[owner] + ladder.level[on]
    sides = np.bincount(ring[on], minlength=first[-1])

    raw = np.take_along_axis(mesh.faces[surface.ids[ladder.side]], ladder.turn, axis=1)
    corner = np.take_along_axis(surface.faces[ladder.side], ladder.turn, axis=1)
    uv = mesh.uvs[raw].astype(np.float64)
    leave, arrive = np.zeros((2, len(ring), 2))  # where the ring edge that starts at a vertex starts and ends
    up, down = ladder.rising, ~ladder.rising
    leave[corner[down, 1]], arrive[corner[down, 1]] = uv[down, 1], uv[down, 0]
    leave[corner[up, 0]], arrive[corner[up, 0]] = uv[up, 0], uv[up, 1]
    start, mirrored = _starts(surface, ladder.after, ring, first, leave, arrive)
    order, offsets = _walk(start, ladder.after, sides)
    uvs = leave[order]
    uvs[offsets[1:] - 1] = arrive[order[offsets[1:] - 2]]
    uvs = _unfold(uvs, offsets, first, ring[corner], uv)
    normals = scatter(mesh.normals[raw].reshape(-1, 3).astype(np.float64), corner.ravel(), len(ring))
    sky = np.ones(len(mesh.positions)) if mesh.occlusion is None else mesh.occlusion.astype(np.float64)
    occlusion = _means(sky[raw.ravel()], corner.ravel(), len(ring))

    flat = surface.faces[ladder.flat]
    cap_raw = mesh.faces[surface.ids[ladder.flat]].ravel()
    shares = np.maximum(np.bincount(flat.ravel(), minlength=len(ring)), 1)[:, None]
    cap_uvs = scatter(mesh.uvs[cap_raw].astype(np.float64), flat.ravel(), len(ring)) / shares
    cap_occlusion = _means(sky[cap_raw], flat.ravel(), len(ring))
    cap_normals = scatter(mesh.normals[cap_raw].astype(np.float64), flat.ravel(), len(ring))
    cap_ring = np.unique(ring[flat].max(axis=1, initial=-1))
    cap_order, cap_offsets = _walk(start[cap_ring], ladder.after, sides[cap_ring])

    face_ring = np.full(len(mesh.faces), -1)
    face_ring[surface.ids[ladder.side]] = np.minimum(ring[corner[:, 0]], ring[corner[:, 2]])
    face_ring[surface.ids[ladder.flat]] = ring[flat].max(axis=1, initial=-1)
    of_base = np.zeros(first[-1], np.int64)
    of_base[face_ring[surface.ids[ladder.side]]] = surface.ids[ladder.side]
    return Tubes(
        rings=_rings(offsets, surface.positions[order], normals[order], uvs, occlusion[order]),
        first=first,
        mirrored=mirrored,
        caps=_rings(
            cap_offsets,
            surface.positions[cap_order],
            cap_normals[cap_order],
            cap_uvs[cap_order],
            cap_occlusion[cap_order],
        ),
        cap_ring=cap_ring,
        material=mesh.face_material[of_base[first[:-1]]],
        node=mesh.face_node[of_base[first[:-1]]],
        face_ring=face_ring,
    )


def _starts(
    surface: Surface, after: Longs, ring: Longs, first: Longs, leave: Doubles, arrive: Doubles
) -> tuple[Longs, Mask]:
    """The vertex where each ring starts: (R,), and which tubes are mirrored: (T,)."""
    count = int(first[-1])
    on = np.flatnonzero(ring >= 0)
    seam = np.zeros(len(ring), np.bool_)
    seam[after[on]] = np.abs(leave[after[on]] - arrive[on]).max(axis=1) > _SEAM
    least, most = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(least, ring[on], leave[on])
    np.maximum.at(most, ring[on], leave[on])
    varied = (most - least).max(axis=1) > _SEAM
    around = leave[on, (most - least).argmax(axis=1)[ring[on]]]
    start = np.zeros(count, np.int64)
    order = on[np.lexsort([-around, seam[on], ring[on]])]
    start[ring[order]] = order  # the last written stays: on the seam, else where the texture is least
    seamed = np.zeros(count, np.bool_)
    seamed[ring[seam]] = True
    tube = np.repeat(np.arange(len(first) - 1), np.diff(first))
    folds = np.bincount(tube, weights=varied & ~seamed, minlength=len(first) - 1)
    mirrored = np.asarray(2 * folds > np.diff(first))
    free = ~varied & ~seamed
    free[first[:-1]] = False
    if free.any():
        above = _straight(surface, ring, count)
        level = np.arange(count) - first[tube]
        rows = np.flatnonzero(free)
        rows = rows[np.argsort(level[rows], kind="stable")]
        for batch in np.split(rows, np.flatnonzero(np.diff(level[rows])) + 1):
            start[batch] = above[start[batch - 1]]
    return start, mirrored


def _straight(surface: Surface, ring: Longs, count: int) -> Longs:
    """(V,) of the vertices that an edge joins to each on the next ring, the one that lies straightest above it."""
    on = ring >= 0
    shares = np.maximum(np.bincount(ring[on], minlength=count), 1)[:, None]
    center = scatter(surface.positions[on], ring[on], count) / shares
    local = np.where(on[:, None], surface.positions - center[ring], 0)
    local /= np.maximum(np.linalg.norm(local, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    ends = np.concatenate([surface.edges, surface.edges[:, ::-1]])
    ends = ends[(ring[ends[:, 0]] >= 0) & (ring[ends[:, 1]] == ring[ends[:, 0]] + 1)]
    order = np.argsort(np.einsum("ij,ij->i", local[ends[:, 0]], local[ends[:, 1]]), kind="stable")
    above = np.arange(len(ring))
    above[ends[order, 0]] = ends[order, 1]  # the last written, hence the straightest, stays
    return above


def _walk(start: Longs, after: Longs, sides: Longs) -> tuple[Longs, Longs]:
    """The vertices of each ring in order, the first one again at the end, and the offset of each ring: (R + 1,)."""
    offsets = np.concatenate([[0], np.cumsum(sides + 1)])
    order = np.empty(offsets[-1], np.int64)
    vertex, active = start, np.arange(len(start))
    for step in range(int(sides.max(initial=0)) + 1):
        active = active[sides[active] >= step]
        order[offsets[active] + step] = vertex[active]
        vertex = after[vertex]
    return order, offsets


def _unfold(uvs: Doubles, offsets: Longs, first: Longs, ring: Longs, uv: Doubles) -> Doubles:
    """Shift each ring's texture coordinates (S, 2) so that they run on along the tube; give points those of a ring.

    ring: (N, 3) and uv: (N, 3, 2) of the corners of the side faces, of which the first two lie on one ring.
    """
    count = int(first[-1])
    sides = np.diff(offsets) - 1
    section = np.minimum(ring[:, 0], ring[:, 2])
    counted = (sides[ring] == 1) | np.array([True, True, False])
    ends = []
    for upper in (0, 1):
        face, corner = np.nonzero(counted & (ring == section[:, None] + upper))
        total = np.maximum(np.bincount(section[face], minlength=count), 1)[:, None]
        ends.append(scatter(uv[face, corner], section[face], count) / total)
    below, above = ends
    rise = above - below  # zero at the last ring of a tube, which starts no section

    tube = np.repeat(np.arange(len(first) - 1), np.diff(first))
    main = scatter(np.abs(rise), tube, len(first) - 1).argmax(axis=1)[tube]
    sign = rise[np.arange(count), main]
    sign = np.where(np.abs(sign) > _SEAM, np.sign(sign), 0)
    signed = np.flatnonzero(sign)[::-1]
    way = np.ones(len(first) - 1)
    way[tube[signed]] = sign[signed]  # the last written, hence the first section's, stays
    rise = rise * np.where(sign == 0, 1, sign * way[tube])[:, None]
    wanted = np.cumsum(rise, axis=0) - rise
    wanted += (below[first[:-1]] - wanted[first[:-1]])[tube]
    last = first[1:] - 1
    mean = below.copy()
    mean[last] = above[last - 1]
    unfolded = uvs + np.repeat(wanted - mean, sides + 1, axis=0)
    for points, neighbour in ((last[sides[last] == 1], -1), (first[:-1][sides[first[:-1]] == 1], 1)):
        shift = np.zeros((len(points), 2))  # along the tube only: around, the source's tip has no place of its own
        rows = np.arange(len(points)), main[points]
        shift[rows] = (wanted[points] - wanted[points + neighbour])[rows]
        unfolded[offsets[points]] = unfolded[offsets[points + neighbour]] + shift
        unfolded[offsets[points] + 1] = unfolded[offsets[points + neighbour + 1] - 1] + shift
    return unfolded


def _means(values: Doubles, vertex: Longs, count: int) -> Doubles:
    """(count,) the mean of the values (N,) at each vertex; 0 where there is none."""
    return np.asarray(np.bincount(vertex, values, count) / np.maximum(np.bincount(vertex, minlength=count), 1))


def _rings(first: Longs, positions: Doubles, normals: Doubles, uvs: Doubles, occlusion: Doubles) -> Rings:
    count = len(first) - 1
    ring = np.repeat(np.arange(count), np.diff(first))
    steps = np.zeros(len(positions))
    steps[:-1] = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    steps[first[1:] - 1] = 0
    perimeters = np.bincount(ring, weights=steps, minlength=count).astype(np.float64)
    walked = np.cumsum(steps) - steps
    fractions = (walked - walked[first[:-1]][ring]) / np.where(perimeters > 0, perimeters, 1)[ring]
    fractions[first[1:] - 1] = 1
    middles = (positions + np.roll(positions, -1, axis=0)) / 2
    weights = np.where(perimeters[ring] > 0, steps, 1)
    weights[first[1:] - 1] = 0
    centers = scatter(middles * weights[:, None], ring, count) / np.bincount(ring, weights=weights)[:, None]
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return Rings(
        first=first,
        positions=positions,
        normals=normals / np.where(lengths > 0, lengths, 1),
        uvs=uvs,
        occlusion=occlusion,
        fractions=fractions,
        centers=centers,
        perimeters=perimeters,
    )
