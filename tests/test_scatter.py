"""Scattered trees keep their distance, lie in their cells, and are the same again for the same seed."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from treebake.errors import SettingsError
from treebake.model import Forest
from treebake.settings import load_settings
from treebake.stages.scatter import ForestSettings, scatter

OAK = np.array([(-3, -0.1, -2), (5, 9, 2)], np.float32)  # 8 wide, beside its origin
BIRCH = np.array([(-1, 0, -1), (1, 12, 1.5)], np.float32)
BOTH = {"oak": OAK, "birch": BIRCH}


def arrays(forest: Forest) -> list[np.ndarray]:
    return [forest.species, forest.places, forest.turns, *astuple(forest.cells)]


def corners(box: np.ndarray) -> np.ndarray:
    x, y, z = box.T.astype(np.float64)
    return np.stack(np.meshgrid(x, y, z), axis=-1).reshape(-1, 3)


def distances(forest: Forest) -> np.ndarray:
    ground = forest.places[:, [0, 2]]
    return cKDTree(ground).query(ground, 2)[0][:, 1]


@pytest.mark.parametrize("trees", [0, 1, 2, 100_000])
def test_there_are_as_many_as_asked_for_each_in_one_cell(trees: int) -> None:
    forest = scatter(BOTH, ForestSettings(trees=trees))
    assert forest.species.shape == forest.turns.shape == (trees,)
    assert forest.places.shape == (trees, 4)
    assert [values.dtype.str[1:] for values in arrays(forest)] == ["i4", "f4", "f4", "f4", "i4", "i4"]
    cells = forest.cells
    assert (cells.count > 0).all()
    assert np.array_equal(np.append(cells.first, trees), np.cumsum([0, *cells.count]))
    assert len(cells.bounds) == len(cells.first) <= 600
    assert forest.names == ("oak", "birch")


@settings(max_examples=60, deadline=None)
@given(
    trees=st.integers(0, 200),
    seed=st.integers(0, 2**32),
    spacing=st.floats(0.05, 20),
    cell=st.floats(1, 40),
    unit=st.sampled_from([0.01, 1.0, 100.0]),
    shift=st.floats(-30, 30),
)
def test_every_tree_lies_in_its_cell_and_keeps_its_distance(
    trees: int, seed: int, spacing: float, cell: float, unit: float, shift: float
) -> None:
    sizes = {"oak": OAK * np.float32(unit), "birch": (BIRCH + np.float32([shift, 0, 0])) * np.float32(unit)}
    forest = scatter(sizes, ForestSettings(trees=trees, seed=seed, spacing=spacing, cell=cell))
    for bounds, first, count in zip(*astuple(forest.cells), strict=True):
        rows = slice(first, first + count)
        assert (np.diff(forest.species[rows]) >= 0).all()  # a run for each species
        for species, place, turn in zip(forest.species[rows], forest.places[rows], forest.turns[rows], strict=True):
            box = Rotation.from_euler("y", float(turn)).apply(corners(sizes[forest.names[species]]))
            placed = box * float(place[3]) + place[:3].astype(np.float64)
            assert (bounds[0] <= placed.min(axis=0)).all()
            assert (placed.max(axis=0) <= bounds[1]).all()
        assert np.ptp(forest.places[rows, ::2][:, :2], axis=0).max() <= cell * spacing * 8 * unit * (1 + 1e-5)
    if trees > 1:
        assert distances(forest).min() >= spacing * 8 * unit * (1 - 1e-5)


def test_trees_stand_close_all_around_the_origin_and_in_no_rows() -> None:
    forest = scatter({"oak": OAK}, ForestSettings(trees=5000, seed=3))
    away = np.hypot(*forest.places[:, [0, 2]].T)
    assert np.pi * away.max() ** 2 / 8**2 / 5000 == pytest.approx(1.8, abs=0.05)  # squares of a spacing per tree
    assert np.median(distances(forest)) < 1.15 * 8
    directions = np.arctan2(forest.places[:, 0], forest.places[:, 2])
    share = np.histogram(directions, 8, (-np.pi, np.pi))[0] / 5000
    assert share == pytest.approx(1 / 8, abs=0.01)
    assert (forest.places[:, 1] == 0).all()


def test_scales_and_turns_are_of_any_amount() -> None:
    forest = scatter(BOTH, ForestSettings(trees=2000, least_scale=0.5, greatest_scale=2.5))
    assert np.histogram(forest.places[:, 3], 4, (0.5, 2.5))[0] == pytest.approx(500, abs=75)
    assert np.histogram(forest.turns, 4, (0, 2 * np.pi))[0] == pytest.approx(500, abs=75)
    same = scatter(BOTH, ForestSettings(trees=20, least_scale=1.5, greatest_scale=1.5))
    assert (same.places[:, 3] == 1.5).all()


def test_species_are_mixed_in_equal_shares_or_by_weight() -> None:
    equal = scatter(BOTH, ForestSettings(trees=4000))
    assert np.bincount(equal.species) == pytest.approx(2000, abs=150)
    weighted = scatter(BOTH, ForestSettings(trees=4000, weights={"oak": 3}))
    assert np.bincount(weighted.species) == pytest.approx([3000, 1000], abs=150)
    assert set(scatter(BOTH, ForestSettings(weights={"oak": 0})).species) == {1}


def test_a_seed_is_a_forest() -> None:
    first, again, other = (scatter(BOTH, ForestSettings(trees=500, seed=seed)) for seed in (1, 1, 2))
    assert [a.tobytes() for a in arrays(first)] == [a.tobytes() for a in arrays(again)]
    assert not np.array_equal(first.places, other.places)


def test_a_tree_in_centimetres_makes_the_same_forest() -> None:
    metres = scatter({"oak": OAK}, ForestSettings(trees=300))
    centimetres = scatter({"oak": OAK * np.float32(100)}, ForestSettings(trees=300))
    assert np.allclose(centimetres.places, metres.places * np.float32([100, 100, 100, 1]), rtol=1e-6)
    assert np.array_equal(centimetres.cells.first, metres.cells.first)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"trees": -1}, r"\[forest\] trees is -1; it must be 0 to 1,000,000"),
        ({"trees": 1_000_001}, "trees is 1000001"),
        ({"seed": -1}, "seed is -1; it must be 0 or more"),
        ({"spacing": 0.0}, "spacing is 0.0; it must be greater than 0"),
        ({"least_scale": 0.0}, "least_scale is 0.0; it must be greater than 0"),
        ({"greatest_scale": 0.5}, "greatest_scale is 0.5; it must be at least least_scale"),
        ({"cell": 0.5}, "cell is 0.5; it must be 1 or more"),
        ({"weights": {"oak": -1.0}}, "weights is {'oak': -1.0}; it must be 0 or more for each species"),
        ({"weights": {"ash": 1.0}}, "weights names ash, which is no species here; there are oak, birch"),
        ({"weights": {"oak": 0.0, "birch": 0.0}}, "weights are all 0"),
    ],
)
def test_settings_out_of_range_are_named(change: dict, says: str) -> None:
    with pytest.raises(SettingsError, match=says):
        scatter(BOTH, replace(ForestSettings(), **change))


def test_weights_can_be_written_in_a_file(tmp_path) -> None:
    (tmp_path / "forest.toml").write_text("[forest]\nweights = { oak = 3, birch = 1.5 }\n")
    assert load_settings([tmp_path / "forest.toml"]).forest.weights == {"oak": 3, "birch": 1.5}
