"""Many trees in one call, and several kinds of them in one scene: as if each had been put there by hand."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from foliage import PAINTED
from groves import NOBODY, Place, front, hillside, planted, put, seen_from_it, standing
from stems import empty
from synthetic import joined, lit, quad, small_tree
from test_indirect import EVERYTHING_LOOKED_UP, NOTHING_LOOKED_UP, crown, crown_textures
from test_slicings_draw import Cards
from test_views_draw import BLUE, made

from treebake.gl.context import context
from treebake.gl.draw import Drawing
from treebake.gl.scene import Scene, Stand
from treebake.gl.view import ONE_TREE, Grove, View
from treebake.model import AlphaMode, Floats, Layers, Material, Mesh

SOMEWHERE: Place = (0.4, -0.3, 0.8, 0.7, 70.0)
TREE = joined(small_tree(), quad(PAINTED, x=(-0.5, 0.3), y=(0.2, 0.9), z=0.4, normal=(0.0, 0.6, 0.8)))
RED, GREEN = (Material(str(rgb), base_color=(*rgb, 1.0), double_sided=True) for rgb in ((0.8, 0, 0), (0, 0.8, 0)))
HALF = 2e-3  # colours are kept in half floats


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


def color(view: View, *stands: tuple[Mesh, Layers | None, Grove]) -> Floats:
    return planted(view, *stands).color


def glass(red: float, green: float, alpha: float = 0.5) -> Material:
    return Material(
        f"{red} {green}", base_color=(red, green, 0.0, alpha), alpha_mode=AlphaMode.BLEND, double_sided=True
    )


# ---- meshes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "place",
    [(0.5, -0.4, 1.0, 1.0, 0.0), (0, -0.5, 0, 1.6, 0.0), (0, 0, 0, 1.0, 90.0), (0, 0, 0, 1.0, 215.0), SOMEWHERE],
    ids=["moved", "scaled", "turned a quarter", "turned", "all"],
)
def test_a_tree_in_a_grove_is_the_mesh_put_there_by_hand(place: Place) -> None:
    there, by_hand = (
        planted(hillside(), *each)
        for each in (
            [(TREE, None, standing(place))],
            [(put(TREE, place), None, ONE_TREE)],
        )
    )
    assert by_hand.color[..., 3].sum() > 200
    # Rounding may move an edge over a sample here and there.
    off = np.abs(there.color - by_hand.color)
    assert (off > HALF).any(axis=2).sum() < 0.005 * (by_hand.color[..., 3] > 0).sum()
    assert (np.abs(there.depth - by_hand.depth) > 1e-3).sum() < 0.005 * (by_hand.color[..., 3] > 0).sum()


@pytest.mark.parametrize("degrees", [0.0, 60.0, -60.0])
def test_the_light_does_not_turn_with_a_tree(degrees: float) -> None:
    grey = Material("grey", base_color=(0.2, 0.2, 0.2, 1.0))
    around = np.radians(degrees)
    found = color(front(), (quad(grey), None, standing((0, 0, 0, 1, degrees))))[32, 32]
    assert np.allclose(found, [*lit(0.2, (np.sin(around), 0, np.cos(around))), 1], atol=HALF)


def test_a_grove_is_its_trees_one_by_one() -> None:
    places = [(-1.2, 0, -1.0, 0.9, 10.0), SOMEWHERE, (0.9, -0.6, 2.0, 0.6, 250.0), (0.1, -0.2, -2.0, 1.3, 75.0)]
    together = color(hillside(), (TREE, None, standing(*places)))
    apart = color(hillside(), *((TREE, None, standing(place)) for place in places))
    shuffled = color(hillside(), (TREE, None, standing(*places[::-1])))
    assert together[..., 3].sum() > 500
    np.testing.assert_array_equal(together, apart)
    np.testing.assert_array_equal(together, shuffled)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_of_two_blended_trees_the_nearer_one_lies_over_the_other(order: tuple[int, int]) -> None:
    pane = joined(quad(glass(0.8, 0.0), y=(0.0, 1.0)), quad(glass(0.0, 0.8), y=(-1.0, 0.0)))
    # The near one stands lower, so that its red half lies over the far one's green half.
    places = [((0.0, 0.5, -3.0, 1.0, 0.0), (0.0, -0.5, 3.0, 1.0, 0.0))[i] for i in order]
    found = color(front(), (pane, None, standing(*places)))[32, 32]
    red, green = (np.array([*lit(each, (0, 0, 1)), 1.0]) for each in ((0.8, 0, 0), (0, 0.8, 0)))
    assert np.allclose(found, 0.5 * red + 0.25 * green, atol=HALF)


@pytest.mark.parametrize("degrees", [0.0, 180.0])
def test_the_triangles_of_a_blended_tree_are_sorted_as_it_is_turned(degrees: float) -> None:
    """Two panes of one material, told apart by their normals' light."""
    pane = glass(0.5, 0.5)
    both = joined(quad(pane, z=0.3, normal=(0, 1, 0)), quad(pane, z=-0.3, normal=(0, -1, 0)))
    one = replace(both, face_material=np.zeros(4, np.int32))
    place = (0.0, 0.0, 0.0, 1.0, degrees)
    found = color(front(), (one, None, standing(place)))[32, 32]
    sign = 1 if degrees == 0 else -1  # the back of a double-sided face has its normal reversed
    lights = [np.array([*lit((0.5, 0.5, 0), (0, sign * up, 0)), 1.0]) for up in (1, -1)]
    near, far = lights if degrees == 0 else lights[::-1]
    assert np.allclose(found, 0.5 * near + 0.25 * far, atol=HALF)


GLASS = quad(glass(0.8, 0.0))
KINDS: dict[str, tuple[Mesh, Layers | None]] = {
    "solid": (TREE, None),
    "glass": (GLASS, None),
    "indirect": (empty(), crown_textures()),
    "views": (empty(), made()),
    "slicings": (empty(), Cards().made()),
}


@pytest.mark.parametrize("kind", KINDS)
def test_no_trees_no_picture(kind: str) -> None:
    assert color(hillside(), (*KINDS[kind], standing(SOMEWHERE))).any()
    nothing = planted(hillside(), (*KINDS[kind], NOBODY))
    assert not nothing.color.any()
    assert not nothing.depth.any()


@pytest.mark.parametrize("kind", KINDS)
def test_no_trees_ask_for_no_fragments(kind: str) -> None:
    with closing(Scene((64, 64))) as scene, closing(Drawing(*KINDS[kind])) as drawing:
        assert scene.fragments(front(), [Stand(drawing, NOBODY)]) == 0


@pytest.mark.parametrize("kind", KINDS)
def test_the_fragments_of_trees_are_the_sum_of_each_trees(kind: str) -> None:
    places = [(-1.0, 0.0, -2.0, 0.8, 0.0), (0.4, -0.3, 0.8, 0.7, 130.0), (0.4, -0.3, 1.2, 0.7, 60.0)]
    view = hillside()
    with closing(Scene(view.window)) as scene, closing(Drawing(*KINDS[kind])) as drawing:
        each = [scene.fragments(view, [Stand(drawing, standing(place))]) for place in places]
        assert scene.fragments(view, [Stand(drawing, standing(*places))]) == sum(each)
        assert min(each) > 30
        assert drawing.fragments(view) == scene.fragments(view, [Stand(drawing, ONE_TREE)])


# ---- trees that come and go -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("opacity", [0.25, 0.5, 0.9])
def test_a_solid_tree_that_fades_covers_that_part_of_its_pixels(opacity: float) -> None:
    view = front(128)
    whole, part = (color(view, (quad(RED), None, standing((0, 0, 0, 1, 0), opacities=o))) for o in (1.0, opacity))
    assert (whole[..., 3] == 1).all()
    assert part[..., 3].mean() == pytest.approx(opacity, abs=0.02)
    covered = part[..., 3] > 0
    np.testing.assert_array_equal(part[covered], whole[covered])
    # No rows, columns or blocks of pixels: each quarter of the picture loses as many.
    quarters = part[..., 3].reshape(2, 64, 2, 64).mean(axis=(1, 3))
    assert np.allclose(quarters, opacity, atol=0.04)


def test_a_fading_tree_keeps_the_pixels_it_had() -> None:
    view = front(128)
    covered = [
        color(view, (quad(RED), None, standing((0, 0, 0, 1, 0), opacities=o)))[..., 3] > 0
        for o in (0.0, 0.2, 0.5, 0.5, 0.8, 1.0)
    ]
    assert not covered[0].any()
    np.testing.assert_array_equal(covered[2], covered[3])
    for less, more in pairwise(covered):
        assert not (less & ~more).any()
    # Wherever the tree is: the pixels are the window's.
    aside = color(view, (quad(RED), None, standing((0, 0, 3.0, 1.2, 0), opacities=0.5)))[..., 3] > 0
    np.testing.assert_array_equal(aside, covered[2])


def test_each_tree_fades_for_itself() -> None:
    half = quad(RED, x=(-0.5, 0.5))
    found = color(front(), (half, None, standing((-0.5, 0, 0, 1, 0), (0.5, 0, 0, 1, 0), opacities=(0.0, 1.0))))
    assert not found[:, :31].any()
    assert (found[:, 33:, 3] == 1).all()


@pytest.mark.parametrize("fade", [EVERYTHING_LOOKED_UP, NOTHING_LOOKED_UP], ids=["looked up", "far texture"])
def test_indirect_billboards_fade(monkeypatch: pytest.MonkeyPatch, fade: tuple[float, float]) -> None:
    monkeypatch.setattr("treebake.gl.indirect.FADE", fade)
    view = hillside(128, reach=0.8)
    none, half, whole = (
        color(view, (empty(), crown_textures(), standing((0, 0, 0, 1, 0), opacities=o)))[..., 3] for o in (0, 0.5, 1)
    )
    assert whole.sum() > 1000
    assert not none.any()
    assert 0.35 * whole.sum() < half.sum() < 0.75 * whole.sum()
    assert (half <= whole).all()


# ---- indirect billboards --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fade", [EVERYTHING_LOOKED_UP, NOTHING_LOOKED_UP], ids=["looked up", "far texture"])
@pytest.mark.parametrize(
    "place",
    [(0.3, -0.2, 0.5, 1.0, 0.0), (0, 0, 0, 1.5, 0.0), (0, 0, 0, 1.0, 75.0), (0.2, 0.1, -0.3, 1.2, 230.0)],
    ids=["moved", "scaled", "turned", "all"],
)
def test_indirect_billboards_are_seen_as_from_elsewhere(
    monkeypatch: pytest.MonkeyPatch, place: Place, fade: tuple[float, float]
) -> None:
    monkeypatch.setattr("treebake.gl.indirect.FADE", fade)
    view = hillside(128, reach=1.0)
    there = planted(view, (empty(), crown_textures(), standing(place)))
    instead = planted(seen_from_it(view, place), (empty(), crown_textures(), ONE_TREE))
    alphas = np.stack([there.color[..., 3], instead.color[..., 3]])
    assert alphas[1].sum() > 500
    assert np.abs(np.subtract(*alphas)).sum() < 0.01 * alphas[1].sum()
    both = alphas.min(axis=0) == 1
    # Depth is told in the unit of the tree's own frame.
    assert (np.abs(there.depth - place[3] * instead.depth)[both] > 0.01).mean() < 0.01
    if place[4] == 0:  # else the light stands still in the world
        assert (np.abs(there.color - instead.color)[both] > 0.02).any(axis=1).mean() < 0.02


@pytest.mark.parametrize("degrees", [0.0, 90.0, 200.0])
def test_the_sun_does_not_turn_with_indirect_billboards(degrees: float) -> None:
    view, place = hillside(128, reach=0.8), (0.0, 0.0, 0.0, 1.0, degrees)
    there = planted(view, (empty(), crown_textures(), standing(place))).color
    leaves = planted(view, (put(crown()[0].foliage, place), None, ONE_TREE)).color
    both = (there[..., 3] == 1) & (leaves[..., 3] == 1)
    assert both.sum() > 1000
    assert np.abs(there - leaves)[both].mean() < 0.035


# ---- views ----------------------------------------------------------------------------------------------------------


def test_a_vanishing_view_hides_nothing_that_is_drawn_after_it() -> None:
    blue = made(colors=BLUE)
    behind = (quad(glass(0.8, 0.0, 1.0), x=(-0.3, 0.3), y=(-0.3, 0.3), z=-2.0), None, ONE_TREE)

    def red(*opacities: float) -> float:
        stands = [(empty(), blue, standing((0, 0, 0, 1, 0), opacities=o)) for o in opacities]
        return float(color(front(), *stands, behind)[32, 32, 0])

    assert red(1.0) < 0.01  # whole, it hides
    assert red(0.99) > 0.5
    assert red(0.2) > 0.5
    # Not of one tree alone: of a grove, only those that are whole do.
    grove = standing((0, 0, 0, 1, 0), (5, 0, 0, 1, 0), opacities=(0.5, 1.0))
    assert color(front(), (empty(), blue, grove), behind)[32, 32, 0] > 0.5


def test_a_view_covers_as_much_as_its_opacity() -> None:
    whole, half = (
        color(front(), (empty(), made(colors=BLUE), standing((0, 0, 0, 1, 0), opacities=o)))[32, 32] for o in (1, 0.5)
    )
    assert whole[3] == pytest.approx(1, abs=0.01)
    assert np.allclose(half, 0.5 * whole, atol=HALF)


# ---- scenes ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_nearer_stand_hides_a_farther_one(order: tuple[int, int]) -> None:
    stands = [(quad(RED), None, standing((0, 0, -2.0, 1.2, 0))), (quad(GREEN), None, standing((0, 0, 2.0, 0.5, 0)))]
    found = color(front(), *(stands[i] for i in order))
    assert np.allclose(found[32, 32], [*lit((0, 0.8, 0), (0, 0, 1)), 1], atol=HALF)
    assert np.allclose(found[4, 4], [*lit((0.8, 0, 0), (0, 0, 1)), 1], atol=HALF)


def test_blended_stands_are_blended_in_the_order_given() -> None:
    red, green = ((quad(glass(*rg)), None, ONE_TREE) for rg in ((0.8, 0.0), (0.0, 0.8)))
    lights = [np.array([*lit(each, (0, 0, 1)), 1.0]) for each in ((0.8, 0, 0), (0, 0.8, 0))]
    for stands, (below, above) in (((red, green), lights), ((green, red), lights[::-1])):
        assert np.allclose(color(front(), *stands)[32, 32], 0.5 * above + 0.25 * below, atol=HALF)


def test_blended_stands_lie_over_solid_ones_wherever_in_the_order() -> None:
    solid, pane = (quad(GREEN), None, standing((0, 0, -1, 1, 0))), (quad(glass(0.8, 0.0)), None, ONE_TREE)
    wanted = 0.5 * (lit((0.8, 0, 0), (0, 0, 1)) + lit((0, 0.8, 0), (0, 0, 1)))
    for stands in ((solid, pane), (pane, solid)):
        assert np.allclose(color(front(), *stands)[32, 32], [*wanted, 1], atol=HALF)


def test_a_blended_stand_behind_a_solid_one_is_hidden() -> None:
    solid, pane = (quad(GREEN), None, standing((0, 0, 1, 1, 0))), (quad(glass(0.8, 0.0)), None, ONE_TREE)
    assert np.allclose(color(front(), pane, solid)[32, 32], [*lit((0, 0.8, 0), (0, 0, 1)), 1], atol=HALF)


def test_a_scene_is_what_one_drawing_shows_of_one_tree() -> None:
    for mesh, layers in KINDS.values():
        with closing(Drawing(mesh, layers)) as drawing:
            alone = drawing.picture(hillside())
        found = planted(hillside(), (mesh, layers, ONE_TREE))
        np.testing.assert_array_equal(found.color, alone.color)
        np.testing.assert_array_equal(found.depth, alone.depth)


@pytest.mark.parametrize("aspect", [2.0, 0.5])
@pytest.mark.parametrize("kind", KINDS)
def test_a_window_that_is_not_square_shows_more_or_less_at_its_sides(kind: str, aspect: float) -> None:
    square, other = front(64, reach=2.0), front(64, reach=2.0, aspect=aspect)
    assert other.window == (int(64 * aspect), 64)
    place = (0.1, -0.2, 0.0, 0.7, 0.0)
    found, wanted = (planted(view, (*KINDS[kind], standing(place))) for view in (other, square))
    assert found.color.shape == (64, int(64 * aspect), 4)
    width = min(found.color.shape[1], 64)
    assert wanted.color[:, 32 - width // 2 : 32 + width // 2, 3].sum() > 100
    middle = found.color.shape[1] // 2
    ours = found.color[:, middle - width // 2 : middle + width // 2]
    theirs = wanted.color[:, 32 - width // 2 : 32 + width // 2]
    assert np.abs(ours - theirs).mean() < (0.01 if kind == "indirect" else 1e-3)  # its dither goes by the pixel


def test_scenes_and_drawings_do_not_depend_on_those_closed_before() -> None:
    view = front()
    with closing(Drawing(quad(RED))) as drawing, closing(Scene(view.window)) as scene:
        stand = [Stand(drawing, ONE_TREE)]
        before = scene.picture(view, stand)
        other = Scene((32, 48))
        other.picture(front(48, aspect=32 / 48), stand)
        other.close()
        after = scene.picture(view, stand)
        np.testing.assert_array_equal(before.color, after.color)
        other = Scene((32, 48))
        other.draw(front(48, aspect=32 / 48), stand)
        other.close()
        assert scene.fragments(view, stand) == 64 * 64
        again = Drawing(quad(GREEN))
        again.picture(view)
        again.close()
        np.testing.assert_array_equal(scene.picture(view, stand).color, before.color)
        np.testing.assert_array_equal(drawing.picture(view).color, before.color)


@pytest.mark.parametrize("closed", ["scene", "drawing"])
def test_what_is_closed_while_it_is_drawn_on_leaves_nothing_in_use(closed: str) -> None:
    view = front()
    with closing(Scene(view.window)) as scene, closing(Drawing(quad(RED))) as drawing:
        wanted = scene.picture(view, [Stand(drawing, ONE_TREE)])
        other = Scene(view.window) if closed == "scene" else Drawing(quad(GREEN))
        target = other._target if isinstance(other, Scene) else other._target(view.window)
        target.samples.use()
        other.close()
        np.testing.assert_array_equal(scene.picture(view, [Stand(drawing, ONE_TREE)]).color, wanted.color)
        np.testing.assert_array_equal(drawing.picture(view).color, wanted.color)


def test_a_picture_after_what_is_blended_or_timed_is_the_same() -> None:
    """A blended stand leaves depth unwritten, and a drawing for its time leaves another framebuffer in use."""
    view = front()
    with (
        closing(Scene(view.window)) as scene,
        closing(Drawing(quad(RED))) as solid,
        closing(Drawing(quad(glass(0.8, 0.0)))) as pane,
    ):
        wanted = scene.picture(view, [Stand(solid, ONE_TREE)])
        near = [Stand(solid, standing((0, 0, 3, 1, 0))), Stand(pane, standing((0, 0, 4, 1, 0)))]
        scene.picture(view, near)
        scene.draw(view, near)
        found = scene.picture(view, [Stand(solid, ONE_TREE)])
        np.testing.assert_array_equal(found.color, wanted.color)
        np.testing.assert_array_equal(found.depth, wanted.depth)


def test_a_drawing_of_what_is_blended_too_can_be_repeated() -> None:
    with closing(Drawing(joined(quad(RED), quad(glass(0.8, 0.0), z=0.5)))) as drawing:
        first, second = (drawing.picture(front()) for _ in range(2))
    np.testing.assert_array_equal(first.color, second.color)
    np.testing.assert_array_equal(first.depth, second.depth)
    assert np.allclose(first.color[32, 32], [*lit((0.8, 0, 0), (0, 0, 1)), 1], atol=HALF)
