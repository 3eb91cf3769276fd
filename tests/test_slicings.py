"""A few leaves of two colours, sliced: the table of slices says where each of them is to be found."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from foliage import GREEN, frozen, leaf_tree

from treebake.asset import read_slicings
from treebake.asset.pictures import write_slicings
from treebake.errors import BudgetError, SettingsError
from treebake.geometry import turn_to
from treebake.gl.photo import Photo
from treebake.images import to_linear
from treebake.model import AlphaMode, Doubles, Floats, Material, SlicedFoliage, Slicings, Texture, Tree
from treebake.pictures import STEEPEST
from treebake.stages.slicings import SlicingSettings, slicings
from treebake.stages.slicings.mirror import mirrored_pairs

RED = Material("red", base_color=(0.6, 0.1, 0.1, 1.0), double_sided=True)
SMALL = SlicingSettings(orientations=4, slices=3, texels=128, far_texels=16, supersample=2, atlas=1024, gutter=2)

# Seen from the four sides and from above, no leaf hides another; they lie at depths of all slices.
CENTERS = np.array([(-0.7, -0.5, 0.6), (0.1, 0.5, -0.8), (0.8, 0.0, 0.0), (-0.2, -0.95, -0.3)])
NORMAL = np.ones(3) / np.sqrt(3)
SIZE = 0.3


def two_colors(centers: object = CENTERS, normals: object = NORMAL, *, size: float = SIZE) -> Tree:
    """Leaves by turns green and red."""
    tree = leaf_tree(centers, normals, size=size)
    colors = (np.arange(tree.foliage.triangles, dtype=np.int32) // 2) % 2
    return frozen(replace(tree, foliage=replace(tree.foliage, materials=(GREEN, RED), face_material=colors)))


@cache
def baked() -> SlicedFoliage:
    return slicings(two_colors(), SMALL)


# ---- a readable twin of the table of slices --------------------------------------------------------------------------


@dataclass(frozen=True)
class Found:
    """What a slice shows at a place. depth: along the slicing's way to the viewer, from the center."""

    coverage: float
    albedo: Floats
    normal: Doubles  # in the world, on the viewer's side
    depth: float


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    slicings: Slicings
    cells: Floats

    @property
    def turn(self) -> Doubles:
        return self.cells[:3, :3].astype(np.float64)

    @property
    def offset(self) -> float:
        return float(self.cells[0, 3])

    @property
    def range(self) -> tuple[float, float]:
        """From the plane; the greater first where a picture is seen from behind."""
        return float(self.cells[1, 3]), float(self.cells[2, 3])

    @property
    def rectangles(self) -> list[tuple[Floats, Floats]]:
        """Left, bottom, right, top on the slice, and where these are in the atlas."""
        pairs = self.cells[3:].reshape(-1, 2, 4)
        return [(bounds, texels) for bounds, texels in pairs if bounds[2] > bounds[0]]

    @property
    def texel(self) -> float:
        """Size of a texel."""
        bounds, texels = self.rectangles[0]
        width = self.slicings.atlas.coverage.pixels.shape[1]
        return float((bounds[2] - bounds[0]) / abs(texels[2] - texels[0]) / width)

    def at(self, x: float, y: float) -> Found | None:
        """What is seen at a place of the slice; None where no rectangle is."""
        for bounds, texels in self.rectangles:
            part = (np.array([x, y]) - bounds[:2]) / (bounds[2:] - bounds[:2])
            if (part >= 0).all() and (part < 1).all():
                return self._texel(texels[:2] + part * (texels[2:] - texels[:2]))
        return None

    def covered(self) -> float:
        """The area that the slice covers."""
        atlas = self.slicings.atlas.coverage.pixels[..., 0]
        total = 0.0
        for _, texels in self.rectangles:
            left, bottom, right, top = np.rint(texels * [*atlas.shape[::-1], *atlas.shape[::-1]]).astype(int)
            total += float(atlas[top:bottom, min(left, right) : max(left, right)].sum()) / 255
        return total * self.texel**2 if self.rectangles else 0.0

    def _texel(self, uv: Floats) -> Found:
        atlas = self.slicings.atlas
        coverage, albedo, relief = (
            image.pixels[int(uv[1] * image.pixels.shape[0]), int(uv[0] * image.pixels.shape[1])]
            for image in (atlas.coverage, atlas.albedo, atlas.relief)
        )
        far, near = self.range
        slope = (relief[:2] / 255.0 * 2 - 1) * STEEPEST * (1, 1 if far < near else -1)
        normal = np.append(slope, 1) / np.linalg.norm(np.append(slope, 1))
        depth = self.offset + far + relief[2] / 255.0 * (near - far)
        return Found(coverage[0] / 255, to_linear(albedo[:3]), normal @ self.turn, float(depth))


def rows(made: Slicings, slicing: int) -> list[Row]:
    """The slices of one slicing."""
    return [Row(made, cells) for cells in made.slices[slicing * made.count : (slicing + 1) * made.count]]


def all_rows(made: Slicings) -> list[Row]:
    return [Row(made, cells) for cells in made.slices]


def turns(settings: SlicingSettings) -> list[Doubles]:
    around = [turn_to(0.0, 360 * i / settings.orientations) for i in range(settings.orientations)]
    return [*around, turn_to(90.0, 0.0)]


def assert_shows_every_leaf(made: Slicings, tree: Tree, slicing: int, turn: Doubles) -> None:
    """Each leaf is on the slice nearest to it and on no other, where it is in parallel projection."""
    sliced = rows(made, slicing)
    for leaf, center in enumerate(tree.leaves.centers):
        x, y, depth = turn @ (center - made.center)
        nearest = int(np.argmin([abs(row.offset - depth) for row in sliced]))
        shown = [row.at(x, y) for row in sliced]
        assert [index for index, found in enumerate(shown) if found and found.coverage > 0] == [nearest]
        found = shown[nearest]
        color = tree.foliage.materials[tree.foliage.face_material[2 * leaf]].base_color[:3]
        assert found.coverage == 1
        np.testing.assert_allclose(found.albedo, color, atol=0.01)
        # Relief keeps one texel of four, any of them.
        steep = np.tan(np.arccos(abs(tree.leaves.normals[leaf] @ turn[2])))
        far, near = sliced[nearest].range
        assert found.depth == pytest.approx(depth, abs=abs(near - far) / 255 + 3 * sliced[nearest].texel * steep)
        side = np.sign(tree.leaves.normals[leaf] @ turn[2])
        np.testing.assert_allclose(found.normal, side * tree.leaves.normals[leaf], atol=0.02)


# ---- where leaves are ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("slicing", range(5), ids=["front", "right", "back", "left", "above"])
def test_every_leaf_is_on_its_slice_with_its_colour_depth_and_slope(slicing: int) -> None:
    assert_shows_every_leaf(baked().slicings, two_colors(), slicing, turns(SMALL)[slicing])


@pytest.mark.parametrize("slicing", range(5), ids=["front", "right", "back", "left", "above"])
def test_a_slice_covers_what_its_leaves_do(slicing: int) -> None:
    turn, tree = turns(SMALL)[slicing], two_colors()
    sliced = rows(baked().slicings, slicing)
    depths = (tree.leaves.centers - baked().slicings.center) @ turn[2]
    nearest = np.abs(depths[:, None] - [row.offset for row in sliced]).argmin(axis=1)
    for index, row in enumerate(sliced):
        assert row.covered() == pytest.approx((nearest == index).sum() * SIZE**2 / np.sqrt(3), rel=0.04)


def test_the_table_starts_with_the_front_and_goes_round_to_the_right() -> None:
    made = baked().slicings
    for slicing, turn in enumerate(turns(SMALL)):
        for row in rows(made, slicing):
            np.testing.assert_allclose(row.turn, turn, atol=1e-7)
        offsets = [row.offset for row in rows(made, slicing)]
        assert offsets == sorted(offsets)  # the furthest first
        np.testing.assert_allclose(offsets, -np.array(offsets[::-1]), atol=1e-7)


def test_what_is_said_of_the_slicings() -> None:
    made, tree = baked().slicings, two_colors()
    np.testing.assert_allclose(made.center, tree.foliage.bounds.mean(axis=0), atol=1e-6)
    assert made.size == pytest.approx(np.ptp(tree.foliage.bounds, axis=0).max())
    assert (made.orientations, made.count, made.above, made.dropped) == (4, 3, True, 0)
    assert made.atlas.mips == 1  # of a gutter of two texels
    kept = sum((b[2] - b[0]) * (b[3] - b[1]) / row.texel**2 for row in all_rows(made) for b, _ in row.rectangles)
    assert kept < made.untrimmed
    wide, high = np.ptp((tree.foliage.positions @ turn_to(0, 0).T)[:, :2], axis=0)
    assert made.untrimmed > 4 * 3 * 128**2 * min(wide, high) / max(wide, high)


def test_rectangles_keep_their_gutter() -> None:
    height, width = baked().slicings.atlas.coverage.pixels.shape[:2]
    held = np.zeros((height, width), int)
    for row in all_rows(baked().slicings):
        for _, texels in row.rectangles:
            left, bottom, right, top = np.rint(texels * [width, height, width, height]).astype(int)
            assert min(left, top, width - right, height - bottom) >= SMALL.gutter
            held[top - 2 : bottom + 2, left - 2 : right + 2] += 1
    assert held.max() == 1


def test_far_away_all_leaves_are_on_one_slice() -> None:
    made, tree = baked().slicings, two_colors()
    assert made.far_row == 5 * 3
    assert len(made.slices) == 5 * 3 + 5
    for slicing, turn in enumerate(turns(SMALL)):
        row = Row(made, made.slices[made.far_row + slicing])
        assert row.offset == 0
        np.testing.assert_allclose(row.turn, turn, atol=1e-7)
        for center in tree.leaves.centers:
            x, y, depth = turn @ (center - made.center)
            found = row.at(x, y)
            assert found is not None
            assert found.depth == pytest.approx(depth, abs=2 * row.texel)


def test_no_far_slices_where_none_are_asked_for() -> None:
    made = slicings(two_colors(), replace(SMALL, far_height=0.0)).slicings
    assert len(made.slices) == made.far_row == 5 * 3


def test_no_slicing_from_above_where_none_is_asked_for() -> None:
    made = slicings(two_colors(), replace(SMALL, above=False)).slicings
    assert not made.above
    assert (made.far_row, len(made.slices)) == (4 * 3, 4 * 3 + 4)
    assert all(row.turn[2, 1] == 0 for row in all_rows(made))


# ---- large primitives ----------------------------------------------------------------------------------------------


def long_and_short() -> Tree:
    """A leaf of 1.5, tilted so that it reaches over all slices of the front, and two small ones at the ends."""
    small = leaf_tree([(-0.9, 0, 0.8), (0.9, 0, -0.8)], size=0.1)
    long = leaf_tree([(0, 0, 0)], (0, 1, 1), size=1.5)
    leaves = {
        field.name: np.concatenate([getattr(small.leaves, field.name), getattr(long.leaves, field.name)])
        for field in fields(small.leaves)
    }
    leaves["face_leaf"] = np.array([0, 0, 1, 1, 2, 2], np.int32)
    foliage = replace(
        small.foliage,
        **{
            name: np.concatenate([getattr(small.foliage, name), getattr(long.foliage, name)])
            for name in ("positions", "normals", "uvs", "face_material", "face_node")
        },
        faces=np.concatenate([small.foliage.faces, long.foliage.faces + 8]).astype(np.int32),
    )
    return frozen(replace(small, foliage=foliage, leaves=replace(small.leaves, **leaves)))


def test_a_large_primitive_is_cut_up_between_the_slices() -> None:
    tree = long_and_short()
    made = slicings(tree, replace(SMALL, above=False))
    assert made.solid.triangles == 0
    sliced = rows(made.slicings, 0)
    edges = [-np.inf, *((a.offset + b.offset) / 2 for a, b in pairwise(sliced)), np.inf]
    for y in np.linspace(-0.45, 0.45, 19):  # it leans back: its depth is -y
        (index,) = (i for i in range(3) if edges[i] <= -y < edges[i + 1])
        if min(abs(-y - edges[i]) for i in (1, 2)) < 2 * sliced[index].texel:
            continue
        shown = [row.at(0, y) for row in sliced]
        assert [i for i, found in enumerate(shown) if found and found.coverage > 0] == [index]
        assert shown[index].depth == pytest.approx(-y, abs=2 * sliced[index].texel)
    covered = sum(row.covered() for row in sliced)
    assert covered == pytest.approx(1.5**2 / np.sqrt(2) + 2 * 0.1**2, rel=0.03)


def test_a_large_primitive_is_left_as_a_mesh() -> None:
    tree = long_and_short()
    made = slicings(tree, replace(SMALL, above=False, large="mesh"))
    assert made.solid.triangles == 2
    np.testing.assert_array_equal(made.solid.bounds, leaf_tree([(0, 0, 0)], (0, 1, 1), size=1.5).foliage.bounds)
    sliced = rows(made.slicings, 0)
    assert sum(row.covered() for row in sliced) == pytest.approx(2 * 0.1**2, rel=0.1)
    assert max(abs(made.standard.positions[:, 1])) < 0.25  # the standard cards leave it out too


def test_what_is_large_in_one_slicing_only_is_on_no_slice_of_any() -> None:
    # Flat to the front, and on edge to the side.
    tree = leaf_tree([(0, 0, 0), (0, 0, -1), (1, 0, 0)], [(0, 0, 1), (0, 0, 1), (1, 0, 0)], size=0.9)
    made = slicings(tree, replace(SMALL, orientations=4, above=False, large="mesh"))
    assert made.solid.triangles == 6
    assert not any(row.rectangles for row in all_rows(made.slicings))
    assert made.standard.triangles == 0


# ---- mirrored slices -----------------------------------------------------------------------------------------------


def seen_from_behind(made: Slicings) -> list[int]:
    return [number for number, row in enumerate(all_rows(made)) if row.range[0] > row.range[1]]


def test_what_looks_alike_from_both_sides_is_kept_once() -> None:
    made = baked().slicings
    assert seen_from_behind(made) == list(range(6, 12))  # the back and the left, not the one from above, nor the far
    apart = slicings(two_colors(), replace(SMALL, mirror=0.0)).slicings
    assert made.atlas.coverage.pixels[..., 0].sum() < 0.75 * apart.atlas.coverage.pixels[..., 0].sum()


def test_what_shows_another_colour_from_behind_is_not_mirrored() -> None:
    tree = two_colors([(0, 0, 0.05), (0, 0, -0.05), (0.4, 0.4, 0.6), (0.4, 0.4, -0.6)], (0, 0, 1))
    assert seen_from_behind(slicings(tree, SMALL).slicings) == [
        6,
        8,
        9,
        10,
        11,
    ]  # not the middle; on edge they show nothing


@pytest.mark.parametrize(
    "settings", [replace(SMALL, mirror=0.0), replace(SMALL, orientations=5)], ids=["tolerance 0", "odd"]
)
def test_nothing_is_mirrored(settings: SlicingSettings) -> None:
    assert seen_from_behind(slicings(two_colors(), settings).slicings) == []


def photo(*columns: float, depth: float = 0.25, slope: tuple[float, float] = (0.6, 0.7)) -> Photo:
    """A picture of one row: coverage of each column; all of it premultiplied."""
    alpha = np.array([columns], np.float32)
    relief = np.stack([alpha * slope[0], alpha * slope[1], alpha * depth, alpha], axis=2)
    return Photo(np.dstack([alpha * 0.5] * 3 + [alpha]), relief)


def test_opposite_pictures_pair_by_the_plane_that_they_share() -> None:
    # Two slicings of two slices: the furthest of the front lies where the nearest of the back does.
    front = [photo(1, 0, 0), photo(0, 1, 1, depth=0.5)]
    back = [photo(1, 1, 0, depth=0.5, slope=(0.6, 0.3)), photo(0, 0, 1, depth=0.75, slope=(0.6, 0.3))]
    assert mirrored_pairs([*front, *back], 2, 2, 0.001) == {2: 1, 3: 0}
    assert mirrored_pairs([*front, *back[::-1]], 2, 2, 0.001) == {}
    assert mirrored_pairs([*front, *back, photo(1)], 2, 2, 0.001) == {2: 1, 3: 0}  # what is not around the tree


@pytest.mark.parametrize(
    ("behind", "what"),
    [
        (photo(0, 1, depth=0.75, slope=(0.6, 0.3)), None),
        (photo(1, 0, depth=0.75, slope=(0.6, 0.3)), "place"),
        (photo(0, 1, depth=0.25, slope=(0.6, 0.3)), "depth"),
        (photo(0, 1, depth=0.75, slope=(0.6, 0.7)), "slope up"),
        (photo(0, 1, depth=0.75, slope=(0.4, 0.3)), "slope aside"),
        (photo(0, 0, 1, depth=0.75, slope=(0.6, 0.3)), "size"),
    ],
)
def test_pictures_pair_only_where_all_of_them_is_mirrored(behind: Photo, what: str | None) -> None:
    assert mirrored_pairs([photo(1, 0), behind], 2, 1, 0.1) == ({} if what else {1: 0})


def test_slices_that_show_nothing_pair() -> None:
    assert mirrored_pairs([photo(0, 0), photo(0, 0)], 2, 1, 0.01) == {1: 0}


def test_the_tolerance_is_the_mean_over_what_is_covered() -> None:
    darker = photo(0, 1, depth=0.75, slope=(0.6, 0.3))
    darker.albedo[..., :3] *= np.float32(0.9)  # by 0.05 of 1
    for tolerance, pairs in ((0.051, {1: 0}), (0.049, {})):
        assert mirrored_pairs([photo(1, 0), darker], 2, 1, tolerance) == pairs


# ---- standard cards ------------------------------------------------------------------------------------------------


def test_standard_cards_stand_on_the_slices_of_two_perpendicular_slicings() -> None:
    made = baked()
    cards = made.standard
    (material,) = cards.materials
    assert (material.alpha_mode, material.double_sided) == (AlphaMode.MASK, True)
    assert material.normal_map is not None
    corners = cards.positions[cards.faces].astype(np.float64)
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    assert {tuple(np.abs(side.round(6))) for side in sides} == {(0, 0, 1), (1, 0, 0)}
    np.testing.assert_allclose(cards.normals[cards.faces[:, 0]], sides, atol=1e-6)
    for slicing, axis in ((0, 2), (1, 0)):
        mine = np.abs(sides[:, axis]) > 0.5
        planes = {round(float(value), 5) for value in corners[mine][..., axis].ravel() - made.slicings.center[axis]}
        assert planes == {round(row.offset, 5) for row in rows(made.slicings, slicing)}
    assert cards.triangles == 2 * 6


def test_standard_cards_show_each_leaf_at_its_place() -> None:
    cards, tree = baked().standard, two_colors()
    texture = cards.materials[0].color_map
    assert isinstance(texture, Texture)
    size = np.array(texture.pixels.shape[1::-1])
    for leaf, center in enumerate(tree.leaves.centers):
        seen = []
        for first in range(0, len(cards.positions), 4):  # left bottom, right bottom, right top, left top
            place, uvs = cards.positions[first : first + 4].astype(np.float64), cards.uvs[first : first + 4]
            right, up = place[1] - place[0], place[3] - place[0]
            part = np.array([(center - place[0]) @ way / (way @ way) for way in (right, up)])
            if (part > 0).all() and (part < 1).all():
                x, y = ((uvs[0] + part[0] * (uvs[1] - uvs[0]) + part[1] * (uvs[3] - uvs[0])) * size).astype(int)
                seen.append(texture.pixels[y, x])
        shown = [texel for texel in seen if texel[3] > 127]
        color = tree.foliage.materials[leaf % 2].base_color[:3]
        assert len(shown) == 2  # once each way
        for texel in shown:
            np.testing.assert_allclose(to_linear(texel[:3]), color, atol=0.02)


# ---- odd foliage, and the same twice --------------------------------------------------------------------------------


def arrays_of(value: object) -> list[np.ndarray]:
    """Every array and number in a dataclass."""
    if isinstance(value, np.ndarray):
        return [value]
    if hasattr(value, "__dataclass_fields__"):
        return [array for field in fields(value) for array in arrays_of(getattr(value, field.name))]
    if isinstance(value, tuple):
        return [array for part in value for array in arrays_of(part)]
    return [np.array(value)]


def test_the_same_tree_gives_the_same_bytes() -> None:
    again = slicings(two_colors(), SMALL)
    for first, second in zip(arrays_of(baked()), arrays_of(again), strict=True):
        assert first.tobytes() == second.tobytes()


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize(
    "centers",
    [[(0, 0, 0)], [(-1, 0, 0), (1, 0.3, 0)]],
    ids=["a single leaf", "all in one plane"],
)
def test_flat_foliage_is_sliced(centers: Sequence[tuple[float, ...]], count: int) -> None:
    tree = leaf_tree(centers, size=0.5)
    made = slicings(tree, replace(SMALL, slices=count)).slicings
    assert np.isfinite(made.slices).all()
    assert np.isfinite([made.brightness, made.exposure]).all()
    covered = sum(row.covered() for row in rows(made, 0))
    assert covered == pytest.approx(len(centers) * 0.5**2, rel=0.03)
    assert sum(row.covered() for row in rows(made, 1)) == 0  # seen on edge


def test_a_single_leaf_is_no_large_primitive() -> None:
    tree = leaf_tree([(0.1, 0.2, 0.3)], (1, 2, 3))
    assert slicings(tree, replace(SMALL, above=False, orientations=4, large="mesh")).solid.triangles == 0


@pytest.mark.parametrize("texels", [16, 128])
def test_the_longer_side_has_the_texels_that_are_asked_for(texels: int) -> None:
    made = slicings(two_colors(), replace(SMALL, texels=texels, supersample=1, slices=1, atlas=16384)).slicings
    longer = np.ptp(two_colors().foliage.bounds, axis=0)[:2].max()
    assert rows(made, 0)[0].texel == pytest.approx(longer / texels, rel=1e-3)


# ---- settings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("orientations", 1, "4 to 64"),
        ("orientations", 65, "4 to 64"),
        ("slices", 0, "1 to 64"),
        ("slices", 65, "1 to 64"),
        ("texels", 15, "16 to 1024"),
        ("texels", 1025, "16 to 1024"),
        ("far_texels", 15, "16 to 1024"),
        ("far_texels", 1025, "16 to 1024"),
        ("far_height", -1.0, "0 or more"),
        ("dropped", 3, "0 to 2"),
        ("dropped", -1, "0 to 2"),
        ("large", "leaf", '"slices" or "mesh"'),
        ("mirror", -0.1, "0 to 1"),
        ("mirror", 1.1, "0 to 1"),
        ("rectangles", 0, "1 to 8"),
        ("rectangles", 9, "1 to 8"),
        ("atlas", 32, "power of two from 64 to 16384"),
        ("atlas", 1000, "power of two from 64 to 16384"),
        ("atlas", 32768, "power of two from 64 to 16384"),
        ("gutter", 0, "power of two from 1 to 64"),
        ("gutter", 3, "power of two from 1 to 64"),
        ("gutter", 128, "power of two from 1 to 64"),
        ("supersample", 0, "1 to 4"),
        ("supersample", 5, "1 to 4"),
    ],
)
def test_a_setting_out_of_range_is_named(name: str, value: object, says: str) -> None:
    with pytest.raises(SettingsError) as caught:
        slicings(two_colors(), replace(SMALL, **{name: value}))
    assert str(caught.value).startswith(f"[slicings] {name} is {value}; it must be ")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "settings",
    [
        {"slices": 1, "dropped": 0, "orientations": 4, "far_height": 0.0, "mirror": 1.0, "gutter": 1},
        {"slices": 3, "dropped": 2, "rectangles": 8, "texels": 16, "gutter": 64, "atlas": 16384},
    ],
    ids=["least", "most"],
)
def test_settings_at_the_ends_of_their_ranges_are_taken(settings: dict[str, object]) -> None:
    assert slicings(two_colors(), replace(SMALL, **settings)).standard.triangles > 0


def test_an_atlas_too_small_names_one_that_is_large_enough() -> None:
    small = replace(SMALL, texels=256, supersample=1, atlas=64)
    with pytest.raises(
        BudgetError, match=r"an atlas of 64 texels a side; set \[slicings\] atlas = \d+, or lower \[slicings\] texels"
    ) as caught:
        slicings(two_colors(), small)
    assert "\n" not in str(caught.value)
    enough = int(re.findall(r"atlas = (\d+)", str(caught.value))[0])
    assert enough & (enough - 1) == 0
    with pytest.raises(BudgetError):
        slicings(two_colors(), replace(small, atlas=enough // 2))
    made = slicings(two_colors(), replace(small, atlas=enough)).slicings
    assert max(made.atlas.coverage.pixels.shape) <= enough


# ---- what a review found ---------------------------------------------------------------------------------------------


def test_a_leaf_that_lies_flat_is_published_and_read(tmp_path: Path) -> None:
    tree = leaf_tree([(0.0, 1.0, 0.0)], (0, 1, 0))
    write_slicings(tmp_path / "lily.glb", slicings(tree, SMALL))
    assert read_slicings(tmp_path / "lily.glb").size > 0


def test_a_tree_far_from_the_origin_is_fitted_like_any() -> None:
    near, far = (
        slicings(leaf_tree([(x + 0.3 * i, 0.2 * i, 0.4 * (i % 3)) for i in range(6)], size=0.4), SMALL).slicings
        for x in (0.0, 512.0)
    )
    assert far.brightness == pytest.approx(near.brightness, abs=0.05)
    assert far.exposure == pytest.approx(near.exposure, abs=0.02)


def test_nothing_fades_where_a_slice_is_cut_in_two() -> None:
    bar, post = (np.array(box, float) for box in ((-1, -1, 1, -0.6), (-1, -1, -0.6, 1)))  # an L, solid
    tree = leaf_tree([(0.0, 0.0, 0.0)] * 2, size=1.0)
    corners = [[[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]] for x0, y0, x1, y1 in (bar, post)]
    tree = replace(tree, foliage=replace(tree.foliage, positions=np.array(corners, np.float32).reshape(-1, 3)))
    made = slicings(tree, replace(SMALL, slices=1, rectangles=2, above=False, far_height=0.0)).slicings
    row = made.slices[0]
    assert (row[3::2, 2] > row[3::2, 0]).all()  # it was cut
    height, width = made.atlas.coverage.pixels.shape[:2]
    for left, bottom, right, top in row[4::2] * [width, height, width, height]:
        beyond = made.atlas.coverage.pixels[round(top) - 1 : round(bottom) + 1, round(left) - 1 : round(right) + 1, 0]
        inside = made.atlas.coverage.pixels[round(top) : round(bottom), round(left) : round(right), 0]
        assert (inside[1:-1, 1:-1] == 255).all()  # its outline may fall within a texel
        assert any((edge[1:-1] == 255).any() for edge in (beyond[0], beyond[-1], beyond[:, 0], beyond[:, -1]))
