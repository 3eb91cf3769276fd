"""Levels of detail: ever fewer planes and trunk triangles, each made for the height in pixels that it is seen at.

A level's atlas has a texel for a pixel at that height and its coverage is fitted there, branches thinner than a pixel
move into its cloud, and what is left of the trunk is simplified. Measured on the chestnut, FLIP over floor(1 px):

- 1, 1.5 and 2 texels a pixel: 1.74, 1.73, 1.72 (107 planes, 128 pixels; 1.4, 2.6, 2.8 MB), 1.72, 1.70, 1.69 (32
  planes, 64 pixels), 1.53, 1.57, 1.61 (8 planes, 32 pixels).
- 1, 2 and 4 cards a plane: 1.78, 1.72, 1.70 (278 planes, 256 pixels), and no difference below.
- an atlas of 1024 or 2048: 1.72 or 1.68 (278 planes at 1.5 texels a pixel), for 2.9 or 8.9 MB.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from treebake.checks import check
from treebake.errors import SettingsError
from treebake.geometry import join
from treebake.model import BakedLevel, BillboardCloud, Clusters, Hierarchy, MappedTrunk, Mesh, Tree
from treebake.morph import morph_to_next
from treebake.planes import with_pieces
from treebake.stages.billboards import BillboardSettings, billboards
from treebake.stages.trunk import TrunkSettings, compare, trunk
from treebake.stages.trunk_maps import TrunkMapSettings, trunk_maps
from treebake.stages.twigs import TwigSettings, twigs
from treebake.verify import SCALE, cameras, silhouette_iou
from treebake.workspace import Result, Workspace

if TYPE_CHECKING:
    from treebake.settings import Settings

_TEXELS = 1.0  # of the atlas for a pixel
_CARDS = 2  # of a plane, in the mean
_ATLAS = 1024  # greatest side, texels
_ELEVATIONS, _AZIMUTHS = (0.0, 25.0, 60.0), 8  # in which the trunk's silhouette is looked at: the verifier's


@dataclass(frozen=True)
class LevelSettings:
    """The coarser levels, an entry for each of hierarchy.billboards."""

    enabled: bool = True  # bake the coarser levels
    heights: tuple[int, ...] = (256, 128, 64, 48, 32)  # pixels of the tree up to which each is, descending, 16 to 2048
    trunk_triangles: tuple[int, ...] = (4000, 2000, 800, 400, 200)  # of each level's trunk, descending, 1 or more


@dataclass(frozen=True)
class _Plan:
    """What a level's stages are run with."""

    height: int
    twigs: TwigSettings
    textures: BillboardSettings
    trunk: TrunkSettings
    maps: TrunkMapSettings


def bake_levels(
    work: Workspace,
    settings: "Settings",
    parts: Result[Tree],
    tree: Result[Tree],
    planes: Result[Hierarchy] | None,
    finest: MappedTrunk,
) -> tuple[BakedLevel, ...]:
    """Bake every coarser level, from near to far.

    parts: the tree as it was split. tree, planes, finest: of the finest level, the tree's first leaves those of the
    split; planes: None where there is no foliage, and each level is a trunk alone. Levels for which there are too few
    planes, or for want of foliage no fewer triangles than in the level above, are left out.
    Raises what the stages raise.
    """
    split = parts.value
    whole = join(split.trunk, split.foliage)
    views = cameras(whole, _ELEVATIONS, _AZIMUTHS)[SCALE]
    plans = [
        _plan(settings, number, whole, views[0].radius, split.leaves.size if planes else 1.0)
        for number in range(len(settings.levels.heights))
    ]
    made = dict(zip(settings.hierarchy.billboards, plans, strict=True))
    chosen: list[tuple[_Plan, Clusters | None]] = [(plan, None) for plan in plans]
    if planes:
        chosen = [(made[clusters.count], clusters) for clusters in planes.value.levels[1:]]
    levels: list[BakedLevel] = []
    for number, (plan, clusters) in enumerate(chosen, 1):
        sparse = work.run(twigs, plan.twigs, parts, name=f"twigs_{number}")
        solid_left = work.run(trunk, plan.trunk, sparse.part("trunk"), name=f"trunk_{number}")
        left = solid_left.value
        cloud = BillboardCloud(split.foliage, np.zeros(0, np.int32))
        if clusters and planes:
            placed = _placed(settings, clusters, tree.value, sparse.value, split.leaves.count)
            cloud = work.run(billboards, plan.textures, sparse, Result.of(placed), name=f"billboards_{number}").value
            cloud = morph_to_next(cloud, planes.value, number)
        elif not 0 < left.triangles < (levels[-1].trunk if levels else finest.mesh).triangles:
            continue
        leaves = sparse.value.leaves
        pieces = sparse.value.foliage.select(leaves.is_twig[leaves.face_leaf])
        kept = silhouette_iou(split.trunk, join(left, pieces), views, plan.height) if split.trunk.triangles else None
        area = compare(split.trunk, left, pieces).silhouette_kept
        surfaces = solid_left, sparse.part("trunk"), parts.part("trunk"), Result.of(finest.maps)
        mapped = work.run(trunk_maps, plan.maps, *surfaces, name=f"trunk_maps_{number}").value
        levels.append(BakedLevel(cloud, mapped.mesh, plan.height, kept, area, mapped.maps))
    return tuple(levels)


def check_levels(settings: "Settings") -> None:
    """Raise SettingsError where a setting is out of range, or there is not one entry for each level."""
    levels, count = settings.levels, len(settings.hierarchy.billboards)
    for name in ("heights", "trunk_triangles"):
        if (entries := len(getattr(levels, name))) != count:
            raise SettingsError(
                f"[levels] {name} has {entries} entries and [hierarchy] billboards {count}; give one for each level"
            )
    ranges = all(16 <= height <= 2048 for height in levels.heights)
    rules = (
        ("heights", ranges and all(a > b for a, b in pairwise(levels.heights)), "descending, 16 to 2048"),
        ("trunk_triangles", all(a > b for a, b in pairwise((*levels.trunk_triangles, 0))), "descending, 1 or more"),
    )
    check("levels", levels, rules)


def _plan(settings: "Settings", number: int, whole: Mesh, radius: float, leaf: float) -> _Plan:
    """radius: of the tree's bounding sphere. leaf: the mean leaf's size."""
    height = settings.levels.heights[number]
    budget = min(settings.levels.trunk_triangles[number], settings.trunk.triangles)
    pixel = 2 * radius / height
    half = pixel / 2 / float(np.ptp(whole.bounds[:, 1]) or 2 * radius)  # a pixel's, as a part of the tree's height
    return _Plan(
        height=height,
        twigs=replace(settings.twigs, trunk_triangles=budget, radius=-1.0, thinnest=min(half, 1.0), detail=half),
        textures=replace(
            settings.textures,
            atlas=min(settings.textures.atlas, _ATLAS),
            leaf_texels=_TEXELS * leaf / pixel,
            triangles=2 * _CARDS * settings.hierarchy.billboards[number],
            height=height,
        ),
        trunk=TrunkSettings(budget),
        maps=replace(settings.trunk_maps, height=height),
    )


def _placed(settings: "Settings", clusters: Clusters, finest: Tree, tree: Tree, kept: int) -> Clusters:
    """The planes of a level for the leaves of its own tree, whose pieces of twigs are others than the finest's."""
    weights = settings.hierarchy.angle_weight, settings.hierarchy.compactness
    return with_pieces(clusters, finest.leaves, tree.leaves, kept, *weights)
