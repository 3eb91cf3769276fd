"""View impostors as they are drawn: pictures made by hand, one flat colour a view, and small trees beside them."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foliage import leaf_tree, random_leaves
from stems import empty, sphere, stem, tree_of
from test_views import chosen

from tests.synthetic import BACK, FRONT, SOFTNESS, joined, lit, quad
from treebake.geometry import join, turn_to
from treebake.gl.context import context
from treebake.gl.draw import Drawing
from treebake.gl.target import Picture
from treebake.gl.view import Grove, View, looking
from treebake.gl.views import ViewCards
from treebake.images import to_linear
from treebake.model import AlphaMode, Bytes, Doubles, Floats, Material, Mesh, PictureAtlas, Texture, Tree, Views
from treebake.pictures import STEEPEST
from treebake.stages.views import ViewSettings, views
from treebake.stages.views.directions import hemi_octahedron, ring
from treebake.stages.views.support import support
from treebake.verify.cost import cost_of

# Colours that block compression keeps.
COLORS = np.array([[r, g, b] for r in (255, 0) for g in (255, 0) for b in (0, 255)] + [(132, 130, 132)], np.uint8)
CELL, PICTURE = 32, 16  # texels
PIXELS = 64
CLOSE = 0.02
FLAT = (128 / 255 * 2 - 1) * STEEPEST  # the slope that is nearest to none, in 8 bits


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


# ---- made by hand --------------------------------------------------------------------------------------------------


def made(
    layout: str = "ring",
    side: int = 4,
    *,
    half: float = 0.5,
    depth: Callable[[Doubles], Doubles] = np.zeros_like,
    colors: Bytes = COLORS,
    center: object = (0.0, 0.0, 0.0),
    brightness: float = 0.0,
    share: float = 1.0,
) -> Views:
    """A cube that each view sees as a square of side 2 `half` and one colour. depth: -1..1, of its columns -1..1."""
    frames = ring(side) if layout == "ring" else hemi_octahedron(side)
    size = np.array([CELL * len(frames), CELL, CELL * len(frames), CELL])
    table = np.zeros((len(frames), 5, 4), np.float32)
    coverage = np.zeros((CELL, size[0], 4), np.uint8)
    coverage[..., 3] = 255
    albedo, relief = (np.full((CELL // 2, size[0] // 2, 4), 255, np.uint8) for _ in range(2))
    columns = np.clip((np.arange(CELL // 2) + 0.5 - CELL / 4) / (PICTURE / 4), -1, 1)
    margin = (CELL - PICTURE) // 2
    for number, frame in enumerate(frames):
        left = CELL * number + margin
        table[number, :3, :3] = frame
        table[number, 1:3, 3] = -half, half
        table[number, 3] = -half, -half, half, half
        table[number, 4] = np.array([left, margin + PICTURE, left + PICTURE, margin]) / size
        coverage[margin : margin + PICTURE, left : left + PICTURE, :3] = round(255 * share)
        here = np.s_[:, CELL // 2 * number : CELL // 2 * (number + 1)]
        albedo[here][..., :3] = colors[number]
        relief[here][..., :2] = 128
        relief[here][..., 2] = np.rint((depth(columns) / 2 + 0.5) * 255)
    sky = np.full((CELL // 8, size[0] // 8, 4), 255, np.uint8)
    parts = (("coverage", coverage), ("albedo", albedo), ("relief", relief), ("occlusion", sky))
    images = [Texture(name, pixels) for name, pixels in parts]
    corners = half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
    return Views(
        pictures=table,
        layout=layout,
        side=side,
        layers=1,
        center=np.array(center, np.float64),
        radius=half * 3**0.5,
        support=support(corners),
        brightness=brightness,
        exposure=1.0,
        atlas=PictureAtlas(*images, mips=3),
    )


def light(layout: str = "ring", side: int = 4, *, turned: float = 0.0) -> Doubles:
    """What comes from the picture of each view: (K, 3). turned: the tree, in degrees."""
    frames = ring(side) if layout == "ring" else hemi_octahedron(side)
    normals = [np.array([FLAT, FLAT, 1]) @ frame @ turn_to(0.0, turned) for frame in frames]
    return np.array([lit(to_linear(color), normal, SOFTNESS) for color, normal in zip(COLORS, normals, strict=False)])


def from_afar(elevation: float, azimuth: float, *, at: object = (0, 0, 0), distance: float = 20.0) -> View:
    """A view of what lies around a point, in which a unit is half the picture."""
    turn = turn_to(elevation, azimuth)
    depths = distance - 4, distance + 4
    return looking(turn, np.asarray(at) + distance * turn[2], distance, depths, PIXELS, 0.0)


def towards(way: Doubles) -> View:
    elevation, azimuth = np.degrees([np.arctan2(way[1], np.hypot(way[0], way[2])), np.arctan2(way[0], way[2])])
    return from_afar(float(elevation), float(azimuth))


def draw(found: Views, view: View, mesh: Mesh | None = None) -> Picture:
    with closing(Drawing(mesh or empty(), found)) as drawing:
        return drawing.picture(view)


def middle(picture: Picture) -> Floats:
    """The one colour in the middle, premultiplied."""
    size = len(picture.color)
    part = picture.color[size // 2 - 3 : size // 2 + 3, size // 2 - 3 : size // 2 + 3]
    assert np.ptp(part, axis=(0, 1)).max() < 2 * CLOSE
    return np.asarray(part.mean(axis=(0, 1)))


# ---- which views are seen ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", range(4))
@pytest.mark.parametrize("brightness", [0.0, 1.8])
def test_facing_a_view_it_alone_is_seen(number: int, brightness: float) -> None:
    picture = draw(made(brightness=brightness), from_afar(0.0, 90.0 * number))
    assert np.allclose(middle(picture), [*light()[number], 1], atol=CLOSE)


@pytest.mark.parametrize("number", range(4))
def test_midway_between_two_views_both_are_seen_alike(number: int) -> None:
    color = middle(draw(made(), from_afar(0.0, 90.0 * number + 45)))
    mean = light()[[number, (number + 1) % 4]].mean(axis=0)
    assert color[3] == pytest.approx(1 - 0.5**2, abs=CLOSE)
    assert np.allclose(color[:3] / color[3], mean, atol=CLOSE)


@pytest.mark.parametrize(("brightness", "opacity"), [(0.4, 0.6), (1.0, 0.75), (1.8, 0.95), (9.0, 1.0)])
def test_blended_views_are_made_more_opaque(brightness: float, opacity: float) -> None:
    color = middle(draw(made(brightness=brightness), from_afar(0.0, 45.0)))
    assert color[3] == pytest.approx(1 - (1 - opacity) ** 2, abs=CLOSE)
    assert np.allclose(color[:3] / color[3], light()[:2].mean(axis=0), atol=CLOSE)


@pytest.mark.parametrize("azimuth", [22.5, 67.5])
def test_the_view_that_weighs_most_says_how_much_more_opaque(azimuth: float) -> None:
    # 1 + m (1 - 3/4) on both.
    assert middle(draw(made(brightness=1.0), from_afar(0.0, azimuth)))[3] == pytest.approx(
        1 - (1 - 1.25 * 0.75) * (1 - 1.25 * 0.25), abs=CLOSE
    )


def test_a_quarter_of_the_way_the_nearer_view_weighs_three_times_as_much() -> None:
    color = middle(draw(made(), from_afar(0.0, 22.5)))
    assert np.allclose(color[:3] / color[3], light()[:2].T @ [0.75, 0.25], atol=CLOSE)


def test_exposure_is_a_factor_of_the_light_alone() -> None:
    grey = made(colors=np.full((4, 3), 132, np.uint8))
    plain, bright = (middle(draw(replace(grey, exposure=exposure), from_afar(0.0, 0.0))) for exposure in (1.0, 1.5))
    assert np.allclose(bright[:3], 1.5 * plain[:3], rtol=0.01)
    assert bright[3] == plain[3]


@pytest.mark.parametrize("number", [0, 2, 4, 7, 8])
def test_facing_a_view_of_the_grid_it_alone_is_seen(number: int) -> None:
    way = hemi_octahedron(3)[number][2]
    assert np.allclose(middle(draw(made("hemi", 3), towards(way))), [*light("hemi", 3)[number], 1], atol=CLOSE)


@pytest.mark.parametrize(
    "way",
    [(0.5, 0.4, 0.1), (-0.3, 0.5, 0.4), (0.1, 0.3, -0.6), (-0.5, 0.2, -0.2), (0.2, 0.9, 0.25), (0.6, -0.3, 0.2)],
    ids=str,
)
def test_three_views_of_the_grid_are_mixed_by_their_shares(way: tuple[float, float, float]) -> None:
    direction = np.array(way) / np.linalg.norm(way)
    found, shares = chosen(direction, 3)
    assert (shares > 0.05).sum() >= 2
    color = middle(draw(made("hemi", 3), towards(direction)))
    assert color[3] == pytest.approx(1 - np.prod(1 - shares), abs=CLOSE)
    assert np.allclose(color[:3] / color[3], shares @ light("hemi", 3)[found], atol=CLOSE)


@pytest.mark.parametrize("up", [1.0, -1.0], ids=["above", "below"])
@pytest.mark.parametrize("layout", ["ring", "hemi"])
def test_straight_above_and_below_something_is_seen(layout: str, up: float) -> None:
    turn = np.array([[1.0, 0, 0], [0, 0, -up], [0, up, 0]])
    color = middle(draw(made(layout, 3), looking(turn, 20 * turn[2], 20.0, (16, 24), PIXELS, 0.0)))
    assert np.isfinite(color).all()
    assert color[3] > 0.5
    if (layout, up) == ("hemi", 1.0):
        assert np.allclose(color, [*light("hemi", 3)[4], 1], atol=CLOSE)


def test_a_parallel_view_is_one_from_very_far_away() -> None:
    found = made()
    for view, number in ((FRONT, 0), (BACK, 2)):
        picture = draw(found, replace(view, size=PIXELS))
        assert np.allclose(middle(picture), [*light()[number], 1], atol=CLOSE)
        assert picture.color[..., 3].sum() == pytest.approx((PIXELS / 2) ** 2, rel=0.1)


# ---- where they are seen -------------------------------------------------------------------------------------------


def test_a_picture_lies_where_the_tree_is() -> None:
    picture = draw(made(center=(0.25, -0.25, 0.0), half=0.25), from_afar(0.0, 0.0))
    shown = picture.color[..., 3] > 0.5
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    assert np.allclose([rows[0], rows[-1] + 1, columns[0], columns[-1] + 1], [32, 48, 32, 48], atol=1)
    assert not picture.color[:28].any()


def test_a_picture_is_upright() -> None:
    found = made()
    pixels = found.atlas.coverage.pixels.copy()
    pixels[: CELL // 2, CELL // 2 :, :3] = 0  # all but the left column of the first view's lower half
    pixels[:, CELL // 2 : CELL, :3] = 0
    pixels[: CELL // 2, : CELL // 2, :3] = 0
    only = replace(found, atlas=replace(found.atlas, coverage=Texture("coverage", pixels)))
    alpha = draw(only, from_afar(0.0, 0.0)).color[..., 3]
    assert alpha[36:46, 18:28].min() > 0.9  # left, below
    assert alpha.sum() < 1.4 * 16**2


def test_depth_is_that_of_the_pictures_relief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("treebake.gl.views.RELIEF_HEIGHT", 0.0)  # as if it were near
    stepped = made(depth=lambda x: np.where(x < 0, -0.5, 0.5))
    depth = draw(stepped, from_afar(0.0, 0.0)).depth
    assert np.allclose(depth[28:36, 18:28], 20.25, atol=0.02)
    assert np.allclose(depth[28:36, 36:46], 19.75, atol=0.02)


RED = Material("red", base_color=(0.9, 0.0, 0.0, 1.0))
BLUE = COLORS[[1] * 4] * np.uint8([0, 0, 1])


def test_a_face_inside_the_tree_cuts_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("treebake.gl.views.RELIEF_HEIGHT", 0.0)  # as if it were near
    stepped = made(depth=lambda x: np.where(x < 0, -0.5, 0.5), colors=BLUE)
    color = draw(stepped, from_afar(0.0, 0.0), quad(RED, x=(-0.5, 0.5), y=(-0.5, 0.5))).color
    assert (color[28:36, 18:28, 0] > 0.1).all()  # the tree is behind
    assert not color[28:36, 18:28, 2].any()
    assert (color[28:36, 36:46, 2] > 0.7).all()  # the tree is before
    assert not color[28:36, 36:46, 0].any()


def test_depth_is_written_for_what_is_drawn_later() -> None:
    glass = Material("glass", base_color=(0.9, 0.0, 0.0, 0.5), alpha_mode=AlphaMode.BLEND)
    panes = joined(quad(glass, x=(-0.5, 0.0), y=(-0.5, 0.5), z=-0.2), quad(glass, x=(0.0, 0.5), y=(-0.5, 0.5), z=0.2))
    color = draw(made(colors=BLUE), from_afar(0.0, 0.0), panes).color
    assert not color[28:36, 18:28, 0].any()  # behind the tree
    assert (color[28:36, 36:46, 0] > 0.1).all()


# ---- the card ------------------------------------------------------------------------------------------------------


def fragments(found: Views, view: View) -> Floats:
    """How often the card covers each pixel, row 0 on top."""
    gl = context()
    target = gl.framebuffer([gl.renderbuffer((view.size, view.size), 1, dtype="f4")])
    target.clear()
    with closing_cards(found) as cards, gl.scope(target, gl.BLEND):
        gl.blend_func = gl.ONE, gl.ONE
        cards.count(view)
    return np.frombuffer(target.read(components=1, dtype="f4"), np.float32).reshape(view.size, view.size)[::-1]


class closing_cards:  # noqa: N801 - reads as `closing` does
    """Cards on the graphics card, for a while."""

    def __init__(self, found: Views) -> None:
        self._cards = ViewCards(context(), found)

    def __enter__(self) -> ViewCards:
        return self._cards

    def __exit__(self, *_: object) -> None:
        self._cards.release()


@cache
def crown() -> Tree:
    leaves = random_leaves(3, 60, spread=0.5)
    tree = leaf_tree(leaves.centers + np.array([0, 1.2, 0]), leaves.normals, size=0.25)
    return replace(tree, trunk=stem(length=1.2, radii=(0.08, 0.08)))


@cache
def branch() -> Tree:
    """Far longer than high, and not in the middle of anything."""
    return leaf_tree([(0.2 * i, 0.05 * (i % 3), 0.0) for i in range(12)], (0.5, 0.5, 0.7), size=0.25)


@cache
def ball() -> Tree:
    return replace(tree_of(empty(), 0), trunk=sphere(3))


@cache
def pole() -> Tree:
    return tree_of(stem(length=2.0, radii=(0.06, 0.06), capped=True), 0)


TREES = {"crown": crown, "branch": branch, "ball": ball, "pole": pole}


@cache
def photographed(name: str) -> Views:
    settings = ViewSettings(layout="hemi", side=5, layers=2, texels=128, atlas=2048, supersample=2)
    (impostor,) = views([TREES[name]()], settings)
    return impostor.views


def whole(name: str) -> Mesh:
    tree = TREES[name]()
    return join(tree.trunk, tree.foliage)


def filling(found: Views, elevation: float, azimuth: float, distance: float, size: int = 192) -> View:
    """From so many radii away, a view that the sphere fills."""
    turn = turn_to(elevation, azimuth)
    far = distance * found.radius
    depths = 0.05 * found.radius, far + 2 * found.radius
    scale = 0.9 * np.sqrt(distance**2 - 1)
    return looking(turn, found.center + far * turn[2], float(scale), depths, size, 0.0)


@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize("distance", [1.3, 3.33, 30.0])
@pytest.mark.parametrize("elevation", [0.0, 30.0, 60.0, 90.0, -45.0])
def test_the_card_cuts_nothing_off(name: str, distance: float, elevation: float) -> None:
    found = photographed(name)
    with closing(Drawing(whole(name))) as drawing:
        for azimuth in (0.0, 70.0):
            view = filling(found, elevation, azimuth, distance)
            card = fragments(found, view)
            seen = drawing.picture(view).color[..., 3] == 1
            assert seen.any()
            assert card[seen].all()


@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize("elevation", [0.0, 60.0, 90.0])
def test_no_two_triangles_of_a_card_show_the_same_pixel(name: str, elevation: float) -> None:
    # They would blend the tree over itself.
    for distance in (1.3, 30.0):
        found = photographed(name)
        assert fragments(found, filling(found, elevation, 20.0, distance)).max() == 1


def test_a_card_is_six_triangles_and_an_octagon() -> None:
    found = made()
    found = replace(found, support=np.full(33, 0.5, np.float32), radius=0.5)
    assert (cost_of(empty(), found).triangles, cost_of(empty(), found).draw_calls) == (6, 1)
    area = fragments(found, from_afar(0.0, 0.0, distance=200.0)).sum() / (PIXELS / 2) ** 2
    assert area == pytest.approx(8 * np.tan(np.pi / 8) * 0.5**2, rel=0.03)  # about the circle


def test_the_card_of_a_long_tree_is_far_smaller_than_a_square() -> None:
    found = photographed("branch")
    square = (2 * found.radius) ** 2
    view = filling(found, 0.0, 20.0, 30.0)
    assert fragments(found, view).sum() / (view.focus / (30 * found.radius)) ** 2 < 0.5 * square


def box(picture: Picture) -> list[int]:
    shown = picture.color[..., 3] > 0.4
    rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
    return [int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])]


@pytest.mark.parametrize("distance", [2.0, 6.0])
@pytest.mark.parametrize("number", [2, 3, 7, 11, 12, 16, 18])
def test_facing_a_view_the_tree_is_as_large_as_it_is(number: int, distance: float) -> None:
    way = hemi_octahedron(5)[number][2]
    elevation, azimuth = np.degrees([np.arcsin(way[1]), np.arctan2(way[0], way[2])])
    found = photographed("crown")
    view = filling(found, float(elevation), float(azimuth), distance, size=128)
    with closing(Drawing(whole("crown"))) as drawing:
        assert np.abs(np.subtract(box(drawing.picture(view)), box(draw(found, view)))).max() <= 2


# ---- where the viewer may be ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [0.0, 0.3, 0.85])
@pytest.mark.parametrize("layout", ["ring", "hemi"])
def test_from_inside_the_sphere_nothing_is_seen(layout: str, distance: float) -> None:
    found = made(layout, 3)
    view = looking(np.eye(3), np.array([0, 0, distance]), 1.0, (0.01, 4.0), PIXELS, 0.0)
    picture = draw(found, view)
    assert not picture.color.any()
    assert not picture.depth.any()
    assert draw(found, replace(view, to_clip=from_afar(0.0, 0.0).to_clip)).color.any()


def test_behind_the_viewer_nothing_is_seen() -> None:
    assert not draw(made(), looking(turn_to(0.0, 180.0), np.array([0, 0, 5.0]), 1.0, (1, 9), PIXELS, 0.0)).color.any()


# ---- many trees in one call ----------------------------------------------------------------------------------------


def planted(found: Views, groves: list[Grove], view: View) -> Floats:
    """Groves drawn one after the other over nothing: (h, w, 4)."""
    gl = context()
    size = view.size, view.size
    target = gl.framebuffer([gl.renderbuffer(size, 4, dtype="f4")], gl.depth_renderbuffer(size))
    target.clear()
    with closing_cards(found) as cards, gl.scope(target, gl.DEPTH_TEST):
        for grove in groves:
            cards.draw(view, target, grove)
    return np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(*size, 4)[::-1]


def standing(*places: tuple[float, float, float, float], turns: object = 0.0) -> Grove:
    kept = np.array(places, np.float32)
    return Grove(kept, np.broadcast_to(np.asarray(turns, np.float32), len(kept)).copy())


@pytest.mark.parametrize("height", [0.0, np.inf], ids=["looked into", "plain"])
def test_many_trees_in_one_call_are_as_one_by_one_the_farthest_first(
    monkeypatch: pytest.MonkeyPatch, height: float
) -> None:
    monkeypatch.setattr("treebake.gl.views.RELIEF_HEIGHT", height)  # told for all by the largest of them
    found = made(share=0.6, half=0.3)
    places = [(0.1 * i - 0.3, 0.05 * i, z, 1.0 + 0.1 * i) for i, z in enumerate((0.5, -2.0, 1.5, -0.5, 3.0))]
    turns = np.array([0.1, 2.0, 3.0, 4.0, 5.5], np.float32)
    view = from_afar(10.0, 15.0)
    one_by_one = np.argsort(-np.linalg.norm(np.array(places)[:, :3] - view.eye, axis=1))
    wanted = planted(found, [standing(places[i], turns=turns[i]) for i in one_by_one], view)
    together = planted(found, [standing(*places, turns=turns)], view)
    np.testing.assert_array_equal(together, wanted)
    mixed = [3, 0, 4, 2, 1]
    shuffled = standing(*(places[i] for i in mixed), turns=turns[mixed])
    np.testing.assert_array_equal(planted(found, [shuffled], view), wanted)
    nearest_first = planted(found, [standing(places[i], turns=turns[i]) for i in one_by_one[::-1]], view)
    assert np.abs(nearest_first - wanted).max() > 0.1  # the order is seen


def test_a_tree_turned_from_z_towards_x_shows_its_front_there() -> None:
    quarter = [standing((0, 0, 0, 1), turns=np.pi / 2)]
    color = planted(made(), quarter, from_afar(0.0, 90.0))[PIXELS // 2, PIXELS // 2]
    assert np.allclose(color, [*light(turned=90.0)[0], 1], atol=CLOSE)
    color = planted(made(), quarter, from_afar(0.0, 0.0))[PIXELS // 2, PIXELS // 2]
    assert np.allclose(color, [*light(turned=90.0)[3], 1], atol=CLOSE)


def test_a_turned_and_scaled_tree_is_one_seen_from_elsewhere() -> None:
    found = photographed("crown")
    turn, scale, place = 1.1, 0.7, np.array([0.3, -0.2, 0.5])
    view = from_afar(25.0, 40.0)
    around = turn_to(0.0, float(np.degrees(turn))).T  # from the tree's axes to the world's
    to_world = np.eye(4)
    to_world[:3, :3], to_world[:3, 3] = scale * around, place
    moved = replace(view, to_clip=view.to_clip @ to_world / scale)
    there = planted(found, [standing((*place, scale), turns=turn)], view)
    here = planted(found, [standing((0, 0, 0, 1))], moved)
    assert here[..., 3].sum() > 100
    assert np.abs(there - here)[..., 3].mean() < 1e-3  # the light stands still in the world


@pytest.mark.parametrize("height", [0.0, np.inf], ids=["looked into", "plain"])
@pytest.mark.parametrize("degrees", [180.0, 90.0])
def test_the_sun_does_not_turn_with_a_tree(monkeypatch: pytest.MonkeyPatch, height: float, degrees: float) -> None:
    """A tree turned in a grove looks as one does that was turned before it was baked."""
    monkeypatch.setattr("treebake.gl.views.RELIEF_HEIGHT", height)
    around_y = turn_to(0.0, degrees)  # a row vector times this is turned from +Z towards +X

    def turned(mesh: Mesh) -> Mesh:
        positions, normals = ((each @ around_y).astype(np.float32) for each in (mesh.positions, mesh.normals))
        return replace(mesh, positions=positions, normals=normals)

    one, other = crown(), replace(crown(), trunk=turned(crown().trunk), foliage=turned(crown().foliage))
    (made,), (wanted,) = (
        [each.views for each in views([tree], ViewSettings(layout="ring", texels=96))] for tree in (one, other)
    )
    wanted = replace(wanted, brightness=made.brightness, exposure=made.exposure)  # fitted from other sides
    view = from_afar(10.0, 15.0, at=(0.0, 0.8, 0.0))
    seen, true = (
        planted(found, [standing((0, 0, 0, 1), turns=turns)], view)
        for found, turns in ((made, np.radians(degrees)), (wanted, 0.0))
    )
    assert true[..., 3].sum() > 100
    assert seen[..., :3].sum() == pytest.approx(true[..., :3].sum(), rel=0.01)
    assert np.abs(seen - true)[..., :3].sum() < 0.05 * true[..., :3].sum()


def test_a_tree_twice_as_large_covers_four_times_as_much() -> None:
    view = from_afar(0.0, 0.0, distance=100.0)
    small, large = (planted(made(half=0.25), [standing((0, 0, 0, scale))], view)[..., 3].sum() for scale in (1.0, 2.0))
    assert large == pytest.approx(4 * small, rel=0.05)


def test_no_trees_no_picture() -> None:
    none = Grove(np.zeros((0, 4), np.float32), np.zeros(0, np.float32))
    assert not planted(made(), [none], from_afar(0.0, 0.0)).any()


def test_release_frees_the_textures() -> None:
    cards = ViewCards(context(), made())
    textures = list(cards._textures.values())
    cards.release()
    assert {type(texture.mglo).__name__ for texture in textures} == {"InvalidObject"}
