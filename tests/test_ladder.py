"""Which representation is drawn at which height, and the one that is kept within a budget."""

import logging
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from importlib import import_module
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from stems import empty
from synthetic import joined, small_tree

from treebake import cli
from treebake.asset import Asset, Rung, read_asset, write_asset
from treebake.errors import BudgetError, InputError, SettingsError
from treebake.meshes import read_mesh
from treebake.model import BakedLevel, BakedTree, BillboardCloud, Material, Mesh
from treebake.verify import BudgetSettings, LadderSettings, ladder, smallest
from treebake.verify.cost import cost_of
from treebake.verify.drawn_as import Candidate, candidates, drawn_as

TREE = small_tree()
NOTHING = empty()
FEW = LadderSettings(heights=(128, 64, 32), elevations=(0.0,), azimuths=2)
LADDER, BUDGET = (import_module(f"treebake.verify.{name}") for name in ("ladder", "budget"))


def tinted(factor: float) -> Mesh:
    """The tree, darker: 0.5 is seen at all heights of FEW, 0.3 more so; 0.9 not below 100 pixels."""

    def dark(material: Material) -> Material:
        r, g, b, a = material.base_color
        return replace(material, base_color=(r * factor, g * factor, b * factor, a))

    return replace(TREE, materials=tuple(map(dark, TREE.materials)))


LEAFLESS = TREE.select(TREE.face_node != 3)  # one leaf less: seen at 128 pixels and not at 64
TWICE = joined(TREE, TREE)  # looks as the tree does, for twice the work


def offered(monkeypatch: pytest.MonkeyPatch, *meshes: Mesh) -> tuple[Candidate, ...]:
    """Let these be what an asset can be drawn as, named by their numbers."""
    found = tuple(Candidate(f"no. {number}", f"{number}.glb", None, mesh, None) for number, mesh in enumerate(meshes))
    for module in (LADDER, BUDGET):
        monkeypatch.setattr(module, "candidates", lambda _: found)
    return found


@pytest.fixture(autouse=True)
def _few_views(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BUDGET, "_ELEVATIONS", FEW.elevations)
    monkeypatch.setattr(BUDGET, "_AZIMUTHS", FEW.azimuths)


@pytest.fixture
def asset(tmp_path: Path) -> Asset:
    """A small tree with a coarser level, which the tests that offer other candidates do not look at."""
    nothing = BillboardCloud(NOTHING, np.zeros(0, np.int32))
    far = BakedLevel(nothing, TREE.select(TREE.face_node < 2), 100, 1.0)
    write_asset(BakedTree("oak", nothing, None, TREE, TREE.triangles, TREE.bounds, levels=(far,)), tmp_path / "oak")
    return read_asset(tmp_path / "oak")


# ---- what is chosen -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_what_equals_the_source_for_the_least_work_is_the_one_rung(
    monkeypatch: pytest.MonkeyPatch, asset: Asset, order: tuple[int, ...]
) -> None:
    found = offered(monkeypatch, *((TREE, TWICE, NOTHING)[i] for i in order))
    made = ladder(asset, TREE, FEW)
    (rung,) = made.rungs
    own = found[order.index(0)]
    assert (rung.representation, rung.file, rung.min_height, rung.flip_ratio) == (own.representation, own.file, 0, 0.0)
    assert (rung.triangles, rung.gpu_bytes) == (cost_of(TREE).triangles, cost_of(TREE).gpu_bytes)
    reasons = {left.representation: left.reason for left in made.left_out}
    assert set(reasons) == {each.representation for each in found} - {own.representation}
    assert reasons[found[order.index(1)].representation] == "others were invisible for less work at every height"
    assert "seen where it would have been less work" in reasons[found[order.index(2)].representation]


def test_each_is_drawn_down_to_where_a_cheaper_one_is_as_good(monkeypatch: pytest.MonkeyPatch, asset: Asset) -> None:
    offered(monkeypatch, NOTHING, LEAFLESS, TREE)
    made = ladder(asset, TREE, FEW)
    assert [(rung.representation, rung.min_height) for rung in made.rungs] == [("no. 2", 64), ("no. 1", 0)]
    assert made.rungs[0].flip_ratio == 0
    assert 0 < made.rungs[1].flip_ratio <= 1
    assert [left.representation for left in made.left_out] == ["no. 0"]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_where_nothing_is_invisible_the_least_different_one_is_drawn(
    monkeypatch: pytest.MonkeyPatch, asset: Asset, order: tuple[int, int]
) -> None:
    offered(monkeypatch, *((tinted(0.7), NOTHING)[i] for i in order))
    (rung,) = ladder(asset, TREE, replace(FEW, heights=(64,))).rungs
    assert rung.representation == f"no. {order.index(0)}"
    assert rung.flip_ratio > 1


def test_where_nothing_is_near_invisible_at_any_height_too(monkeypatch: pytest.MonkeyPatch, asset: Asset) -> None:
    offered(monkeypatch, NOTHING, tinted(0.5))
    made = ladder(asset, TREE, FEW)
    assert [(rung.representation, rung.min_height) for rung in made.rungs] == [("no. 1", 0)]


def test_what_shows_nothing_is_never_chosen_beside_what_shows_the_tree(
    monkeypatch: pytest.MonkeyPatch, asset: Asset
) -> None:
    for other in (TREE, TWICE, LEAFLESS):
        offered(monkeypatch, other, NOTHING)
        made = ladder(asset, TREE, replace(FEW, heights=(64, 16)))
        assert {rung.representation for rung in made.rungs} == {"no. 0"}


def test_the_levels_take_over_where_they_are_no_worse(monkeypatch: pytest.MonkeyPatch, asset: Asset) -> None:
    levels = (TREE, LEAFLESS, tinted(0.5))
    found = tuple(Candidate("cloud", f"{number}.glb", number, mesh, None) for number, mesh in enumerate(levels))
    monkeypatch.setattr(LADDER, "candidates", lambda _: found)
    assert ladder(asset, TREE, FEW).level_heights == (64, 32, 0)  # the last is seen even at the least height
    monkeypatch.setattr(LADDER, "candidates", lambda _: found[:1])
    assert ladder(asset, TREE, FEW).level_heights == (0,)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("heights", ()),
        ("heights", (64, 128)),
        ("heights", (64, 64)),
        ("heights", (64, 52)),  # one change would begin before the other is over
        ("heights", (4096, 64)),
        ("heights", (64, 4)),
        ("elevations", ()),
        ("elevations", (0.0, 95.0)),
        ("azimuths", 0),
    ],
)
def test_a_setting_of_the_ladder_out_of_range_is_named(asset: Asset, name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=rf"^\[ladder\] {name} is .*; it must be ") as raised:
        ladder(asset, TREE, replace(FEW, **{name: value}))
    assert "\n" not in str(raised.value)


# ---- of a baked tree ------------------------------------------------------------------------------------------------

QUICK = (
    *("ladder.enabled=false", "slicings.enabled=false", "textures.atlas=128", "textures.supersample=1"),
    *("indirect.leaf_texels=16", "indirect.far_texels=1", "views.texels=48", "views.supersample=1", "views.layers=1"),
)


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Asset, Mesh]]:
    """A grown shrub, baked in a hurry."""
    folder = tmp_path_factory.mktemp("ladder")
    settings = [item for each in QUICK for item in ("--set", each)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
        for arguments in (
            ["grow", "shrub", "--leaves", "60", "-o", str(folder / "a.glb")],
            ["bake", str(folder / "a.glb"), "-o", str(folder), "--billboards", "4", "-q", *settings],
        ):
            patch.setattr("sys.argv", ["treebake", *arguments])
            with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said, pytest.raises(SystemExit) as left:
                cli.main()
            assert not left.value.code, said.getvalue()
        yield read_asset(folder / "a"), read_mesh(folder / "a.glb")


def test_everything_that_an_asset_holds_is_a_candidate(grown: tuple[Asset, Mesh]) -> None:
    asset, _ = grown
    found = candidates(asset)
    levels = [("cloud", number) for number in range(len(asset.manifest.levels))]
    assert [(each.representation, each.level) for each in found] == [
        ("leaves", None),
        ("indirect", None),
        ("views", None),
        *levels,
    ]
    for each in found:
        assert (asset.folder / each.file).is_file()
        again = drawn_as(asset, each.representation, each.level)
        assert (again.file, cost_of(again.mesh, again.layers)) == (each.file, cost_of(each.mesh, each.layers))
        assert (each.layers is None) == (each.representation == "cloud")
    # What layers take the place of is not drawn beside them.
    leaves, indirect, views, *clouds = found
    assert leaves.mesh.triangles == indirect.mesh.triangles < clouds[0].mesh.triangles
    assert views.mesh.triangles == 0


def test_a_ladder_of_a_baked_tree_holds_together(grown: tuple[Asset, Mesh]) -> None:
    asset, source = grown
    few = LadderSettings(heights=(96, 48, 24, 12), elevations=(0.0,), azimuths=1)
    made = ladder(asset, source, few)
    heights = [rung.min_height for rung in made.rungs]
    assert heights == sorted(heights, reverse=True)
    assert len(set(heights)) == len(heights)
    assert heights[-1] == 0
    assert set(heights[:-1]) <= set(few.heights)
    assert len(made.level_heights) == len(asset.manifest.levels)
    assert list(made.level_heights) == sorted(made.level_heights, reverse=True)
    assert made.level_heights[-1] == 0
    costs = {(each.representation, each.level): cost_of(each.mesh, each.layers) for each in candidates(asset)}
    for rung in made.rungs:
        assert (asset.folder / rung.file).is_file()
        cost = costs[rung.representation, rung.level]
        assert (rung.triangles, rung.gpu_bytes) == (cost.triangles, cost.gpu_bytes)
        assert rung.flip_ratio >= 0
    on = {(rung.representation, rung.level) for rung in made.rungs}
    off = {(left.representation, left.level) for left in made.left_out}
    assert on | off == set(costs)
    assert not on & off
    assert all(left.reason and "\n" not in left.reason for left in made.left_out)
    assert all((asset.folder / left.file).is_file() for left in made.left_out)
    assert made == ladder(asset, source, few)


def test_a_damaged_level_is_named(asset: Asset) -> None:
    asset.level_paths[1].write_bytes(asset.level_paths[1].read_bytes()[:50])
    with pytest.raises(InputError, match=asset.level_paths[1].name):
        ladder(asset, TREE, FEW)


# ---- within a budget ------------------------------------------------------------------------------------------------

AT_64 = BudgetSettings(height=64)


def picked(asset: Asset, settings: BudgetSettings) -> tuple[Rung, list[tuple[str, float]]]:
    """What was found, and what was drawn for it."""
    told: list[tuple[str, float]] = []

    class Remember(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            told.append(record.args[:2])  # type: ignore[index, arg-type]

    handler, log = Remember(), BUDGET.LOG
    before = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        return smallest(asset, TREE, settings), told
    finally:
        log.removeHandler(handler)
        log.setLevel(before)


def test_the_smallest_that_is_invisible_is_found_smallest_first(monkeypatch: pytest.MonkeyPatch, asset: Asset) -> None:
    offered(monkeypatch, TWICE, TREE, NOTHING, LEAFLESS)
    rung, told = picked(asset, AT_64)
    assert [name for name, _ in told] == ["no. 2", "no. 3"]  # no bigger one is drawn once one is invisible
    assert told[0][1] > 1 >= told[1][1]
    assert (rung.representation, rung.file, rung.level, rung.min_height) == ("no. 3", "3.glb", None, 0)
    assert rung.flip_ratio == round(told[1][1], 4)
    assert (rung.triangles, rung.gpu_bytes) == (LEAFLESS.triangles, cost_of(LEAFLESS).gpu_bytes)


@pytest.mark.parametrize("cap", ["triangles", "bytes"])
def test_what_is_beyond_a_cap_is_not_looked_at(monkeypatch: pytest.MonkeyPatch, asset: Asset, cap: str) -> None:
    offered(monkeypatch, TREE, LEAFLESS, TWICE, NOTHING)
    size = {"triangles": lambda mesh: mesh.triangles, "bytes": lambda mesh: cost_of(mesh).gpu_bytes}[cap]
    within = replace(AT_64, height=256, **{cap: size(LEAFLESS)})  # where only the whole tree is invisible
    rung, told = picked(asset, within)
    assert [name for name, _ in told] == ["no. 3", "no. 1"]
    assert rung.representation == "no. 1"
    assert rung.flip_ratio > 1  # the least that differs, told as it is
    assert picked(asset, replace(within, **{cap: size(TREE)}))[0].representation == "no. 0"
    assert picked(asset, replace(within, **{cap: size(TREE) - 1}))[0].representation == "no. 1"


def test_nothing_within_the_caps_names_the_smallest(monkeypatch: pytest.MonkeyPatch, asset: Asset) -> None:
    offered(monkeypatch, TWICE, TREE)
    cost = cost_of(TREE)
    for settings in (replace(AT_64, triangles=3), replace(AT_64, bytes=100), replace(AT_64, triangles=3, bytes=100)):
        with pytest.raises(BudgetError) as raised:
            smallest(asset, TREE, settings)
        assert str(raised.value) == (
            f"nothing of oak is within [budget] triangles = {settings.triangles}, bytes = {settings.bytes}; "
            f"the smallest has {cost.triangles:,} triangles and {cost.gpu_bytes:,} bytes"
        )


def test_a_cloud_that_moves_its_leaves_too_far_is_not_drawn(monkeypatch: pytest.MonkeyPatch, asset: Asset) -> None:
    pixel = 2 * 1.45 / 64  # of the sphere's radius; half a pixel more or less does not matter here

    def moved(*pixels: float) -> None:
        meshes = ((n, mesh, away * pixel) for n, (mesh, away) in enumerate(zip((TREE, LEAFLESS), pixels, strict=True)))
        found = tuple(Candidate("cloud", f"{n}.glb", n, mesh, None, away) for n, mesh, away in meshes)
        monkeypatch.setattr(BUDGET, "candidates", lambda _: found)

    moved(0.0, 1.0)
    assert picked(asset, AT_64)[0].level == 1
    # A pixel is smaller where the tree is higher.
    assert picked(asset, replace(AT_64, height=256))[0].level == 0
    moved(0.0, 4.0)
    rung, told = picked(asset, AT_64)
    assert (rung.level, len(told)) == (0, 1)
    # Where all move their leaves too far they are drawn all the same.
    moved(9.0, 9.0)
    assert picked(asset, AT_64)[0].level == 1


def test_where_nothing_is_invisible_it_is_for_the_caller_to_say_so(
    monkeypatch: pytest.MonkeyPatch, asset: Asset, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    offered(monkeypatch, NOTHING, tinted(0.3), tinted(0.5))
    with caplog.at_level(logging.WARNING):
        rung, told = picked(asset, AT_64)
    assert rung.representation == "no. 2"
    assert rung.flip_ratio > 1
    assert len(told) == 3
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("name", "value"),
    [("height", 0), ("height", 15), ("height", 4096), ("triangles", -1), ("bytes", -1)],
)
def test_a_setting_of_the_budget_out_of_range_is_named(asset: Asset, name: str, value: int) -> None:
    with pytest.raises(SettingsError, match=rf"^\[budget\] {name} is {value}; it must be "):
        smallest(asset, TREE, replace(AT_64, **{name: value}))


def test_a_baked_tree_within_a_budget(grown: tuple[Asset, Mesh]) -> None:
    asset, source = grown
    costs = [cost_of(each.mesh, each.layers) for each in candidates(asset)]
    least = min(cost.gpu_bytes for cost in costs)
    rung = smallest(asset, source, BudgetSettings(height=24, bytes=least))
    assert rung.gpu_bytes == least
    with pytest.raises(BudgetError, match=f"bytes = {least - 1}; the smallest has .* and {least:,} bytes"):
        smallest(asset, source, BudgetSettings(height=24, bytes=least - 1))
