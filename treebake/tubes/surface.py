"""Welds a mesh and takes it apart into components: the topology that seams and flat shading hide."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from treebake.geometry import components
from treebake.model import Doubles, Floats, Ints, Longs, Mesh

_WELD = 1e-6  # vertices nearer than this part of the mesh's size are one


@dataclass(frozen=True, eq=False)
class Surface:
    """C components of a mesh, joined along the edges of exactly two faces of the same material and node.

    ids: (F,) the mesh's faces that have an area. faces: (F, 3) their welded corners; a vertex belongs to one component,
    so tubes that touch in a vertex, or along an edge of more faces, share nothing. positions: (V, 3) float64.
    comp: (V,) the component of each vertex. edges: (E, 2) and uses: (E,) how many faces meet there.
    """

    ids: Longs
    faces: Longs
    positions: Doubles
    comp: Longs
    count: int
    edges: Longs
    uses: Longs

    @property
    def face_comp(self) -> Longs:
        """(F,) the component of each face."""
        return self.comp[self.faces[:, 0]]


def find_surface(mesh: Mesh) -> Surface:
    """Weld coinciding vertices and find the components. O(V log V + F)."""
    corners = _weld(mesh.positions, mesh.faces)[mesh.faces]
    ids = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    corners = corners[ids]
    kind = mesh.face_material[ids].astype(np.int64) * (len(mesh.nodes) + 1) + mesh.face_node[ids]
    _, edge, uses = _edges(corners)
    begin = np.cumsum(uses) - uses
    pairs = (np.argsort(edge, kind="stable") // 3)[begin[uses == 2][:, None] + [0, 1]]
    pairs = pairs[kind[pairs[:, 0]] == kind[pairs[:, 1]]]
    face_comp = components(pairs.astype(np.int32), len(ids)).astype(np.int64)
    span = int(corners.max(initial=0)) + 1
    keys, inverse = np.unique(corners + span * face_comp[:, None], return_inverse=True)
    faces = inverse.reshape(-1, 3)
    positions = np.empty((len(keys), 3))
    positions[faces] = mesh.positions[mesh.faces[ids]]
    edges, _, uses = _edges(faces)
    count = int(face_comp.max(initial=-1)) + 1
    return Surface(ids, faces, positions, keys // span, count, edges, uses)


def _weld(positions: Floats, faces: Ints) -> Longs:
    """(V,) the merged vertex of each used one: coinciding ones, also where rounding moved them by 1e-6 of the size."""
    used = np.unique(faces)
    merged = np.zeros(len(positions), np.int64)
    if len(used):
        points, same = np.unique(positions[used], axis=0, return_inverse=True)
        reach = _WELD * float(np.ptp(points, axis=0).max())
        near = cKDTree(points).query_pairs(reach, output_type="ndarray")
        merged[used] = components(near.astype(np.int32), len(points))[same.ravel()]
    return merged


def scatter(values: Doubles, label: Longs, count: int) -> Doubles:
    """(count, ...) the sum of the rows of `values` that have each label."""
    columns = values.reshape(len(values), int(np.prod(values.shape[1:]))).T
    sums = [np.bincount(label, weights=column, minlength=count) for column in columns]
    return np.stack(sums, axis=1, dtype=np.float64).reshape(count, *values.shape[1:])


def _edges(faces: Longs) -> tuple[Longs, Longs, Longs]:
    """Undirected edges (E, 2); the edge from each corner to the next: (3 F,); how many faces meet at each: (E,)."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    span = int(faces.max(initial=0)) + 1
    keys, inverse, uses = np.unique(ends[:, 0] * span + ends[:, 1], return_inverse=True, return_counts=True)
    return np.stack([keys // span, keys % span], axis=1), inverse, uses
