"""The ladder at work in a forest: which step a tree is drawn with, which trees are seen, and the way through them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic import small_tree

from treebake.geometry import turn_to
from treebake.gl.scene import Stand
from treebake.gl.view import Grove, View, looking
from treebake.model import Cells, Doubles, Floats, Forest, Ints
from treebake.stages.scatter import ForestSettings, scatter
from treebake.verify.cameras import bounding_sphere
from treebake.verify.path import path, view_of
from treebake.verify.stands import Kind, Trees, pixels_high, seen, stands
from treebake.verify.switching import FADE, switched

TREE = small_tree()
FIELD = 45.0  # degrees

# ---- which step -----------------------------------------------------------------------------------------------------

# Far enough apart that one change is over before the next begins.
LADDERS = (
    st.lists(st.integers(8, 2048), max_size=6, unique=True)
    .map(lambda heights: (*sorted(heights, reverse=True), 0))
    .filter(lambda rungs: all(b == 0 or a >= FADE * b for a, b in pairwise(rungs)))
)
HEIGHTS = st.lists(st.floats(0.5, 5000), min_size=1, max_size=20).map(np.array)


def visible(heights: Doubles, rungs: tuple[int, ...]) -> Doubles:
    """How visible each step is: (n, steps)."""
    step, nearer, farther = switched(heights, rungs)
    assert step.dtype == np.int64
    found = np.zeros((len(heights), len(rungs) + 1))
    found[np.arange(len(heights)), step] = nearer
    found[np.arange(len(heights)), step + 1] += farther
    assert not found[:, -1].any()  # there is no step after the last
    return found[:, :-1]


@given(HEIGHTS, LADDERS)
def test_one_step_is_whole_and_at_most_its_neighbour_is_seen_too(heights: Doubles, rungs: tuple[int, ...]) -> None:
    for shares in visible(heights, rungs):
        assert shares.max() == 1
        assert ((shares >= 0) & (shares <= 1)).all()
        shown = np.flatnonzero(shares)
        assert len(shown) <= 2
        assert np.ptp(shown) == len(shown) - 1


@given(HEIGHTS, LADDERS)
def test_outside_of_changes_the_step_is_the_one_that_reaches_down_to_the_height(
    heights: Doubles, rungs: tuple[int, ...]
) -> None:
    for height, shares in zip(heights, visible(heights, rungs), strict=True):
        if not any(rung / FADE < height < rung for rung in rungs):
            wanted = next(number for number, rung in enumerate(rungs) if height >= rung)
            assert shares[wanted] == 1
            assert shares.sum() == 1


@given(st.floats(1, 5000), st.floats(1e-6, 1e-4), LADDERS)
def test_nothing_changes_at_once(height: float, part: float, rungs: tuple[int, ...]) -> None:
    here, there = visible(np.array([height, height * (1 + part)]), rungs)
    assert np.abs(here - there).max() < 10 * part


@given(LADDERS)
def test_a_change_is_continuous_at_its_ends(rungs: tuple[int, ...]) -> None:
    for rung in rungs[:-1]:
        for edge in (rung, rung / FADE):
            below, at, above = visible(edge * np.array([1 - 1e-9, 1.0, 1 + 1e-9]), rungs)
            assert np.abs(np.stack([below, above]) - at).max() < 1e-6


def test_first_the_farther_one_is_whole_then_the_nearer_one() -> None:
    rungs = (100, 0)
    middle = 100 / FADE**0.5
    steps = visible(np.array([100.0, 100 / FADE**0.25, middle, 100 / FADE**0.75, 100 / FADE]), rungs)
    np.testing.assert_allclose(steps, [(1, 0), (1, 0.5), (1, 1), (0.5, 1), (0, 1)], atol=1e-12)


@given(HEIGHTS)
def test_one_rung_is_always_whole(heights: Doubles) -> None:
    step, nearer, farther = switched(heights, (0,))
    assert not step.any()
    assert (nearer == 1).all()
    assert not farther.any()


def test_the_least_and_the_greatest_heights() -> None:
    for height, wanted in ((0.0, (0, 0, 1)), (1e-9, (0, 0, 1)), (1e9, (1, 0, 0))):
        np.testing.assert_array_equal(visible(np.array([height]), (256, 32, 0)), [wanted])
    step, nearer, farther = switched(np.zeros(0), (256, 32, 0))
    assert len(step) == len(nearer) == len(farther) == 0


# ---- which trees ----------------------------------------------------------------------------------------------------


@dataclass(eq=False)
class Paper:
    """Stands for a drawing where nothing is drawn."""

    name: str
    blended: bool = False
    rows: list[Floats] = field(default_factory=list)


def kind(*names: str, rungs: Sequence[int] = (0,), blended: Sequence[bool] = (), size: float = 1.0) -> Kind:
    center, radius = bounding_sphere(TREE)
    blends = [*blended, *[False] * len(names)]
    papers = tuple(Paper(name, blend) for name, blend in zip(names, blends, strict=False))
    return Kind(center * size, radius * size, papers, tuple(rungs))  # type: ignore[arg-type]


def forest_of(trees: int, seed: int = 0, *, species: int = 1, cell: float = 3.0) -> Forest:
    sizes = dict.fromkeys("abc"[:species], TREE.bounds)
    return scatter(sizes, ForestSettings(trees=trees, seed=seed, cell=cell))


def look(place: Doubles, azimuth: float, elevation: float, aspect: float = 1.0, far: float = 60.0) -> View:
    return looking(
        turn_to(elevation, azimuth), place, 1 / math.tan(math.radians(FIELD / 2)), (0.05, far), 128, 0, aspect
    )


def in_view(view: View, points: Doubles) -> np.ndarray:
    clip = np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1) @ view.to_clip.T
    return np.asarray((np.abs(clip[..., :3]) <= clip[..., 3:]).all(axis=-1))


def points_of(forest: Forest) -> Doubles:
    """Points all over the part of each tree's sphere that lies in its own box: (n, k, 3)."""
    center, radius = bounding_sphere(TREE)
    spread = np.random.default_rng(5).normal(size=(400, 3))
    ball = center + radius * spread / np.linalg.norm(spread, axis=1, keepdims=True)
    inside = np.clip(ball, *TREE.bounds.astype(np.float64))
    inside = np.concatenate([inside, TREE.positions])
    return np.stack([Grove(forest.places, forest.turns).where(point) for point in inside], axis=1)


WIDE = forest_of(150, 2)
WIDE_POINTS = points_of(WIDE)


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(st.floats(-25, 25), st.floats(0.1, 15), st.floats(-25, 25)).map(np.array),
    st.floats(0, 360),
    st.floats(-30, 89),
    st.sampled_from([0.5, 1.0, 2.0]),
    st.floats(5, 60),
)
def test_no_tree_that_is_in_view_is_dropped(
    place: Doubles, azimuth: float, elevation: float, aspect: float, far: float
) -> None:
    view = look(place, azimuth, elevation, aspect, far)
    one = kind("near")
    trees = Trees.of(WIDE, [one])
    found = seen(view, WIDE, trees)
    assert (np.diff(found) > 0).all()
    true = np.flatnonzero(in_view(view, WIDE_POINTS).any(axis=1))
    assert not set(true) - set(found)


def test_what_lies_behind_beside_and_too_far_away_is_left_out() -> None:
    one = kind("near")
    for cell in (1.0, 50.0):  # by its cell, by its sphere
        forest = forest_of(150, 2, cell=cell)
        found = seen(look(np.array([0.0, 1.0, 0.0]), 180.0, 0.0, far=10.0), forest, Trees.of(forest, [one]))
        x, z = forest.places[found][:, [0, 2]].T
        assert 0 < len(found) < 40
        assert z.min() > -3
        assert z.max() < 13
        assert (np.abs(x) < z + 5).all()
    assert not len(seen(look(np.array([0.0, 500.0, 0.0]), 0.0, 89.0), WIDE, Trees.of(WIDE, [one])))


def test_the_spheres_stand_where_the_trees_do() -> None:
    forest = forest_of(20, 3, species=2)
    kinds = [kind("a"), kind("b", size=2.0)]
    trees = Trees.of(forest, kinds)
    for number in range(20):
        here = kinds[forest.species[number]]
        x, y, z, scale = forest.places[number].astype(np.float64)
        turned = here.center @ turn_to(0.0, math.degrees(forest.turns[number]))
        np.testing.assert_allclose(trees.centers[number], [x, y, z] + scale * turned, atol=1e-5)
        assert trees.radii[number] == pytest.approx(scale * here.radius)


@pytest.mark.parametrize("aspect", [1.0, 2.0])
def test_a_tree_is_as_high_as_its_sphere_wherever_it_is_in_the_picture(aspect: float) -> None:
    forest = Forest(
        ("a",),
        np.zeros(3, np.int32),
        np.array([(0, 0, 0, 1), (0, 0, 10, 1), (8, 0, 14, 2)], np.float32),
        np.zeros(3, np.float32),
        Cells(np.zeros((0, 2, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.int32)),
    )
    ball = Kind(np.zeros(3), 1.0, (), ())
    view = look(np.array([0.0, 0.0, 20.0]), 0.0, 0.0, aspect)
    found = pixels_high(view, Trees.of(forest, [ball]), np.arange(3))
    # At distance d a unit is 64 / tan(FIELD / 2) / d pixels high.
    unit = 64 / math.tan(math.radians(FIELD / 2))
    np.testing.assert_allclose(found, [2 * unit / 20, 2 * unit / 10, 4 * unit / 10], rtol=1e-6)


# ---- what they are drawn with ---------------------------------------------------------------------------------------


def drawn_rows(found: Sequence[Stand]) -> list[tuple[str, tuple[float, ...], float]]:
    """Name of the drawing, place and opacity of everything to be drawn."""
    return [
        (stand.drawing.name, tuple(place), float(opacity))  # type: ignore[attr-defined]
        for stand in found
        for place, opacity in zip(
            stand.grove.places.tolist(),
            np.ones(len(stand.grove.turns)) if stand.grove.opacities is None else stand.grove.opacities,
            strict=True,
        )
    ]


@settings(max_examples=50, deadline=None)
@given(
    st.integers(0, 60),
    st.integers(1, 2),
    st.tuples(st.floats(-15, 15), st.floats(0.1, 15), st.floats(-15, 15)).map(np.array),
    LADDERS,
    st.lists(st.booleans(), min_size=7, max_size=7),
)
def test_every_tree_is_drawn_once_outside_of_changes_and_twice_within(
    count: int, species: int, place: Doubles, rungs: tuple[int, ...], blended: list[bool]
) -> None:
    forest = forest_of(count, 4, species=species)
    kinds = [
        kind(*(f"{name}{rung}" for rung in range(len(rungs))), rungs=rungs, blended=blended) for name in "ab"[:species]
    ]
    trees = Trees.of(forest, kinds)
    view = look(place, 30.0, 10.0)
    chosen = seen(view, forest, trees)
    found = stands(view, trees, chosen, kinds)
    assert all(len(stand.grove.turns) for stand in found)
    rows = drawn_rows(found)
    assert len(set(rows)) == len(rows)
    heights = pixels_high(view, trees, chosen)
    shares = visible(heights, rungs) if len(chosen) else np.zeros((0, len(rungs)))
    wanted = {
        ("ab"[forest.species[tree]] + str(rung), tuple(forest.places[tree].tolist()), float(np.float32(share[rung])))
        for tree, share in zip(chosen, shares, strict=True)
        for rung in np.flatnonzero(share)
    }
    assert {(name, at, opacity) for name, at, opacity in rows if opacity > 0} == {row for row in wanted if row[2] > 0}


def test_a_turn_stays_with_its_tree() -> None:
    forest, one = forest_of(40, 5), kind("near", "far", rungs=(30, 0))
    trees = Trees.of(forest, [one])
    view = look(np.array([0.0, 1.0, 12.0]), 0.0, 0.0)
    turns = {tuple(place): turn for place, turn in zip(forest.places.tolist(), forest.turns, strict=True)}
    found = stands(view, trees, seen(view, forest, trees), [one])
    assert len(found) == 2
    for stand in found:
        for place, turn in zip(stand.grove.places.tolist(), stand.grove.turns, strict=True):
            assert turns[tuple(place)] == turn


def test_of_two_blended_species_the_farther_shells_come_first() -> None:
    forest = forest_of(120, 6, species=2)
    kinds = [kind("a", blended=[True]), kind("b", blended=[True])]
    trees = Trees.of(forest, kinds)
    eye = np.array([0.0, 1.0, 20.0])
    found = stands(look(eye, 0.0, 0.0), trees, np.arange(120), kinds)
    assert {stand.drawing.name for stand in found} == {"a", "b"}  # type: ignore[attr-defined]
    away = [np.linalg.norm(stand.grove.where(kinds[0].center) - eye, axis=1) for stand in found]
    assert len(found) > 6
    for farther, nearer in pairwise(away):
        assert nearer.max() < 1.25 * farther.min() * (1 + 1e-6)
    assert sum(len(each) for each in away) == 120


def test_solid_trees_of_a_rung_and_blended_ones_of_one_species_need_one_call() -> None:
    for blended in (False, True):
        forest = forest_of(120, 6)
        one = kind("a", blended=[blended])
        trees = Trees.of(forest, [one])
        found = stands(look(np.array([0.0, 1.0, 20.0]), 0.0, 0.0), trees, np.arange(120), [one])
        assert len(found) == 1


def test_no_tree_in_view_is_no_stand() -> None:
    forest = forest_of(0)
    kinds = [kind("a")]
    trees = Trees.of(forest, kinds)
    view = look(np.array([0.0, 1.0, 20.0]), 0.0, 0.0)
    chosen = seen(view, forest, trees)
    assert chosen.dtype == np.intp
    assert len(chosen) == 0
    assert stands(view, trees, chosen, kinds) == []


# ---- the path -------------------------------------------------------------------------------------------------------


def planted(*ground: tuple[float, float], scale: float = 1.0) -> Forest:
    """Trees that stand at these x and z, in a cell of their own each."""
    count = len(ground)
    places = np.array([(x, 0.0, z, scale) for x, z in ground], np.float32).reshape(-1, 4)
    bounds = np.stack([places[:, :3] - 3 * scale, places[:, :3] + 3 * scale], axis=1).reshape(-1, 2, 3)
    numbers: Ints = np.arange(count, dtype=np.int32)
    cells = Cells(bounds.astype(np.float32), numbers, np.ones(count, np.int32))
    return Forest(("a",), np.zeros(count, np.int32), places, np.zeros(count, np.float32), cells)


@pytest.mark.parametrize("frames", [2, 3, 10, 25])
@pytest.mark.parametrize("trees", [0, 1, 80])
def test_a_path_has_its_frames_half_of_them_walked(trees: int, frames: int) -> None:
    eyes = path(forest_of(trees), np.full(trees, 4.0), 1.2, frames, FIELD)
    assert len(eyes) == frames
    walked = [eye for eye in eyes if eye.elevation == 0]
    assert len(walked) == (frames + 1) // 2
    assert all(np.isfinite(eye.place).all() for eye in eyes)
    assert len({tuple(eye.place) for eye in eyes}) == frames


@pytest.mark.parametrize("trees", [0, 1, 80])
def test_the_walk_is_at_eye_level_from_the_edge_to_the_middle(trees: int) -> None:
    forest = forest_of(trees)
    heights = np.linspace(3.0, 5.0, trees)
    eyes = path(forest, heights, 1.2, 20, FIELD)[:10]
    edge = np.linalg.norm(forest.places[:, [0, 2]], axis=1).max(initial=0.0) + 1.2
    median = np.median(heights) if trees else 1.0
    np.testing.assert_allclose([eye.place[1] for eye in eyes], 0.17 * median)
    np.testing.assert_allclose([eye.place[2] for eye in eyes], np.linspace(edge, 0, 10), atol=1e-6)
    assert len({eye.place[0] for eye in eyes}) == 1
    assert abs(eyes[0].place[0]) <= 2.4 + 1e-9


def test_the_lane_keeps_clear_of_a_trunk_on_the_middle_line() -> None:
    eyes = path(planted((0.0, 5.0), (9.0, 0.0)), np.full(2, 4.0), 1.0, 10, FIELD)
    assert abs(eyes[0].place[0]) >= 1.0
    # As far as it can from both: between two trunks, in the middle of the wider gap.
    eyes = path(planted((-1.5, 5.0), (-0.5, 2.0), (1.5, 1.0)), np.full(3, 4.0), 1.0, 10, FIELD)
    assert eyes[0].place[0] == pytest.approx(0.5, abs=0.06)
    # What is not on the way does not count.
    for beside in ((0.0, -5.0), (30.0, 5.0)):
        eyes = path(planted((-2.0, 5.0), (2.0, 5.0), beside), np.full(3, 4.0), 1.0, 10, FIELD)
        assert eyes[0].place[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("aspect", [1.0, 4 / 3])
@pytest.mark.parametrize(
    "forest",
    [
        planted((0.0, 0.0)),
        forest_of(3, 1),
        forest_of(30, 1),
        forest_of(200, 1),
    ],
    ids=["one at the origin", "3", "30", "200"],
)
def test_the_flight_ends_where_all_trees_are_seen_whole(forest: Forest, aspect: float) -> None:
    one, trees = kind("a"), len(forest.turns)
    spheres = Trees.of(forest, [one])
    reach = float(spheres.radii.max())
    last = path(forest, 2 * spheres.radii, reach, 12, FIELD)[-1]
    view = view_of(last, (round(240 * aspect), 240), FIELD, (0.1, 500.0))
    assert last.elevation == 40
    points = np.stack([spheres.grove.where(point) for point in TREE.positions.astype(np.float64)], axis=1)
    assert in_view(view, points).all()
    assert len(seen(view, forest, spheres)) == trees


def test_the_flight_looks_at_the_middle_in_the_end() -> None:
    forest = forest_of(50)
    last = path(forest, np.full(50, 4.0), 1.2, 12, FIELD)[-1]
    x, y, _, w = view_of(last, (320, 240), FIELD, (0.1, 500.0)).to_clip @ [0.0, 0.0, 0.0, 1.0]
    assert w > 0
    assert abs(x / w) < 1e-6
    assert abs(y / w) < 1e-6


def test_a_view_of_the_path_is_as_wide_as_its_window_and_moves_by_pixels() -> None:
    eye = path(planted((0.0, -5.0)), np.full(1, 4.0), 1.0, 4, FIELD)[0]
    views = [view_of(eye, (320, 240), FIELD, (0.1, 100.0), shift) for shift in (0.0, 1.0)]
    assert views[0].window == (320, 240)
    ahead = eye.place + np.array([[0, 0, -10.0], [0, 10 * math.tan(math.radians(FIELD / 2)), -10.0]])
    clip = [np.column_stack([ahead, np.ones(2)]) @ view.to_clip.T for view in views]
    place, moved = (each[:, :2] / each[:, 3:] for each in clip)
    np.testing.assert_allclose(place, [(0, 0), (0, 1)], atol=1e-9)
    np.testing.assert_allclose((moved - place) * (160, 120), [(1, 0), (1, 0)], atol=1e-9)
