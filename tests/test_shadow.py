"""Shadow maps: where the sun's view puts what it sees, and that every representation casts a shadow of its own."""

from contextlib import closing

import numpy as np
import pytest
from foliage import PAINTED
from groves import standing
from hypothesis import given
from hypothesis import strategies as st
from synthetic import quad
from test_indirect import crown, crown_textures
from test_slicings_draw import Cards
from test_views_draw import made

from treebake.geometry import turn_to
from treebake.gl.draw import Drawing
from treebake.gl.scene import Stand
from treebake.gl.shadow import ShadowMap, sun_view
from treebake.gl.view import ONE_TREE, Grove, View
from treebake.leaf_cards import leaf_cards
from treebake.model import EMPTY_MESH, Doubles, Floats, Layers, Mesh
from treebake.verify.cameras import Camera

POINTS = np.random.default_rng(5).normal(size=(60, 3)) * (1, 2, 1) + (3, 2, -1)
CAMERA = Camera(12.0, 40.0, POINTS.mean(axis=0), 5.0)
angles = st.floats(-180, 180)
elevations = st.floats(-89, 89)


def seen(view: View, points: Doubles) -> Doubles:
    """In clip space, divided by w."""
    clip = np.column_stack([points, np.ones(len(points))]) @ view.to_clip.T
    return np.asarray(clip[:, :3] / clip[:, 3:])


@given(elevations, angles, st.booleans())
def test_all_points_are_inside_and_rays_are_parallel_to_the_light(up: float, around: float, perspective: bool) -> None:
    sun = turn_to(up, around)[2]
    view = sun_view(sun, POINTS, 512, CAMERA.view(256) if perspective else None)
    assert np.linalg.det(view.to_clip) < 0  # not mirrored, or the faces that look at the sun would be culled
    places = seen(view, POINTS)
    assert (np.abs(places[:, :2]) <= 1 - 2 * 2 / 512 + 1e-6).all()
    assert (np.abs(places[:, 2]) <= 1 + 1e-6).all()
    nearer = seen(view, POINTS + 0.1 * sun)
    assert np.allclose(nearer[:, :2], places[:, :2], atol=1e-6)  # behind each other as the sun sees them
    assert (nearer[:, 2] < places[:, 2]).all()


@given(elevations, angles, st.booleans())
def test_the_eye_is_far_away_where_the_sun_is(up: float, around: float, perspective: bool) -> None:
    sun = turn_to(up, around)[2]
    view = sun_view(sun, POINTS, 512, CAMERA.view(256) if perspective else None)
    assert np.allclose(view.eye / np.linalg.norm(view.eye), sun, atol=1e-6)
    assert np.linalg.norm(view.eye) > 1e6
    assert view.eye_focus / np.linalg.norm(view.eye) == pytest.approx(view.focus)


def test_what_is_near_the_viewer_gets_more_texels() -> None:
    """[WSP04]: across the view, a unit near by takes more of the map than one far off; without a viewer as much."""
    close = Camera(0.0, 0.0, np.array([0.0, 0.0, 0.0]), 1.0)
    row = np.array([[x, 0.0, z] for z, half in ((1.0, 0.5), (-30.0, 5.0)) for x in (-half, half)])
    sun = turn_to(80.0, 90.0)[2]

    def widths(viewer: View | None) -> tuple[float, float]:
        places = seen(sun_view(sun, row, 512, viewer), row)
        near, far = (float(np.linalg.norm(np.subtract(*places[i : i + 2, :2]))) for i in (0, 2))
        return near, far / 10

    near, far = widths(close.view(256))
    assert near > 2 * far
    assert widths(None)[0] == pytest.approx(widths(None)[1])
    assert near > 1.5 * widths(None)[0]


@pytest.mark.parametrize("up", [0.0, 180.0], ids=["into the sun", "with the sun behind"])
def test_along_the_light_perspective_is_left_out(up: float) -> None:
    sun = turn_to(CAMERA.elevation, CAMERA.azimuth + up)[2] * (1, 1 if not up else -1, 1)
    plain, seen_by = sun_view(sun, POINTS, 256), sun_view(sun, POINTS, 256, CAMERA.view(128))
    assert (seen_by.to_clip[3] == (0, 0, 0, 1)).all()
    assert (plain.to_clip[3] == (0, 0, 0, 1)).all()


def cast(mesh: Mesh, layers: Layers | None, points: Floats, texels: int = 128, grove: Grove = ONE_TREE) -> Floats:
    sun = turn_to(35.0, 20.0)[2]
    with closing(Drawing(mesh, layers, exact_cutouts=True)) as drawing, closing(ShadowMap(texels)) as shadows:
        shadows.cast([Stand(drawing, grove)], sun_view(sun, points.astype(np.float64), texels))
        return shadows.depths()


def test_nothing_casts_nothing() -> None:
    assert (cast(EMPTY_MESH, None, quad(PAINTED).positions) == 1).all()


@pytest.mark.parametrize("name", ["indirect", "leaves"])
def test_leaves_from_tables_cast_the_shadow_of_the_leaves(name: str) -> None:
    tree, _ = crown()
    textures = crown_textures()
    layers = textures if name == "indirect" else leaf_cards(textures)
    points = tree.foliage.positions
    source, ours = cast(tree.foliage, None, points), cast(EMPTY_MESH, layers, points)
    both, either = (source < 1) & (ours < 1), (source < 1) | (ours < 1)
    assert both.sum() / either.sum() > 0.85
    assert np.abs(source[both] - ours[both]).mean() < 0.01


@pytest.mark.parametrize(("coverage", "casts"), [(255, True), (200, True), (70, False)])
def test_a_slice_casts_a_shadow_where_it_covers_enough(coverage: int, casts: bool) -> None:
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    depths = cast(EMPTY_MESH, Cards(count=3, coverage=coverage).made(), cube)
    assert (depths < 1).any() == casts


@pytest.mark.parametrize("layout", ["ring", "hemi"])
@pytest.mark.parametrize(("share", "casts"), [(1.0, True), (0.8, True), (0.4, False)])
def test_the_nearest_view_alone_casts_a_shadow_where_it_covers_half(layout: str, share: float, casts: bool) -> None:
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    depths = cast(EMPTY_MESH, made(layout, 4 if layout == "ring" else 3, share=share), cube)
    assert (depths < 1).any() == casts
    if casts:  # a square that faces the sun more or less, whose depth is that of its middle or nearer
        assert depths[64, 64] == pytest.approx(0.5, abs=0.2)


@pytest.mark.parametrize("name", ["slicings", "views"])
def test_a_tree_that_fades_casts_its_shadow(name: str) -> None:
    cube = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    layers = Cards(count=3, coverage=255).made() if name == "slicings" else made("ring", 4)
    fading = standing((0, 0, 0, 1, 0), opacities=0.9)
    np.testing.assert_array_equal(cast(EMPTY_MESH, layers, cube, grove=fading) < 1, cast(EMPTY_MESH, layers, cube) < 1)
    assert (cast(EMPTY_MESH, layers, cube, grove=fading) < 1).any()
