"""The protocol as a whole: what is compared with what, what is kept, what is written."""

import json
import logging
import math
import os
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tests.synthetic import joined, quad, small_tree, texture
from treebake.errors import MeshError, SettingsError, WorkspaceError
from treebake.files import cache_folder
from treebake.images import read_image
from treebake.model import AlphaMode, Material, Mesh
from treebake.verify import (
    Figures,
    VerifySettings,
    as_dict,
    failures,
    format_table,
    protocol,
    reference,
    verify,
    write_report,
)
from treebake.verify.cameras import FIELD_OF_VIEW, MARGIN, cameras

FEW = VerifySettings(heights=(32, 64), elevations=(0.0, 60.0), azimuths=2)
TREE = small_tree()
NOTHING = TREE.select(np.zeros(8, bool))


def test_a_source_against_itself() -> None:
    report = verify(TREE, TREE, FEW)
    assert [level.height for level in report.levels] == [64, 32]
    assert report.views == 4
    for level in report.levels:
        ours = level.candidate
        assert (ours.flip, ours.flip_worst, ours.flip_ratio, ours.iou, ours.coverage) == (0, 0, 0, 1, 1)
        assert ours.ssim == pytest.approx(1)
        assert ours.depth_cm == 0
        assert ours.foliage_coverage == 1
        assert (ours.triangles, ours.draw_calls) == (8, 4)
        assert level.invisible


def test_floors_and_the_empty_scene_give_the_scale() -> None:
    for level in verify(TREE, TREE, FEW).levels:
        assert level.floor_one.flip_ratio == 1
        assert 0 < level.floor_half.flip < level.floor_one.flip < level.empty.flip
        assert level.floor_one.iou < level.floor_half.iou < 1
        assert level.floor_one.coverage == pytest.approx(1, abs=1e-6)
        assert (level.empty.coverage, level.empty.iou, level.empty.triangles) == (0, 0, 0)
        assert level.empty.depth_cm is None
        assert level.empty.overdraw is None


def test_a_candidate_moved_by_a_pixel_scores_the_floor() -> None:
    card = quad(Material("card", base_color=(0.1, 0.5, 0.1, 1)), x=(-0.4, 0.4), y=(-1.0, 1.0))
    settings = VerifySettings(heights=(64,), elevations=(0.0,), azimuths=1)
    radius = cameras(card, (0.0,), 1)[0].radius
    pixel = 2 * radius / math.cos(math.radians(FIELD_OF_VIEW / 2)) / 64  # at the card, through the sphere's centre
    (level,) = verify(card, replace(card, positions=card.positions + np.float32([pixel, 0, 0])), settings).levels
    assert level.candidate.flip_ratio == pytest.approx(1, rel=1e-3)
    assert level.candidate.ssim == pytest.approx(level.floor_one.ssim, rel=1e-3)
    assert level.candidate.iou == pytest.approx(level.floor_one.iou, rel=1e-3)


def test_an_empty_candidate_scores_like_the_empty_scene() -> None:
    settings = replace(FEW, azimuths=1, elevations=(0.0,))  # one view, which the scale is measured in too
    for level in verify(TREE, NOTHING, settings).levels:
        assert asdict(level.candidate) == asdict(level.empty) | {"gpu_bytes": level.candidate.gpu_bytes}
        assert not level.invisible


def test_an_empty_source_is_refused() -> None:
    with pytest.raises(MeshError, match="no triangles"):
        verify(NOTHING, TREE, FEW)


def test_coverage_is_the_candidates_area_over_the_sources() -> None:
    card = quad(Material("card", base_color=(0.1, 0.5, 0.1, 1)), x=(-1.0, 1.0))
    half = quad(card.materials[0], x=(-1.0, 0.0))
    (level,) = verify(card, half, VerifySettings(heights=(128,), elevations=(0.0,), azimuths=1)).levels
    assert level.candidate.coverage == pytest.approx(0.5, abs=0.01)
    assert level.candidate.iou == pytest.approx(0.5, abs=0.01)
    assert level.candidate.overdraw == pytest.approx(1, abs=0.02)


def test_foliage_coverage_takes_the_trunk_off() -> None:
    trunk = TREE.select(TREE.face_material == 0)
    settings = replace(FEW, elevations=(0.0,), azimuths=1)
    (level, *_) = verify(TREE, TREE, settings, trunk=trunk).levels
    assert level.candidate.foliage_coverage == 1
    assert level.floor_one.foliage_coverage == pytest.approx(1, abs=1e-6)
    assert level.empty.foliage_coverage == 0
    (level, *_) = verify(TREE, trunk, settings, trunk=trunk).levels
    assert level.candidate.foliage_coverage == pytest.approx(0, abs=1e-6)
    (level, *_) = verify(TREE, TREE.select(np.arange(8) < 4), settings, trunk=trunk).levels  # one leaf of three
    assert level.candidate.foliage_coverage == pytest.approx(0.31, abs=0.02)  # by areas: 0.42 of 1.38 square units


def test_the_source_is_drawn_as_it_is_and_the_candidate_as_a_client_does() -> None:
    """Leaves that mipmaps thin out are missing from a candidate, even where it is the source's own file."""
    holes = np.kron([[255, 0], [0, 0]], np.ones((32, 32)))[..., None].repeat(4, axis=2)
    leaves = Material("leaves", color_map=texture(holes), alpha_mode=AlphaMode.MASK, double_sided=True)
    card = quad(leaves, uvs=50.3 * np.array([(0, 1), (1, 1), (1, 0), (0, 0)]))
    for level in verify(card, card, FEW).levels:
        assert level.candidate.coverage == 0
        assert level.candidate.flip_ratio is not None
        assert level.candidate.flip_ratio > 1
        assert level.floor_half.coverage == pytest.approx(1, abs=0.1)


def test_each_height_may_have_its_own_candidate() -> None:
    near, far = verify(TREE, {64: TREE, 32: NOTHING}, FEW).levels
    assert (near.candidate.coverage, far.candidate.coverage) == (1, 0)
    with pytest.raises(SettingsError, match="64 px"):
        verify(TREE, {32: TREE}, FEW)


def test_quick_is_one_height_and_a_third_of_the_views() -> None:
    report = verify(TREE, TREE, VerifySettings(quick=True))
    assert [level.height for level in report.levels] == [256]
    assert report.views == 8


@pytest.mark.parametrize(
    "wrong",
    [{"heights": ()}, {"heights": (8,)}, {"elevations": ()}, {"elevations": (91.0,)}, {"azimuths": 0}],
)
def test_settings_out_of_range_are_named(wrong: dict[str, object]) -> None:
    with pytest.raises(SettingsError, match=f"verify.{next(iter(wrong))}"):
        verify(TREE, TREE, VerifySettings(**wrong))


def test_progress_ends_at_the_total(tmp_path: Path) -> None:
    for _ in ("drawn", "from the cache"):
        steps: list[tuple[int, int]] = []
        verify(TREE, TREE, FEW, tmp_path, progress=lambda done, total: steps.append((done, total)))  # noqa: B023
        assert steps[-1] == (16, 16)
        assert steps == sorted(set(steps))


def test_inputs_are_left_alone() -> None:
    before = [getattr(TREE, name).copy() for name in ("positions", "faces", "face_material")]
    verify(TREE, TREE, FEW)
    for name, array in zip(("positions", "faces", "face_material"), before, strict=True):
        assert np.array_equal(getattr(TREE, name), array)


# --- the cache ---


def drawn_sources(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The heights at which a source is drawn from now on."""
    drawn: list[int] = []
    original = reference._draw

    def spy(source: Mesh, trunk: Mesh | None, views: object, height: int, scored: object) -> object:
        drawn.append(height)
        return original(source, trunk, views, height, scored)

    monkeypatch.setattr(reference, "_draw", spy)
    return drawn


def test_a_second_verify_draws_only_the_candidate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = drawn_sources(monkeypatch)
    trunk = TREE.select(TREE.face_material == 0)
    first = as_dict(verify(TREE, TREE.select(np.arange(8) < 6), FEW, tmp_path, trunk=trunk))
    assert drawn == [64, 32]
    assert as_dict(verify(TREE, TREE.select(np.arange(8) < 6), FEW, tmp_path, trunk=trunk)) == first
    assert drawn == [64, 32]


def repainted(mesh: Mesh) -> Mesh:
    bark, *leaves = mesh.materials
    return replace(mesh, materials=(replace(bark, color_map=texture([[(90, 60, 30)]])), *leaves))


@pytest.mark.parametrize(
    ("source", "settings"),
    [
        (replace(TREE, positions=TREE.positions * np.float32(1.01)), FEW),
        (replace(TREE, materials=(replace(TREE.materials[0], double_sided=False), *TREE.materials[1:])), FEW),
        (repainted(TREE), FEW),
        (TREE, replace(FEW, elevations=(0.0, 59.0))),
    ],
    ids=["moved", "single-sided", "repainted", "other views"],
)
def test_another_source_or_view_is_drawn_anew(
    source: Mesh, settings: VerifySettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    verify(TREE, TREE, FEW, tmp_path)
    drawn = drawn_sources(monkeypatch)
    report = verify(source, source, settings, tmp_path)
    assert drawn == [64, 32]
    assert report.levels[0].candidate.flip == 0
    assert len(list(tmp_path.iterdir())) == 4  # each has its own file, so several trees share the folder


def test_a_damaged_cache_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = as_dict(verify(TREE, TREE, FEW, tmp_path))
    for path in tmp_path.iterdir():
        path.write_bytes(path.read_bytes()[:-2000])
    drawn = drawn_sources(monkeypatch)
    assert as_dict(verify(TREE, TREE, FEW, tmp_path)) == first
    assert drawn == [64, 32]


def test_a_cache_that_cannot_be_written_is_done_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "treebake")
    (tmp_path / "cache").write_text("a file, not a folder")
    drawn = drawn_sources(monkeypatch)
    for _ in range(2):
        assert verify(TREE, TREE, FEW, tmp_path / "cache").levels[0].candidate.flip == 0
    assert drawn == [64, 32] * 2
    (line,) = set(caplog.messages)
    assert f"{tmp_path / 'cache'} cannot be written" in line


def test_the_cache_is_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    assert cache_folder() == tmp_path / ".cache/treebake"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "elsewhere"))
    assert cache_folder() == tmp_path / "elsewhere/treebake"


def test_a_full_cache_drops_what_was_not_used_for_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "_KEPT", 250)
    for age, name in enumerate(("source_new.npz", "source_middle.npz", "source_old.npz")):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    (tmp_path / "theirs.txt").write_bytes(bytes(1000))
    reference._prune(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"source_new.npz", "source_middle.npz", "theirs.txt"}


# --- thresholds ---

GOOD = Figures(
    flip=0.05, flip_worst=0.06, flip_ratio=1.31, flip_ratio_worst=1.5, ssim=0.9, iou=0.8, coverage=0.97,
    foliage_coverage=None, depth_cm=3.0, overdraw=2.0, triangles=12_345, draw_calls=2, gpu_bytes=1000,
)  # fmt: skip


@pytest.mark.parametrize(
    ("thresholds", "expected"),
    [
        ({}, []),
        ({"flip_ratio": 1.4}, []),
        ({"flip_ratio": 1.31}, []),
        ({"flip_ratio": 1.0}, ["flip_ratio at 256 px is 1.310, above 1"]),
        ({"flip_ratio_max": 1.0}, ["flip_ratio at 256 px is 1.310, above 1"]),
        ({"flip_ratio": {"512": 1.0}}, []),
        ({"flip_ratio": {"256": 1.0, "512": 1.4}}, ["flip_ratio at 256 px is 1.310, above 1"]),
        ({"coverage_min": 0.98, "coverage_max": 1.02}, ["coverage at 256 px is 0.970, below 0.98"]),
        ({"triangles": 12_000}, ["triangles at 256 px is 12,345, above 12000"]),
        ({"foliage_coverage_min": 0.95}, ["foliage_coverage at 256 px could not be measured, and is asked for"]),
    ],
)
def test_missed_thresholds_are_named(thresholds: dict[str, object], expected: list[str]) -> None:
    assert list(failures([(256, GOOD)], thresholds)) == expected


@pytest.mark.parametrize(
    ("thresholds", "message"),
    [
        ({"flip_ration": 1.0}, "did you mean flip_ratio"),
        ({"beauty": 1.0}, "known are flip"),
        ({"ssim_min": {"big": 1.0}}, "big is no height"),
    ],
)
def test_wrong_thresholds_are_refused_before_anything_is_drawn(
    thresholds: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(protocol, "reference", None)
    with pytest.raises(SettingsError, match=message):
        verify(TREE, TREE, replace(FEW, thresholds=thresholds))


def test_a_bound_may_be_for_the_close_up() -> None:
    measured = [(64, replace(GOOD, flip=0.1)), ("close", replace(GOOD, flip=0.5))]
    assert failures(measured, {"flip": {"close": 0.4}}) == ("flip close up is 0.500, above 0.4",)
    assert failures(measured, {"flip": 0.4}) == ()  # a bound without a height is for the heights


def test_the_report_holds_what_was_missed() -> None:
    report = verify(TREE, NOTHING, replace(FEW, thresholds={"coverage_min": {"64": 0.98}}))
    assert report.misses == ("coverage at 64 px is 0.000, below 0.98",)


# --- the report ---


def test_the_written_report(tmp_path: Path) -> None:
    report = verify(TREE, TREE.select(TREE.face_material != 0), FEW)
    write_report({"bare": report}, tmp_path / "new")
    written = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert written == ["bare_32px.png", "bare_64px.png", "report.json"]
    text = (tmp_path / "new/report.json").read_text()
    assert json.loads(text) == {"bare": as_dict(report)}
    assert text == json.dumps(json.loads(text), indent=2, sort_keys=True) + "\n"

    sheet = read_image(tmp_path / "new/bare_64px.png")
    side = 64 + MARGIN
    assert sheet.shape == (2 * side, 3 * side, 4)  # an elevation a row: source, candidate, FLIP
    source, candidate, flip = (sheet[:side, i * side : (i + 1) * side, :3].astype(int) for i in range(3))
    bark = source - candidate != 0
    assert bark.any()
    assert flip[bark.any(axis=2)].mean() > flip[~bark.any(axis=2)].mean()
    assert flip[0, 0].tolist() == [0, 0, 4]


def test_the_same_report_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_report({"same": verify(TREE, TREE, FEW)}, tmp_path / name)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_a_report_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(WorkspaceError, match="cannot be written"):
        write_report({"tree": verify(TREE, TREE, FEW)}, tmp_path / "file")


def test_the_table_shows_every_height_with_its_scale() -> None:
    lines = format_table({"candidate": verify(TREE, NOTHING, FEW)}).splitlines()
    assert len(lines) == 1 + 2 * 4
    assert lines[1].split()[:2] == ["64px", "candidate"]
    assert lines[3].split()[:4] == ["floor", "1px", lines[3].split()[2], lines[3].split()[3]]
    assert "1.000" in lines[3]
    assert lines[4].split()[0] == "empty"


def test_the_table_shows_every_representation_above_one_scale() -> None:
    lines = format_table({"same_bytes": verify(TREE, TREE, FEW), "none": verify(TREE, NOTHING, FEW)}).splitlines()
    assert len(lines) == 1 + 2 * 5
    assert lines[1].split()[:4] == ["64px", "same", "bytes", "="]  # invisible
    assert lines[2].split()[0] == "none"
    assert [line.split()[0] for line in lines[3:7]] == ["floor", "floor", "empty", "32px"]


def test_every_representation_has_its_sheets_in_one_report(tmp_path: Path) -> None:
    reports = {"full": verify(TREE, TREE, FEW), "none": verify(TREE, NOTHING, FEW)}
    write_report(reports, tmp_path)
    sheets = {f"{name}_{height}px.png" for name in reports for height in (32, 64)}
    assert {path.name for path in tmp_path.iterdir()} == sheets | {"report.json"}
    kept = json.loads((tmp_path / "report.json").read_text())
    assert {name: kept[name]["heights"][0]["coverage"] for name in kept} == {"full": 1, "none": 0}


def test_meshes_without_textures_or_nodes_in_common_can_be_compared() -> None:
    other = joined(TREE, TREE)
    assert verify(TREE, other, FEW).levels[0].candidate.coverage == pytest.approx(1)


def test_a_threshold_at_a_height_that_is_never_measured_is_refused() -> None:
    with pytest.raises(SettingsError, match="500 px is not among"):
        verify(TREE, TREE, replace(FEW, thresholds={"flip_ratio": {"500": 1.0}}))
