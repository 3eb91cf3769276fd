"""Patches: the faces of a mesh in labelled groups, measured, and cut until each is near-planar."""

from dataclasses import dataclass

import numpy as np

from treebake.geometry import components, shared_edges, weld
from treebake.model import Doubles, Floats, Ints, Mesh

_COPLANAR = np.cos(np.radians(2.0))  # faces that bend less along their common edge lie in one facet
_CREASED = np.cos(np.radians(10.0))  # faces that bend more have a crease between them, not a smooth curve
_ROUNDS = 16  # of bisection at most; a sphere takes four
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Patches:
    """N groups of faces, measured.

    centers: (N, 3) float64, area-weighted. normals: (N, 3) float64, unit. areas: (N,) float64. radii: (N,) float64,
    from the centre to the farthest vertex. resultants: (N,) float64, length of the area-weighted mean normal: 1 for a
    plane, 0 for a closed or tubular surface. bends: (N,) float64, 1 - mean (n.m)^2 over the patch, m the direction
    that makes it least: 0 for a plane, 1/2 for a tube, 2/3 for a sphere; the sides of a sheet count alike.
    """

    centers: Doubles
    normals: Doubles
    areas: Doubles
    radii: Doubles
    resultants: Doubles
    bends: Doubles


def measure(positions: Floats, faces: Ints, labels: Ints) -> Patches:
    """Measure patches; positions: (V, 3), faces: (F, 3), labels: (F,) int32 in 0..N-1, each used. O(F)."""
    count = int(labels.max(initial=-1)) + 1
    units, face_areas = _face_normals(positions, faces)
    areas = np.maximum(_total(labels, face_areas, count), _TINY)
    corners = [positions[faces[:, i]] for i in range(3)]
    centers = _sums(labels, (corners[0] + corners[1] + corners[2]) / 3, count, face_areas) / areas[:, None]
    radii = np.zeros(count)
    for corner in corners:
        np.maximum.at(radii, labels, np.linalg.norm(corner - centers[labels], axis=1))
    means = _sums(labels, units, count, face_areas) / areas[:, None]
    resultants = np.linalg.norm(means, axis=1)
    normals, bends = _spread(units, face_areas, labels, means, resultants)
    return Patches(centers, normals, areas, radii, resultants, bends)


def _face_normals(positions: Floats, faces: Ints) -> tuple[Doubles, Doubles]:
    """Unit normals (F, 3), zero for a face without area, and areas (F,)."""
    a, b, c = (positions[faces[:, i]].astype(np.float64) for i in range(3))
    crosses = np.cross(b - a, c - a)
    lengths = np.linalg.norm(crosses, axis=1)
    return crosses / np.maximum(lengths, _TINY)[:, None], lengths / 2


def _total(labels: Ints, values: Floats | Doubles, count: int) -> Doubles:
    return np.bincount(labels, values, count).astype(np.float64)  # bincount of nothing is int


def _sums(labels: Ints, vectors: Floats | Doubles, count: int, weights: Doubles | float = 1.0) -> Doubles:
    return np.stack([_total(labels, vectors[:, i] * weights, count) for i in range(vectors.shape[1])], axis=1)


def _spread(
    units: Doubles, areas: Doubles, labels: Ints, means: Doubles, resultants: Doubles
) -> tuple[Doubles, Doubles]:
    """The normals and bends of patches; the mean normal stands where it is already close to the best direction.

    Mean (n.m)^2 >= (mean n.m)^2, so only patches with a small mean normal need eigenvectors.
    """
    bends = 1 - resultants**2
    normals = means / np.maximum(resultants, _TINY)[:, None]
    open_patch = bends > 0.02
    rank = np.cumsum(open_patch) - 1
    chosen = open_patch[labels]
    row, n, w, count = rank[labels[chosen]], units[chosen], areas[chosen], int(open_patch.sum())
    moments = np.stack([_sums(row, n * n[:, i, None], count, w) for i in range(3)], axis=1)
    moments /= _total(row, w, count)[:, None, None]
    values, vectors = np.linalg.eigh(moments)
    bends[open_patch] = 1 - values[:, 2]
    hollow = resultants[open_patch] < 0.2  # a sheet with two sides, or a closed surface, has no mean normal to speak of
    normals[np.flatnonzero(open_patch)[hollow]] = vectors[hollow, :, 2]
    return normals, bends


def cut_into_leaves(mesh: Mesh, bend: float, large: float) -> Ints:
    """Label the smallest near-planar patches: (F,) int32, numbered by first appearance.

    A welded component that bends no more than `bend` is one leaf, whatever it is made of; one with a radius above
    `large` units may bend less in proportion. One that bends more is cut, as far as needed: into pieces that hang
    together by edges, not just corners; into its facets, where it is a clump of flat cards; and else, being curved, by
    halves of its normals until they are flat enough. O(F log F).
    """
    welded = weld(mesh.positions)[mesh.faces]
    labels = np.empty(mesh.triangles, np.int32)
    pending, done = np.arange(mesh.triangles), 0
    patch = components(welded, int(welded.max(initial=-1)) + 1)[welded[:, 0]]
    for cut in (_whole, _into_pieces, _into_cards, *[_in_halves] * _ROUNDS):
        faces = mesh.faces[pending]
        patch = by_first(cut(welded[pending], _face_normals(mesh.positions, faces)[0], patch))
        labels[pending] = patch + done
        done += int(patch.max(initial=-1)) + 1
        found = measure(mesh.positions, faces, patch)
        bent = (found.bends > bend * np.minimum(1, large / np.maximum(found.radii, _TINY)))[patch]
        pending, patch = pending[bent], by_first(patch[bent])
        if not len(pending):
            break
    return by_first(labels)


def by_first(labels: Ints) -> Ints:
    """The same labels renumbered 0..N-1 in the order in which they first appear."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return rank[inverse]


# Each cut takes welded corners (F, 3), unit normals (F, 3) and the patch (F,) of its faces; it gives a finer patch.


def _whole(_welded: Ints, _units: Doubles, patch: Ints) -> Ints:
    return patch


def _into_pieces(welded: Ints, _units: Doubles, patch: Ints) -> Ints:
    pairs = shared_edges(welded) // 3
    return components(pairs[patch[pairs[:, 0]] == patch[pairs[:, 1]]], len(patch))


def _into_cards(welded: Ints, units: Doubles, patch: Ints) -> Ints:
    """The facets of creased patches, which clumps of cards are; a smoothly curved patch stays whole.

    A facet is what is coplanar, and else a quad that is not: two triangles in a row that share an edge.
    """
    pairs = shared_edges(welded) // 3
    pairs = pairs[patch[pairs[:, 0]] == patch[pairs[:, 1]]]
    one, other = pairs.T
    cosines = np.abs(np.einsum("pi,pi->p", units[one], units[other]))
    coplanar = cosines > _COPLANAR
    single = np.ones(len(patch), bool)
    single[pairs[coplanar]] = False
    in_a_row = single[one] & single[other] & (other - one == 1) & (_place_in_patch(patch)[one] % 2 == 0)
    facets = components(pairs[coplanar | in_a_row], len(patch))
    count = int(patch.max()) + 1
    smooth = np.bincount(patch[one[~coplanar & (cosines > _CREASED)]], minlength=count)
    creased = smooth < 0.1 * np.bincount(patch[one], minlength=count)
    return np.where(creased[patch], facets + count, patch).astype(np.int32)


def _place_in_patch(patch: Ints) -> Ints:
    """How many faces of its patch come before each face."""
    order = np.argsort(patch, kind="stable")
    sizes = np.bincount(patch)
    places = np.empty(len(patch), np.int32)
    places[order] = np.arange(len(patch)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return places


def _in_halves(welded: Ints, units: Doubles, patch: Ints) -> Ints:
    """Halve each patch where its normals spread most, and keep apart what the halving tears."""
    count = int(patch.max()) + 1
    sizes = np.bincount(patch, minlength=count)[:, None]
    offsets = units - (_sums(patch, units, count) / sizes)[patch]
    moments = np.stack([_sums(patch, offsets * offsets[:, i, None], count) for i in range(3)], axis=1)
    axes = np.linalg.eigh(moments)[1][:, :, 2]
    side = np.einsum("fi,fi->f", offsets, axes[patch]) > 0
    return _into_pieces(welded, units, (2 * patch + side).astype(np.int32))
