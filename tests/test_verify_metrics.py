"""The metrics, against pictures small enough to work out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.synthetic import joined, quad, small_tree, texture
from treebake.gl.target import Picture
from treebake.images import flip_error, to_srgb
from treebake.model import IndirectTextures, Material
from treebake.verify.cost import Cost, cost_of
from treebake.verify.metrics import GREY, SKY, over, score, score_all, similarity

SIZE = 64


def picture(rows: slice, columns: slice, *, alpha: float = 1.0, depth: float = 5.0, color: float = 0.3) -> Picture:
    """A rectangle of one colour."""
    pixels, depths = np.zeros((SIZE, SIZE, 4), np.float32), np.zeros((SIZE, SIZE), np.float32)
    pixels[rows, columns] = (color * alpha, color * alpha, color * alpha, alpha)
    depths[rows, columns] = depth
    return Picture(pixels, depths)


ALL = slice(None)
LEFT = picture(ALL, slice(0, 32))
NOTHING = picture(slice(0, 0), ALL)


def test_a_picture_against_itself() -> None:
    s = score(LEFT, LEFT)
    assert (s.flip[0], s.iou[0], s.area[0], s.depth[0]) == (0, 1, 32 * SIZE, 0)
    assert s.ssim[0] == pytest.approx(1)


def test_nothing_against_nothing() -> None:
    s = score(NOTHING, NOTHING)
    assert (s.flip[0], s.iou[0], s.area[0]) == (0, 1, 0)
    assert np.isnan(s.depth[0])


def test_shifted_rectangle() -> None:
    s = score(LEFT, picture(ALL, slice(16, 48), depth=5.25))
    assert s.iou[0] == pytest.approx(16 / 48)
    assert s.area[0] == 32 * SIZE
    assert s.depth[0] == pytest.approx(0.25)
    assert 0 < s.flip[0] < 1
    assert s.ssim[0] < 0.9


def test_half_covered_pixels_count_half() -> None:
    s = score(LEFT, picture(ALL, slice(0, 32), alpha=0.5))
    assert s.area[0] == 16 * SIZE
    assert s.iou[0] == pytest.approx(0.5)


def test_depth_is_compared_where_both_cover_half_a_pixel() -> None:
    assert np.isnan(score(LEFT, picture(ALL, slice(0, 32), alpha=0.49)).depth[0])


def test_flip_and_ssim_are_means_over_the_window_and_two_backgrounds() -> None:
    """What is computed only around the tree is what computing it everywhere gives."""
    rng = np.random.default_rng(3)
    pictures = []
    for _ in range(2):
        pixels = np.zeros((96, 96, 4), np.float32)
        alpha = rng.random((30, 20, 1), np.float32)
        pixels[40:70, 30:50] = np.concatenate([rng.random((30, 20, 3), np.float32) * alpha, alpha], axis=2)
        pictures.append(Picture(pixels, np.zeros((96, 96), np.float32)))
    s = score(*pictures)
    pairs = [[over(p, background) for p in pictures] for background in (SKY, GREY)]
    assert s.flip[0] == pytest.approx(np.mean([flip_error(*pair).mean() for pair in pairs]), rel=1e-4)
    assert s.ssim[0] == pytest.approx(np.mean([similarity(*pair).mean() for pair in pairs]), rel=1e-6)


def test_over_composites_premultiplied_light() -> None:
    half = picture(ALL, ALL, alpha=0.5, color=0.4)
    assert np.allclose(over(half, (0.2, 0.4, 0.6)), [0.3, 0.4, 0.5])
    assert over(half, (9.0, 0.0, 0.0)).max() == 1


def ssim_at(a: np.ndarray, b: np.ndarray, row: int, column: int) -> float:
    """SSIM of one pixel by the definition."""
    offsets = np.arange(-5, 6)
    weights = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    weights /= weights.sum()
    luminance = [to_srgb(image @ np.float32([0.2126, 0.7152, 0.0722])) / 255 for image in (a, b)]
    x, y = (image[row - 5 : row + 6, column - 5 : column + 6] for image in luminance)
    mx, my = (weights * x).sum(), (weights * y).sum()
    vx, vy = (weights * (x - mx) ** 2).sum(), (weights * (y - my) ** 2).sum()
    cov = (weights * (x - mx) * (y - my)).sum()
    return ((2 * mx * my + 1e-4) * (2 * cov + 9e-4)) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), row=st.integers(5, 18), column=st.integers(5, 26))
def test_ssim_matches_its_definition(seed: int, row: int, column: int) -> None:
    a, b = np.random.default_rng(seed).random((2, 24, 32, 3), np.float32)
    assert similarity(a, b)[row, column] == pytest.approx(ssim_at(a, b, row, column), abs=1e-9)


def test_views_keep_their_order() -> None:
    others = [LEFT, NOTHING] * 5
    scores = score_all(lambda other: score(LEFT, other), iter(others))
    assert scores.iou.tolist() == [1, 0] * 5
    assert scores.depth.shape == (10,)


def test_an_error_while_scoring_is_raised() -> None:
    with pytest.raises(ZeroDivisionError):
        score_all(lambda x: 1 // x, [1, 0, 1])


def test_a_draw_call_for_each_material_of_each_node() -> None:
    assert cost_of(small_tree()).draw_calls == 4
    one_node = replace(small_tree(), face_node=np.zeros(8, np.int32))
    assert cost_of(one_node).draw_calls == 4  # the three leaves have a material each
    assert cost_of(replace(one_node, face_material=np.array([0, 0] + [1] * 6, np.int32))).draw_calls == 2
    assert cost_of(small_tree().select(np.zeros(8, bool))).draw_calls == 0


def test_gpu_bytes_count_each_used_texture_once_with_mipmaps() -> None:
    image = texture(np.zeros((2, 4, 3)))  # 4x2, 2x1, 1x1
    maps = Material("maps", color_map=image, normal_map=texture(np.zeros((1, 1, 3))))
    unused = Material("unused", color_map=texture(np.zeros((64, 64, 3))))
    mesh = joined(quad(maps), quad(Material("same", color_map=image)), quad(unused)).select(np.arange(6) < 4)
    assert cost_of(mesh).gpu_bytes == 16 * 3 + 16 * 1 + 8 * 32 + 12 * 4  # a block of 16 bytes for each of 3 mips, and 1


@pytest.mark.parametrize("name", ["color_map", "normal_map", "occlusion_map", "roughness_map"])
def test_any_map_costs_its_bytes(name: str) -> None:
    bare, image = Material("bare"), texture(np.zeros((4, 4, 3)))
    mapped = Material("bare", **{name: image})
    assert cost_of(quad(mapped)).gpu_bytes == cost_of(quad(bare)).gpu_bytes + 16 * 3
    # Of two maps in one image, as occlusion and roughness often are, that image counts once.
    both = replace(mapped, occlusion_map=image, roughness_map=image)
    assert cost_of(quad(replace(both, color_map=None, normal_map=None))).gpu_bytes == cost_of(quad(mapped)).gpu_bytes


def test_texture_coordinates_of_occlusion_cost_bytes_where_they_are_its_own() -> None:
    mesh = quad(Material("bark"))
    there = mesh.uvs.copy()
    assert cost_of(replace(mesh, occlusion_uvs=there)) == cost_of(mesh)
    there[:3] += 0.5
    assert cost_of(replace(mesh, occlusion_uvs=there)).gpu_bytes == cost_of(mesh).gpu_bytes + 3 * 8


def test_indirect_billboards_cost_a_draw_call_a_box_each_and_their_bytes() -> None:
    def words(kind: type, *shape: int) -> np.ndarray:
        return np.zeros(shape, kind)

    image, small = texture(np.zeros((4, 8, 3))), texture(np.zeros((1, 1, 3)))
    layers = IndirectTextures(
        billboards=words(np.float32, 3, 20),
        shapes=words(np.float32, 1, 16),
        hash_texture=words(np.uint32, 2, 4),
        lists_texture=words(np.uint16, 1, 1024),
        placements=words(np.uint32, 1, 1024, 4),
        ambient=words(np.uint8, 1, 1024, 4),
        leaves=7,
        largest=1.0,
        leaf_color=image,
        leaf_normal=image,
        far_color=small,
        far_normal=small,
    )
    tables = 3 * 80 + 64 + 8 * 4 + 1024 * (2 + 16 + 4)
    blocks = 5 * (16 + 24) + 16 + 24  # 8 x 4 texels are two blocks; its mips 4 x 2, 2 x 1 and 1 x 1 one each
    alone = cost_of(small_tree())
    assert cost_of(small_tree(), layers) == Cost(8 + 3 * 12, 4 + 1, alone.gpu_bytes + tables + blocks)
    assert alone.triangles == 8
