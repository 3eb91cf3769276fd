"""The rows of light, A1 to A5 and A7; the trunk has its own, A6."""

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


TREES = {"chestnut": ("chestnut", *CHESTNUT, *ONE_LEVEL), "oak": OAK, "birch": BIRCH}
UNLIT = ("occlusion.directions=0", "translucency.enabled=false", "trunk_maps.enabled=false")


@row("A1", [0.03] * 3, "sky at the corners of leaves, as published, against 1,024 rays: mean absolute error, each tree")
def _a1(run: Runner) -> Measured:
    found = {name: _held(run.asset(*options)) for name, options in TREES.items()}
    value = [held.corners for held in found.values()]
    note = "; ".join(
        f"{name}: at vertices {held.vertices:.4f}, {held.with_buried:.4f} with those inside branches"
        for name, held in found.items()
    )
    return Measured(value, max(value) <= 0.03, note)


@row("A2", [1.1] * 3, "indirect at 512 px relit by 8 suns, with occlusion and shadows: FLIP / floor(1 px), each tree")
def _a2(run: Runner) -> Measured:
    return _relit(run, "indirect", 1.1)


@row("A3", [[1.2] * 3, [1.3] * 3], "the same of the cloud at 256 px; of slicings at 128 px")
def _a3(run: Runner) -> Measured:
    cloud, slicings = _relit(run, "cloud", 1.2), _relit(run, "slicings", 1.3)
    views = _figures(run, "views", "relit", "flip_ratio")
    note = f"cloud: {cloud.note}; slicings: {slicings.note}; views at 64 px {views}"
    return Measured([cloud.value, slicings.value], cloud.holds and slicings.holds, note)


@row(
    "A4",
    [0.93] * 3,
    "shadow of the indirect on the ground, sun at 45 degrees, 512 px: IoU with the source's, each tree",
)
def _a4(run: Runner) -> Measured:
    value = _figures(run, "indirect", "shadows", "ground_iou")
    others = ("leaves", "cloud", "slicings", "views")
    note = "; ".join(f"{name} {_figures(run, name, 'shadows', 'ground_iou')}" for name in others)
    return Measured(value, min(value) >= 0.93, note)


@row("A5", [0.25] * 3, "depth of visible foliage, 278 billboards looked up, over leaf length: mean error, each tree")
def _a5(run: Runner) -> Measured:
    value = _figures(run, "indirect", "relit", "leaf_depth")
    note = "; ".join(f"{name} {_figures(run, name, 'relit', 'leaf_depth')}" for name in ("leaves", "cloud"))
    return Measured(value, max(value) <= 0.25, note)


@row("A7", 200, "R more for a bake with occlusion, light through leaves and trunk maps")
def _a7(run: Runner) -> Measured:
    name, options = "chestnut", (*CHESTNUT, "--set", "ladder.enabled=false")  # with all levels
    without = [word for setting in UNLIT for word in ("--set", setting)]
    seconds = [[run.bake_seconds(name, *options, *extra) for extra in ((), without)] for _ in range(2)]
    (lit, plain), render = (min(column) for column in zip(*seconds, strict=True)), run.render_seconds(name)
    note = f"bake {lit:.1f} s with, {plain:.1f} s without, the quicker of two each; R {1000 * render:.1f} ms"
    return Measured((lit - plain) / render, lit - plain <= 200 * render, note)


def _relit(run: Runner, representation: str, bound: float) -> Measured:
    value = _figures(run, representation, "relit", "flip_ratio")
    worst = _figures(run, representation, "relit", "flip_ratio_worst")
    return Measured(value, max(value) <= bound, f"worst sun {worst}")


def _figures(run: Runner, representation: str, part: str, figure: str) -> list[float]:
    """Of each tree."""
    return [run.light(*options)[representation][part][figure] for options in TREES.values()]


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
