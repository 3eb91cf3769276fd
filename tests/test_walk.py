"""A walk through a forest, and up to one tree: drawn as its sources, it is no different from them and does not pop."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from stems import empty
from synthetic import small_tree

from treebake.asset import Asset, Rung, read_asset, write_asset
from treebake.errors import AssetError, SettingsError
from treebake.gl.draw import Drawing
from treebake.model import BakedTree, BillboardCloud, Forest, Material, Mesh
from treebake.stages.scatter import ForestSettings, scatter
from treebake.verify import WalkSettings, approach, forest_facts, format_forest, walk, write_forest_report
from treebake.verify.cameras import bounding_sphere
from treebake.verify.drawn_as import Candidate

TREE = small_tree()
NOTHING = empty()
SMALL = WalkSettings(width=96, height=64, frames=6, compared=3)
STANDS = import_module("treebake.verify.stands")


def tinted(factor: float, mesh: Mesh = TREE) -> Mesh:
    def dark(material: Material) -> Material:
        r, g, b, a = material.base_color
        return replace(material, base_color=(r * factor, g * factor, b * factor, a))

    return replace(mesh, materials=tuple(map(dark, mesh.materials)))


def scaled(factor: float) -> Mesh:
    return replace(TREE, positions=TREE.positions * np.float32(factor))


def rungs(*min_heights: int) -> tuple[Rung, ...]:
    return tuple(
        Rung(f"no. {number}", f"{number}.glb", None, height, 0.0, 8, 100 + number)
        for number, height in enumerate(min_heights)
    )


def asset(folder: Path, name: str, *min_heights: int) -> Asset:
    """A published tree with that ladder, whose files `drawn` has something else drawn for."""
    nothing = BillboardCloud(NOTHING, np.zeros(0, np.int32))
    write_asset(BakedTree(name, nothing, None, TREE, TREE.triangles, TREE.bounds), folder / name)
    made = read_asset(folder / name)
    return replace(made, manifest=replace(made.manifest, ladder=rungs(*min_heights)))


def drawn(monkeypatch: pytest.MonkeyPatch, *meshes: Mesh) -> None:
    """Let these be drawn for the rungs of every asset."""

    def one(_: Asset, representation: str, level: int | None = None) -> Candidate:
        number = int(representation.removeprefix("no. "))
        return Candidate(representation, f"{number}.glb", level, meshes[number], None)

    monkeypatch.setattr(STANDS, "drawn_as", one)


def planted(trees: int, *names: str, unit: float = 1.0, seed: int = 3) -> Forest:
    sizes = dict.fromkeys(names or ("oak",), unit * TREE.bounds)
    return scatter(sizes, ForestSettings(trees=trees, seed=seed, cell=3.0))


# ---- a walk ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("heights", [(0,), (24, 0)], ids=["one rung", "changes"])
def test_a_forest_drawn_as_its_source_does_not_differ(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, heights: tuple[int, ...]
) -> None:
    drawn(monkeypatch, TREE, TREE)
    found = walk(planted(25), {"oak": asset(tmp_path, "oak", *heights)}, {"oak": TREE}, SMALL)
    assert found.flip_ratio == 0
    compared = [frame for frame in found.frames if frame.flip is not None]
    assert [frame.flip for frame in compared] == [0, 0, 0]
    assert [frame.flip_ratio for frame in compared] == [0, 0, 0]
    for source, ours in found.samples:
        assert source.shape == (64, 96, 3)
        np.testing.assert_array_equal(source, ours)
        assert np.ptp(source) > 0.1  # there is something to see
    assert found.gpu_bytes == sum(rung.gpu_bytes for rung in rungs(*heights))


def test_what_differs_is_told_and_the_worst_frames_are_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, tinted(0.3))
    found = walk(planted(25), {"oak": asset(tmp_path, "oak", 0)}, {"oak": TREE}, SMALL)
    compared = [frame for frame in found.frames if frame.flip is not None]
    assert all(frame.flip > 0 for frame in compared)  # type: ignore[operator]
    floors = [frame.flip / frame.flip_ratio for frame in compared]  # type: ignore[operator]
    assert found.flip_ratio == pytest.approx(sum(frame.flip for frame in compared) / sum(floors))  # type: ignore[misc]
    assert len(found.samples) == 2
    # Where only far trees are missing the frame that shows them all differs most.
    drawn(monkeypatch, TREE, NOTHING)
    found = walk(planted(25), {"oak": asset(tmp_path, "oak", 24, 0)}, {"oak": TREE}, SMALL)
    source, ours = found.samples[0]
    assert np.ptp(ours, axis=(0, 1)).max() == 0 < np.ptp(source, axis=(0, 1)).min()


def test_a_nearer_rung_is_drawn_near_and_a_farther_one_far(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE, NOTHING)
    forest = planted(25)

    def triangles(*heights: int) -> list[int]:
        found = walk(forest, {"oak": asset(tmp_path, "oak", *heights)}, {"oak": TREE}, SMALL)
        assert [frame.trees for frame in found.frames] == trees
        return [frame.triangles for frame in found.frames]

    trees = [frame.trees for frame in walk(forest, {"oak": asset(tmp_path, "oak", 0)}, {"oak": TREE}, SMALL).frames]
    assert trees[-1] == 25
    assert triangles(1, 0) == [TREE.triangles * count for count in trees]
    assert triangles(4096, 0)[-1] == 0
    # Flown away from, ever fewer are near.
    some = triangles(24, 0)
    assert some[-1] == 0 < some[0]


@pytest.mark.parametrize(("frames", "compared", "which"), [(6, 3, [0, 2, 5]), (5, 1, [0]), (4, 4, [0, 1, 2, 3])])
def test_compared_frames_are_spread_over_all(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, frames: int, compared: int, which: list[int]
) -> None:
    drawn(monkeypatch, TREE)
    told: list[tuple[int, int]] = []
    settings = replace(SMALL, frames=frames, compared=compared)
    found = walk(
        planted(6),
        {"oak": asset(tmp_path, "oak", 0)},
        {"oak": TREE},
        settings,
        progress=lambda done, of: told.append((done, of)),
    )
    assert len(found.frames) == frames
    for number, frame in enumerate(found.frames):
        known = [frame.flip is None, frame.source_milliseconds is None]
        assert known == [number not in which] * 2
    assert told == [(number + 1, frames) for number in range(frames)]
    assert len(found.samples) == min(2, compared)


def test_two_species_are_drawn_with_their_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE)
    assets = {name: asset(tmp_path, name, 0) for name in ("oak", "birch")}
    sources = {"oak": TREE, "birch": tinted(0.2)}
    found = walk(planted(25, "oak", "birch"), assets, sources, SMALL)
    assert found.flip_ratio > 0  # the birches are drawn as oaks
    assert found.frames[-1].trees == 25
    assert found.gpu_bytes == 200
    assert {frame.draw_calls for frame in found.frames} <= {0, 4, 8}  # four materials, once for each species


def test_a_forest_without_trees_is_walked_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE)
    found = walk(planted(0), {"oak": asset(tmp_path, "oak", 0)}, {"oak": TREE}, SMALL)
    assert len(found.frames) == 6
    for frame in found.frames:
        assert (frame.trees, frame.triangles, frame.draw_calls, frame.overdraw) == (0, 0, 0, 0)
    assert found.flip_ratio is None  # there is nothing that could differ
    for figure in (found.worst, found.mean, found.speed_up_worst, found.speed_up_mean):
        assert figure is not None
        assert np.isfinite(figure)
        assert figure > 0
    assert format_forest(found, {"oak": ()}).count("\n") > 6
    write_forest_report(found, {"oak": ()}, tmp_path)
    assert (tmp_path / "forest.png").is_file()
    assert forest_facts(found, {})["frames"][5]["trees"] == 0


def test_without_compared_frames_the_source_is_not_drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE)
    found = walk(planted(6), {"oak": asset(tmp_path, "oak", 0)}, {"oak": TREE}, replace(SMALL, compared=0))
    assert all(frame.flip is None and frame.source_milliseconds is None for frame in found.frames)
    assert (found.flip_ratio, found.speed_up_worst, found.speed_up_mean, found.samples) == (None, None, None, ())
    assert "source: worst" not in format_forest(found, {})
    write_forest_report(found, {}, tmp_path)
    assert not (tmp_path / "forest.png").exists()


def test_the_path_of_another_forest_may_be_walked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE)
    one = {"oak": asset(tmp_path, "oak", 0)}
    small, large = planted(6), planted(60)
    few = replace(SMALL, compared=0)
    own, along, whole = (
        walk(forest, one, {"oak": TREE}, few, along=way)
        for forest, way in ((small, None), (small, large), (large, None))
    )
    assert own.frames[-1].trees == along.frames[-1].trees == 6
    # From where all of the large forest is seen, the small one is farther off.
    assert along.frames[-1].overdraw < 0.7 * own.frames[-1].overdraw
    assert along.frames[-1].overdraw < whole.frames[-1].overdraw


@pytest.mark.parametrize("unit", [0.01, 100.0])
def test_the_unit_does_not_matter(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, unit: float) -> None:
    found = []
    for each in (1.0, unit):
        drawn(monkeypatch, tinted(0.3, scaled(each)))
        found.append(walk(planted(12, unit=each), {"oak": asset(tmp_path, "oak", 0)}, {"oak": scaled(each)}, SMALL))
    for one, other in zip(found[0].frames, found[1].frames, strict=True):
        assert one.trees == other.trees
        assert one.overdraw == pytest.approx(other.overdraw, rel=0.02, abs=0.01)
        if one.flip_ratio is not None:
            assert one.flip_ratio == pytest.approx(other.flip_ratio, rel=0.05)


@pytest.mark.parametrize("unit", [0.1, 50.0])
def test_the_nearest_that_is_seen_goes_by_the_smallest_tree(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, unit: float
) -> None:
    """Else depth is told too coarsely: far off, what is behind would show."""
    seen = []

    def remembered(self: Drawing, view: object, *rest: object) -> None:
        seen.append(view)
        solid(self, view, *rest)  # type: ignore[arg-type]

    solid = Drawing.draw_solid
    source = scaled(unit)
    drawn(monkeypatch, source)
    monkeypatch.setattr(Drawing, "draw_solid", remembered)
    forest = planted(6, unit=unit)
    walk(forest, {"oak": asset(tmp_path, "oak", 0)}, {"oak": source}, SMALL)
    smallest = bounding_sphere(source)[1] * float(forest.places[:, 3].min())
    assert seen
    assert {round(view.near / (0.02 * smallest), 2) for view in seen} == {1.0}


# ---- what is wrong --------------------------------------------------------------------------------------------------


def test_an_asset_without_a_ladder_is_named(tmp_path: Path) -> None:
    assets = {"oak": asset(tmp_path, "oak")}
    with pytest.raises(AssetError) as raised:
        walk(planted(3), assets, {"oak": TREE}, SMALL)
    assert str(raised.value) == f"{tmp_path / 'oak'} has no ladder; bake it with ladder.enabled = true"


def test_a_source_that_is_missing_is_named(tmp_path: Path) -> None:
    assets = {name: asset(tmp_path, name, 0) for name in ("oak", "birch")}
    with pytest.raises(SettingsError) as raised:
        walk(planted(3, "oak", "birch"), assets, {"oak": TREE}, SMALL)
    assert str(raised.value) == "there is no source of birch; name its file with --source, as birch.glb"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("width", 63),
        ("width", 5000),
        ("height", 63),
        ("height", 5000),
        ("field_of_view", 9.0),
        ("field_of_view", 121.0),
        ("frames", 1),
        ("compared", -1),
        ("compared", 7),
    ],
)
def test_a_setting_of_the_walk_out_of_range_is_named(tmp_path: Path, name: str, value: float) -> None:
    with pytest.raises(SettingsError, match=rf"^\[walk\] {name} is {value}; it must be "):
        walk(planted(1), {"oak": asset(tmp_path, "oak", 0)}, {"oak": TREE}, replace(SMALL, **{name: value}))


# ---- walking up to one tree -----------------------------------------------------------------------------------------


def test_changes_between_what_looks_the_same_are_not_seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE, TREE, TREE)
    first, second = approach(asset(tmp_path, "oak", 40, 24, 0), TREE)
    assert (first.height, first.nearer, first.farther) == (40, "no. 0", "no. 1")
    assert (second.height, second.nearer, second.farther) == (24, "no. 1", "no. 2")
    assert first.step == pytest.approx(1, abs=1e-3)
    assert second.step == pytest.approx(1, abs=1e-3)


def test_a_change_between_what_looks_different_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    steps = []
    for factor in (0.9, 0.2):
        drawn(monkeypatch, TREE, tinted(factor))
        (change,) = approach(asset(tmp_path, "oak", 32, 0), TREE)
        steps.append(change.step)
    assert 1 <= steps[0] < steps[1]
    # At once it would be seen more.
    monkeypatch.setattr("treebake.verify.switching.FADE", 1.0001)
    (pop,) = approach(asset(tmp_path, "oak", 32, 0), TREE)
    assert pop.step > 1.1 * steps[1]


def test_one_rung_does_not_change(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn(monkeypatch, TREE)
    assert approach(asset(tmp_path, "oak", 0), TREE) == ()
