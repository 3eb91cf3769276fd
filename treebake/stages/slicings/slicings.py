"""Slicings of a tree's foliage: parallel textured slices in several orientations ([J00])."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from treebake.brightness import fit_brightness
from treebake.checks import check, is_power_of_two
from treebake.crossed import crossed_cards
from treebake.geometry import join, turn_to
from treebake.gl.photo import photograph
from treebake.model import Doubles, Mesh, SlicedFoliage, Slicings, Tree
from treebake.stages.slicings.assign import assign
from treebake.stages.slicings.layout import layout
from treebake.stages.slicings.mirror import mirrored_pairs
from treebake.stages.slicings.shots import shots

_FIT_HEIGHT = 160  # pixels of the tree: the middle of the range that slicings are for


@dataclass(frozen=True)
class SlicingSettings:
    """How the foliage is sliced."""

    enabled: bool = True  # bake slicings
    orientations: int = 6  # slicings around the tree, evenly spaced, 4 to 64
    slices: int = 5  # of each slicing, 1 to 64
    texels: int = 256  # of a slice's longer side, 16 to 1024
    above: bool = True  # one more slicing, seen from above
    far_texels: int = 64  # of the longer side where a slicing is one slice, for trees far away, 16 to 1024
    far_height: float = 32.0  # pixels of the crown's size on screen below which those are drawn; 0: never
    dropped: int = 0  # furthest slices of each slicing that are not drawn, 0 to slices - 1
    large: str = "slices"  # primitives longer than the slices stand apart: cut up between "slices", or left as "mesh"
    mirror: float = 0.01  # a slice seen from behind is the mirrored front where they differ less, 0 (never) to 1
    rectangles: int = 2  # of each slice, 1 to 8: more of them leave out more empty texels and draw more triangles
    atlas: int = 4096  # greatest side of the atlas in texels, a power of two, 64 to 16384
    gutter: int = 4  # texels kept free around each rectangle, a power of two: mips down to that size stay clean
    supersample: int = 4  # samples per texel each way, 1 to 4


def slicings(tree: Tree, settings: SlicingSettings) -> SlicedFoliage:
    """Slice, photograph, trim, pack and fit the foliage of a tree. O(orientations (faces + texels)).

    Raises SettingsError where a setting is out of range and BudgetError where the slices exceed the atlas.
    """
    _check(settings)
    foliage, leaves = tree.foliage, tree.leaves
    center = foliage.bounds.astype(np.float64).mean(axis=0)
    turns = [turn_to(0.0, 360.0 * number / settings.orientations) for number in range(settings.orientations)]
    if settings.above:
        turns.append(turn_to(90.0, 0.0))
    near = [assign(foliage, leaves, center, turn, settings.slices) for turn in turns]
    far = [assign(foliage, leaves, center, turn, 1) for turn in turns] if settings.far_height else []
    solid = np.zeros(foliage.triangles, bool)
    if settings.large == "mesh":
        solid = np.any([slicing.large for slicing in near], axis=0)[leaves.face_leaf]
    groups = [(slicing, settings.texels) for slicing in near] + [(slicing, settings.far_texels) for slicing in far]
    slices = [each for slicing, texels in groups for each in shots(tree, slicing, center, texels, solid)]
    photos = list(photograph(foliage, [each.shot for each in slices], settings.supersample))
    mirrored = mirrored_pairs(photos, settings.orientations, settings.slices, settings.mirror)
    table, atlas = layout(slices, photos, mirrored, settings.rectangles, settings.gutter, settings.atlas)
    made = Slicings(
        slices=table,
        orientations=settings.orientations,
        count=settings.slices,
        center=center,
        size=float(np.ptp(foliage.bounds, axis=0).max()) or 1.0,
        above=settings.above,
        far_row=len(near) * settings.slices,
        far_height=settings.far_height,
        dropped=settings.dropped,
        brightness=0.0,
        exposure=1.0,
        atlas=atlas,
        transmission=tree.transmission,
        untrimmed=sum(width * height for width, height in (each.shot.size for each in slices)),
    )
    large = foliage.select(solid)
    fitted = fit_brightness(made, join(tree.trunk, large), join(tree.trunk, foliage), _FIT_HEIGHT)
    return SlicedFoliage(fitted, large, _standard(tree, center, solid, settings))


def _standard(tree: Tree, center: Doubles, solid: NDArray[np.bool_], settings: SlicingSettings) -> Mesh:
    """The slices of two perpendicular slicings as cards that any viewer draws, at half the texels."""
    sliced = [assign(tree.foliage, tree.leaves, center, turn_to(0.0, azimuth), settings.slices) for azimuth in (0, 90)]
    slices = [each for slicing in sliced for each in shots(tree, slicing, center, max(settings.texels // 2, 16), solid)]
    taken = [each.shot for each in slices]
    photos = list(photograph(tree.foliage, taken, settings.supersample))
    depths = np.array([each.offset + float((each.slicing.turn @ center)[2]) for each in slices])
    return crossed_cards(taken, photos, depths, "slices", tree.transmission)


def _check(settings: SlicingSettings) -> None:
    rules = (
        ("orientations", 4 <= settings.orientations <= 64, "4 to 64, for example 6"),
        ("slices", 1 <= settings.slices <= 64, "1 to 64, for example 5"),
        ("texels", 16 <= settings.texels <= 1024, "16 to 1024, for example 256"),
        ("far_texels", 16 <= settings.far_texels <= 1024, "16 to 1024, for example 64"),
        ("far_height", settings.far_height >= 0, "0 or more"),
        ("dropped", 0 <= settings.dropped < settings.slices, f"0 to {settings.slices - 1}, one less than slices"),
        ("large", settings.large in ("slices", "mesh"), '"slices" or "mesh"'),
        ("mirror", 0 <= settings.mirror <= 1, "0 to 1, for example 0.01"),
        ("rectangles", 1 <= settings.rectangles <= 8, "1 to 8, for example 2"),
        ("atlas", is_power_of_two(settings.atlas, 64, 16384), "a power of two from 64 to 16384"),
        ("gutter", is_power_of_two(settings.gutter, 1, 64), "a power of two from 1 to 64"),
        ("supersample", 1 <= settings.supersample <= 4, "1 to 4"),
    )
    check("slicings", settings, rules)
