"""Full light: shadows, the occluded sky and what comes through leaves, pixel by pixel as the numpy twin has it."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from synthetic import BACK, FRONT, joined, quad, texture

from treebake.geometry import turn_to
from treebake.gl.context import context
from treebake.gl.draw import Drawing
from treebake.gl.light import DAYLIGHT, Light
from treebake.gl.scene import Scene, Stand
from treebake.gl.shadow import ShadowMap, sun_view
from treebake.gl.target import Picture
from treebake.gl.view import ONE_TREE, View
from treebake.model import AlphaMode, Material, Mesh, Transmission
from treebake.verify.cameras import Camera

GREY = Material("grey", base_color=(0.2, 0.2, 0.2, 1.0), double_sided=True)
LEAF = replace(GREY, transmission=Transmission(0.25, (0.1, 0.3, 0.05)))
AHEAD = Light(turn_to(30.0, 20.0)[2])
BEHIND = Light(turn_to(30.0, 200.0)[2])
POINTS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
HALF = 1e-3  # colours are kept in half floats


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


def full_light(mesh: Mesh, light: Light, view: View = FRONT, *, texels: int = 256) -> Picture:
    with closing(Drawing(mesh)) as drawing, closing(ShadowMap(texels)) as shadows:
        shadows.cast([Stand(drawing, ONE_TREE)], sun_view(light.sun_direction, POINTS, texels))
        return drawing.picture(view, light, shadows)


def twin(material: Material, normal: object, light: Light, *, shade: float = 1.0, seen: float = 1.0) -> np.ndarray:
    """The readable twin of lighting.glsl with SHADED. normal: on the viewer's side. shade: part of the sun there."""
    n = np.asarray(normal, float)
    cosine = float(n @ light.sun_direction)
    above, below = (
        np.array(light.ground) + (np.array(light.sky) - light.ground) * (0.5 + side * 0.5 * n[1]) for side in (1, -1)
    )
    sun = shade * np.array(light.sun)
    factor, color = 0.0, np.zeros(3)
    if material.transmission:
        factor, color = material.transmission.factor, np.array(material.transmission.color)
    back = np.array(material.base_color[:3]) * (sun * max(cosine, 0) + above * seen)
    through = color * (sun * max(-cosine, 0) + below * seen)
    return np.asarray(np.minimum((1 - factor) * back + factor * through, 1.0))


@pytest.mark.parametrize("view", [FRONT, BACK], ids=["from the front", "from the back"])
@pytest.mark.parametrize("light", [AHEAD, BEHIND], ids=["sun ahead", "sun behind"])
@pytest.mark.parametrize("material", [GREY, LEAF], ids=["opaque", "thin"])
def test_a_leaf_is_lit_from_both_sides_as_its_twin(material: Material, light: Light, view: View) -> None:
    picture = full_light(quad(material), light, view)
    normal = (0, 0, 1 if view is FRONT else -1)
    assert np.allclose(picture.color[..., :3], twin(material, normal, light), atol=HALF)


def test_light_comes_through_a_leaf_only_with_transmission() -> None:
    thin, opaque = (full_light(quad(material), BEHIND).color.sum() for material in (LEAF, GREY))
    sky_alone = full_light(quad(GREY), replace(BEHIND, sun=(0.0, 0.0, 0.0))).color.sum()
    assert opaque == pytest.approx(sky_alone, rel=1e-3)
    assert thin > opaque


def test_what_goes_through_may_have_a_colour_that_does_not_come_back() -> None:
    red = Material("red", (0.0, 0.5, 0.5, 1.0), transmission=Transmission(0.5, (0.6, 0.0, 0.0)), double_sided=True)
    night = Light(BEHIND.sun_direction, sky=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0))
    assert np.allclose(full_light(quad(red), night).color[..., :3], twin(red, (0, 0, 1), night), atol=HALF)
    assert full_light(quad(red), night).color[..., 0].min() > 0.1


def test_a_textured_leaf_sends_its_colour_map_times_the_transmission_through() -> None:
    """The base colour is of what comes back alone."""
    image = texture([[(255, 188, 0)]])
    material = replace(LEAF, base_color=(0.5, 0.25, 1.0, 1.0), color_map=image)
    night = Light(BEHIND.sun_direction, sky=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0))
    red, green, blue = full_light(quad(material), night).color[0, 0, :3]
    cosine = -night.sun_direction[2]
    assert red == pytest.approx(0.25 * 0.1 * 1.25 * cosine, abs=HALF)
    assert green == pytest.approx(0.25 * 0.3 * 0.503 * 1.15 * cosine, abs=HALF)
    assert blue == 0


def test_what_lies_in_shadow_has_only_the_sky() -> None:
    roof = quad(GREY, x=(-1, 1), y=(-1, 1), z=0.9)
    wall = quad(GREY, z=-0.5)
    picture = full_light(joined(wall, roof), AHEAD, replace(FRONT, to_clip=np.diag([1.0, 1.0, 1.0, 1.0])))
    assert np.allclose(picture.color[4, 4, :3], twin(GREY, (0, 0, 1), AHEAD, shade=0.0), atol=HALF)


def test_a_hole_that_is_cut_out_lets_the_sun_through() -> None:
    image = texture([[(255, 255, 255, 0)]])
    sieve = replace(GREY, color_map=image, alpha_mode=AlphaMode.MASK)
    scene = joined(quad(GREY, z=-0.5), quad(sieve, z=0.9))
    assert np.allclose(full_light(scene, AHEAD).color[..., :3], twin(GREY, (0, 0, 1), AHEAD), atol=HALF)


@pytest.mark.parametrize("alpha", [0.0, 0.25, 0.75, 1.0])
def test_glass_shades_as_much_as_it_covers(alpha: float) -> None:
    glass = replace(GREY, base_color=(1, 1, 1, alpha), alpha_mode=AlphaMode.BLEND)
    with closing(Drawing(quad(glass))) as drawing, closing(ShadowMap(128)) as shadows:
        shadows.cast([Stand(drawing, ONE_TREE)], sun_view(np.array([0.0, 0.0, 1.0]), POINTS, 128))
        assert (shadows.depths() < 1).mean() == pytest.approx(alpha * (124 / 128) ** 2, abs=0.02)


@pytest.mark.parametrize("double_sided", [True, False])
def test_a_roof_that_faces_the_sun_casts_a_shadow(double_sided: bool) -> None:
    material = replace(GREY, double_sided=double_sided)
    light = Light(turn_to(30.0, 20.0)[2])
    with closing(Drawing(quad(material))) as drawing, closing(ShadowMap(64)) as shadows:
        shadows.cast([Stand(drawing, ONE_TREE)], sun_view(light.sun_direction, POINTS, 64))
        assert (shadows.depths() < 1).any()


@pytest.mark.parametrize("seen", [True, False], ids=["in perspective", "in parallel"])
@pytest.mark.parametrize("around", [0.0, 50.0, 90.0])
@pytest.mark.parametrize("elevation", [10.0, 45.0, 80.0])
@pytest.mark.parametrize("tilt", [0.0, 40.0, 60.0])
def test_no_strip_shades_itself(tilt: float, elevation: float, around: float, seen: bool) -> None:
    """Twenty times as long as wide, so that the texels of the map that is fitted to it are no squares."""
    strip = quad(GREY, x=(-0.05, 0.05))
    turn = turn_to(tilt - 90.0, 15.0)
    strip = replace(
        strip,
        positions=(strip.positions @ turn).astype(np.float32),
        normals=(strip.normals @ turn).astype(np.float32),
    )
    light = Light(turn_to(elevation, around)[2])
    night = replace(light, sky=(0.0, 0.0, 0.0), ground=(0.0, 0.0, 0.0))
    view = Camera(35.0, 30.0, np.zeros(3), 1.2).view(160)
    points = strip.positions.astype(np.float64)
    with closing(Drawing(strip)) as drawing, closing(ShadowMap(256)) as shadows, closing(ShadowMap(1)) as none:
        open_air = drawing.picture(view, night, none).color.sum()
        shadows.cast([Stand(drawing, ONE_TREE)], sun_view(light.sun_direction, points, 256, view if seen else None))
        assert drawing.picture(view, night, shadows).color.sum() == pytest.approx(open_air, rel=1e-3)


@pytest.mark.parametrize("elevation", [5.0, 10.0, 40.0, 90.0])
def test_no_surface_shades_itself(elevation: float) -> None:
    light = Light(turn_to(elevation, 0.0)[2])
    floor = replace(
        quad(GREY), positions=quad(GREY).positions[:, [0, 2, 1]] * (1, 1, -1), normals=np.tile([[0, 1, 0]], (4, 1))
    )
    floor = replace(floor, positions=floor.positions.astype(np.float32), normals=floor.normals.astype(np.float32))
    down = View(np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1]]), 64, 0.0, 2.0)
    colors = full_light(floor, light, down).color[..., :3]
    assert np.allclose(colors, twin(GREY, (0, 1, 0), light), atol=HALF)


def test_occlusion_takes_from_the_sky_and_nothing_from_the_sun() -> None:
    mesh = replace(quad(GREY), occlusion=np.full(4, 0.4, np.float32))
    assert np.allclose(full_light(mesh, AHEAD).color[..., :3], twin(GREY, (0, 0, 1), AHEAD, seen=0.4), atol=HALF)
    whole = replace(AHEAD, occluded=False)
    assert np.allclose(full_light(mesh, whole).color[..., :3], twin(GREY, (0, 0, 1), AHEAD), atol=HALF)


def test_occlusion_maps_are_looked_up_by_their_own_uvs() -> None:
    image = texture([[(255, 0, 0), (51, 0, 0)]])  # the right half sees a fifth
    mesh = quad(replace(GREY, occlusion_map=image), uvs=[(0.25, 0.5)] * 4)
    assert np.allclose(full_light(mesh, AHEAD).color[..., :3], twin(GREY, (0, 0, 1), AHEAD), atol=HALF)
    mesh = replace(mesh, occlusion_uvs=np.tile(np.array([[0.75, 0.5]], np.float32), (4, 1)))
    expected = twin(GREY, (0, 0, 1), AHEAD, seen=0.2)
    assert np.allclose(full_light(mesh, AHEAD).color[..., :3], expected, atol=HALF)


def test_without_shadows_the_sky_is_whole_and_leaves_are_opaque() -> None:
    """As a stock client draws: occlusion is in no source file, so it must not tell a candidate from it."""
    mesh = replace(quad(LEAF), occlusion=np.full(4, 0.4, np.float32))
    with closing(Drawing(mesh)) as drawing:
        color = drawing.picture(FRONT, AHEAD).color[..., :3]
    assert np.allclose(color, twin(GREY, (0, 0, 1), AHEAD), atol=HALF)


def test_a_scene_is_lit_as_a_drawing_is() -> None:
    mesh = joined(quad(LEAF, x=(-1, 0), z=0.5), quad(LEAF, z=-0.5))
    with closing(Drawing(mesh)) as drawing, closing(Scene(FRONT.window)) as scene, closing(ShadowMap(64)) as shadows:
        stands = [Stand(drawing, ONE_TREE)]
        shadows.cast(stands, sun_view(AHEAD.sun_direction, POINTS, 64))
        one, other = drawing.picture(FRONT, AHEAD, shadows), scene.picture(FRONT, stands, AHEAD, shadows)
        assert (one.color == other.color).all()
        plain = scene.picture(FRONT, stands)
        assert (plain.color == drawing.picture(FRONT, DAYLIGHT).color).all()
        assert not (plain.color == one.color).all()
