"""Which trees of a forest are seen, and what each is drawn with: the ladder at work."""

from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.asset import Asset
from treebake.gl.draw import Drawing
from treebake.gl.scene import Stand
from treebake.gl.view import Grove, View
from treebake.model import Doubles, Forest, Mesh
from treebake.verify.cameras import bounding_sphere
from treebake.verify.drawn_as import drawn_as
from treebake.verify.switching import switched

_SHELL = 1.25  # blended trees are drawn in shells about the viewer, each so much farther than the next


@dataclass(frozen=True, eq=False)
class Kind:
    """A species on the graphics card.

    center, radius: of its bounding sphere, in its own frame. drawings: of its rungs, from near to far. min_heights:
    down to which each is drawn.
    """

    center: Doubles
    radius: float
    drawings: tuple[Drawing, ...]
    min_heights: tuple[int, ...]


def kind_of(asset: Asset, source: Mesh, stack: ExitStack) -> Kind:
    """A species as its ladder draws it, until the stack is closed. Raises AssetError and GraphicsError."""
    ladder = asset.manifest.ladder
    drawn = [drawn_as(asset, rung.representation, rung.level) for rung in ladder]
    drawings = [stack.enter_context(closing(Drawing(each.mesh, each.layers))) for each in drawn]
    return Kind(*bounding_sphere(source), tuple(drawings), tuple(rung.min_height for rung in ladder))


@dataclass(frozen=True, eq=False)
class Trees:
    """The trees of a forest with their bounding spheres. grove: all n of them. species: (n,) int32. centers: (n, 3)
    float64 and radii: (n,) float64, in the world.
    """

    grove: Grove
    species: NDArray[np.int32]
    centers: Doubles
    radii: Doubles

    @classmethod
    def of(cls, forest: Forest, kinds: Sequence[Kind]) -> "Trees":
        """Put the spheres of the kinds where the trees stand."""
        grove = Grove(forest.places, forest.turns)
        centers = np.zeros((len(forest.turns), 3))
        for number, kind in enumerate(kinds):
            mine = forest.species == number
            centers[mine] = grove.select(mine).where(kind.center)
        radii = forest.places[:, 3] * np.array([kind.radius for kind in kinds])[forest.species]
        return cls(grove, forest.species, centers, np.asarray(radii, np.float64))


def seen(view: View, forest: Forest, trees: Trees) -> NDArray[np.intp]:
    """The numbers of the trees of which something may be in view: of the cells in view, those whose sphere is."""
    planes = np.stack([view.to_clip[3] + side * view.to_clip[axis] for axis in range(3) for side in (1, -1)])
    planes /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    low, high = forest.cells.bounds[:, 0].astype(np.float64), forest.cells.bounds[:, 1].astype(np.float64)
    corner = np.where(planes[:, None, :3] > 0, high, low)  # of each cell, the farthest inside each plane
    cells = (np.einsum("pci,pi->pc", corner, planes[:, :3]) + planes[:, 3:] >= 0).all(axis=0)
    near = np.flatnonzero(np.repeat(cells, forest.cells.count))
    away = trees.centers[near] @ planes[:, :3].T + planes[:, 3]
    return np.asarray(near[(away >= -trees.radii[near, None]).all(axis=1)], np.intp)


def pixels_high(view: View, trees: Trees, chosen: NDArray[np.intp]) -> Doubles:
    """How high the spheres of some trees are on screen, (n,) float64: at their distance, wherever in the picture."""
    away = np.linalg.norm(trees.centers[chosen] - view.eye, axis=1)
    return np.asarray(2 * trees.radii[chosen] * view.focus / np.maximum(away, 1e-9))


def stands(view: View, trees: Trees, chosen: NDArray[np.intp], kinds: Sequence[Kind]) -> list[Stand]:
    """What to draw the chosen trees with, farthest first. A tree that changes its rung is drawn with both."""
    heights = pixels_high(view, trees, chosen)
    away = np.linalg.norm(trees.centers[chosen] - view.eye, axis=1)
    shell = np.floor(np.log(np.maximum(away, 1e-9)) / np.log(_SHELL)).astype(np.int64)
    rows = []  # (tree, species, rung, shell, opacity) for everything to be drawn
    for number, kind in enumerate(kinds):
        mine = np.flatnonzero(trees.species[chosen] == number)
        step, nearer, farther = switched(heights[mine], kind.min_heights)
        for rung, opacity in ((step, nearer), (step + 1, farther)):
            shown = opacity > 0
            tree, of = mine[shown], rung[shown]
            blended = np.array([drawing.blended for drawing in kind.drawings])[of]
            rows.append((tree, np.full(len(tree), number), of, np.where(blended, shell[tree], 0), opacity[shown]))
    tree, species, rung, shell, opacity = (np.concatenate(column) for column in zip(*rows, strict=True))
    order = np.lexsort([tree, -rung, species, -shell])
    key = np.stack([shell, species, rung])[:, order]
    alone = len(kinds) == 1  # then shells of one rung need no border between them
    changes = np.any(key[alone:, 1:] != key[alone:, :-1], axis=0)
    found = []
    for group in np.split(order, np.flatnonzero(changes) + 1) if len(order) else []:
        grove = trees.grove.select(chosen[tree[group]])
        opacities = opacity[group].astype(np.float32)
        faded = Grove(grove.places, grove.turns, None if (opacities == 1).all() else opacities)
        found.append(Stand(kinds[species[group[0]]].drawings[rung[group[0]]], faded))
    return found
