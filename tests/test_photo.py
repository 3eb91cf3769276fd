"""Photographs of small meshes: every texel can be worked out by hand."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.synthetic import joined, quad, texture
from treebake.geometry import turn_to
from treebake.gl.context import context
from treebake.gl.photo import Photo, Shot, photograph
from treebake.images import to_linear
from treebake.model import AlphaMode, Doubles, Material, Mesh
from treebake.pictures import STEEPEST

GREY = Material("grey", base_color=(0.2, 0.2, 0.2, 1.0))
RED, GREEN = (Material(n, base_color=c) for n, c in (("red", (0.5, 0, 0, 1)), ("green", (0, 0.5, 0, 1))))
FRONT = np.eye(3)
HALF = 1e-3  # samples are kept in half floats
EVERYWHERE = (-np.inf, np.inf)


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


def shot(
    mesh: Mesh,
    turn: Doubles = FRONT,
    *,
    reach: tuple[float, float, float] = (1.0, 1.0, 1.0),
    size: tuple[int, int] = (8, 8),
    cut: bool = False,
    slab: tuple[float, float] = EVERYWHERE,
) -> Shot:
    """All faces, whole or cut, in a box around the origin."""
    every, none = np.arange(mesh.triangles, dtype=np.int32), np.zeros(0, np.int32)
    high = np.array(reach)
    return Shot(turn, -high, high, size, none if cut else every, every if cut else none, slab)


def take(mesh: Mesh, *args: Doubles, supersample: int = 4, **more: object) -> Photo:
    (photo,) = photograph(mesh, [shot(mesh, *args, **more)], supersample)
    return photo


def slope(right: float, up: float) -> list[float]:
    return [right / STEEPEST / 2 + 0.5, up / STEEPEST / 2 + 0.5]


def test_a_quad_is_where_it_is_and_upright() -> None:
    alpha = take(quad(GREY, x=(-1.0, 0.0), y=(0.5, 1.0))).albedo[..., 3]
    expected = np.zeros((8, 8))
    expected[:2, :4] = 1  # the left half of the upper quarter
    np.testing.assert_array_equal(alpha, expected)


def test_a_picture_may_be_wider_than_high() -> None:
    photo = take(quad(GREY, x=(1.0, 2.0), y=(-1.0, 0.0)), reach=(2.0, 1.0, 1.0), size=(8, 4))
    expected = np.zeros((4, 8))
    expected[2:, 6:] = 1
    np.testing.assert_array_equal(photo.albedo[..., 3], expected)
    assert (photo.albedo.shape, photo.relief.shape) == ((4, 8, 4), (4, 8, 4))


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 180.0, 270.0, 37.0])
def test_seen_from_any_side_right_is_right(azimuth: float) -> None:
    turn = turn_to(0.0, azimuth)
    mesh = quad(GREY, x=(0.0, 1.0), y=(-1.0, 0.0))
    facing = replace(mesh, positions=np.asarray(mesh.positions @ turn, np.float32))
    alpha = take(facing, turn).albedo[..., 3]
    assert alpha[4:, 4:].min() == 1
    assert alpha.sum() == 16


@pytest.mark.parametrize("supersample", [2, 4])
def test_a_half_covered_texel_is_covered_by_half(supersample: int) -> None:
    photo = take(quad(GREY, x=(-1.0, 0.125)), supersample=supersample)  # its edge halves the fifth column
    assert photo.albedo[0, :, 3].tolist() == [1, 1, 1, 1, 0.5, 0, 0, 0]


def test_one_sample_a_texel_is_all_or_nothing() -> None:
    assert take(quad(GREY, x=(-1.0, 0.15)), supersample=1).albedo[0, :, 3].tolist() == [1, 1, 1, 1, 1, 0, 0, 0]


def test_everything_is_premultiplied_by_coverage() -> None:
    photo = take(quad(GREY, x=(-1.0, 0.125), z=0.5))
    for image in (photo.albedo, photo.relief):
        assert np.allclose(image[:, 4], image[:, 3] / 2, atol=HALF)
        assert image[:, 3].all()
        assert not image[:, 5:].any()


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 1, 0.1), (0, -1, 0.1)])
def test_albedo_has_no_light(normal: tuple[float, float, float]) -> None:
    assert np.allclose(take(quad(GREY, normal=normal)).albedo[..., :3], 0.2, atol=HALF)


def test_a_texture_is_upright() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (8, 8, 3), np.uint8)
    photo = take(quad(Material("map", color_map=texture(pixels), base_color=(1.0, 0.5, 1.0, 1.0))), supersample=1)
    assert np.allclose(photo.albedo[..., :3], to_linear(pixels) * [1, 0.5, 1], atol=2 * HALF)


@pytest.mark.parametrize(("z", "depth"), [(-0.99, 0.005), (-0.5, 0.25), (0.0, 0.5), (0.99, 0.995)])
def test_depth_goes_from_the_far_end_to_the_viewer(z: float, depth: float) -> None:
    assert np.allclose(take(quad(GREY, z=z)).relief[..., 2], depth, atol=HALF)


def test_depth_is_along_the_way_to_the_viewer() -> None:
    mesh = quad(replace(GREY, double_sided=True), x=(-0.5, 0.5), y=(-0.5, 0.5), z=0.5)
    photo = take(mesh, turn_to(0.0, 180.0), reach=(1.0, 1.0, 2.0))
    assert np.allclose(photo.relief[4, 4, 2], (-0.5 + 2) / 4, atol=HALF)


def test_a_picture_sees_all_of_its_depth_and_no_more() -> None:
    assert not take(quad(GREY, z=1.1)).albedo.any()
    assert not take(quad(GREY, z=-1.1)).albedo.any()


@pytest.mark.parametrize("azimuth", [-60.0, 30.0, 60.0])
@pytest.mark.parametrize("elevation", [0.0, 40.0])
def test_slopes_are_those_of_the_surface_as_the_picture_sees_it(azimuth: float, elevation: float) -> None:
    turn = turn_to(elevation, azimuth)
    mesh = quad(GREY, x=(-3, 3), y=(-3, 3))
    right, up, towards = turn @ [0, 0, 1]
    photo = take(mesh, turn, reach=(0.1, 0.1, 9.0))
    assert np.allclose(photo.relief[..., :2], slope(right / towards, up / towards), atol=2 * HALF)


def test_a_slope_to_the_right_is_red_and_one_up_green() -> None:
    assert np.allclose(take(quad(GREY, normal=(0.6, 0, 0.8))).relief[0, 0, :2], slope(0.75, 0), atol=HALF)
    assert np.allclose(take(quad(GREY, normal=(0, 0.6, 0.8))).relief[0, 0, :2], slope(0, 0.75), atol=HALF)


@pytest.mark.parametrize("normal", [(1, 0, 0.01), (1, 0, 0), (1, 0, -1)], ids=["steep", "edge-on", "averted"])
def test_slopes_end_at_the_steepest(normal: tuple[float, float, float]) -> None:
    assert np.allclose(take(quad(GREY, normal=normal)).relief[0, 0, :2], [1, 0.5], atol=HALF)


def test_normals_that_cancel_each_other_face_the_viewer() -> None:
    photo = take(quad(GREY, normal=(0, 0, 0)))
    assert np.allclose(photo.relief[..., :2], 0.5, atol=HALF)


def test_the_back_of_a_single_sided_face_is_not_seen() -> None:
    assert not take(quad(GREY), turn_to(0.0, 180.0)).albedo.any()


def test_the_back_of_a_double_sided_face_slopes_the_other_way() -> None:
    both = quad(replace(GREY, double_sided=True), normal=(0.6, 0, 0.8))
    back = take(both, turn_to(0.0, 180.0))
    assert np.allclose(back.relief[..., :2], slope(0.75, 0), atol=HALF)  # right is -X from there
    assert np.allclose(take(both).relief[..., :2], slope(0.75, 0), atol=HALF)


@pytest.mark.parametrize(("alpha", "cutoff", "seen"), [(127, 0.5, 0), (128, 0.5, 1), (80, 0.3, 1), (0, 0.1, 0)])
def test_a_mask_is_cut_at_its_cutoff(alpha: int, cutoff: float, seen: float) -> None:
    mask = Material("mask", color_map=texture([[(90, 90, 90)]], alpha), alpha_mode=AlphaMode.MASK, alpha_cutoff=cutoff)
    assert (take(quad(mask)).albedo[..., 3] == seen).all()


def test_small_cut_outs_are_neither_thinned_nor_coloured_by_mips() -> None:
    pixels = np.kron([[1, 0], [0, 0]], np.ones((16, 16)))[..., None] * [0, 120, 0, 255]  # opaque in a quarter
    pixels[pixels[..., 3] == 0, :3] = 255  # white under the alpha
    mask = Material("mask", color_map=texture(pixels), alpha_mode=AlphaMode.MASK)
    mesh = quad(mask, uvs=53.7 * np.array([(0, 1), (1, 1), (1, 0), (0, 0)]))
    photo = take(mesh, size=(61, 61))
    assert photo.albedo[..., 3].mean() == pytest.approx(0.25, abs=0.02)
    mean = photo.albedo[..., :3].sum(axis=(0, 1)) / photo.albedo[..., 3].sum()
    assert np.allclose(mean, to_linear(np.array([0, 120, 0], np.uint8)), atol=0.03)


@pytest.mark.parametrize("alpha", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_a_blended_face_covers_its_share(alpha: float) -> None:
    glass = Material("glass", base_color=(0.2, 0.4, 0.2, alpha), alpha_mode=AlphaMode.BLEND)
    photo = take(quad(glass))
    assert (photo.albedo[..., 3] == alpha).all()
    assert np.allclose(photo.albedo[..., :3], alpha * np.array([0.2, 0.4, 0.2]), atol=HALF)


def test_an_opaque_face_ignores_alpha() -> None:
    assert (take(quad(Material("opaque", base_color=(1, 1, 1, 0.0)))).albedo[..., 3] == 1).all()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_hides_the_farther(order: tuple[int, int]) -> None:
    near, far = quad(RED, z=0.3, x=(-1.0, 0.0)), quad(GREEN)
    photo = take(joined(*[(near, far)[i] for i in order]))
    assert photo.albedo[:, :4, 1].max() == 0
    assert photo.albedo[:, 4:, 0].max() == 0
    assert np.allclose(photo.relief[0, :, 2], [0.65] * 4 + [0.5] * 4, atol=HALF)


def test_whole_faces_and_cut_ones_hide_each_other() -> None:
    mesh = joined(quad(RED, z=0.3), quad(GREEN))
    two = np.arange(2, dtype=np.int32)
    for whole, cut in ((two, two + 2), (two + 2, two)):
        (photo,) = photograph(mesh, [replace(shot(mesh), faces=whole, cut=cut, slab=(-0.5, 0.5))], 2)
        assert photo.albedo[..., 1].max() == 0


def slanted() -> Mesh:
    """From far at the left to near at the right: depth is x."""
    mesh = quad(GREY)
    return replace(mesh, positions=mesh.positions + mesh.positions[:, :1] * np.float32([0, 0, 1]))


def test_cut_faces_are_seen_in_the_slab_only_and_others_whole() -> None:
    seen = take(slanted(), cut=True, slab=(-0.25, 0.5)).albedo[..., 3]
    np.testing.assert_array_equal(seen, np.tile([0, 0, 0, 1, 1, 1, 0, 0], (8, 1)))
    assert take(slanted(), slab=(-0.25, 0.5)).albedo[..., 3].min() == 1


@pytest.mark.parametrize("turn", [FRONT, turn_to(0.0, 10.0), turn_to(20.0, 200.0)], ids=["front", "aside", "behind"])
def test_slabs_side_by_side_share_a_face_without_a_gap(turn: Doubles) -> None:
    both = replace(slanted(), materials=(replace(GREY, double_sided=True),))
    edges = [-np.inf, -0.3, 0.1, np.inf]
    parts = [take(both, turn, reach=(2, 2, 2), cut=True, slab=slab).albedo[..., 3] for slab in pairwise(edges)]
    np.testing.assert_array_equal(sum(parts), take(both, turn, reach=(2, 2, 2)).albedo[..., 3])
    assert all(part.any() for part in parts)


def test_only_the_faces_asked_for_are_seen() -> None:
    mesh = joined(quad(RED, z=0.3), quad(GREEN))
    (photo,) = photograph(mesh, [replace(shot(mesh), faces=np.array([3, 2], np.int32))], 1)
    assert photo.albedo[..., 0].max() == 0
    assert photo.albedo[..., 1].min() > 0


def test_no_faces_are_an_empty_picture() -> None:
    mesh = quad(GREY)
    photo = next(photograph(mesh, [replace(shot(mesh), faces=np.zeros(0, np.int32))], 4))
    for image in (photo.albedo, photo.relief):
        assert image.shape[:2] == (8, 8)
        assert not image.any()


BUMP = (200, 170, 220)


@pytest.mark.parametrize(
    ("uvs", "turned"),
    [
        (((0, 1), (1, 1), (1, 0), (0, 0)), [[1, 0], [0, 1]]),
        (((1, 1), (0, 1), (0, 0), (1, 0)), [[-1, 0], [0, 1]]),
        (((0, 0), (1, 0), (1, 1), (0, 1)), [[1, 0], [0, -1]]),
        (((0, 0), (0, 1), (1, 1), (1, 0)), [[0, -1], [1, 0]]),
    ],
    ids=["upright", "mirrored", "upside down", "turned"],
)
def test_a_normal_map_turns_the_slope(uvs: object, turned: object) -> None:
    x, y, z = np.array(BUMP) / 255 * 2 - 1
    right, up = np.array(turned) @ [x, y]
    photo = take(quad(replace(GREY, normal_map=texture([[BUMP]])), uvs=uvs))
    assert np.allclose(photo.relief[..., :2], slope(right / z, up / z), atol=2 * HALF)


def test_seen_from_behind_a_bump_is_a_dent() -> None:
    both = quad(replace(GREY, normal_map=texture([[BUMP]]), double_sided=True))
    x, y, z = np.array(BUMP) / 255 * 2 - 1
    photo = take(both, turn_to(0.0, 180.0))
    assert np.allclose(photo.relief[..., :2], slope(x / z, -y / z), atol=2 * HALF)  # reversed; right is -X from there


def test_pictures_do_not_depend_on_those_taken_before() -> None:
    mesh = joined(quad(RED, z=0.3, x=(-1.0, 0.0)), quad(GREEN))
    shots = [shot(mesh), shot(mesh, size=(4, 2)), shot(mesh, turn_to(0.0, 180.0)), shot(mesh)]
    together = list(photograph(mesh, shots, 2))
    for each, photo in zip(shots, together, strict=True):
        (alone,) = photograph(mesh, [each], 2)
        for name in ("albedo", "relief"):
            np.testing.assert_array_equal(getattr(photo, name), getattr(alone, name))


def test_no_shots_no_pictures() -> None:
    assert list(photograph(quad(GREY), [], 4)) == []
