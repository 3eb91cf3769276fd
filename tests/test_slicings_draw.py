"""Slicings as they are drawn: pixels against a twin of the blending in numpy, and against the leaves themselves."""

from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from foliage import GREEN, leaf_tree
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from stems import empty
from synthetic import SOFTNESS, lit, quad

from treebake.brightness import fit_brightness
from treebake.geometry import turn_to
from treebake.gl.context import context
from treebake.gl.draw import Drawing
from treebake.gl.slicings import RELIEF_HEIGHT, SlicingCards
from treebake.gl.view import ONE_TREE, Grove, View, looking
from treebake.images import to_linear, to_srgb
from treebake.model import AlphaMode, Floats, Material, Mesh, PictureAtlas, Slicings, Texture, Tree
from treebake.pictures import STEEPEST
from treebake.stages.slicings import SlicingSettings, slicings
from treebake.stages.slicings.mirror import seen_from_behind

CELL = 16  # texels of a picture's side in the atlas
AWAY = 20.0
FLAT = (128 / 255 * 2 - 1) * STEEPEST  # the slope that is nearest to none, in 8 bits
# Colours that block compression keeps: full or nothing in each channel.
COLORS = np.array([c for c in product((0, 1), repeat=3) if any(c)], np.float32)
RED = Material("red", base_color=(0.8, 0.0, 0.0, 1.0), double_sided=True)
CLOSE, FAR = 128, 16  # pixels of the cards' height: above and below that from which on slices are looked into


@dataclass(frozen=True)
class Cards:
    """Slicings made by hand: every slice is a square of side 2, all of one colour and coverage."""

    orientations: int = 6
    count: int = 1
    above: bool = False
    coverage: int = 255
    brightness: float = 0.0
    exposure: float = 1.0
    dropped: int = 0
    far_height: float = 0.0
    depth: float = 0.0  # in front of each slice's plane, where its surface lies
    gap: float = 0.2  # between slices

    @property
    def turns(self) -> list[np.ndarray]:
        around = [turn_to(0.0, 360 * i / self.orientations) for i in range(self.orientations)]
        return [*around, turn_to(90.0, 0.0)] if self.above else around

    def color(self, slicing: int, step: int) -> Floats:
        """Albedo of a slice; of a far one, where `step` is -1."""
        return COLORS[(slicing * self.count + step) % 7 if step >= 0 else (6 - slicing) % 7]

    def light(self, slicing: int, step: int) -> np.ndarray:
        """What comes from a slice under the lamps."""
        normal = np.array([FLAT, FLAT, 1]) @ self.turns[slicing]
        return lit(self.exposure * self.color(slicing, step), normal, SOFTNESS)

    def made(self) -> Slicings:
        far = [(slicing, -1) for slicing in range(len(self.turns))] if self.far_height else []
        shown = [(slicing, step) for slicing in range(len(self.turns)) for step in range(self.count)] + far
        table = np.zeros((len(shown), 5, 4), np.float32)
        albedo = np.zeros((CELL // 2, CELL // 2 * len(shown), 3), np.float32)
        for number, (slicing, step) in enumerate(shown):
            table[number, :3, :3] = self.turns[slicing]
            offset = (step - (self.count - 1) / 2) * self.gap if step >= 0 else 0
            table[number, :3, 3] = offset, min(self.depth, 0), max(self.depth, 0)
            table[number, 3] = -1, -1, 1, 1
            table[number, 4] = number / len(shown), 1, (number + 1) / len(shown), 0
            albedo[:, number * CELL // 2 : (number + 1) * CELL // 2] = self.color(slicing, step)
        relief = np.full_like(albedo, (128 / 255, 128 / 255, float(self.depth > 0)))
        atlas = PictureAtlas(
            coverage=texture(np.full((CELL, CELL * len(shown), 3), self.coverage, np.uint8)),
            albedo=texture(to_srgb(albedo)),
            relief=texture(np.rint(relief * 255).astype(np.uint8)),
            occlusion=texture(np.full((CELL // 8, CELL // 8 * len(shown), 3), 255, np.uint8)),
            mips=0,
        )
        return Slicings(
            slices=table,
            orientations=self.orientations,
            count=self.count,
            center=np.zeros(3),
            size=2.0,
            above=self.above,
            far_row=len(self.turns) * self.count,
            far_height=self.far_height,
            dropped=self.dropped,
            brightness=self.brightness,
            exposure=self.exposure,
            atlas=atlas,
            untrimmed=1,
        )

    def weights(self, azimuth: float, elevation: float) -> dict[int, float]:
        """Of the slicings that are blended, the strongest last."""
        around = azimuth % 360 / 360 * self.orientations
        nearest = int(np.floor(around + 0.5))
        following = nearest + (1 if around >= nearest else -1)
        second = abs(around - nearest)
        top = float(np.clip((elevation - 30) / 30, 0, 1)) if self.above else 0.0
        found = {self.orientations: top}
        found |= {following % self.orientations: (1 - top) * second}
        found |= {nearest % self.orientations: (1 - top) * (1 - second)}
        return {slicing: weight for slicing, weight in found.items() if weight > 0}

    def cosine(self, slicing: int, azimuth: float, elevation: float) -> float:
        """Of the angle between a slicing's way to the viewer and the viewer's own place."""
        return float(self.turns[slicing][2] @ turn_to(elevation, azimuth)[2])

    def seen(self, azimuth: float, elevation: float, pixels: int) -> Floats:
        """What the middle of a view shows, premultiplied: [J00] 2.3 in a few lines. A slice has one side."""
        weights = self.weights(azimuth, elevation)
        factor = 1 + self.brightness * (1 - max(weights.values()))
        result = np.zeros(4)
        for step in [-1] if pixels < self.far_height else range(self.dropped, self.count):
            for slicing, weight in weights.items():
                cosine = self.cosine(slicing, azimuth, elevation)
                part = self.coverage / 255
                if pixels >= RELIEF_HEIGHT:  # turned from the viewer, a surface covers less
                    ray = self.turns[slicing] @ turn_to(elevation, azimuth)[2]
                    part = 1 - (1 - part) ** abs(ray @ [FLAT, FLAT, 1])
                alpha = min(factor * weight, 1) * part * (cosine > 0)
                result = np.append(self.light(slicing, step), 1) * alpha + result * (1 - alpha)
        return result.astype(np.float32)


def texture(pixels: np.ndarray) -> Texture:
    return Texture("made", np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)]))


def around(azimuth: float, elevation: float = 0.0, *, pixels: int = CLOSE, size: int = 32, away: float = AWAY) -> View:
    """At the origin, where a unit is pixels / 2 long."""
    turn = turn_to(elevation, azimuth)
    return looking(turn, away * turn[2], pixels * away / size, (away - 4, away + 4), size, 0.0)


def middle(made: Slicings, view: View, mesh: Mesh | None = None) -> Floats:
    with closing(Drawing(mesh or empty(), made)) as drawing:
        color = drawing.picture(view).color
    at = view.size // 2
    return color[at - 1 : at + 1, at - 1 : at + 1].mean(axis=(0, 1))


# ---- how much of which slicing ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("pixels", [CLOSE, FAR], ids=["looked into", "plain"])
@pytest.mark.parametrize("azimuth", [0, 10, 29, 31, 59, 60, 100, 200, 359])
@pytest.mark.parametrize("brightness", [0.0, 0.5, 1.8])
def test_two_slicings_are_blended_by_their_angles(azimuth: float, brightness: float, pixels: int) -> None:
    cards = Cards(brightness=brightness)
    seen = middle(cards.made(), around(azimuth, pixels=pixels))
    np.testing.assert_allclose(seen, cards.seen(azimuth, 0, pixels), atol=2e-3)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0, 360),
    st.floats(-25, 80),
    st.sampled_from([CLOSE, FAR]),
    st.builds(
        Cards,
        orientations=st.integers(3, 7),
        count=st.integers(1, 3),
        above=st.booleans(),
        coverage=st.integers(20, 255),
        brightness=st.floats(0, 1.8),
        exposure=st.floats(0.5, 2),
        far_height=st.sampled_from([0.0, 30.0]),
    ),
)
def test_anything_is_blended_as_the_twin_says(azimuth: float, elevation: float, pixels: int, cards: Cards) -> None:
    assume(abs(azimuth / 360 * cards.orientations % 1 - 0.5) > 1e-3)  # midway either may come first
    slants = [cards.cosine(slicing, azimuth, elevation) for slicing in cards.weights(azimuth, elevation)]
    assume(all(abs(slant) > 0.4 for slant in slants))  # on edge a slice may miss the middle
    seen = middle(cards.made(), around(azimuth, elevation, pixels=pixels))
    np.testing.assert_allclose(seen, cards.seen(azimuth, elevation, pixels), atol=8e-3)


@pytest.mark.parametrize("slicing", [0, 1, 2])
def test_facing_a_slicing_only_it_is_seen(slicing: int) -> None:
    cards = Cards(brightness=1.0)
    seen = middle(cards.made(), around(60.0 * slicing))
    np.testing.assert_allclose(seen, [*cards.light(slicing, 0), 1], atol=1e-3)


@pytest.mark.parametrize("brightness", [0.0, 0.5, 1.0])
def test_midway_both_have_the_same_opacity(brightness: float) -> None:
    cards = Cards(brightness=brightness)
    seen = middle(cards.made(), around(30.0))
    opacity = 0.5 * (1 + 0.5 * brightness)
    assert seen[3] == pytest.approx(1 - (1 - opacity) ** 2, abs=2e-3)
    either = [np.array([*cards.light(slicing, 0), 1]) for slicing in (0, 1)]
    orders = [opacity * over + opacity * (1 - opacity) * under for over, under in (either, either[::-1])]
    assert min(np.abs(seen - order).max() for order in orders) < 3e-3


def test_across_the_middle_the_pair_stays_and_only_its_order_changes() -> None:
    cards = Cards()
    left, right = (middle(cards.made(), around(azimuth)) for azimuth in (29.9, 30.1))
    assert left[3] == pytest.approx(right[3], abs=2e-3)
    hidden = 0.25 * np.abs(cards.light(0, 0) - cards.light(1, 0))  # by the upper one
    np.testing.assert_allclose(np.abs(left - right)[:3], hidden, atol=0.01)


@pytest.mark.parametrize(("elevation", "weight"), [(29.0, 0.0), (30.0, 0.0), (45.0, 0.5), (60.0, 1.0), (89.0, 1.0)])
def test_from_above_the_third_takes_over(elevation: float, weight: float) -> None:
    cards = Cards(above=True)
    seen = middle(cards.made(), around(0.0, elevation))
    np.testing.assert_allclose(seen, cards.seen(0, elevation, CLOSE), atol=2e-3)
    # Facing the front, it comes first and the front over it.
    assert seen[3] == pytest.approx(1 - (1 - weight) * weight, abs=5e-3)


def test_without_a_slicing_from_above_the_sides_stay() -> None:
    assert middle(Cards().made(), around(0.0, 60.0))[3] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("pixels", [CLOSE, FAR], ids=["looked into", "plain"])
def test_exposure_is_a_factor_of_the_light_alone(pixels: int) -> None:
    cards = Cards(coverage=100)
    bright, dim = (middle(replace(cards, exposure=e).made(), around(10.0, pixels=pixels)) for e in (0.8, 0.4))
    np.testing.assert_allclose(dim[:3], bright[:3] / 2, atol=1e-3)
    assert dim[3] == pytest.approx(bright[3], abs=1e-4)


# ---- slices --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pixels", [CLOSE, FAR], ids=["looked into", "plain"])
def test_slices_come_back_to_front(pixels: int) -> None:
    cards = Cards(count=3, coverage=128)
    seen = middle(cards.made(), around(0.0, pixels=pixels))
    far, between, near = (cards.light(0, step) for step in range(3))
    c = 128 / 255
    wanted = c * near + (1 - c) * (c * between + (1 - c) * c * far)
    np.testing.assert_allclose(seen, [*wanted, 1 - (1 - c) ** 3], atol=3e-3)


@pytest.mark.parametrize("dropped", [1, 2])
def test_the_furthest_slices_can_be_left_out(dropped: int) -> None:
    cards = Cards(count=3, coverage=128, dropped=dropped)
    seen = middle(cards.made(), around(20.0))
    assert seen[3] < middle(replace(cards, dropped=0).made(), around(20.0))[3] - 0.05
    np.testing.assert_allclose(seen, cards.seen(20, 0, CLOSE), atol=3e-3)


@pytest.mark.parametrize("pixels", [12, 24, 60])
def test_a_small_tree_is_a_single_slice(pixels: int) -> None:
    """The switch is at far_height pixels of the crown, at any size of the picture."""
    for height, far in ((pixels * 1.05, True), (pixels * 0.95, False)):
        cards = Cards(count=2, coverage=128, far_height=height)
        seen = middle(cards.made(), around(0.0, pixels=pixels))
        opacity = 128 / 255 if far else 1 - (127 / 255) ** 2
        assert seen[3] == pytest.approx(opacity, abs=3e-3)
        np.testing.assert_allclose(seen, cards.seen(0, 0, pixels), atol=3e-3)


def test_a_slice_that_the_viewer_has_passed_is_not_drawn() -> None:
    cards = Cards(count=2, gap=2.0)  # slices at -1 and 1, the viewer between them
    made = cards.made()
    front = turn_to(0.0, 0.0)
    for away, step in ((1.5, 1), (0.5, 0)):
        view = looking(front, away * front[2], 1.0, (0.1, 4.0), 32, 0.0)
        np.testing.assert_allclose(middle(made, view)[:3], cards.light(0, step), atol=1e-3)


# ---- depth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pixels", [CLOSE, FAR], ids=["looked into", "plain"])
@pytest.mark.parametrize(("z", "shown"), [(0.3, False), (-0.3, True)])
def test_slices_are_hidden_by_what_is_before_them(z: float, shown: bool, pixels: int) -> None:
    cards = Cards()
    opaque = quad(Material("wall", base_color=(0.0, 0.0, 0.0, 1.0)), z=z)
    seen = middle(cards.made(), around(0.0, pixels=pixels), opaque)
    np.testing.assert_allclose(seen[:3], cards.light(0, 0) if shown else 0, atol=1e-3)
    assert seen[3] == pytest.approx(1)


def test_a_slice_looked_into_lies_where_its_picture_did() -> None:
    # The plane is behind the wall, and what it shows is before.
    wall = quad(Material("wall", base_color=(0.0, 0.0, 0.0, 1.0)), z=0.15)
    for depth, shown in ((0.3, True), (0.1, False)):
        cards = Cards(depth=depth)
        seen = middle(cards.made(), around(0.0), wall)
        assert (seen[:3].max() > 0.4) == shown
    assert middle(Cards(depth=0.3).made(), around(0.0, pixels=FAR), wall)[:3].max() < 1e-3  # flat from far away


def test_slices_write_no_depth() -> None:
    # A pane of glass behind the slices is drawn after them: were they in the depth buffer, it would be hidden.
    cards = Cards()
    pane = quad(Material("pane", base_color=(0.0, 0.0, 0.0, 1.0), alpha_mode=AlphaMode.BLEND), z=-0.3)
    assert middle(cards.made(), around(0.0), pane)[:3].max() < 1e-3
    with closing(Drawing(empty(), cards.made())) as drawing:
        assert drawing.picture(around(0.0)).depth[16, 16] == pytest.approx(AWAY, abs=1e-2)  # it is told all the same


# ---- looked into -----------------------------------------------------------------------------------------------------


BAKE = SlicingSettings(
    orientations=4, slices=1, texels=256, far_height=0.0, above=False, supersample=2, atlas=1024, gutter=4
)


def deep() -> Tree:
    """A green leaf before the only slice and a red one behind it, with smaller ones at the ends of the depth."""
    tree = leaf_tree([(0.5, 0.3, 0.7), (-0.5, -0.3, -0.7), (0, 0.9, 1.0), (0, -0.9, -1.0)], size=0.4)
    materials = (GREEN, RED)
    colors = np.array([0, 0, 1, 1, 0, 0, 1, 1], np.int32)
    return replace(tree, foliage=replace(tree.foliage, materials=materials, face_material=colors))


@cache
def baked_deep() -> Slicings:
    return slicings(deep(), BAKE).slicings


def center_of(color: Floats, channel: int, window: tuple[slice, slice]) -> np.ndarray:
    """Of what is seen in red or green: (row, column)."""
    weight = np.where(color[..., channel] > 2 * color[..., 1 - channel], color[..., channel], 0)
    masked = np.zeros_like(weight)
    masked[window] = weight[window]
    assert masked.sum() > 0
    return np.array([(grid * masked).sum() / masked.sum() for grid in np.mgrid[: len(weight), : len(weight)]])


@pytest.mark.parametrize("azimuth", [0.0, 12.0, -20.0])
def test_leaves_off_the_plane_are_seen_at_their_true_place(azimuth: float) -> None:
    size, pixels = 256, 200
    view = around(azimuth, pixels=pixels, size=size, away=12.0)
    with closing(Drawing(deep().foliage)) as drawing:
        wanted = drawing.picture(view).color
    with closing(Drawing(empty(), baked_deep())) as drawing:
        seen = drawing.picture(view).color
    flat = baked_deep().slices.copy()
    flat[:, 1:3, 3] = 0  # all on the plane
    with closing(Drawing(empty(), replace(baked_deep(), slices=flat))) as drawing:
        on_plane = drawing.picture(view).color
    upper, lower = np.s_[68:128, :], np.s_[128:188, :]  # without the small ones at the ends
    for channel, window in ((1, upper), (0, lower)):
        true = center_of(wanted, channel, window)
        assert np.abs(center_of(seen, channel, window) - true).max() < 1
        assert azimuth == 0 or np.abs(center_of(on_plane, channel, window) - true).max() > 10


@pytest.mark.parametrize("pixels", [CLOSE, FAR], ids=["looked into", "plain"])
@pytest.mark.parametrize("elevation", [0.0, 25.0, -25.0])
@pytest.mark.parametrize("behind", [False, True], ids=["from before", "from behind"])
def test_slopes_tell_the_light_and_how_much_is_covered(elevation: float, behind: bool, pixels: int) -> None:
    """Of a picture seen from behind, the slope up runs the other way."""
    cards = Cards(orientations=4, coverage=128, depth=0.01)
    made = cards.made()
    relief = made.atlas.relief.pixels.copy()
    relief[..., :2] = 144, 160
    slices = made.slices.copy()
    slices[2] = seen_from_behind(slices[0], slices[2])
    made = replace(made, slices=slices, atlas=replace(made.atlas, relief=texture(relief[..., :3])))
    seen = middle(made, around(180.0 if behind else 0.0, elevation, pixels=pixels))
    right, up = (np.array([144, 160]) / 255 * 2 - 1) * STEEPEST * (1, -1 if behind else 1)
    turned = abs(turn_to(0, 0) @ turn_to(elevation, 0)[2] @ [right, up, 1]) if pixels == CLOSE else 1.0
    np.testing.assert_allclose(seen[3], 1 - (127 / 255) ** turned, atol=3e-3)
    light = lit(cards.color(0, 0), [right, up, 1] @ turn_to(0.0, 180.0 if behind else 0.0), SOFTNESS)
    np.testing.assert_allclose(seen[:3], light * seen[3], atol=3e-3)


def test_from_far_away_slices_are_flat() -> None:
    view = around(20.0, pixels=int(RELIEF_HEIGHT) - 8, size=64, away=40.0)
    with closing(Drawing(empty(), baked_deep())) as drawing:
        color = drawing.picture(view).color
    # The green leaf is drawn at x = 0.5 on the plane, whose right is foreshortened by the view.
    row, column = center_of(color, 1, np.s_[23:32, :])
    shift = 0.5 * np.cos(np.radians(20)) * view.focus / 40
    assert column == pytest.approx(31.5 + shift, abs=0.7)
    assert row < 32


def test_a_leaf_at_the_end_of_a_slices_depth_is_as_opaque_as_any() -> None:
    tree = leaf_tree([(0.5, 0, 0.7), (-0.5, 0, -0.7)], size=0.6)
    made = replace(slicings(tree, BAKE).slicings, brightness=0.0)
    view = around(0.0, pixels=200, size=256, away=12.0)
    with closing(Drawing(empty(), made)) as drawing:
        alpha = drawing.picture(view).color[..., 3]
    with closing(Drawing(tree.foliage)) as drawing:
        wanted = drawing.picture(view).color[..., 3]
    assert alpha.sum() == pytest.approx(wanted.sum(), rel=0.05)


# ---- a grove ---------------------------------------------------------------------------------------------------------


def crown() -> Tree:
    random = np.random.default_rng(1)
    return leaf_tree(random.uniform(-1, 1, (60, 3)), random.normal(size=(60, 3)), size=0.4)


CROWN = replace(BAKE, orientations=8, slices=3, texels=96)


@cache
def baked_crown() -> Slicings:
    return slicings(crown(), CROWN).slicings


def drawn(made: Slicings, view: View, *groves: Grove) -> Floats:
    """Groves, by default one tree, drawn over each other in turn: (h, w, 4) float32."""
    gl = context()
    images = [gl.texture((view.size, view.size), 4, dtype="f4") for _ in range(2)]
    frame = gl.framebuffer(images, gl.depth_renderbuffer((view.size, view.size)))
    frame.clear()
    cards = SlicingCards(gl, made)
    with gl.scope(frame, gl.DEPTH_TEST):
        for grove in groves or (ONE_TREE,):
            cards.draw(view, frame, grove)
    cards.release()
    data = frame.read(components=4, dtype="f4")
    return np.frombuffer(data, np.float32).reshape(view.size, view.size, 4)[::-1]


def grove(*trees: tuple[float, float, float, float, float]) -> Grove:
    """x, y, z, scale and turn in degrees of each."""
    values = np.array(trees, np.float32)
    return Grove(values[:, :4], np.radians(values[:, 4]))


def hillside(size: int = 64) -> View:
    turn = turn_to(10.0, 0.0)
    return looking(turn, 20 * turn[2], 4.0, (1.0, 200.0), size, 0.0)


def test_trees_in_one_call_are_the_trees_drawn_one_by_one() -> None:
    trees = [(0, 0, 0, 1, 0), (1.5, 0.5, -3, 1.5, 40), (-1, -1, 4, 0.7, 200), (2, 1, -60, 2, 90)]
    far_first = sorted(trees, key=lambda t: -np.linalg.norm(np.array(t[:3]) - hillside().eye))
    together = drawn(baked_crown(), hillside(), grove(*trees))
    apart = drawn(baked_crown(), hillside(), *(grove(tree) for tree in far_first))
    assert (together[..., 3] > 0.2).sum() > 100
    np.testing.assert_allclose(together, apart, atol=1e-6)
    wrong = drawn(baked_crown(), hillside(), *(grove(tree) for tree in far_first[::-1]))
    assert np.abs(wrong - apart).max() > 0.1  # they overlap


def test_the_order_of_the_trees_does_not_matter() -> None:
    trees = [(0, 0, 0, 1, 0), (0.5, 0.2, -1, 1.5, 40), (-0.5, 0, 2, 0.7, 200)]
    first, second = (drawn(baked_crown(), hillside(), grove(*order)) for order in (trees, trees[::-1]))
    np.testing.assert_allclose(first, second, atol=1e-6)


@pytest.mark.parametrize(
    "tree",
    [(0, 0, 0, 1, 0), (0.7, -0.4, 1, 1, 0), (0, 0, 0, 1.5, 0), (0, 0, 0, 1, 70), (0.5, 0.3, -2, 0.6, -130)],
    ids=["as it is", "moved", "scaled", "turned", "all"],
)
def test_a_tree_of_a_grove_is_the_tree_seen_from_elsewhere(tree: tuple[float, float, float, float, float]) -> None:
    *place, scale, degrees = tree
    angle = np.radians(degrees)
    to_world = np.eye(4)
    to_world[:3, :3] = scale * np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]  # +Z towards +X
    )
    to_world[:3, 3] = place
    view = hillside(128)
    instead = View(view.to_clip @ to_world / scale, view.size, view.near, view.far)
    moved = drawn(baked_crown(), view, grove(tree))
    assert (moved[..., 3] > 0.2).sum() > 50
    off = np.abs(moved - drawn(baked_crown(), instead))[..., 3]  # the light stands still in the world
    assert off.mean() < 1e-4  # rounding may add a step through a slice, at a few pixels
    assert off.max() < 0.05


@pytest.mark.parametrize("height", [0.0, np.inf], ids=["looked into", "plain"])
@pytest.mark.parametrize("degrees", [180, 90])
def test_the_sun_does_not_turn_with_a_tree(monkeypatch: pytest.MonkeyPatch, height: float, degrees: float) -> None:
    """A tree turned in a grove looks as one does that was turned before it was baked."""
    monkeypatch.setattr("treebake.gl.slicings.RELIEF_HEIGHT", height)
    tree, around_y = crown(), turn_to(0.0, degrees)  # a row vector times this is turned from +Z towards +X
    mesh, leaves = tree.foliage, tree.leaves
    turned = replace(
        tree,
        foliage=replace(
            mesh,
            positions=(mesh.positions @ around_y).astype(np.float32),
            normals=(mesh.normals @ around_y).astype(np.float32),
        ),
        leaves=replace(leaves, centers=leaves.centers @ around_y, normals=leaves.normals @ around_y),
    )
    made = baked_crown()
    wanted = slicings(turned, CROWN).slicings
    wanted = replace(wanted, brightness=made.brightness, exposure=made.exposure)  # fitted from other sides
    seen, true = (drawn(*of) for of in ((made, hillside(), grove((0, 0, 0, 1, degrees))), (wanted, hillside())))
    assert (true[..., 3] > 0.2).sum() > 100
    assert seen[..., :3].sum() == pytest.approx(true[..., :3].sum(), rel=0.01)
    assert np.abs(seen - true)[..., :3].sum() < 0.05 * true[..., :3].sum()


def test_in_a_grove_each_tree_is_near_or_far_for_itself() -> None:
    cards = Cards(count=2, coverage=128, far_height=20.0)
    view = looking(turn_to(0, 0), np.array([0.0, 0.0, 20.0]), 4.0, (1.0, 400.0), 128, 0.0)
    color = drawn(cards.made(), view, grove((-2, 0, 0, 1, 0), (24, 0, -180, 1, 0)))
    for (x, z), pixels in (((-2, 0), 25), ((24, -180), 3)):
        azimuth = np.degrees(np.arctan2(-x, 20 - z))
        column = int(64 + 256 * x / (20 - z))
        np.testing.assert_allclose(color[64, column], cards.seen(azimuth, 0, pixels), atol=5e-3)


# ---- brightness ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.6, 1.3])
def test_a_known_exposure_is_recovered(factor: float) -> None:
    atlas = baked_crown().atlas
    pixels = atlas.albedo.pixels.copy()
    pixels[..., :3] = to_srgb(np.minimum(to_linear(pixels[..., :3]) / factor, 1).astype(np.float32))
    other = replace(baked_crown(), exposure=1.0, atlas=replace(atlas, albedo=Texture("albedo", pixels)))
    fitted = fit_brightness(other, empty(), crown().foliage, 160)
    assert fitted.exposure == pytest.approx(factor * baked_crown().exposure, rel=0.03)
    assert fitted.brightness == pytest.approx(baked_crown().brightness, abs=0.01)  # light is not coverage


def test_the_fit_does_not_depend_on_what_it_starts_from() -> None:
    start = replace(baked_crown(), brightness=1.7, exposure=1.0)
    fitted = fit_brightness(start, empty(), crown().foliage, 160)
    assert fitted.brightness == baked_crown().brightness


def test_fitted_slicings_cover_as_much_as_the_tree() -> None:
    areas = []
    for azimuth in np.arange(0, 360, 25.0):
        view = around(azimuth, pixels=100, size=160)
        with closing(Drawing(empty(), baked_crown())) as drawing:
            sliced = drawing.picture(view).color[..., 3].sum()
        with closing(Drawing(crown().foliage, exact_cutouts=True)) as drawing:
            areas.append(sliced / drawing.picture(view).color[..., 3].sum())
    assert np.mean(areas) == pytest.approx(1, abs=0.04)


def test_an_exposure_stays_within_its_bounds() -> None:
    black = Texture("albedo", np.full_like(baked_crown().atlas.albedo.pixels, (0, 0, 0, 255)))
    dark = replace(baked_crown(), atlas=replace(baked_crown().atlas, albedo=black))
    assert fit_brightness(dark, empty(), crown().foliage, 64).exposure == 2.0


@pytest.mark.parametrize("source", [empty(), quad(RED, x=(0, 0))], ids=["no faces", "no area"])
def test_an_empty_source_leaves_the_stand_in_alone(source: Mesh) -> None:
    made = baked_crown()
    assert fit_brightness(made, empty(), source, 64) is made
