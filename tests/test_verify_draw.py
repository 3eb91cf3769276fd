"""The renderer: what a stock glTF client would show, pixel by pixel where that can be worked out by hand."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from tests.synthetic import BACK, FRONT, joined, lit, quad, small_tree, texture
from tests.trees import tree
from treebake.errors import GraphicsError
from treebake.gl.context import context
from treebake.gl.draw import Drawing
from treebake.gl.target import Picture
from treebake.gl.view import View
from treebake.images import to_linear
from treebake.meshes import read_mesh
from treebake.model import AlphaMode, Material, Mesh, Texture
from treebake.verify.cameras import FIELD_OF_VIEW, MARGIN, Camera, cameras

GREY = Material("grey", base_color=(0.2, 0.2, 0.2, 1.0))
UNIT = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float)  # texture coordinates of an upright picture
HALF = 1e-3  # colours are kept in half floats


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


def draw(mesh: Mesh, view: View = FRONT, *, exact_cutouts: bool = False) -> Picture:
    with closing(Drawing(mesh, exact_cutouts=exact_cutouts)) as drawing:
        return drawing.picture(view)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 1, 0), (0, -1, 0), (0.6, 0, 0.8), (-0.6, 0.8, 0)])
def test_light_matches_its_numpy_twin(normal: tuple[float, float, float]) -> None:
    picture = draw(quad(GREY, normal=normal))
    assert np.allclose(picture.color[..., :3], lit(0.2, normal), atol=HALF)
    assert (picture.color[..., 3] == 1).all()


def test_bright_light_is_clipped() -> None:
    assert draw(quad(Material("white"), normal=(0, 1, 0))).color.max() == 1


def test_single_sided_back_is_not_drawn() -> None:
    picture = draw(quad(GREY), BACK)
    assert not picture.color.any()
    assert not picture.depth.any()


def test_double_sided_back_is_lit_from_behind() -> None:
    both = replace(GREY, double_sided=True)
    assert np.allclose(draw(quad(both), BACK).color[0, 0, :3], lit(0.2, (0, 0, -1)), atol=HALF)
    assert np.allclose(draw(quad(both), FRONT).color[0, 0, :3], lit(0.2, (0, 0, 1)), atol=HALF)


BUMP = (200, 170, 220)
UVS = {  # texture coordinates of the corners, and where u and v then point in the world
    "upright": (((0, 1), (1, 1), (1, 0), (0, 0)), (1, 0, 0), (0, -1, 0)),
    "mirrored": (((1, 1), (0, 1), (0, 0), (1, 0)), (-1, 0, 0), (0, -1, 0)),
    "upside down": (((0, 0), (1, 0), (1, 1), (0, 1)), (1, 0, 0), (0, 1, 0)),
    "turned": (((0, 0), (0, 1), (1, 1), (1, 0)), (0, 1, 0), (1, 0, 0)),
}


@pytest.mark.parametrize("side", ["front", "back"])
@pytest.mark.parametrize("uvs", UVS)
def test_normal_map_points_as_gltf_says(uvs: str, side: str) -> None:
    corners, along_u, along_v = UVS[uvs]
    material = replace(GREY, normal_map=texture([[BUMP]]), double_sided=True)
    x, y, z = np.array(BUMP) / 255 * 2 - 1
    normal = x * np.array(along_u) - y * np.array(along_v) + z * np.array([0, 0, 1])  # +Y is up in the picture
    picture = draw(quad(material, uvs=corners), FRONT if side == "front" else BACK)
    expected = lit(0.2, normal if side == "front" else -normal)
    assert np.allclose(picture.color[..., :3], expected, atol=HALF)


def test_normal_map_without_texture_coordinates_is_ignored() -> None:
    mesh = quad(replace(GREY, normal_map=texture([[BUMP]])), uvs=np.zeros((4, 2)))
    assert np.allclose(draw(mesh).color[..., :3], lit(0.2, (0, 0, 1)), atol=HALF)


def test_texture_is_upright_and_unfiltered_at_its_own_size() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (8, 8, 3))
    material = Material("map", color_map=texture(pixels))
    light = lit(0.25, (0, 0, 1)) * 4  # unclipped
    expected = np.minimum(to_linear(pixels.astype(np.uint8)) * light, 1)
    assert np.allclose(draw(quad(material)).color[..., :3], expected, atol=2 * HALF)


def test_first_mip_is_averaged_in_linear_light() -> None:
    pixels = np.tile([[0, 255], [255, 0]], (8, 8))[..., None].repeat(3, axis=2)  # 16 x 16 texels on 8 x 8 pixels
    material = Material("map", base_color=(0.4, 0.4, 0.4, 1.0), color_map=texture(pixels))
    expected = lit(0.4 * 0.5, (0, 0, 1))  # sRGB-encoded values averaged would give 0.4 * 0.216
    assert np.allclose(draw(quad(material)).color[..., :3], expected, rtol=0.01)


def test_texture_repeats() -> None:
    material = Material("map", base_color=(0.4, 0.4, 0.4, 1), color_map=texture([[(255, 0, 0), (0, 255, 0)]]))
    uvs = np.array([(-1, 1), (1, 1), (1, 0), (-1, 0)])
    red = draw(quad(material, uvs=uvs)).color[0, :, 0]
    assert np.allclose(red[:4], red[4:], atol=HALF)
    assert red[0] > 2 * red[2]


@pytest.mark.parametrize(("alpha", "cutoff", "drawn"), [(127, 0.5, False), (128, 0.5, True), (80, 0.3, True)])
@pytest.mark.parametrize("exact_cutouts", [False, True])
def test_mask_is_cut_at_its_cutoff(alpha: int, cutoff: float, drawn: bool, exact_cutouts: bool) -> None:
    material = Material(
        "mask", color_map=texture([[(90, 90, 90)]], alpha), alpha_mode=AlphaMode.MASK, alpha_cutoff=cutoff
    )
    picture = draw(quad(material), exact_cutouts=exact_cutouts)
    assert (picture.color[..., 3] == float(drawn)).all()
    assert np.allclose(picture.color[..., :3], drawn * lit(to_linear(np.uint8([90]))[0], (0, 0, 1)), atol=HALF)


def test_factor_counts_in_the_alpha_test() -> None:
    material = Material("mask", base_color=(1, 1, 1, 0.4), alpha_mode=AlphaMode.MASK)
    assert not draw(quad(material)).color.any()


def test_opaque_ignores_alpha() -> None:
    picture = draw(quad(Material("opaque", base_color=(1, 1, 1, 0.0), color_map=texture([[(9, 9, 9)]], 0))))
    assert (picture.color[..., 3] == 1).all()


def test_mipmaps_thin_a_mask_and_exact_cutouts_do_not() -> None:
    pixels = np.kron([[255, 0], [0, 0]], np.ones((16, 16)))[..., None].repeat(4, axis=2)  # opaque in a quarter
    mesh = quad(Material("mask", color_map=texture(pixels), alpha_mode=AlphaMode.MASK), uvs=98.7 * UNIT)
    view = replace(FRONT, size=61)
    assert draw(mesh, view).color[..., 3].mean() == 0
    assert draw(mesh, view, exact_cutouts=True).color[..., 3].mean() == pytest.approx(0.25, abs=0.02)


def test_exact_cutouts_keep_the_colour_of_what_is_cut_out() -> None:
    pixels = np.kron([[1, 0], [0, 0]], np.ones((64, 64)))[..., None] * [0, 120, 0, 255]
    pixels[pixels[..., 3] == 0, :3] = 255  # white under the alpha, which mipmaps mix in
    leaf = Material("mask", color_map=texture(pixels), alpha_mode=AlphaMode.MASK)
    color = draw(quad(leaf, uvs=98.7 * UNIT), replace(FRONT, size=61), exact_cutouts=True).color
    mean = color[..., :3].sum(axis=(0, 1)) / color[..., 3].sum()
    assert np.allclose(mean, lit(to_linear(np.uint8([[0, 120, 0]]))[0], (0, 0, 1)), atol=0.015)


def test_exact_cutouts_leave_opaque_alone() -> None:
    stock, exact = (draw(small_tree(), exact_cutouts=exact) for exact in (False, True))
    assert np.array_equal(stock.color, exact.color)
    assert np.array_equal(stock.depth, exact.depth)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_blend_is_drawn_back_to_front_over_opaque(order: tuple[int, int]) -> None:
    glass = Material("glass", base_color=(0.0, 0.4, 0.0, 0.5), alpha_mode=AlphaMode.BLEND)
    far, near = quad(glass, z=0.1), quad(glass, z=0.3)
    panes = joined(*[(far, near)[i] for i in order])
    panes = replace(panes, face_material=np.zeros(4, np.int32))  # one material: its triangles are sorted
    mesh = joined(panes, quad(GREY))
    camera = Camera(0.0, 0.0, np.zeros(3), 2.0)
    middle = draw(mesh, camera.view(64)).color[48, 48]
    green, grey = lit((0, 0.4, 0), (0, 0, 1)), lit(0.2, (0, 0, 1))
    assert np.allclose(middle[:3], green * 0.5 + 0.5 * (green * 0.5 + 0.5 * grey), atol=HALF)
    assert middle[3] == 1


def test_blend_alone_leaves_the_background_through() -> None:
    glass = Material("glass", base_color=(0.0, 0.4, 0.0, 0.25), alpha_mode=AlphaMode.BLEND)
    picture = draw(quad(glass))
    assert np.allclose(picture.color[..., 3], 0.25, atol=HALF)
    assert np.allclose(picture.depth, 1, atol=HALF)


def test_sorting_turns_blended_triangles_round_with_the_view() -> None:
    panes = [
        quad(Material("pane", base_color=(*color, 0.5), alpha_mode=AlphaMode.BLEND, double_sided=True), z=z)
        for color, z in (((0.4, 0.0, 0.0), -0.3), ((0.4, 0.0, 0.0), 0.3))
    ]
    mesh = joined(*panes)
    mesh = replace(mesh, face_material=np.zeros(4, np.int32))
    with closing(Drawing(mesh)) as drawing:
        for azimuth in (0, 180, 0):  # the index buffer is written anew each time
            view = Camera(0.0, azimuth, np.zeros(3), 2.0).view(64)
            assert drawing.picture(view).color[48, 48, 3] == pytest.approx(0.75, abs=HALF)


def test_edges_are_smoothed() -> None:
    picture = draw(quad(GREY, x=(-1.0, 0.125)))  # the edge runs through the middle of the fifth column
    assert np.allclose(picture.color[:, 4, 3], 0.5)
    assert np.allclose(picture.color[:, :4, 3], 1)
    assert not picture.color[:, 5:].any()


def test_depth_runs_along_the_optical_axis() -> None:
    camera = Camera(0.0, 0.0, np.zeros(3), 2.0)
    distance = 2.0 / np.sin(np.radians(FIELD_OF_VIEW / 2))
    picture = draw(quad(GREY, z=0.5), camera.view(64))
    covered = picture.color[..., 3] > 0
    assert np.allclose(picture.depth[covered], distance - 0.5, rtol=1e-5)
    assert not picture.depth[~covered].any()


def test_nearer_surface_hides_the_farther() -> None:
    red, green = (Material(n, base_color=c) for n, c in (("red", (0.5, 0, 0, 1)), ("green", (0, 0.5, 0, 1))))
    for mesh in (joined(quad(red, z=0.2), quad(green)), joined(quad(green), quad(red, z=0.2))):
        assert draw(mesh).color[..., 1].max() == 0


def test_fragments_count_what_is_hidden_and_cut_out_too() -> None:
    hole = Material("hole", base_color=(1, 1, 1, 0), alpha_mode=AlphaMode.MASK)
    mesh = joined(quad(GREY, z=0.2), quad(GREY), quad(hole, z=0.1))
    with closing(Drawing(mesh)) as drawing:
        assert drawing.fragments(FRONT) == 3 * 8 * 8
        assert drawing.fragments(BACK) == 0


def test_nothing_to_draw() -> None:
    mesh = quad(GREY).select(np.zeros(2, bool))
    with closing(Drawing(mesh)) as drawing:
        assert not drawing.picture(FRONT).color.any()
        assert drawing.fragments(FRONT) == 0


def test_views_do_not_depend_on_what_was_drawn_before() -> None:
    mesh = small_tree()
    view = Camera(25.0, 45.0, np.array([0, 1.2, 0]), 1.5).view(64)
    with closing(Drawing(mesh)) as drawing, closing(Drawing(quad(replace(GREY, double_sided=True)))) as other:
        first = drawing.picture(view)
        other.picture(FRONT)
        drawing.fragments(view)
        again = drawing.picture(view)
    assert np.array_equal(first.color, again.color)
    assert np.array_equal(first.depth, again.depth)


def test_a_texture_used_twice_is_uploaded_once_per_colour_space() -> None:
    image = texture([[(128, 128, 255)]])
    mesh = joined(*(quad(replace(GREY, color_map=image, normal_map=image)) for _ in range(3)))
    with closing(Drawing(mesh)) as drawing:
        assert len(drawing._textures) == 3  # and the one in place of what there is not


def test_close_frees_everything() -> None:
    drawing = Drawing(quad(replace(GREY, color_map=texture([[(9, 9, 9)]]))))
    drawing.picture(FRONT)
    (target,) = drawing._targets.values()
    made = [*drawing._owned, *target._images, target.samples, target._resolved, target.count]
    drawing.close()
    assert {type(resource.mglo).__name__ for resource in made} == {"InvalidObject"}


def test_after_a_wireframe_that_failed_faces_are_drawn_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise GraphicsError("no more memory")

    with closing(Drawing(quad(GREY))) as drawing:
        whole = drawing.picture(FRONT).color
        monkeypatch.setattr(drawing, "count", fail)
        with pytest.raises(GraphicsError):
            drawing.wireframe(FRONT)
        assert not context().wireframe
        np.testing.assert_array_equal(drawing.picture(FRONT).color, whole)


def test_a_texture_too_large_is_refused_by_name() -> None:
    wide = Texture("panorama", np.zeros((1, context().info["GL_MAX_TEXTURE_SIZE"] + 1, 4), np.uint8))
    with pytest.raises(GraphicsError, match="panorama"):
        Drawing(quad(replace(GREY, color_map=wide)))


def test_a_real_oak_keeps_its_area_at_every_height() -> None:
    mesh = read_mesh(tree("ez_oak_large.glb"))
    camera = cameras(mesh, (25.0,), 1)[0]

    def areas(*, exact_cutouts: bool) -> list[float]:
        with closing(Drawing(mesh, exact_cutouts=exact_cutouts)) as drawing:
            return [float(drawing.picture(camera.view(h)).color[..., 3].sum()) / h**2 for h in (512, 128, 64)]

    exact, stock = areas(exact_cutouts=True), areas(exact_cutouts=False)
    assert exact[1:] == pytest.approx([exact[0]] * 2, rel=0.02)
    assert stock[0] == pytest.approx(exact[0], rel=0.02)
    assert stock[2] < 0.7 * exact[2]


# --- the cameras ---


def project(view: View, points: np.ndarray) -> np.ndarray:
    """Pixel positions, (0, 0) at the upper left corner."""
    clip = np.c_[points, np.ones(len(points))] @ view.to_clip.T
    return (clip[:, :2] / clip[:, 3:] * [1, -1] + 1) / 2 * view.size


def sphere(center: np.ndarray, radius: float) -> np.ndarray:
    directions = np.random.default_rng(0).normal(size=(200_000, 3))
    return center + radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)


@pytest.mark.parametrize("elevation", [0.0, 25.0, 60.0, 90.0])
@pytest.mark.parametrize("height", [64, 512])
def test_the_sphere_is_as_high_as_asked_and_centred(elevation: float, height: int) -> None:
    center = np.array([3.0, 5.0, -2.0])
    view = Camera(elevation, 45.0, center, 7.0).view(height)
    pixels = project(view, sphere(center, 7.0))
    assert view.size == height + MARGIN
    assert np.allclose(np.ptp(pixels, axis=0), height, rtol=2e-3)
    assert np.allclose((pixels.min(axis=0) + pixels.max(axis=0)) / 2, view.size / 2, atol=0.5)


@pytest.mark.parametrize("shift", [0.5, 1.0])
def test_shift_moves_every_pixel_alike(shift: float) -> None:
    camera = Camera(25.0, 90.0, np.zeros(3), 1.0)
    points = sphere(np.zeros(3), 1.0)[:100]
    moved = project(camera.view(128, shift), points) - project(camera.view(128), points)
    assert np.allclose(moved, [shift, 0.0])


def test_a_pixel_shift_gives_the_same_pixels_moved_on() -> None:
    camera = cameras(small_tree(), (25.0,), 3)[1]
    still, moved = draw(small_tree(), camera.view(64)), draw(small_tree(), camera.view(64, 1.0))
    assert np.abs(np.roll(still.color, 1, axis=1) - moved.color).mean() < 1e-4


@pytest.mark.parametrize(
    ("azimuth", "leftmost"), [(0.0, [-1, 0, 0]), (90.0, [0, 0, 1]), (180.0, [1, 0, 0]), (270.0, [0, 0, -1])]
)
def test_azimuths_go_from_z_towards_x_and_up_is_up(azimuth: float, leftmost: list[float]) -> None:
    view = Camera(0.0, azimuth, np.zeros(3), 2.0).view(64)
    points = np.array([[1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0]], float)
    pixels = project(view, points)
    assert points[pixels[:, 0].argmin()].tolist() == leftmost
    assert points[pixels[:, 1].argmin()].tolist() == [0, 1, 0]


def test_cameras_see_the_used_vertices_only() -> None:
    mesh = small_tree()
    stray = replace(mesh, positions=np.r_[mesh.positions, [[1e6, 0, 0]]].astype(np.float32))
    (one, *_), (other, *_) = (cameras(m, (0.0, 60.0), 4) for m in (mesh, stray))
    assert one.radius == other.radius
    assert np.array_equal(one.center, other.center)


def test_a_single_point_is_still_a_view() -> None:
    flat = replace(small_tree(), positions=np.zeros((16, 3), np.float32))
    assert np.isfinite(cameras(flat, (0.0,), 1)[0].view(64).to_clip).all()
