"""The stage: tree and clusters in, tables and textures out."""

from dataclasses import dataclass

import numpy as np

from treebake.checks import check, is_power_of_two
from treebake.errors import BudgetError
from treebake.model import Clusters, Floats, IndirectTextures, Ints, Leaves, Tree
from treebake.packing import pack_cells
from treebake.placements import SHAPES, Placements
from treebake.placements import pack as pack_placements
from treebake.stages.indirect.ambient import ambient
from treebake.stages.indirect.boxes import Boxes, box
from treebake.stages.indirect.far import draw_far
from treebake.stages.indirect.leaf_images import LeafImages, draw_leaf_images
from treebake.stages.indirect.lists import Footprints, in_rows, list_leaves
from treebake.stages.indirect.poses import Poses, laid_flat, poses, snapped
from treebake.stages.indirect.shapes import Shapes, find_shapes

_MOST_TEXELS = 16384  # that a texture may have a side
_LOWEST = 1e-4  # relief over half a leaf's height; below it a leaf is flat


@dataclass(frozen=True)
class IndirectSettings:
    """How leaves become tables."""

    enabled: bool = True  # false: none are made
    cell: float = 1.5  # side of a hash cell, in mean leaf sizes, > 0; smaller cells have shorter lists
    flat: bool = False  # lay leaves into their planes, as the papers do; otherwise they stay where they are
    single: bool = False  # one leaf a cell at most, [GSSK05]'s leaf distribution; best with a small cell
    orientations: int = 0  # directions within its plane to which a leaf is snapped; 0 keeps it exact
    leaf_texels: int = 64  # along the root of the area of the image of a leaf without texture, 4 to 1024
    atlas: int = 2048  # greatest side of the leaves texture in texels, a power of two, 64 to 16384
    likeness: float = 0.02  # RMS difference, of 1, below which shapes share one image, >= 0
    far_texels: int = 4  # of the low-resolution texture along a cell: a power of two, 1 to 16
    limit: int = 4096  # greatest side of the hash texture in texels, a power of two, 64 to 16384


def indirect(tree: Tree, clusters: Clusters, settings: IndirectSettings) -> IndirectTextures:
    """Place every leaf in its billboard's box, list the leaves of each cell, and draw the leaf images.

    O(E log E + texels) for E pairs of leaf and cell. Raises SettingsError where a setting is out of range and
    BudgetError where a tree exceeds what a table can hold, naming the setting to change.
    """
    _check(settings)
    leaves = tree.leaves
    shapes = find_shapes(tree.foliage, leaves)
    _check_counts(len(shapes.exemplars), clusters.count)
    exact = poses(tree.foliage, leaves, shapes)
    flat = laid_flat(exact, leaves, clusters)
    drawn = flat if settings.flat else exact
    if settings.orientations:
        drawn = snapped(drawn, settings.orientations)
    side = settings.cell * _leaf_size(exact, leaves)
    boxes = box(clusters, (drawn, flat), side)  # the far texture shows the leaves laid flat
    origins, (width, height) = _place_grids(boxes, settings)
    order = np.argsort(clusters.labels, kind="stable")
    first = np.searchsorted(clusters.labels[order], np.arange(clusters.count))
    foot = _footprints(drawn, boxes, clusters, order, first, side)
    hashes, lists = list_leaves(foot, boxes.sizes, origins, (height, width), single=settings.single)
    images = draw_leaf_images(tree.foliage, leaves, shapes, settings.leaf_texels, settings.atlas, settings.likeness)
    largest = float(drawn.halves[:, 1].max())
    placements = in_rows(pack_placements(_placements(drawn, shapes, boxes, clusters, largest, side))[order])
    far_color, far_normal = draw_far(tree, clusters, boxes, origins, (height, width), 1 / side, settings.far_texels)
    return IndirectTextures(
        billboards=_billboard_rows(boxes, origins, first, drawn, clusters, side),
        shapes=_shape_rows(shapes, images),
        hash_texture=hashes,
        lists_texture=lists,
        placements=placements,
        ambient=in_rows(ambient(tree.foliage, leaves, exact)[order]),
        leaves=leaves.count,
        largest=largest / side,
        leaf_color=images.color,
        leaf_normal=images.normal,
        far_color=far_color,
        far_normal=far_normal,
        transmission=tree.transmission,
    )


def _check(settings: IndirectSettings) -> None:
    rules = (
        ("cell", settings.cell > 0, "above 0"),
        ("orientations", settings.orientations >= 0, "0 or more"),
        ("leaf_texels", 4 <= settings.leaf_texels <= 1024, "4 to 1024"),
        ("atlas", is_power_of_two(settings.atlas, 64, 16384), "a power of two from 64 to 16384"),
        ("likeness", settings.likeness >= 0, "0 or more"),
        ("far_texels", is_power_of_two(settings.far_texels, 1, 16), "1, 2, 4, 8 or 16"),
        ("limit", is_power_of_two(settings.limit, 64, 16384), "a power of two from 64 to 16384"),
    )
    check("indirect", settings, rules)


def _check_counts(shapes: int, billboards: int) -> None:
    for found, most, what, mend in (
        (shapes, SHAPES, "leaf shapes", "raise [split] copy_tolerance"),
        (billboards, _MOST_TEXELS, "billboards", "lower [indirect_cluster] billboards"),
    ):
        if found > most:
            raise BudgetError(
                f"the indirect textures need {found:,} {what} and can hold {most:,}; {mend}, or do without them by "
                "[indirect] enabled = false"
            )


def _place_grids(boxes: Boxes, settings: IndirectSettings) -> tuple[Ints, tuple[int, int]]:
    """The first texel of each billboard in the hash texture, and the texture's width and height."""
    packed = pack_cells(boxes.sizes, settings.limit)
    if packed is None:
        raise BudgetError(
            f"the hash texture of {len(boxes.sizes):,} billboards exceeds {settings.limit} x {settings.limit} texels; "
            "raise [indirect] cell or limit"
        )
    if max(packed[1]) * settings.far_texels > _MOST_TEXELS:
        raise BudgetError(
            f"the low-resolution texture exceeds {_MOST_TEXELS} x {_MOST_TEXELS} texels; raise [indirect] cell or "
            "lower far_texels"
        )
    return packed


def _leaf_size(exact: Poses, leaves: Leaves) -> float:
    """The root of the mean area of a leaf's rectangle: the side of its point sprite in [GPSS07] 4.2."""
    real = ~leaves.is_twig
    areas = 4 * exact.halves[:, 0] * exact.halves[:, 1]
    return float(np.sqrt(areas[real if real.any() else slice(None)].mean()))


def _footprints(
    drawn: Poses, boxes: Boxes, clusters: Clusters, order: np.ndarray, first: np.ndarray, side: float
) -> Footprints:
    billboard = clusters.labels[order]
    centers = boxes.local(drawn.centers, clusters.labels)[order]
    edges = drawn.frames[order] * drawn.halves[order][:, :, None]
    in_plane = np.einsum("nij,nej->nei", boxes.frames[billboard][:, :2], edges)
    return Footprints(
        billboard=billboard,
        number=(np.arange(len(order)) - first[billboard]).astype(np.int32),
        middles=centers[:, :2] / side,
        edges=in_plane / side,
        depths=centers[:, 2],
    )


def _placements(
    drawn: Poses, shapes: Shapes, boxes: Boxes, clusters: Clusters, largest: float, side: float
) -> Placements:
    billboard = clusters.labels
    extent = np.column_stack([boxes.sizes * side, boxes.depths])
    centers = boxes.local(drawn.centers, billboard) / np.maximum(extent, 1e-300)[billboard]
    # Of a twig piece width and length are its own; of a leaf they are its shape's, scaled.
    twig = shapes.is_twig[shapes.of_leaf]
    narrowing = np.where(twig, np.minimum(drawn.halves[:, 0] / drawn.halves[:, 1], 1), 1.0)
    return Placements(
        positions=centers,
        rotations=boxes.frames[billboard] @ np.swapaxes(drawn.frames, 1, 2),
        scales=drawn.halves[:, 1] / largest,
        narrowings=narrowing,
        shape=shapes.of_leaf,
        mirrored=drawn.mirrored,
    )


def _billboard_rows(
    boxes: Boxes, origins: np.ndarray, first: np.ndarray, drawn: Poses, clusters: Clusters, side: float
) -> Floats:
    """The billboards table; FORMAT.md names the columns."""
    labels = clusters.labels
    reach = np.zeros(len(first))
    np.maximum.at(reach, labels, drawn.reach(boxes.frames[labels, 2]))
    to_cells = np.concatenate([boxes.frames, -boxes.corners[:, :, None]], axis=2) / side
    return np.column_stack(
        [
            to_cells.reshape(-1, 12),
            boxes.sizes,
            boxes.depths / side,
            boxes.planes / side,
            origins,
            first,
            reach / side,
        ]
    ).astype(np.float32)


def _shape_rows(shapes: Shapes, images: LeafImages) -> Floats:
    """The shapes table; FORMAT.md names the columns. Sizes are over half the shape's height."""
    halves = shapes.halves / shapes.halves[:, 1:2]
    halves[:, 2] = np.where(halves[:, 2] < _LOWEST, 0, halves[:, 2])
    halves[shapes.is_twig] = 1
    return np.column_stack([halves, shapes.is_twig, images.front, images.back, images.thresholds]).astype(np.float32)
