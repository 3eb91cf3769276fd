"""Patches: the faces of a mesh in labelled groups, measured, and cut until each is near-planar."""

from dataclasses import dataclass

import numpy as np

from treebake.geometry import components, shared_edges, weld
from treebake.model import Doubles, Floats, Ints, Mesh

_COPLANAR = np.cos(np.radians(2.0))  # faces that bend less along their common edge lie in one facet
_CREASED = np.cos(np.radians(10.0))  # faces that bend more have a crease between them, not a smooth curve
_ROUNDS = 16  # of bisection; every round at least halves what bends


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
    corners = [positions[faces[:, i]] for i in range(3)]
    crosses = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    doubled = np.linalg.norm(crosses, axis=1)
    areas = _total(labels, doubled, count) / 2
    centroids = (corners[0] + corners[1] + corners[2]) / 3
    centers = _sums(labels, centroids, count, doubled) / (2 * areas[:, None])
    distances = np.max([np.linalg.norm(corner - centers[labels], axis=1) for corner in corners], axis=0, initial=0)
    radii = np.zeros(count)
    np.maximum.at(radii, labels, distances)
    means = _sums(labels, crosses, count) / (2 * areas[:, None])
    resultants = np.linalg.norm(means, axis=1)
    normals, bends = _spread(_units(positions, faces), doubled, labels, means, resultants)
    return Patches(centers, normals, areas, radii, resultants, bends)


def _units(positions: Floats, faces: Ints) -> Floats:
    a, b, c = (positions[faces[:, i]] for i in range(3))
    crosses = np.cross(b - a, c - a)
    units: Floats = crosses / np.linalg.norm(crosses, axis=1, keepdims=True)
    return units


def _total(labels: Ints, values: Floats | Doubles, count: int) -> Doubles:
    return np.bincount(labels, values, count).astype(np.float64)  # bincount of nothing is int


def _sums(labels: Ints, vectors: Floats | Doubles, count: int, weights: Floats | float = 1.0) -> Doubles:
    return np.stack([_total(labels, vectors[:, i] * weights, count) for i in range(vectors.shape[1])], axis=1)


def _spread(
    units: Floats, weights: Floats, labels: Ints, means: Doubles, resultants: Doubles
) -> tuple[Doubles, Doubles]:
    """The normals and bends of patches; the mean normal stands where it is already close to the best direction.

    Mean (n.m)^2 >= (mean n.m)^2, so only patches with a small mean normal need eigenvectors.
    """
    bends = 1 - resultants**2
    normals = means / np.maximum(resultants, 1e-300)[:, None]
    open_patch = bends > 0.02
    rank = np.cumsum(open_patch) - 1
    chosen = open_patch[labels]
    row, n, w, count = rank[labels[chosen]], units[chosen], weights[chosen], int(open_patch.sum())
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
    pending, patch, done = (
        np.arange(mesh.triangles),
        components(welded, int(welded.max(initial=-1)) + 1)[welded[:, 0]],
        0,
    )
    for cut in (_whole, _into_pieces, _into_cards, *[_in_halves] * _ROUNDS):
        faces = mesh.faces[pending]
        patch = by_first(cut(welded[pending], _units(mesh.positions, faces), patch))
        labels[pending] = patch + done
        done += int(patch.max(initial=-1)) + 1
        found = measure(mesh.positions, faces, patch)
        bent = (found.bends > bend * np.minimum(1, large / found.radii))[patch]
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


def _whole(_welded: Ints, _units: Floats, patch: Ints) -> Ints:
    return patch


def _into_pieces(welded: Ints, _units: Floats, patch: Ints) -> Ints:
    pairs = shared_edges(welded) // 3
    return components(pairs[patch[pairs[:, 0]] == patch[pairs[:, 1]]], len(patch))


def _into_cards(welded: Ints, units: Floats, patch: Ints) -> Ints:
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


def _in_halves(welded: Ints, units: Floats, patch: Ints) -> Ints:
    """Halve each patch where its normals spread most, and keep apart what the halving tears."""
    count = int(patch.max()) + 1
    sizes = np.bincount(patch, minlength=count)[:, None]
    offsets = units - (_sums(patch, units, count) / sizes)[patch]
    moments = np.stack([_sums(patch, offsets * offsets[:, i, None], count) for i in range(3)], axis=1)
    axes = np.linalg.eigh(moments)[1][:, :, 2]
    side = np.einsum("fi,fi->f", offsets, axes[patch]) > 0
    return _into_pieces(welded, units, (2 * patch + side).astype(np.int32))
