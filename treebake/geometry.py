"""Geometry that more than one room needs: numpy and scipy only, arrays in and out."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from treebake.model import Doubles, Floats, Ints, Mesh, Morph


def weld(positions: Floats) -> Ints:
    """Give vertices at exactly the same place the same id: (V,) int32, ids 0..W-1.

    positions: (V, 3) float32. Seams in normals or uvs repeat a position to the bit, so no tolerance is needed, and
    none fuses what merely lies close. O(V log V).
    """
    bits = (np.ascontiguousarray(positions, np.float32) + np.float32(0)).view(np.uint32).astype(np.uint64)  # no -0
    plane = _ranks((bits[:, 0] << np.uint64(32)) | bits[:, 1])
    return _ranks((plane << np.uint64(32)) | bits[:, 2]).astype(np.int32)


def _ranks(keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    return np.unique(keys, return_inverse=True)[1].astype(np.uint64)


def components(links: Ints, count: int) -> Ints:
    """Label what hangs together: (count,) int32 in 0..C-1, numbered by first appearance.

    links: (L, K) ids in 0..count-1; all K ids of a row hang together, as the welded corners of a face do. O(L K).
    """
    first = np.repeat(links[:, :1], links.shape[1] - 1, axis=1).reshape(-1)
    others = links[:, 1:].reshape(-1)
    graph = coo_array((np.ones(len(first), np.int8), (first, others)), shape=(count, count))
    labels: Ints = connected_components(graph, directed=False)[1].astype(np.int32)
    return labels


def shared_edges(welded: Ints) -> Ints:
    """The pairs of half-edges on one edge: (P, 2) int32, half-edge 3 f + i runs from corner i of face f to the next.

    welded: (F, 3) int32 welded vertex ids. An edge of two faces gives one pair, one of k faces up to 3 (k - 2).
    O(F log F).
    """
    ends = np.sort(np.stack([welded, np.roll(welded, -1, axis=1)], axis=2).reshape(-1, 2), axis=1).astype(np.int64)
    keys = ends[:, 0] << 32 | ends[:, 1]
    order = np.argsort(keys, kind="stable").astype(np.int32)
    keys = keys[order]
    pairs = []
    for step in (1, 2, 3):  # enough for two coincident sheets, whose edges have four half-edges
        same = keys[step:] == keys[:-step]
        pairs.append(np.stack([order[:-step][same], order[step:][same]], axis=1))
    return np.concatenate(pairs)


def triangulate(positions: Floats, corners: Ints, sizes: Ints) -> Ints:
    """Split polygons into triangles in the same order: (sum of size - 2, 3) int32.

    positions: (V, 3). corners: (sum of sizes,) int32 into positions, polygon after polygon. sizes: (P,) int32; one
    below 3 gives nothing. Convex polygons become fans, vectorised; others are cut ear by ear, one at a time.
    """
    starts = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    targets = np.cumsum(counts) - counts
    triangles = np.empty((int(counts.sum()), 3), np.int32)
    for size in np.unique(sizes[sizes >= 3]):
        which = np.flatnonzero(sizes == size)
        polygons = corners[starts[which, None] + np.arange(size)]
        fan = np.stack([np.zeros(size - 2, int), np.arange(1, size - 1), np.arange(2, size)], axis=1)
        local = np.tile(fan, (len(which), 1, 1))
        for i, outline in _concave(positions[polygons]):
            local[i] = _ears(outline)
        rows = targets[which, None] + np.arange(size - 2)
        triangles[rows] = np.take_along_axis(polygons[:, None, :], local, axis=2)
    return triangles


def _concave(outlines: Floats) -> list[tuple[int, Doubles]]:
    """The outlines (P, N, 3) that turn back somewhere: their number and (N, 2) projection to their own plane."""
    points = outlines.astype(np.float64)
    points -= points[:, :1]
    following = np.roll(points, -1, axis=1)
    normals = np.cross(points, following).sum(axis=1)
    edges = following - points
    turns = np.einsum("pni,pi->pn", np.cross(np.roll(edges, 1, axis=1), edges), normals)
    scale = np.einsum("pi,pi->p", normals, normals)
    found = np.flatnonzero((turns < -1e-6 * scale[:, None]).any(axis=1))
    # The projection along the largest component of the normal, cyclic so that it keeps the winding up to its sign.
    axes = np.abs(normals[found]).argmax(axis=1)
    result = []
    for i, axis in zip(found, axes, strict=True):
        flat = points[i][:, [(axis + 1) % 3, (axis + 2) % 3]]
        result.append((int(i), flat if normals[i, axis] > 0 else flat * (1, -1)))
    return result


def _ears(outline: Doubles) -> NDArray[np.int64]:
    """Cut a counter-clockwise simple polygon (N, 2) into N - 2 triangles; O(N^3), for the few concave ones."""

    def cross(a: int, b: int, c: int) -> float:
        (ux, uy), (vx, vy) = outline[b] - outline[a], outline[c] - outline[a]
        return float(ux * vy - uy * vx)

    def is_ear(a: int, b: int, c: int) -> bool:
        inside = (p for p in ring if p not in (a, b, c))
        return cross(a, b, c) > 0 and not any(min(cross(a, b, p), cross(b, c, p), cross(c, a, p)) >= 0 for p in inside)

    ring, ears = list(range(len(outline))), []
    while len(ring) > 3:
        corners = [(ring[i - 1], ring[i], ring[(i + 1) % len(ring)]) for i in range(len(ring))]
        ear = next((corner for corner in corners if is_ear(*corner)), corners[1])
        ears.append(ear)
        ring.remove(ear[1])
    return np.array([*ears, ring])


def crease_normals(positions: Floats, faces: Ints, crease: float) -> tuple[Floats, Ints, Ints]:
    """Area-weighted vertex normals, smooth except across edges that bend more than `crease` degrees.

    positions: (V, 3). faces: (F, 3) int32. Vertices at the same place count as one, and a vertex on a crease is split.
    Returns normals (N, 3) float32, unit (+Y where the area is zero), the vertex that each stems from (N,) int32, and
    the faces re-indexed into these N: (F, 3) int32. O(F log F).
    """
    welded = weld(positions)[faces]
    a, b, c = (positions[faces[:, i]].astype(np.float64) for i in range(3))
    areas = np.cross(b - a, c - a)
    units = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-300)
    one, other = shared_edges(welded).T
    smooth = np.einsum("ni,ni->n", units[one // 3], units[other // 3]) > np.cos(np.radians(crease))
    one, other = one[smooth], other[smooth]
    # The corners at both ends of a smooth edge join; two half-edges run the same way or, more often, opposite ways.
    following = np.arange(faces.size).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    opposite = welded.reshape(-1)[one] != welded.reshape(-1)[other]
    starts = np.stack([one, np.where(opposite, following[other], other)], axis=1)
    ends = np.stack([following[one], np.where(opposite, other, following[other])], axis=1)
    links = np.concatenate([starts, ends])
    groups = components(links.astype(np.int32), faces.size)
    sums = np.stack([np.bincount(groups, np.repeat(areas[:, i], 3)) for i in range(3)], axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    normals = np.where(lengths > 0, sums / np.maximum(lengths, 1e-300), (0, 1, 0))
    pairs, inverse = np.unique(faces.reshape(-1).astype(np.int64) * (len(sums) + 1) + groups, return_inverse=True)
    source, group = np.divmod(pairs, len(sums) + 1)
    return normals[group].astype(np.float32), source.astype(np.int32), inverse.reshape(-1, 3).astype(np.int32)


def reject(vectors: Doubles, axes: Doubles) -> Doubles:
    """What is left of vectors (N, 3) at right angles to unit axes (N, 3): (N, 3) float64."""
    rest: Doubles = vectors - axes * (vectors * axes).sum(axis=1, keepdims=True)
    return rest


def texture_axes(places: Doubles, uvs: Doubles) -> tuple[Doubles, Doubles, Doubles]:
    """How texture coordinates lie on triangles with corners at places (F, 3, 3) and uvs (F, 3, 2).

    Returns the directions of growing u and of growing v, (F, 3) float64, and (F,) twice the area on the texture, below
    0 where it is wound the other way; both are lengths per u and per v times its size, zero where it is 0.
    """
    (e1, e2), (d1, d2) = ((x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) for x in (places, uvs))
    area: Doubles = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    turn = np.sign(area)[:, None]
    return (e1 * d2[:, 1:] - e2 * d1[:, 1:]) * turn, (e2 * d1[:, :1] - e1 * d2[:, :1]) * turn, area


def turn_to(elevation: float, azimuth: float) -> Doubles:
    """The world's axes as seen by who looks at its origin: (3, 3) float64, rows right, up, towards the viewer.

    elevation: degrees above the horizon. azimuth: degrees from +Z towards +X; it tells right from left straight from
    above too.
    """
    up, around = np.radians([elevation, azimuth])
    towards = np.array([np.cos(up) * np.sin(around), np.sin(up), np.cos(up) * np.cos(around)])
    right = np.array([np.cos(around), 0.0, -np.sin(around)])
    return np.stack([right, np.cross(towards, right), towards])


def corner_occlusion(mesh: Mesh) -> Floats:
    """The part of the sky that the corners of each face see: (F, 3) float32, ones where it is not known."""
    return np.ones(mesh.faces.shape, np.float32) if mesh.occlusion is None else mesh.occlusion[mesh.faces]


def join(first: Mesh, second: Mesh) -> Mesh:
    """Both meshes in one; materials and nodes that they share stay shared.

    Where only one can morph the other stays; where only one is occluded the other sees the whole sky.
    """
    materials = first.materials + tuple(m for m in second.materials if m not in first.materials)
    nodes = first.nodes + tuple(n for n in second.nodes if n not in first.nodes)
    material = np.array([materials.index(m) for m in second.materials], np.int32)
    node = np.array([nodes.index(n) for n in second.nodes], np.int32)
    return Mesh(
        positions=np.concatenate([first.positions, second.positions]),
        normals=np.concatenate([first.normals, second.normals]),
        uvs=np.concatenate([first.uvs, second.uvs]),
        faces=np.concatenate([first.faces, second.faces + np.int32(len(first.positions))]),
        face_material=np.concatenate([first.face_material, material[second.face_material]]),
        face_node=np.concatenate([first.face_node, node[second.face_node]]),
        materials=materials,
        nodes=nodes,
        morph=_joined_morph(first, second),
        occlusion_uvs=_joined(first.occlusion_uvs, second.occlusion_uvs, first.uvs, second.uvs),
        occlusion=_joined(
            first.occlusion, second.occlusion, *(np.ones(len(m.uvs), np.float32) for m in (first, second))
        ),
    )


def _joined(first: Floats | None, second: Floats | None, first_own: Floats, second_own: Floats) -> Floats | None:
    """What vertices have, with what stands for it in a mesh that lacks it; None where both do."""
    if first is None and second is None:
        return None
    return np.concatenate([first_own if first is None else first, second_own if second is None else second])


def _joined_morph(first: Mesh, second: Mesh) -> Morph | None:
    if first.morph is None and second.morph is None:
        return None
    a, b = (mesh.morph or Morph(mesh.positions, mesh.normals) for mesh in (first, second))
    return Morph(np.concatenate([a.positions, b.positions]), np.concatenate([a.normals, b.normals]))
