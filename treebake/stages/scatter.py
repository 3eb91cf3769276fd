"""Scatter trees over the ground: blue noise, each tree with a species, a scale and a turn of its own.

The ground is the plane y = 0, and a tree stands on it as it stands in its own frame. Darts are thrown at a disc about
the origin, and one that lands too close to an earlier one is taken out again, so trees keep their distance and show no
rows. The forest is cut into square cells, which a renderer can leave out as a whole.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from treebake.checks import check
from treebake.errors import SettingsError
from treebake.model import Cells, Doubles, Floats, Forest, Longs

_DARTS = 5  # per square whose side is the least distance; this many leave a tree on 1.8 of them
_ROOM = 2.0  # such squares per tree, so that there are always enough


@dataclass(frozen=True)
class ForestSettings:
    """How trees are scattered."""

    trees: int = 1000  # trees in all (0 to 1,000,000)
    seed: int = 0  # 0 or more; another seed is another forest, the same seed the same bytes
    spacing: float = 1.0  # least distance between two trees, in crown widths of the widest species (> 0); at 1 crowns
    # of scale 1 just touch
    least_scale: float = 0.8  # scale of the smallest trees (> 0)
    greatest_scale: float = 1.2  # scale of the largest trees (at least least_scale)
    weights: dict[str, float] = field(default_factory=dict)  # species -> its share among the trees, over that of
    # others (0 or more); 1 for those not named
    cell: float = 20.0  # side of the culling grid's cells, in spacings (1 or more); a full one has about cell^2 / 1.8
    # trees


def scatter(sizes: Mapping[str, Floats], settings: ForestSettings) -> Forest:
    """Scatter trees of the species in `sizes`: name -> (2, 3) float32, least and greatest corner of a tree at scale 1.

    A crown is as wide as the greater of the tree's extents along x and z; all species have the same unit. There must be
    at least one. O(n log n) in the number of trees.

    Raises SettingsError for settings out of range, and for weights of species that are not there or all zero.
    """
    _check(settings)
    names = tuple(sizes)
    bounds = np.array([sizes[name] for name in names], np.float64)
    n = settings.trees
    spacing = settings.spacing * np.ptp(bounds[:, :, [0, 2]], axis=1).max()
    random = np.random.default_rng(settings.seed)
    ground = spacing * _blue_noise(n, random)
    species = random.choice(len(names), n, p=_shares(names, settings.weights)).astype(np.int32)
    scales = random.uniform(settings.least_scale, settings.greatest_scale, n)
    turns = random.uniform(0, 2 * np.pi, n).astype(np.float32)
    places = np.column_stack([ground[:, 0], np.zeros(n), ground[:, 1], scales]).astype(np.float32)

    column, row = np.floor(ground / (settings.cell * spacing)).astype(np.int64).T
    order = np.lexsort([species, column, row])
    starts = (np.diff(column[order], prepend=0) != 0) | (np.diff(row[order], prepend=0) != 0)
    starts[:1] = True
    species, places, turns = species[order], places[order], turns[order]
    cells = _cells(np.flatnonzero(starts), _extents(bounds[species], places, turns))
    return Forest(names, species, places, turns, cells)


def _blue_noise(n: int, random: np.random.Generator) -> Doubles:
    """Places around the origin, none closer to another than 1, the nearest to it first: (n, 2) float64.

    What darts thrown one after the other would leave, but all darts that no earlier one can take out stay at once, and
    take out their neighbours, until none is undecided. A handful of rounds, O(n log n).
    """
    radius = np.sqrt(_ROOM * n / np.pi) + 2
    away, angle = random.random((2, int(_DARTS * np.pi * radius**2)))
    away, angle = radius * np.sqrt(away), 2 * np.pi * angle
    darts = np.column_stack([away * np.sin(angle), away * np.cos(angle)])
    earlier, later = cKDTree(darts).query_pairs(1.0, output_type="ndarray").T
    stays, undecided = np.zeros(len(darts), bool), np.ones(len(darts), bool)
    while undecided.any():
        beaten = np.zeros(len(darts), bool)
        beaten[later] = True
        found = undecided & ~beaten
        stays |= found
        undecided &= beaten
        undecided[later[found[earlier]]] = False
        still = undecided[earlier] & undecided[later]
        earlier, later = earlier[still], later[still]
    kept = darts[stays]
    return kept[np.argsort((kept**2).sum(axis=1), kind="stable")[:n]]


def _shares(names: tuple[str, ...], weights: Mapping[str, float]) -> Doubles:
    if unknown := [name for name in weights if name not in names]:
        raise SettingsError(
            f"[forest] weights names {unknown[0]}, which is no species here; there are {', '.join(names)}"
        )
    shares = np.array([weights.get(name, 1.0) for name in names])
    if not shares.any():
        raise SettingsError("[forest] weights are all 0; give one of the species more")
    return np.asarray(shares / shares.sum())


def _extents(bounds: Doubles, places: Floats, turns: Floats) -> Doubles:
    """Boxes along the axes around trees with the boxes `bounds` (n, 2, 3) in their own frames: (n, 2, 3)."""
    center, half = bounds.mean(axis=1), np.ptp(bounds, axis=1) / 2
    cosine, sine = np.cos(turns, dtype=np.float64), np.sin(turns, dtype=np.float64)
    center = np.stack(
        [cosine * center[:, 0] + sine * center[:, 2], center[:, 1], cosine * center[:, 2] - sine * center[:, 0]], 1
    )
    cosine, sine = np.abs(cosine), np.abs(sine)
    half = np.stack([cosine * half[:, 0] + sine * half[:, 2], half[:, 1], cosine * half[:, 2] + sine * half[:, 0]], 1)
    boxes = places[:, None, 3:] * np.stack([center - half, center + half], axis=1)
    return np.asarray(boxes + places[:, None, :3])


def _cells(first: Longs, extents: Doubles) -> Cells:
    if not len(first):
        return Cells(np.zeros((0, 2, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32))
    least = np.minimum.reduceat(extents[:, 0], first)
    greatest = np.maximum.reduceat(extents[:, 1], first)
    # Rounded outwards, so that a tree is inside in float32 too.
    bounds = np.stack(
        [
            np.nextafter(least.astype(np.float32), np.float32(-np.inf)),
            np.nextafter(greatest.astype(np.float32), np.float32(np.inf)),
        ],
        axis=1,
    )
    return Cells(bounds, first.astype(np.int32), np.diff(first, append=len(extents)).astype(np.int32))


def _check(settings: ForestSettings) -> None:
    rules = (
        ("trees", 0 <= settings.trees <= 1_000_000, "0 to 1,000,000"),
        ("seed", settings.seed >= 0, "0 or more"),
        ("spacing", settings.spacing > 0, "greater than 0"),
        ("least_scale", settings.least_scale > 0, "greater than 0"),
        ("greatest_scale", settings.greatest_scale >= settings.least_scale, "at least least_scale"),
        ("weights", all(weight >= 0 for weight in settings.weights.values()), "0 or more for each species"),
        ("cell", settings.cell >= 1, "1 or more"),
    )
    check("forest", settings, rules)
