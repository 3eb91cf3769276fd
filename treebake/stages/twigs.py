"""Moves tubes too thin for the trunk's triangle budget into the foliage, as short straight pieces.

Twigs belong with the leaves in the sparse set of a tree ([J00] 2.1): they are thousands, no simplifier can take one
below a triangle, and a plane through a straight piece shows it as well as the mesh does ([GPSS07] 8).
"""

from dataclasses import dataclass, replace

import numpy as np

from treebake.checks import check
from treebake.geometry import join
from treebake.model import Doubles, Leaves, Longs, Mesh, Tree
from treebake.tubes.find import Tubes, find_tubes
from treebake.tubes.loft import loft
from treebake.tubes.plan import Plan, cost, plan, ring_errors, solid_share

_SIDES = 3  # of a piece; three sides are within 7 % of equally wide from everywhere, four within 18 %
_ROUNDS = 48  # bisections: more than the digits that matter
_ROWS = ("centers", "normals", "areas", "radii", "axes", "transforms")  # of Leaves, that hold no element numbers
_MOST_WIDER = 2.0  # a piece's width changes by no more than this factor to keep its silhouette


@dataclass(frozen=True)
class TwigSettings:
    """Which tubes move, and how they are cut."""

    trunk_triangles: int = 8000  # triangles that the trunk may have; the thinnest tubes move until the rest fits, > 0
    radius: float = -1.0  # tubes below this part of the tree's height move; 0 moves none, negative fits the budget
    thinnest: float = 0.0  # tubes below this part of the tree's height move, whatever the budget; 0 to 1
    detail: float = 0.001  # shift of the trunk's silhouette that counts as unseen, as a part of the tree's height, > 0
    length: float = 1.0  # of a piece, in median leaf diameters, > 0


def twigs(tree: Tree, settings: TwigSettings) -> Tree:
    """Move the thin outer sections of the trunk's tubes to the foliage; the tree itself where the trunk is modest.

    A tube is cut where it falls below the radius for good; the outer section leaves the trunk. Its centreline is cut
    into pieces of equal length, each one an element of the leaves with its direction as `axes`, a prism of three sides
    with the texture coordinates and smooth normals of the bark as geometry, and the area of its silhouette, 2 r L, as
    area. Nothing moves where there is no foliage to move to, or the trunk is within its budget and nothing too thin.

    Raises SettingsError where a setting is out of range.
    """
    _check(settings)
    mesh = tree.trunk
    modest = settings.radius < 0 and not settings.thinnest and mesh.triangles <= settings.trunk_triangles
    if tree.leaves.count == 0 or mesh.triangles == 0 or settings.radius == 0 or modest:
        return tree
    tubes = find_tubes(mesh)
    bounds = np.stack([tree.trunk.bounds, tree.foliage.bounds])
    height = float(bounds[:, 1, 1].max() - bounds[:, 0, 1].min())
    radius = settings.radius * height if settings.radius > 0 else _fitting_radius(mesh, tubes, height, settings)
    radius = max(radius, settings.thinnest * height)
    cut = _cuts(tubes, radius)
    if (cut == tubes.first[1:] - 1).all():
        return tree
    length = settings.length * 2 * float(np.median(tree.leaves.radii))
    pieces, leaves = _pieces(mesh, tubes, cut, length)
    ring = np.maximum(tubes.face_ring, 0)
    cut_here, last = cut[tubes.tube[ring]], tubes.first[1:][tubes.tube[ring]] - 1
    stays = (tubes.face_ring < 0) | (ring < cut_here) | (cut_here == last)
    foliage = join(tree.foliage, pieces)
    return replace(tree, trunk=mesh.select(stays), foliage=foliage, leaves=_append(tree.leaves, leaves))


def _check(settings: TwigSettings) -> None:
    rules = (
        ("trunk_triangles", settings.trunk_triangles > 0, "above 0"),
        ("radius", settings.radius <= 1, "at most 1"),
        ("thinnest", 0 <= settings.thinnest <= 1, "0 to 1"),
        ("detail", settings.detail > 0, "above 0"),
        ("length", settings.length > 0, "above 0"),
    )
    check("twigs", settings, rules)


def _cuts(tubes: Tubes, radius: float) -> Longs:
    """(T,) the ring from which on each tube is thinner than `radius`; its last where it never is."""
    thick = np.flatnonzero(tubes.rings.radii >= radius)
    cut = tubes.first[:-1].copy()
    np.maximum.at(cut, tubes.tube[thick], thick)
    return cut


def _fitting_radius(mesh: Mesh, tubes: Tubes, height: float, settings: TwigSettings) -> float:
    """The least radius that leaves a trunk within its budget when it is simplified by an unseen shift.

    Measured on the birch, 12,000 triangles in all at 256 pixels: FLIP over floor(1 px) is 1.26, 1.24 and 1.25 with a
    shift of 0.0005, 0.001 and 0.002 of the height, which move 9,627, 8,460 and 7,716 pieces.
    """
    budget = settings.trunk_triangles - solid_share(mesh, tubes, settings.trunk_triangles)
    tolerance = settings.detail * height
    unseen, number = ring_errors(tubes) <= tolerance, np.arange(len(tubes.tube))

    def fits(radius: float) -> bool:
        cut = _cuts(tubes, radius)[tubes.tube]
        inside = (number <= cut) & (cut > tubes.first[:-1][tubes.tube])
        kept = np.flatnonzero(inside & (~unseen | (number == cut)))
        return int(cost(tubes, plan(tubes, kept, tolerance)).sum()) <= budget

    if fits(0.0):
        return 0.0
    least, most = 0.0, 2 * float(tubes.rings.radii.max(initial=0))
    for _ in range(_ROUNDS):
        middle = (least + most) / 2
        least, most = (least, middle) if fits(middle) else (middle, most)
    return most


def _pieces(mesh: Mesh, tubes: Tubes, cut: Longs, length: float) -> tuple[Mesh, Leaves]:
    """Cut the tubes beyond the rings `cut` (T,) into pieces of about `length`: their mesh and a row for each."""
    start, reach = tubes.along[cut], tubes.along[tubes.first[1:] - 1] - tubes.along[cut]
    number = np.where(reach > 0, np.maximum(np.rint(reach / length), 1), 0).astype(np.int64)
    tube = np.repeat(np.arange(tubes.count), number)
    index = np.arange(len(tube)) - (np.cumsum(number) - number)[tube]
    ends = [start[tube] + reach[tube] * (index + end) / number[tube] for end in (0, 1)]
    ring, blend = (np.stack(both, axis=1) for both in zip(*(_locate(tubes, tube, at) for at in ends), strict=True))

    after = np.minimum(ring + 1, len(tubes.tube) - 1)
    center, radius = tubes.rings.centers, tubes.rings.radii
    point = center[ring] + blend[..., None] * (center[after] - center[ring])
    thick = radius[ring] + blend * (radius[after] - radius[ring])
    chord = point[:, 1] - point[:, 0]
    span = np.linalg.norm(chord, axis=1)
    to_next = tubes.steps * (radius + np.append(radius[1:], 0))  # silhouette of each section
    silhouette = (np.cumsum(to_next) - to_next)[ring] + tubes.steps[ring] * blend * (radius[ring] + thick)
    areas = silhouette[:, 1] - silhouette[:, 0]
    flat = thick.sum(axis=1) * span
    width = np.clip(areas / np.where(flat > 0, flat, 1), 1 / _MOST_WIDER, _MOST_WIDER)
    sides = np.where(tubes.mirrored[tube], _SIDES + 1, _SIDES)
    count = len(tube)
    pair = [np.repeat(values, 2) for values in (sides, width, np.arange(count))]
    pieces, owner = loft(mesh, tubes, Plan(ring.ravel(), blend.ravel(), *pair))

    axes = np.where(span[:, None] > 0, chord / np.where(span > 0, span, 1)[:, None], [0.0, 1.0, 0.0])
    normals = np.cross(axes, np.eye(3)[np.abs(axes).argmin(axis=1)])
    heavy = (thick[:, 0] + 2 * thick[:, 1]) / np.maximum(3 * thick.sum(axis=1), np.finfo(np.float64).tiny)
    centers = point[:, 0] + heavy[:, None] * chord
    radii = np.zeros(count)
    away = np.linalg.norm(pieces.positions[pieces.faces] - centers[owner, None], axis=2).max(axis=1)
    np.maximum.at(radii, owner, away)
    return pieces, Leaves(
        face_leaf=owner.astype(np.int32),
        centers=centers,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        areas=areas,
        radii=radii,
        axes=axes,
        shape=np.arange(count, dtype=np.int32),
        exemplars=np.arange(count, dtype=np.int32),
        transforms=np.tile(np.eye(3, 4), (count, 1, 1)),
    )


def _locate(tubes: Tubes, tube: Longs, at: Doubles) -> tuple[Longs, Doubles]:
    """The ring at or before each distance along its tube, and how far towards the next ring it lies, below 1."""
    gap = 2 * float(tubes.along.max()) + 1  # keeps the tubes apart on one axis
    ring = np.searchsorted(gap * tubes.tube + tubes.along, gap * tube + at, side="right") - 1
    ring = np.clip(ring, tubes.first[tube], tubes.first[tube + 1] - 1)
    step = tubes.steps[ring]
    blend = np.where(step > 0, (at - tubes.along[ring]) / np.where(step > 0, step, 1), 0)
    near_end = blend > 1 - 1e-6
    return ring + near_end, np.where(near_end, 0, np.maximum(blend, 0))


def _append(first: Leaves, second: Leaves) -> Leaves:
    """The rows of both; element and shape numbers of the second count on."""
    rows = {name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in _ROWS}
    elements, shapes = np.int32(first.count), np.int32(len(first.exemplars))
    return Leaves(
        face_leaf=np.concatenate([first.face_leaf, second.face_leaf + elements]),
        shape=np.concatenate([first.shape, second.shape + shapes]),
        exemplars=np.concatenate([first.exemplars, second.exemplars + elements]),
        **rows,
    )
