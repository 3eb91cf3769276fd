"""Once round a tree: brightness, and steps from frame to frame."""

from dataclasses import replace

import pytest
from synthetic import small_tree

from treebake.errors import SettingsError
from treebake.model import Material, Mesh
from treebake.verify import VerifySettings, as_dict, format_table, verify
from treebake.verify.turn import Turn, turn

TREE = small_tree()


def once_round(candidate: Mesh, frames: int = 8) -> Turn:
    done: list[int] = []
    found = turn(TREE, candidate, None, 48, frames, done.append)
    assert sum(done) == frames
    return found


def tinted(factor: float) -> Mesh:
    def dark(material: Material) -> Material:
        r, g, b, a = material.base_color
        return replace(material, base_color=(r * factor, g * factor, b * factor, a))

    return replace(TREE, materials=tuple(map(dark, TREE.materials)))


def test_the_source_itself_is_as_bright_and_steps_alike() -> None:
    found = once_round(TREE)
    assert found.brightness == pytest.approx(1, abs=0.02)
    assert found.brightness_worst == pytest.approx(1, abs=0.05)
    assert found.step == pytest.approx(1, abs=0.1)


def test_a_darker_tree_is_told() -> None:
    found = once_round(tinted(0.5))
    assert found.brightness < 0.95
    assert found.brightness_worst <= found.brightness


def test_a_tree_that_is_gone_neither_glows_nor_steps() -> None:
    found = once_round(TREE.select(TREE.face_material < 0))
    assert found.brightness != pytest.approx(1, abs=0.05)  # the background
    assert found.step == 0


def test_the_report_tells_of_it_only_where_it_was_asked_for() -> None:
    settings = VerifySettings(heights=(32,), elevations=(0.0,), azimuths=1)
    without = verify(TREE, TREE, settings)
    assert (without.turn, as_dict(without)["turn"]) == (None, None)
    asked = verify(TREE, TREE, replace(settings, turn=48, frames=4))
    assert asked.turn is not None
    assert as_dict(asked)["turn"]["frames"] == 4
    assert "once round at 48 px, cloud: brightness" in format_table({"cloud": asked})


@pytest.mark.parametrize(("name", "value"), [("turn", 5), ("turn", 4096), ("frames", 1)])
def test_a_turn_out_of_range_is_named(name: str, value: int) -> None:
    with pytest.raises(SettingsError, match=f"verify.{name}: "):
        verify(TREE, TREE, replace(VerifySettings(turn=64), **{name: value}))


def test_a_quick_run_says_that_it_does_not_walk_round(caplog: pytest.LogCaptureFixture) -> None:
    found = verify(TREE, TREE, VerifySettings(turn=64, quick=True, azimuths=3, elevations=(0.0,)))
    assert found.turn is None
    assert "does not walk round" in caplog.text
