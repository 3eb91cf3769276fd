"""`verify --light`: what it finds of a tree beside itself, beside nothing, and beside one that differs in one thing."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from synthetic import joined, quad, small_tree

from treebake.errors import SettingsError
from treebake.images import read_image
from treebake.model import EMPTY_MESH, Material, Mesh
from treebake.verify import (
    Crown,
    LightReport,
    LightSettings,
    cameras,
    check_light,
    format_light,
    in_full_light,
    light_facts,
    pictures_of,
    write_light_report,
)

QUICK = LightSettings(suns=2, shadow_texels=128, azimuths=2, ground=48, hours=3, day_height=32)
LEAVES = Material("leaves", base_color=(0.2, 0.4, 0.1, 1.0), double_sided=True)
TREE = joined(
    small_tree(),
    *(
        quad(LEAVES, x=(x, x + 0.4), y=(y, y + 0.3), z=z)
        for x, y, z in ((-0.5, 0.2, 0.3), (0.1, 0.5, -0.4), (-0.2, 0.6, 0))
    ),
)
CROWN = Crown(TREE, 0.5)


def found(
    candidate: Mesh, source: Mesh = TREE, settings: LightSettings = QUICK, crown: Crown | None = CROWN
) -> LightReport:
    views = cameras(source, (0.0, 40.0), 2)
    return in_full_light(source, crown, candidate, None, 48, views, settings, lambda _more: None)


@cache
def same() -> LightReport:
    return found(TREE)


def test_a_tree_beside_itself_differs_in_nothing() -> None:
    report = same()
    assert report.relit.flip == 0
    assert report.relit.leaf_depth == 0
    assert report.shadows.ground_iou == report.shadows.depth_map_iou == 1
    assert report.shadows.depth_map_cm == 0
    assert report.shadows.self_shadow == report.shadows.source_self_shadow > 0
    assert report.day is not None
    assert (report.day.brightness, report.day.brightness_worst, report.day.flip_ratio) == (1, 1, 0)


def test_nothing_casts_no_shadow_and_sends_no_light() -> None:
    report = found(EMPTY_MESH)
    assert report.shadows.ground_iou == report.shadows.depth_map_iou == 0
    assert report.shadows.depth_map_cm is None
    assert report.relit.leaf_depth is None
    assert report.relit.flip_ratio > 1
    assert report.day is not None
    assert report.day.brightness == 0


def test_an_occluded_sky_is_darker_and_leaves_the_sun_alone() -> None:
    dark = replace(TREE, occlusion=np.full(len(TREE.positions), 0.3, np.float32))
    report = found(dark)
    assert report.day is not None
    assert report.day.brightness < 0.9
    assert report.shadows == same().shadows


def test_a_tree_moved_away_from_the_viewer_is_off_in_depth_and_shadow() -> None:
    moved = replace(TREE, positions=TREE.positions + np.array([0, 0.1, 0], np.float32))
    report = found(moved)
    assert 0.02 < (report.relit.leaf_depth or 0) < 0.5
    assert 0.2 < report.shadows.ground_iou < 0.98
    assert 1 < (report.shadows.depth_map_cm or 0) < 20


def test_a_tree_without_leaves_has_no_leaf_depth() -> None:
    assert found(TREE, crown=None).relit.leaf_depth is None


def test_a_flat_tree_and_one_sun_are_enough() -> None:
    flat = replace(TREE, positions=TREE.positions * np.array([1, 1, 0], np.float32))
    report = found(flat, flat, replace(QUICK, suns=1, azimuths=1, hours=0, elevation=90.0))
    assert report.relit.flip == 0
    assert report.day is None
    assert np.isfinite(report.shadows.ground_iou)


def test_progress_ends_at_the_number_of_pictures() -> None:
    told: list[int] = []
    views = cameras(TREE, (0.0,), 3)
    in_full_light(TREE, CROWN, TREE, None, 32, views, QUICK, told.append)
    assert sum(told) == pictures_of(3, QUICK) == 3 + 2 + 3


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("suns", 0),
        ("heights", {"cloud": 8}),
        ("heights", {"clouds": 64}),
        ("directions", 7),
        ("shadow_texels", 32),
        ("elevation", 0.0),
        ("azimuths", 0),
        ("ground", 8),
        ("hours", -1),
        ("day_height", 4000),
    ],
)
def test_settings_out_of_range_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(SettingsError, match=rf"\[light\] {name}"):
        check_light(replace(LightSettings(), **{name: value}))


def test_the_report_is_a_table_json_and_sheets(tmp_path: Path) -> None:
    reports = {"cloud": same(), "views": found(EMPTY_MESH, settings=replace(QUICK, hours=0))}
    for stale in ("slicings_suns.png", "views_day.png", "views_512px.png"):
        (tmp_path / stale).touch()
    write_light_report(reports, tmp_path)
    assert not (tmp_path / "slicings_suns.png").exists()
    assert (tmp_path / "views_512px.png").exists()  # of the other report
    assert json.loads((tmp_path / "light.json").read_text()) == light_facts(reports)
    assert light_facts(reports)["views"]["day"] is None
    head, cloud, views = format_light(reports).splitlines()
    assert "ground IoU" in head
    assert cloud.split()[:2] == ["cloud", "48"]
    assert views.split()[-1] == "-"
    side = 48 + 32
    assert read_image(tmp_path / "cloud_light.png").shape == (side, 6 * side, 4)
    assert read_image(tmp_path / "cloud_suns.png").shape == (2 * side, 2 * side, 4)
    assert read_image(tmp_path / "cloud_ground.png").shape == (96, 96, 4)
    assert read_image(tmp_path / "cloud_day.png").shape == (2 * 64, 3 * 64, 4)
    assert not (tmp_path / "views_day.png").exists()
    steps = read_image(tmp_path / "cloud_light.png").reshape(side, 6, side, 4)[..., :3].mean(axis=(0, 2, 3))
    full, wireframe, diffuse, direct, shadows, lit = steps
    assert diffuse > direct  # against white, the sun alone leaves what is turned from it dark
    assert direct >= shadows
    assert lit == pytest.approx(full, abs=1)
    assert wireframe < 255
