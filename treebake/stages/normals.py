"""Normals that make a crown one round body: those of leaves turned away from its middle."""

from dataclasses import dataclass, replace

import numpy as np

from treebake.checks import check
from treebake.model import Doubles, Tree


@dataclass(frozen=True)
class NormalSettings:
    """How the normals of leaves are changed before anything is baked."""

    crown: float = 0.0  # how far they turn away from the crown's middle, 0 to 1; not in indirect textures and leaves


def normals(tree: Tree, settings: NormalSettings) -> Tree:
    """Turn the vertex normals of leaves away from the crown's middle; the tree itself where nothing turns. O(F).

    n becomes (1 - crown) n + crown c, made unit, c being the direction from the leaves' mean centre to the vertex, or
    its opposite where the leaf's front faces the middle. So whoever sees a leaf from outside sees the same normal on
    either of its sides, and two-sided lighting stays right. Leaves that are copies of each other are then lit
    differently, which images that they share cannot show.

    Raises SettingsError where a setting is out of range.
    """
    check("normals", settings, [("crown", 0 <= settings.crown <= 1, "0 to 1")])
    if not settings.crown or not tree.leaves.count:
        return tree
    foliage, leaves = tree.foliage, tree.leaves
    middle = np.average(leaves.centers, axis=0, weights=leaves.areas)
    own = foliage.normals.astype(np.float64)
    outward = _unit(foliage.positions - middle)
    # The side is the whole leaf's: of vertices that disagree the normals between would cancel each other.
    facing = np.einsum("fki,fki->f", own[foliage.faces], outward[foliage.faces]) * foliage.face_areas
    front = np.where(np.bincount(leaves.face_leaf, facing, leaves.count) < 0, -1.0, 1.0)
    side = np.ones(len(own))
    side[foliage.faces] = front[leaves.face_leaf][:, None]
    turned = _unit((1 - settings.crown) * own + settings.crown * side[:, None] * outward)
    kept = np.where(turned.any(axis=1, keepdims=True), turned, own)
    return replace(tree, foliage=replace(foliage, normals=kept.astype(np.float32)))


def _unit(vectors: Doubles) -> Doubles:
    """Unit vectors; zero stays zero."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1))
