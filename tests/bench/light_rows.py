"""The rows of light: what every representation keeps of the source's ambient occlusion, A1."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bench.rays import sky_by_rays
from tests.bench.rows import BIRCH, CHESTNUT, ONE_LEVEL, Measured, row
from tests.bench.runner import Runner
from treebake.asset import read_indirect
from treebake.geometry import join
from treebake.lookup import Billboard, ambient_at, decode_leaves
from treebake.model import Clusters, Doubles, IndirectTextures, Longs, Tree
from treebake.stages.indirect.ambient import ambient
from treebake.stages.indirect.poses import poses
from treebake.stages.indirect.shapes import find_shapes
from treebake.workspace import Workspace

OAK = ("ez_oak_large.glb", "--config", "configs/ez_oak_large.toml", *ONE_LEVEL)
RAYS, LEAVES, SEED = 1024, 1500, 12345
BURIED = 0.01  # of the sky: a vertex that sees less lies inside a branch, where nobody sees it


@dataclass(frozen=True, eq=False)
class Held:
    """Mean absolute differences of the part of the sky from what rays tell: of the leaves' vertices, of these and those
    inside a branch, of the corners that are stored.
    """

    vertices: float
    with_buried: float
    corners: float


@row("A1", 0.03, "sky of leaves as published against 1,024 rays: mean absolute error, the worst of three trees")
def _a1(run: Runner) -> Measured:
    trees = {"chestnut": ("chestnut", *CHESTNUT), "oak": OAK, "birch": BIRCH}
    found = {name: _held(run.asset(*options)) for name, options in trees.items()}
    value = max(max(held.vertices, held.corners) for held in found.values())
    note = "; ".join(
        f"{name}: vertices {held.vertices:.4f} ({held.with_buried:.4f} with those inside branches), "
        f"corners {held.corners:.4f}"
        for name, held in found.items()
    )
    return Measured(value, value <= 0.03, note)


def _held(asset: Path) -> Held:
    work = Workspace(asset)
    tree, clusters = work.read("occlusion", "").value, work.read("indirect_cluster", "").value
    textures = read_indirect(asset / f"{asset.name}.glb")
    return held(tree, clusters, textures)


def held(tree: Tree, clusters: Clusters, textures: IndirectTextures) -> Held:
    """Hold published textures against rays in the source, for some of its leaves.

    tree: the source as it was split. clusters: of its leaves first, and then of its twigs.
    """
    leaves, foliage = tree.leaves, tree.foliage
    some = np.random.default_rng(SEED).permutation(leaves.count)[:LEAVES]
    pairs = np.unique(np.column_stack([leaves.face_leaf.repeat(3), foliage.faces.reshape(-1)]), axis=0)
    leaf, vertex = pairs[np.isin(pairs[:, 0], some)].astype(np.int64).T
    used, row_of = np.unique(vertex, return_inverse=True)
    whole, first = join(tree.trunk, foliage), len(tree.trunk.positions)
    seen = sky_by_rays(whole, used + first, np.ones(len(used), bool), RAYS, leaves.size, SEED)[row_of]
    stored, of_leaf = _published(textures, clusters, foliage.positions[vertex].astype(np.float64), leaf)
    error = np.abs(stored - seen)
    outside = seen > BURIED

    # The corners that fit what rays tell; a vertex inside a branch stands for the rest of its leaf.
    number, total = (np.bincount(leaf[outside], weights, leaves.count) for weights in (None, seen[outside]))
    rest = total / np.maximum(number, 1)
    occlusion = np.zeros(len(foliage.positions), np.float32)
    occlusion[vertex] = np.where(outside, seen, rest[leaf])
    exact = poses(foliage, leaves, find_shapes(foliage, leaves))
    wanted = ambient(replace(foliage, occlusion=occlusion), leaves, exact)[some].astype(np.float64)
    corners = textures.ambient.reshape(-1, 4)[of_leaf[some]]
    known = number[some] > 0
    return Held(
        vertices=float(error[outside].mean()),
        with_buried=float(error.mean()),
        corners=float(np.abs(corners - wanted)[known].mean() / 255),
    )


def _published(
    textures: IndirectTextures, clusters: Clusters, points: Doubles, leaf: Longs
) -> tuple[Doubles, NDArray[np.int64]]:
    """What is stored for points (V, 3) of leaves (V,): (V,); and the placement of each leaf."""
    order = np.argsort(clusters.labels, kind="stable")
    of_leaf = np.empty(len(order), np.int64)
    of_leaf[order] = np.arange(len(order))
    placement = of_leaf[leaf]
    boards = [Billboard.of(each) for each in textures.billboards]
    board = clusters.labels[leaf]
    to_cells = np.stack([each.to_cells for each in boards])[board]
    placed = decode_leaves(textures, placement.astype(np.int32), np.stack([each.size for each in boards])[board])
    cells = np.einsum("vij,vj->vi", to_cells[:, :, :3], points) + to_cells[:, :, 3] - placed.centers
    place = np.einsum("vji,vj->vi", placed.frames, cells)[:, :2] / (placed.halves[:, :2] * placed.scales[:, None])
    return ambient_at(textures, placement.astype(np.int32), place), of_leaf
