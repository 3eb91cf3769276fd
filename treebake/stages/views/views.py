"""View impostors of one or several trees, all in one atlas ([I11])."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from treebake.brightness import fit_brightness
from treebake.checks import check, is_power_of_two
from treebake.crossed import crossed_cards
from treebake.geometry import join, turn_to
from treebake.gl.photo import Shot, photograph
from treebake.model import EMPTY_MESH, Doubles, Floats, Impostor, Ints, Mesh, Transmission, Tree, Views
from treebake.pictures import Part, compose, covered, place_pictures, trimmed
from treebake.stages.views.directions import hemi_octahedron, ring
from treebake.stages.views.support import support

_FIT_HEIGHT = 64  # pixels of the tree: the largest that views are for


@dataclass(frozen=True)
class ViewSettings:
    """From where a tree is photographed, and how finely."""

    enabled: bool = True  # bake view impostors
    layout: str = "hemi"  # "ring": pictures around the tree; "hemi": from all over the upper half, on a hemi-octahedron
    count: int = 8  # pictures of a ring, 2 to 64
    side: int = 8  # pictures along a side of the hemi-octahedron, 2 to 32
    layers: int = 2  # of each picture, one behind the other: what a nearer one hides shows from aside, 1 to 8
    texels: int = 64  # of the longest side of the largest tree, 16 to 1024; a picture askew may have some more
    atlas: int = 4096  # greatest side of the atlas in texels, a power of two, 64 to 16384
    gutter: int = 8  # texels kept free around each picture, a power of two: mips down to that size stay clean
    supersample: int = 4  # samples per texel each way, 1 to 4


def views(trees: Sequence[Tree], settings: ViewSettings) -> tuple[Impostor, ...]:
    """Photograph trees from all sides into one atlas that they share. O(pictures (faces + texels)).

    Texels are equally large on all trees. Raises SettingsError where a setting is out of range and BudgetError where
    the pictures exceed the atlas.
    """
    _check(settings)
    turns = ring(settings.count) if settings.layout == "ring" else hemi_octahedron(settings.side)
    wholes = [join(tree.trunk, tree.foliage) for tree in trees]
    texel = max(float(np.ptp(mesh.bounds, axis=0).max()) for mesh in wholes) / settings.texels or 1.0
    shots = [[shot for turn in turns for shot in _shots(mesh, turn, texel, settings.layers)] for mesh in wholes]
    photos = [
        photo
        for mesh, taken in zip(wholes, shots, strict=True)
        for photo in photograph(mesh, taken, settings.supersample)
    ]
    crops = np.array([trimmed(covered(photo)) for photo in photos], np.int32)
    shown = np.flatnonzero(crops[:, 2] > crops[:, 0])
    origins = np.zeros((len(crops), 2), np.int32)
    sizes = crops[shown, 2:] - crops[shown, :2]
    origins[shown], size = place_pictures(
        sizes, settings.gutter, settings.atlas, "views", "texels, layers, count or side"
    )
    parts = (
        Part(photos[number], (slice(top, bottom), slice(left, right)), (x, y))
        for number, (left, top, right, bottom), (x, y) in zip(
            shown.tolist(), crops[shown].tolist(), origins[shown].tolist(), strict=True
        )
    )
    atlas = compose(parts, size, settings.gutter, "views")
    made = []
    for number, (tree, mesh) in enumerate(zip(trees, wholes, strict=True)):
        own = slice(number * len(shots[0]), (number + 1) * len(shots[0]))
        center = mesh.bounds.astype(np.float64).mean(axis=0)
        points = mesh.positions[mesh.used].astype(np.float64) - center
        plain = Views(
            pictures=_table(shots[number], crops[own], origins[own], size, texel, center),
            layout=settings.layout,
            side=settings.count if settings.layout == "ring" else settings.side,
            layers=settings.layers,
            center=center,
            radius=float(np.linalg.norm(points, axis=1).max()),
            support=support(points),
            brightness=0.0,
            exposure=1.0,
            atlas=atlas,
            transmission=tree.transmission,
        )
        fitted = fit_brightness(plain, EMPTY_MESH, mesh, _FIT_HEIGHT)
        made.append(Impostor(fitted, _standard(mesh, texel, settings.supersample, tree.transmission)))
    return tuple(made)


def _check(settings: ViewSettings) -> None:
    rules = (
        ("layout", settings.layout in ("ring", "hemi"), '"ring" or "hemi"'),
        ("count", 2 <= settings.count <= 64, "2 to 64, for example 8"),
        ("side", 2 <= settings.side <= 32, "2 to 32, for example 12"),
        ("layers", 1 <= settings.layers <= 8, "1 to 8, for example 3"),
        ("texels", 16 <= settings.texels <= 1024, "16 to 1024, for example 128"),
        ("atlas", is_power_of_two(settings.atlas, 64, 16384), "a power of two from 64 to 16384"),
        ("gutter", is_power_of_two(settings.gutter, 1, 64), "a power of two from 1 to 64"),
        ("supersample", 1 <= settings.supersample <= 4, "1 to 4"),
    )
    check("views", settings, rules)


def _shots(mesh: Mesh, turn: Doubles, texel: float, layers: int) -> list[Shot]:
    """The layers of a mesh seen from one side, the nearest first, in texels of a given size.

    Layers hold equal areas of the mesh's triangles, whatever is hidden.
    """
    points = mesh.positions.astype(np.float64) @ turn.T
    low, high = points[mesh.used].min(axis=0), points[mesh.used].max(axis=0)
    size = np.maximum(np.ceil((high - low)[:2] / texel - 1e-6), 1)
    middle, half = (low + high)[:2] / 2, size * texel / 2
    room = 1e-3 * texel + 1e-5 * float((high - low)[2])
    depth = points[:, 2][mesh.faces]
    nearest, farthest, mean = depth.max(axis=1), depth.min(axis=1), depth.mean(axis=1)
    order = np.argsort(mean)
    share = np.cumsum(mesh.face_areas[order])
    inner = mean[order][np.searchsorted(share, share[-1] * np.arange(1, layers) / layers)]
    edges = [float(low[2]) - room]
    for edge in inner.tolist():  # what lies exactly at an edge is in front of it, and no layer is without depth
        edges.append(max(edge - room / 2, edges[-1] + room / (2 * layers)))
    edges.append(float(high[2]) + room)
    return [
        Shot(
            turn=turn,
            low=np.append(middle - half, edges[layer]),
            high=np.append(middle + half, edges[layer + 1]),
            size=(int(size[0]), int(size[1])),
            faces=np.zeros(0, np.int32),
            cut=np.flatnonzero((nearest >= edges[layer]) & (farthest < edges[layer + 1])).astype(np.int32),
            slab=(edges[layer], edges[layer + 1]),
        )
        for layer in reversed(range(layers))
    ]


def _standard(mesh: Mesh, texel: float, supersample: int, transmission: Transmission | None) -> Mesh:
    """Two crossed cards that any viewer draws."""
    taken = [_shots(mesh, turn_to(0.0, azimuth), texel, layers=1)[0] for azimuth in (0.0, 90.0)]
    middle = mesh.bounds.astype(np.float64).mean(axis=0)
    depths = np.array([float((shot.turn @ middle)[2]) for shot in taken])
    return crossed_cards(taken, list(photograph(mesh, taken, supersample)), depths, "views", transmission)


def _table(
    shots: Sequence[Shot], crops: Ints, origins: Ints, size: tuple[int, int], texel: float, center: Doubles
) -> Floats:
    """A row per picture, in the frame of its shot, from the tree's center."""
    table = np.zeros((len(shots), 5, 4), np.float32)
    for row, shot, (left, top, right, bottom), (x, y) in zip(table, shots, crops, origins, strict=True):
        middle = shot.turn @ center
        low, high = shot.low - middle, shot.high - middle
        row[:3, :3] = shot.turn
        row[:3, 3] = 0, low[2], high[2]
        if right == left:
            continue  # shows nothing
        row[3] = low[0] + left * texel, high[1] - bottom * texel, low[0] + right * texel, high[1] - top * texel
        row[4] = np.array([x, y + bottom - top, x + right - left, y]) / [*size, *size]
    return table
