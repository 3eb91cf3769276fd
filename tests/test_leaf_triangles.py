"""Leaves on cards of their own: where the source's leaves lie, and what is seen of them."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foliage import GREEN, PAINTED, leaf_tree, planes
from groves import NOBODY, hillside, planted, put, seen_from_it, standing
from stems import empty, together
from synthetic import lit, quad
from test_indirect import (
    DIAGONAL,
    EVERYTHING_LOOKED_UP,
    PLAIN,
    around,
    assert_alike,
    crown,
    crown_textures,
    one_plane,
    parallel,
    pictures,
    quads,
    twig_tree,
    with_shapes,
)

from treebake.geometry import turn_to
from treebake.gl.context import context
from treebake.gl.draw import Drawing
from treebake.gl.leaf_triangles import LeafTriangles
from treebake.gl.scene import Scene, Stand
from treebake.gl.view import ONE_TREE, View, looking
from treebake.leaf_cards import leaf_cards
from treebake.model import Doubles, Floats, LeafCards, Texture, Tree
from treebake.stages.indirect import indirect
from treebake.stages.split import SplitSettings, split
from treebake.verify.cost import cost_of

OPEN, CLEAR = (255, 255, 255, 255), (0, 0, 0, 0)
PIXELS = 128


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


@cache
def crown_cards() -> LeafCards:
    return leaf_cards(crown_textures())


def corners(cards: LeafCards) -> Doubles:
    """(N, 4, 3) float64, of each card: left top, right top, right bottom, left bottom of its image."""
    center, right, down = np.moveaxis(cards.cards[:, :, :3].astype(np.float64), 1, 0)
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    return np.asarray(center[:, None] + signs[:, :1] * right[:, None] + signs[:, 1:] * down[:, None])


# ---- where they lie -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("made", ["crown", "one leaf", "askew"])
def test_the_cards_lie_where_the_leaves_lie(made: str) -> None:
    if made == "crown":
        tree, cards = crown()[0], crown_cards()
    else:
        normal = (0.0, 0.0, 1.0) if made == "one leaf" else DIAGONAL
        tree = quads([(1.0, 2.0, 3.0)], normal, size=0.4)
        cards = leaf_cards(indirect(tree, one_plane(tree, (0, 0, -1), 3.1), PLAIN))
    size = np.ptp(tree.foliage.bounds, axis=0).max()
    wanted = tree.foliage.positions.reshape(-1, 4, 3).astype(np.float64)
    found = corners(cards)
    assert len(found) == len(wanted) == tree.leaves.count
    nearest = np.linalg.norm(wanted.mean(axis=1)[:, None] - found.mean(axis=1), axis=2).argmin(axis=1)
    assert sorted(nearest) == list(range(len(wanted)))
    away = np.linalg.norm(wanted[:, :, None] - found[nearest][:, None], axis=3).min(axis=2)  # corners in any order
    assert away.max() < 0.004 * size


def test_a_card_is_as_wide_and_as_high_as_its_leaf() -> None:
    cards = crown_cards().cards
    across, along = (np.linalg.norm(cards[:, row, :3], axis=1) for row in (1, 2))
    assert np.allclose(across, 0.125, rtol=0.07)  # 3 bits of a factor
    assert np.allclose(along, 0.125, rtol=0.01)
    assert np.abs((cards[:, 1, :3] * cards[:, 2, :3]).sum(axis=1)).max() < 1e-4


def test_the_numbers_of_the_cards_are_those_of_the_placements() -> None:
    textures = crown_textures()
    cards = crown_cards()
    assert cards.cards.dtype == np.float32
    assert (len(cards.cards), cards.triangles) == (textures.leaves, textures.leaves)
    placed = textures.placements.reshape(-1, 4)[: textures.leaves]
    np.testing.assert_array_equal(cards.cards[:, 0, 3], placed[:, 3] >> 16)
    np.testing.assert_array_equal(cards.cards[:, 1, 3] < 0, (placed[:, 3] >> 15 & 1).astype(bool))
    assert cost_of(empty(), cards).triangles == textures.leaves
    grey = replace(cards, ambient=np.zeros((0, 4), np.uint8))
    assert cost_of(empty(), cards).gpu_bytes == cost_of(empty(), grey).gpu_bytes + 4 * textures.leaves
    assert cards.leaf_color is textures.leaf_color


def test_mirrored_leaves_show_a_mirrored_image_and_light_from_both_sides() -> None:
    """The painted leaf and its mirror image: wound back, and bent away from the light that it is bent to."""
    mesh = leaf_tree([(0.0, 0.0, 0.0)], size=1.0, material=PAINTED, shading=(0.8, 0.0, 0.6)).foliage
    flip = np.array([-1.0, 1.0, 1.0], np.float32)
    mirror = replace(
        mesh,
        positions=mesh.positions * flip + np.float32([1.2, 0, 0]),
        normals=mesh.normals * flip,
        faces=mesh.faces[:, [0, 2, 1]].copy(),
    )
    tree = split(together(mesh, mirror), SplitSettings(foliage_materials=("*",)))
    cards = leaf_cards(indirect(tree, planes([0, 0], [(0, 0, 1)], [0.0]), PLAIN))
    assert len(cards.shapes) == 1
    assert sorted(np.sign(cards.cards[:, 1, 3]).tolist()) == [-1.0, 1.0]
    for side in (1, -1):
        view = parallel((0, 0, side), (0.6, 0, 0), 1.2)
        alike(tree, cards, view, overlap=0.97, color=0.03)
        straight = cards.cards.copy()
        straight[:, 1, 3] = 1
        with pytest.raises(AssertionError):  # were it not mirrored, this would show
            alike(tree, replace(cards, cards=straight), view, overlap=0.97, color=0.03)


def alike(tree: Tree, cards: LeafCards, view: View, *, overlap: float, color: float) -> None:
    """What is seen of the cards is what is seen of the leaves."""
    (true,), (found,) = pictures(tree.foliage, None, [view]), pictures(empty(), cards, [view])  # type: ignore[arg-type]
    alphas = np.stack([true.color[..., 3], found.color[..., 3]])
    assert alphas[0].sum() > 100
    assert alphas.min(axis=0).sum() > overlap * alphas.max(axis=0).sum()
    both = (alphas == 1).all(axis=0)
    assert np.abs(true.color - found.color)[both].mean() < color
    away = np.abs(true.depth - found.depth)[both]
    assert (away < 0.01 * (view.far - view.near)).mean() > 0.985


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0, -1, 0), DIAGONAL])
def test_one_leaf_is_seen_as_it_is_from_both_sides(normal: tuple[float, float, float], side: int) -> None:
    tree = quads([(1.0, 2.0, 3.0)], normal)
    cards = leaf_cards(indirect(tree, one_plane(tree, normal, -(np.array(normal) @ (1, 2, 3))), PLAIN))
    alike(tree, cards, parallel(side * np.array(normal), (1, 2, 3), 0.15), overlap=0.97, color=0.02)


def test_a_crown_is_seen_as_it_is_from_all_sides() -> None:
    assert_alike(crown()[0], crown_cards(), around(crown()[0]))  # type: ignore[arg-type]


def test_the_light_on_a_leaf_falls_as_on_the_source() -> None:
    for shading in ((0.0, 0.8, 0.6), (0.6, 0.0, 0.8), (-0.6, -0.48, 0.64)):
        tree = with_shapes(leaf_tree([(0.0, 0.0, 1.0)], material=GREEN, shading=shading))
        cards = leaf_cards(indirect(tree, one_plane(tree), PLAIN))
        for side in (1, -1):
            (found,) = pictures(empty(), cards, [parallel((0, 0, side), (0, 0, 1), 0.15)])  # type: ignore[arg-type]
            middle = found.color[70:90, 70:90, :3].mean(axis=(0, 1))
            assert np.allclose(middle, lit((0.1, 0.5, 0.1), side * np.array(shading)), atol=0.03)


# ---- made by hand ---------------------------------------------------------------------------------------------------


def by_hand(
    *,
    front: tuple[float, float, float, float] = (0.0, 0.0, 0.5, 1.0),
    back: tuple[float, float, float, float] = (0.5, 0.0, 0.5, 1.0),
    mirrored: bool = False,
    twig: bool = False,
    width: float = 0.3,
    height: float = 0.6,
) -> LeafCards:
    """One upright card that faces +Z: in its front's image red is on the left, in its back's blue; on the right green.

    All in images of 64 texels, full, with a flat surface.
    """
    pixels = np.zeros((64, 128, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[:, :32, 0] = 255
    pixels[:, 64:96, 2] = 255
    pixels[:, 32:64, 1] = pixels[:, 96:, 1] = 255
    normals = np.full((64, 128, 4), (128, 128, 128, 255), np.uint8)
    cards = np.zeros((1, 3, 4), np.float32)
    cards[0, 1] = width, 0, 0, -1 if mirrored else 1
    cards[0, 2] = 0, -height, 0, twig
    shapes = np.array([[width / height, 1, 0, twig, *front, *back, 0.5, 0.5, 0.5, 0.5]], np.float32)
    ambient = np.full((len(cards), 4), 255, np.uint8)
    return LeafCards(cards, shapes, Texture("color", pixels), Texture("normal", normals), ambient)


def view_from(azimuth: float, elevation: float = 0.0, size: int = PIXELS) -> View:
    """In which a unit is half the picture."""
    turn = turn_to(elevation, azimuth)
    return looking(turn, 20 * turn[2], 20.0, (15.0, 25.0), size, 0.0)


def see(cards: LeafCards, view: View, *, samples: int = 4) -> Floats:
    """(h, w, 4), drawn onto pixels with so many samples."""
    gl = context()
    if samples == 4:
        return planted(view, (empty(), cards, ONE_TREE)).color
    target = gl.framebuffer([gl.renderbuffer(view.window, 4, dtype="f4")], gl.depth_renderbuffer(view.window))
    target.clear()
    drawn = LeafTriangles(gl, cards)
    with gl.scope(target, gl.DEPTH_TEST):
        drawn.draw(view, target)
    drawn.release()
    raw = target.read(components=4, dtype="f4")
    return np.frombuffer(raw, np.float32).reshape(view.size, -1, 4)[::-1]


def sides(color: Floats) -> tuple[str, str]:
    """What colour is seen to the left and to the right of the middle."""
    height, width = color.shape[:2]
    found = [color[height // 2, width // 2 + way * 8, :3] for way in (-1, 1)]
    return tuple("-" if not each.any() else "rgb"[int(each.argmax())] for each in found)  # type: ignore[return-value]


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize(
    ("azimuth", "mirrored", "wanted"),
    [(0, False, ("r", "g")), (0, True, ("g", "r")), (180, False, ("g", "b")), (180, True, ("b", "g"))],
)
def test_each_side_shows_its_image(azimuth: float, mirrored: bool, wanted: tuple[str, str], samples: int) -> None:
    # Of both images u runs to the right as seen from the front: from behind they are seen the other way round.
    assert sides(see(by_hand(mirrored=mirrored), view_from(azimuth), samples=samples)) == wanted


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("hidden", ["front", "back"])
def test_a_side_that_is_never_seen_shows_nothing(hidden: str, samples: int) -> None:
    cards = by_hand(**{hidden: (0.0, 0.0, 0.0, 0.0)})  # type: ignore[arg-type]
    shown, gone = (0.0, 180.0) if hidden == "back" else (180.0, 0.0)
    assert see(cards, view_from(shown), samples=samples).any()
    assert not see(cards, view_from(gone), samples=samples).any()


@pytest.mark.parametrize("samples", [1, 4])
def test_a_card_covers_its_rectangle(samples: int) -> None:
    alpha = see(by_hand(), view_from(0.0), samples=samples)[..., 3]
    assert alpha.sum() == pytest.approx(0.3 * 0.6 * PIXELS**2, rel=0.03)
    rows, columns = (np.flatnonzero((alpha > 0.5).any(axis=axis)) for axis in (1, 0))
    assert np.allclose([rows[0], rows[-1] + 1], [64 - 0.6 * 64, 64 + 0.6 * 64], atol=1)
    assert np.allclose([columns[0], columns[-1] + 1], [64 - 0.3 * 64, 64 + 0.3 * 64], atol=1)


@pytest.mark.parametrize("azimuth", [60.0, 240.0])
def test_a_leaf_turned_away_is_narrower_and_a_twig_is_not(azimuth: float) -> None:
    """A twig turns about its axis to face the viewer: it shows its whole width and height from all around."""
    leaf, twig = (see(by_hand(twig=twig), view_from(azimuth))[..., 3].sum() for twig in (False, True))
    whole = see(by_hand(), view_from(0.0))[..., 3].sum()
    assert leaf == pytest.approx(0.5 * whole, rel=0.05)
    assert twig == pytest.approx(whole, rel=0.03)


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 200.0])
def test_a_twig_is_lit_as_round(azimuth: float) -> None:
    color = see(by_hand(twig=True), view_from(azimuth))
    right, _, back = turn_to(0.0, azimuth)
    for place in (-0.8, -0.3, 0.4, 0.8):
        column = int(64 + place * 0.3 * 64)
        at = (column + 0.5 - 64) / (0.3 * 64)
        wanted = lit((1.0, 1.0, 1.0), at * right + np.sqrt(1 - at**2) * back)
        found = color[64, column, :3]
        channel = int(found.argmax())
        assert found[channel] == pytest.approx(wanted[channel], abs=0.04)


def test_a_real_twig_is_seen_as_it_is() -> None:
    tree, clusters = twig_tree()
    cards = leaf_cards(indirect(tree, clusters, PLAIN))
    twigs = cards.cards[:, 2, 3] > 0.5
    assert twigs.sum() == tree.leaves.is_twig.sum() > 0
    true, found = (pictures(mesh, layers, around(tree)) for mesh, layers in ((tree.foliage, None), (empty(), cards)))  # type: ignore[arg-type]
    for one, other in zip(true, found, strict=True):
        assert other.color[..., 3].sum() == pytest.approx(one.color[..., 3].sum(), rel=0.1)


def test_a_cutout_is_cut_at_its_threshold_and_smoothed_by_samples() -> None:
    cards = by_hand()
    pixels = cards.leaf_color.pixels.copy()
    pixels[:, :64][np.add.outer(np.arange(64), np.arange(64)) % 64 < 32] = CLEAR  # slanting stripes
    pixels[:, :, :3] = (255, 0, 0)
    striped = replace(cards, leaf_color=Texture("color", pixels))
    one, four = (see(striped, view_from(0.0, size=40), samples=samples)[..., 3] for samples in (1, 4))
    assert set(np.unique(one)) == {0.0, 1.0}
    assert set(np.unique(four)) == {0.0, 0.25, 0.5, 0.75, 1.0}
    for alpha in (one, four):
        assert alpha.sum() == pytest.approx(0.5 * 0.3 * 0.6 * 40**2, rel=0.1)


# ---- beside billboards of the same tables ---------------------------------------------------------------------------


def beside(view: View, tables: str) -> tuple[Floats, Floats]:
    """Cards and billboards of one leaf or of a crown: (h, w, 4) each."""
    if tables == "one leaf":
        tree = quads([(0.0, 0.0, 0.0)], DIAGONAL, size=0.8)
        textures = indirect(tree, one_plane(tree, (0, 0, -1), 0.0), PLAIN)
    else:
        textures = crown_textures()
    return tuple(  # type: ignore[return-value]
        planted(view, (empty(), layers, ONE_TREE)).color for layers in (leaf_cards(textures), textures)
    )


@pytest.mark.parametrize("size", [32, 96, 256])
@pytest.mark.parametrize("tables", ["one leaf", "crown"])
def test_cards_and_billboards_look_alike(monkeypatch: pytest.MonkeyPatch, tables: str, size: int) -> None:
    monkeypatch.setattr("treebake.gl.indirect.FADE", EVERYTHING_LOOKED_UP)
    ours, theirs = beside(hillside(size, reach=0.8), tables)
    assert theirs[..., 3].sum() > 50
    assert ours[..., 3].sum() == pytest.approx(theirs[..., 3].sum(), rel=0.04)
    assert np.minimum(ours, theirs)[..., 3].sum() > 0.93 * np.maximum(ours, theirs)[..., 3].sum()
    both = (ours[..., 3] == 1) & (theirs[..., 3] == 1)
    assert np.abs(ours - theirs)[both].mean() < 0.03
    mean, other = (each[..., :3].sum(axis=(0, 1)) / each[..., 3].sum() for each in (ours, theirs))
    assert np.allclose(mean, other, rtol=0.05)


def test_the_fragments_are_those_of_one_triangle_about_each_card() -> None:
    view = view_from(0.0)
    with closing(Drawing(empty(), by_hand(width=0.3, height=0.3))) as drawing:
        asked = drawing.fragments(view)
        assert (drawing.triangles, drawing.calls(view, ONE_TREE)) == (1, 1)
    assert asked == pytest.approx(2 * 0.3 * 0.3 * PIXELS**2, rel=0.05)  # twice the card


def test_one_and_four_samples_cover_alike() -> None:
    view = hillside(128, reach=0.8)
    one, four = (see(crown_cards(), view, samples=samples) for samples in (1, 4))
    assert set(np.unique(one[..., 3])) == {0.0, 1.0}
    assert one[..., 3].sum() == pytest.approx(four[..., 3].sum(), rel=0.02)
    inside = four[..., 3] == 1
    assert np.abs(one - four)[inside].mean() < 0.02


def test_a_time_of_a_scene_takes_one_sample_and_its_picture_four() -> None:
    view = hillside(64, reach=0.8)
    with closing(Scene(view.window)) as scene, closing(Drawing(empty(), crown_cards())) as drawing:
        stand = [Stand(drawing, ONE_TREE)]
        before = scene.picture(view, stand).color
        scene.draw(view, stand)
        np.testing.assert_array_equal(scene.picture(view, stand).color, before)


# ---- groves ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "place",
    [(0.3, -0.2, 0.5, 1.0, 0.0), (0, 0, 0, 1.5, 0.0), (0, 0, 0, 1.0, 75.0), (0.2, 0.1, -0.3, 1.2, 230.0)],
    ids=["moved", "scaled", "turned", "all"],
)
def test_a_tree_of_cards_is_the_one_seen_from_elsewhere(place: tuple[float, float, float, float, float]) -> None:
    view = hillside(128, reach=1.0)
    there = planted(view, (empty(), crown_cards(), standing(place)))
    instead = planted(seen_from_it(view, place), (empty(), crown_cards(), ONE_TREE))
    assert instead.color[..., 3].sum() > 500
    assert np.abs(there.color - instead.color)[..., 3].sum() < 0.01 * instead.color[..., 3].sum()
    leaves = planted(view, (put(crown()[0].foliage, place), None, ONE_TREE)).color
    both = (there.color[..., 3] == 1) & (leaves[..., 3] == 1)
    assert both.sum() > 500
    assert np.abs(there.color - leaves)[both].mean() < 0.04  # the light stands still in the world
    assert not planted(view, (empty(), crown_cards(), NOBODY)).color.any()


def test_a_fading_tree_drops_whole_leaves() -> None:
    """Leaves side by side, each of them there or not; the same ones in the count, and in billboards of the tables."""
    side = 12
    places = [(0.3 * x, 0.3 * y, 0.0) for y in range(side) for x in range(side)]
    tree = quads(places, size=0.25, material=GREEN)
    textures = indirect(tree, one_plane(tree, (0, 0, -1), 0.0), PLAIN)
    cards = leaf_cards(textures)
    middle = 0.3 * (side - 1) / 2
    view = looking(np.eye(3), np.array([middle, middle, 40.0]), 40 / (0.15 * side), (30.0, 50.0), 20 * side, 0.0)

    def there(layers: object, opacity: float) -> Floats:
        grove = standing((0, 0, 0, 1, 0), opacities=opacity)
        alpha = planted(view, (empty(), layers, grove)).color[..., 3]  # type: ignore[arg-type]
        return np.asarray(alpha.reshape(side, 20, side, 20)[:, 4:16, :, 4:16].mean(axis=(1, 3)))

    shown = {opacity: there(cards, opacity) for opacity in (0.0, 0.3, 0.6, 1.0)}
    assert not shown[0.0].any()
    assert (shown[1.0] == 1).all()
    for opacity in (0.3, 0.6):
        assert set(np.unique(shown[opacity])) == {0.0, 1.0}
        assert shown[opacity].mean() == pytest.approx(opacity, abs=0.12)
        np.testing.assert_array_equal(there(textures, opacity), shown[opacity])
    assert not (shown[0.3] > shown[0.6]).any()
    with closing(Scene(view.window)) as scene, closing(Drawing(empty(), cards)) as drawing:
        whole, part = (
            scene.fragments(view, [Stand(drawing, standing((0, 0, 0, 1, 0), opacities=o))]) for o in (1.0, 0.6)
        )
    assert part / whole == pytest.approx(shown[0.6].mean(), rel=0.01)


def test_cards_hide_what_is_behind_them_and_are_hidden() -> None:
    cards = by_hand()
    for z, wanted in ((-1.0, "r"), (1.0, "g")):
        found = planted(view_from(0.0), (quad(GREEN, z=z), cards, ONE_TREE)).color
        assert sides(found)[0] == wanted


def test_more_cards_than_a_row_of_the_table_holds() -> None:
    one = by_hand(width=0.01, height=0.01)
    rows = one.cards.repeat(1500, axis=0)
    rows[:, 0, :2] = 0.05 * (np.stack(np.divmod(np.arange(1500), 39), axis=1) - 19)
    alpha = see(replace(one, cards=rows), view_from(0.0, size=512))[..., 3]
    assert alpha.sum() == pytest.approx(1500 * (0.01 * 512) ** 2, rel=0.05)
