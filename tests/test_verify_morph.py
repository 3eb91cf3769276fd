"""What is seen where one level goes over into the next, on cards whose answer is known."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import quad, small_tree

from treebake.errors import SettingsError
from treebake.model import Material, Mesh, Morph
from treebake.verify import VerifySettings, as_dict, cameras, format_table, morphings, verify, write_report

TREE = small_tree()
VIEWS = cameras(TREE, (0.0,), 2)
GREEN = Material("leaf", base_color=(0.1, 0.5, 0.1, 1.0), double_sided=True)


def moved(mesh: Mesh, by: float) -> Mesh:
    return replace(mesh, positions=mesh.positions + np.array((0, by, 0), np.float32))


def into(mesh: Mesh, other: Mesh) -> Mesh:
    return replace(mesh, morph=Morph(other.positions, other.normals))


def test_a_morph_that_arrives_leaves_no_jump() -> None:
    low = quad(GREEN, x=(-0.5, 0.5), y=(0.5, 1.5))
    high = moved(low, 0.6)
    (found,) = morphings(TREE, [(into(low, high), 32), (high, 0)], VIEWS, 4, None)
    assert (found.level, found.height, found.steps) == (0, 32, 4)
    assert found.last == 0
    assert 0 < found.step < found.jump


def test_more_steps_are_smaller() -> None:
    low = quad(GREEN, x=(-0.5, 0.5), y=(0.5, 1.5))
    levels = [(into(low, moved(low, 0.6)), 64), (low, 0)]
    (one,), (eight,) = (morphings(TREE, levels, VIEWS, steps, None) for steps in (1, 8))
    assert eight.step < 0.5 * one.step
    assert one.step == one.last > 0  # there, and back to where it came from


def test_levels_without_a_morph_jump() -> None:
    low = quad(GREEN, x=(-0.5, 0.5), y=(0.5, 1.5))
    near, far = morphings(TREE, [(low, 64), (moved(low, 0.3), 32), (moved(low, 0.6), 0)], VIEWS, 2, None)
    assert (near.step, far.step) == (0, 0)
    assert near.last == near.jump > 0
    assert (near.level, far.level) == (0, 1)


def test_one_level_has_no_next() -> None:
    assert morphings(TREE, [(TREE, 0)], VIEWS, 2, None) == ()


@pytest.mark.parametrize("value", [-1, 65])
def test_steps_out_of_range_are_named(value: int) -> None:
    with pytest.raises(SettingsError, match=r"verify\.morph: 0 to 64"):
        verify(TREE, TREE, VerifySettings(morph=value))


def test_the_report_tells(tmp_path: Path) -> None:
    low = quad(GREEN, x=(-0.5, 0.5), y=(0.5, 1.5))
    found = morphings(TREE, [(into(low, moved(low, 0.6)), 32), (low, 0)], VIEWS, 2, None)
    report = replace(verify(TREE, TREE, VerifySettings(heights=(16,), elevations=(0.0,), azimuths=1)), morphs=found)
    (told,) = as_dict(report)["morphs"]
    assert (told["height"], told["step"]) == (32, round(found[0].step, 5))
    assert "level 0 into 1 at 32 px, FLIP over floor: largest of 2 steps" in format_table({"cloud": report})
    write_report({"cloud": report}, tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["cloud"]["morphs"] == [told]
