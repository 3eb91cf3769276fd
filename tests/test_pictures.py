"""Pictures in one atlas: packed apart, cut to what they show, and put together so that no mip mixes in what is not
there."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.errors import BudgetError
from treebake.gl.photo import Photo
from treebake.images import mip_chain, to_linear
from treebake.model import Bytes, Floats, Ints, PictureAtlas
from treebake.pictures import OCCLUSION, Part, compose, covered, pack_pictures, place_pictures, trimmed

SIZES = st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=1, max_size=20)
GUTTERS = st.sampled_from([1, 2, 4, 8, 16])
LIMITS = st.sampled_from([64, 128, 256, 512])


def pictures(*sizes: tuple[int, int]) -> Ints:
    return np.array(sizes, np.int32).reshape(-1, 2)


def photo(alpha: object, albedo: object = 0.0, relief: object = 0.0, sky: object = 1.0) -> Photo:
    """A picture of that coverage (h, w); the rest, one value or one a texel, is premultiplied here."""
    share = np.asarray(alpha, np.float32)[..., None]
    images = [np.broadcast_to(np.asarray(v, np.float32), (*share.shape[:2], 3)) * share for v in (albedo, relief)]
    seen = np.asarray(sky, np.float32) * share
    return Photo(np.concatenate([images[0], share], axis=2), np.concatenate([images[1], seen], axis=2))


def whole(picture: Photo, x: int, y: int) -> Part:
    height, width = picture.albedo.shape[:2]
    return Part(picture, (slice(0, height), slice(0, width)), (x, y))


def grey(atlas: PictureAtlas) -> Bytes:
    return atlas.coverage.pixels[..., 0]


# ---- packed --------------------------------------------------------------------------------------------------------


def cells_needed(sizes: Ints, gutter: int) -> Ints:
    return -(-(sizes + 2 * max(gutter, OCCLUSION // 2)) // OCCLUSION)


@settings(deadline=None)
@given(SIZES, GUTTERS, LIMITS)
def test_pictures_lie_apart_inside_the_atlas_on_whole_blocks(
    sizes: list[tuple[int, int]], gutter: int, limit: int
) -> None:
    packed = pack_pictures(pictures(*sizes), gutter, limit)
    cells = cells_needed(pictures(*sizes), gutter)
    if packed is None:
        # What fits so easily that shelves would do is never refused.
        assert 3 * np.prod(cells, axis=1).sum() > (limit // OCCLUSION) ** 2 or cells.max() * OCCLUSION > limit // 2
        return
    origins, (width, height) = packed
    assert width % OCCLUSION == height % OCCLUSION == 0
    assert max(width, height) <= limit
    assert (origins.dtype, origins.shape) == (np.int32, (len(sizes), 2))
    around = max(gutter, OCCLUSION // 2)
    assert not ((origins - around) % OCCLUSION).any()
    taken = np.zeros((height, width), np.int32)
    for (x, y), (w, h) in zip(origins, sizes, strict=True):
        assert around <= x <= width - around - w
        assert around <= y <= height - around - h
        taken[y - around : y + h + around, x - around : x + w + around] += 1
    assert taken.max() == 1
    assert (width % gutter, height % gutter) == (0, 0)  # halves as often as the mips that stay clean
    assert taken[-max(OCCLUSION, gutter) :].any()  # no row or column of blocks is there for nothing
    assert taken[:, -max(OCCLUSION, gutter) :].any()


@settings(deadline=None)
@given(SIZES, GUTTERS, LIMITS)
def test_more_than_the_atlas_holds_is_refused(sizes: list[tuple[int, int]], gutter: int, limit: int) -> None:
    cells = cells_needed(pictures(*sizes), gutter)
    if np.prod(cells, axis=1).sum() > (limit // OCCLUSION) ** 2 or cells.max() > limit // OCCLUSION:
        assert pack_pictures(pictures(*sizes), gutter, limit) is None


@pytest.mark.parametrize(
    ("size", "limit", "fits"), [((56, 56), 64, True), ((57, 56), 64, False), ((56, 57), 64, False)]
)
def test_a_picture_fits_with_its_gutter_or_not_at_all(size: tuple[int, int], limit: int, fits: bool) -> None:
    assert (pack_pictures(pictures(size), 2, limit) is not None) == fits


def test_equal_squares_leave_nothing_empty() -> None:
    packed = pack_pictures(pictures(*[(8, 8)] * 16), 4, 64)
    assert packed is not None
    assert packed[1] == (64, 64)
    assert pack_pictures(pictures(*[(8, 8)] * 17), 4, 64) is None


def test_one_wide_picture_gets_an_atlas_as_flat_as_itself() -> None:
    packed = pack_pictures(pictures((96, 8)), 2, 4096)
    assert packed is not None
    assert packed[1] == (104, 16)
    assert packed[0].tolist() == [[4, 4]]


def test_no_pictures_need_one_block() -> None:
    packed = pack_pictures(pictures(), 8, 64)
    assert packed is not None
    assert packed[0].shape == (0, 2)
    assert packed[1] == (8, 8)


@settings(deadline=None)
@given(SIZES, GUTTERS)
def test_the_atlas_that_is_proposed_is_large_enough_and_half_of_it_is_not(
    sizes: list[tuple[int, int]], gutter: int
) -> None:
    with pytest.raises(BudgetError) as caught:
        place_pictures(pictures(*sizes, (64, 64)), gutter, 64, "views", "texels")
    found = re.search(r"set \[views\] atlas = (\d+), or lower \[views\] texels", str(caught.value))
    assert found
    enough = int(found[1])
    assert enough & (enough - 1) == 0
    assert pack_pictures(pictures(*sizes, (64, 64)), gutter, enough) is not None
    assert pack_pictures(pictures(*sizes, (64, 64)), gutter, enough // 2) is None


# ---- cut -----------------------------------------------------------------------------------------------------------


def test_a_single_sample_of_16_is_nothing() -> None:
    alpha = [[0, 1 / 16, 2 / 16, 1]]
    assert covered(photo(alpha, albedo=0.5)).tolist() == [[False, False, True, True]]


def test_a_black_leaf_is_something() -> None:
    assert covered(photo([[1.0]], albedo=0.0)).all()


def test_cut_to_left_top_right_bottom() -> None:
    used = np.zeros((6, 9), bool)
    used[2, 1] = used[4, 6] = True
    assert trimmed(used) == (1, 2, 7, 5)


@pytest.mark.parametrize(
    ("used", "box"), [(np.zeros((3, 5), bool), (0, 0, 0, 0)), (np.ones((3, 5), bool), (0, 0, 5, 3))]
)
def test_nothing_is_cut_to_nothing_and_all_stays(used: np.ndarray, box: tuple[int, int, int, int]) -> None:
    assert trimmed(used) == box


# ---- put together --------------------------------------------------------------------------------------------------


def test_coverage_is_kept_to_the_texel() -> None:
    alpha = np.random.default_rng(0).uniform(0, 1, (5, 7))
    atlas = compose([whole(photo(alpha), 3, 9)], (16, 24), 1, "views")  # at an odd place
    expected = np.zeros((24, 16))
    expected[9:14, 3:10] = np.rint(np.float32(alpha) * 255)
    assert (atlas.coverage.pixels[..., :3] == expected[..., None]).all()
    assert (atlas.coverage.pixels[..., 3] == 255).all()


def test_a_part_is_put_in_with_what_is_around_it_in_the_gutter() -> None:
    alpha = np.arange(20).reshape(4, 5) / 20
    part = Part(photo(alpha), (slice(1, 3), slice(2, 5)), (4, 8))
    pixels = grey(compose([part], (16, 16), 1, "views"))
    assert (pixels[7:11, 3:7] == np.rint(alpha[0:4, 1:5] * 255)).all()  # at the photo's edge there is nothing more
    assert np.count_nonzero(pixels) == 4 * 4


def test_the_images_are_named_and_the_others_smaller() -> None:
    atlas = compose([], (24, 16), 1, "views")
    images = (atlas.coverage, atlas.albedo, atlas.relief, atlas.occlusion)
    assert [image.name for image in images] == ["views_coverage", "views_albedo", "views_relief", "views_occlusion"]
    assert [image.pixels.shape for image in images] == [(16, 24, 4), (8, 12, 4), (8, 12, 4), (2, 3, 4)]
    assert not any(image.has_alpha for image in images)


@pytest.mark.parametrize("best", range(4))
def test_of_four_texels_the_most_covered_is_kept_unmixed(best: int) -> None:
    colors = np.eye(4, 3).reshape(2, 2, 3) * 0.7 + 0.1
    alpha = np.full(4, 0.4)
    alpha[best] = 0.6
    picture = photo(alpha.reshape(2, 2), albedo=colors, relief=colors[:, ::-1])
    atlas = compose([whole(picture, 4, 4)], (16, 16), 4, "views")
    wanted = [image.reshape(4, 3)[best] for image in (colors, colors[:, ::-1])]
    assert to_linear(atlas.albedo.pixels[2, 2, :3]) == pytest.approx(wanted[0], abs=0.01)
    assert atlas.relief.pixels[2, 2, :3] / 255 == pytest.approx(wanted[1], abs=0.01)


def test_images_are_stored_without_coverage_in_their_spaces() -> None:
    atlas = compose([whole(photo(np.full((4, 4), 0.25), 0.5, 0.5), 4, 4)], (16, 16), 4, "views")
    assert atlas.albedo.pixels[2, 2].tolist() == [188, 188, 188, 255]  # sRGB of 1/2
    assert atlas.relief.pixels[2, 2].tolist() == [128, 128, 128, 255]  # linear


def test_clear_texels_take_what_is_around_them() -> None:
    red, blue = (photo(np.ones((4, 4)), color, color) for color in ((0.8, 0, 0), (0, 0, 0.8)))
    atlas = compose([whole(red, 4, 4), whole(blue, 52, 4)], (64, 16), 4, "views")
    for image in (atlas.albedo, atlas.relief):
        left, right = image.pixels[:, :6, :3].astype(int), image.pixels[:, 24:, :3].astype(int)
        assert (left[..., 0] > 4 * left[..., 2]).all()
        assert (right[..., 2] > 4 * right[..., 0]).all()
        assert image.pixels[:, :, [0, 2]].sum(axis=2).min() > 100  # nowhere black


def test_occlusion_is_the_mean_of_what_is_covered() -> None:
    alpha, sky = np.zeros((8, 8)), np.zeros((8, 8))
    alpha[:, :2], sky[:, :2] = 1.0, 0.8
    alpha[:, 2:4], sky[:, 2:4] = 0.5, 0.2
    atlas = compose([whole(photo(alpha, sky=sky[..., None]), 8, 8)], (24, 24), 8, "views")
    assert (atlas.occlusion.pixels == [153, 153, 153, 255]).all()  # (2 0.8 + 2 0.5 0.2) / 3, and around it the same


def test_holes_in_a_leaf_take_the_leaf() -> None:
    alpha = np.ones((8, 8))
    alpha[2:6, 2:6] = 0
    atlas = compose([whole(photo(alpha, 0.5, 0.5), 4, 4)], (16, 16), 4, "views")
    assert np.ptp(atlas.albedo.pixels[..., :3]) <= 1
    assert not grey(atlas)[6:10, 6:10].any()


def test_an_atlas_of_nothing() -> None:
    atlas = compose([], (8, 8), 8, "views")
    assert not grey(atlas).any()
    assert np.isfinite(atlas.albedo.pixels).all()


@pytest.mark.parametrize(("gutter", "mips"), [(1, 0), (2, 1), (4, 2), (8, 3), (64, 6)])
def test_mips_follow_from_the_gutter(gutter: int, mips: int) -> None:
    assert compose([], (8, 8), gutter, "views").mips == mips


@pytest.mark.parametrize("gutter", [1, 2, 4, 8])
def test_no_mip_that_is_kept_shows_a_neighbour(gutter: int) -> None:
    sizes = pictures(*[(12, 12)] * 9)
    packed = pack_pictures(sizes, gutter, 1024)
    assert packed is not None
    origins, size = packed
    full, clear = photo(np.ones((12, 12))), photo(np.zeros((12, 12)))
    for alone in range(9):
        parts = [whole(clear if i == alone else full, *origin) for i, origin in enumerate(origins.tolist())]
        atlas = compose(parts, size, gutter, "views")
        for level, mip in enumerate(mip_chain(atlas.coverage.pixels, srgb=False)[: atlas.mips + 1]):
            # Every texel that a filtered lookup in the clear picture may read.
            low = np.maximum(np.floor((origins[alone] / 2**level) - 0.5), 0).astype(int)
            high = np.ceil((origins[alone] + 12) / 2**level + 0.5).astype(int)
            assert not mip[low[1] : high[1], low[0] : high[0], 0].any()


def looked_up(image: Floats, places: Floats) -> Floats:
    """(N,) of (h, w), filtered bilinearly, at places (N, 2) in its texels: columns and rows."""
    last = np.array(image.shape[::-1]) - 1
    low = np.floor(places - 0.5)
    found = np.zeros(len(places))
    for step in np.ndindex(2, 2):
        texel = np.clip(low + step, 0, last).astype(int)
        found += (1 - np.abs(places - 0.5 - low - step)).prod(axis=1) * image[texel[:, 1], texel[:, 0]]
    return found


@pytest.mark.parametrize("gutter", [1, 2, 4, 8, 16, 32, 64])
@pytest.mark.parametrize("covered_part", [1.0, 0.1], ids=["full", "nearly clear"])
def test_no_occlusion_of_a_neighbour_is_looked_up(gutter: int, covered_part: float) -> None:
    """Of pictures that see no sky beside pictures that see all of it."""
    sizes = pictures(*[(9, 21), (12, 16), (31, 4), (5, 5)] * 6)
    packed = pack_pictures(sizes, gutter, 4096)
    assert packed is not None
    origins, size = packed
    sky = np.arange(len(sizes)) % 3 > 0
    parts = []
    for (width, height), origin, seen in zip(sizes.tolist(), origins.tolist(), sky, strict=True):
        alpha = np.zeros((height, width))
        alpha[: max(int(height * covered_part), 1), : max(int(width * covered_part), 1)] = 1
        parts.append(whole(photo(alpha, sky=float(seen)), *origin))
    atlas = compose(parts, size, gutter, "slicings")
    mips = mip_chain(atlas.occlusion.pixels, srgb=False)[: max(atlas.mips - 3, 0) + 1]
    for level, mip in enumerate(mips):
        for (width, height), origin, seen in zip(sizes, origins, sky, strict=True):
            steps = np.stack(np.meshgrid(np.linspace(0, width, 40), np.linspace(0, height, 40)), axis=-1).reshape(-1, 2)
            found = looked_up(mip[..., 0] / 255, (origin + steps) / (OCCLUSION << level))
            np.testing.assert_allclose(found, float(seen), atol=1e-3)


def values(atlas: PictureAtlas) -> list[Floats]:
    return [image.pixels for image in (atlas.coverage, atlas.albedo, atlas.relief, atlas.occlusion)]


def test_the_order_of_the_parts_does_not_matter() -> None:
    parts = [whole(photo(np.full((4, 4), 0.5 + 0.1 * i), 0.2 * i), 4 + 12 * i, 4) for i in range(3)]
    one, other = (compose(order, (40, 16), 4, "views") for order in (parts, parts[::-1]))
    for a, b in zip(values(one), values(other), strict=True):
        np.testing.assert_array_equal(a, b)
