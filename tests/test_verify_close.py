"""The close-ups: where they look from, and what is measured in them."""

import json
import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.synthetic import joined, quad, small_tree, texture
from treebake.gl.draw import Drawing
from treebake.images import read_image
from treebake.model import AlphaMode, Doubles, Material, Mesh
from treebake.verify import CloseUp, VerifySettings, as_dict, close_ups, format_table, verify, write_report
from treebake.verify.cameras import CLOSE_LEAF, CLOSE_UP, cameras
from treebake.verify.metrics import score

FEW = VerifySettings(heights=(32,), elevations=(0.0,), azimuths=1)
LEVELS, AROUND = (0.0, 25.0, 60.0, 90.0), 8
GREEN = Material("leaf", base_color=(0.1, 0.5, 0.1, 1.0), double_sided=True)
TREE = small_tree()
CROWN = TREE.select(TREE.face_material != 0)
NOTHING = TREE.select(np.zeros(8, bool))
LEAF = 0.7


def points(*positions: object) -> Mesh:
    """A crown of tiny triangles at these places."""
    return joined(*(speck(*np.asarray(position, float)) for position in positions))


def speck(x: float, y: float, z: float) -> Mesh:
    return quad(GREEN, x=(x, x), y=(y, y), z=z)


def pixel(look: CloseUp, point: Doubles, size: int = CLOSE_UP) -> Doubles:
    """Where a point is seen, in pixels from the middle of the picture, and how far away."""
    x, y, _, w = look.view(size).to_clip @ np.append(point, 1.0)
    return np.array([x / w * size / 2, y / w * size / 2, w])


def back_of(look: CloseUp) -> Doubles:
    """The direction from the edge to the viewer."""
    up, around = math.radians(look.elevation), math.radians(look.azimuth)
    return np.array([math.cos(up) * math.sin(around), math.sin(up), math.cos(up) * math.cos(around)])


def seen(mesh: Mesh, look: CloseUp, shift: float = 0.0) -> Doubles:
    with closing(Drawing(mesh)) as drawing:
        return np.asarray(drawing.picture(look.view(shift=shift)).color[..., 3], np.float64)


# ---- where they look from ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("leaf", [0.01, 0.7, 30.0])
def test_a_leaf_at_the_edge_has_its_length_in_pixels(leaf: float) -> None:
    for look in close_ups(CROWN, leaf, LEVELS, AROUND):
        back = back_of(look)
        right = np.cross([0.0, 1.0, 0.0], back) if look.elevation < 90 else np.array([1.0, 0.0, 0.0])
        right -= right @ back * back
        right /= np.linalg.norm(right)
        for across in (right, np.cross(back, right)):
            ends = [pixel(look, look.edge + side * leaf / 2 * across) for side in (-1, 1)]
            assert np.linalg.norm((ends[1] - ends[0])[:2]) == pytest.approx(CLOSE_LEAF)


def test_a_drawn_leaf_at_the_edge_covers_its_square_of_pixels() -> None:
    leaf = quad(GREEN, x=(-0.35, 0.35), y=(-0.35, 0.35), z=2.0)
    (look,) = close_ups(leaf, 0.7, (0.0,), 1)
    picture = seen(leaf, look)
    assert picture.shape == (CLOSE_UP, CLOSE_UP)
    assert picture.sum() == pytest.approx(CLOSE_LEAF**2, abs=CLOSE_LEAF)
    rows, columns = (np.flatnonzero(picture.any(axis=axis)) for axis in (1, 0))
    for lines in (rows, columns):
        assert lines.mean() == pytest.approx((CLOSE_UP - 1) / 2, abs=0.5)
        assert len(lines) == pytest.approx(CLOSE_LEAF, abs=1)


def test_the_edge_is_in_the_middle_of_the_picture() -> None:
    for look in close_ups(CROWN, LEAF, LEVELS, AROUND):
        assert np.allclose(pixel(look, look.edge)[:2], 0, atol=1e-6)


@pytest.mark.parametrize(
    ("places", "edge"),
    [
        ([(0, 0, 1), (0, 0, -1)], 1.0),
        ([(0.1, 0.1, 1), (-0.1, -0.1, -1)], 1.0),  # within two leaves of the middle line
        ([(0, 0, 0.5), (0, 0, -1), (5, 0, 1), (-5, 0, 1)], 0.5),  # those aside do not count
        ([(0, 0, 0.5), (0, 0, -1), (0, 5, 1), (0, -5, 1)], 0.5),
        ([(3, 0, 1), (-4, 0, -1), (4, 0, -1), (-3, 0, 0.5)], 1.0),  # none is near: the nearest ones do
        ([(3, 0, 0.5), (-4, 0, -1), (4, 0, 1)], 0.5),
    ],
)
def test_the_edge_is_the_crowns_nearest_point_near_the_middle_line(places: Sequence[object], edge: float) -> None:
    (look,) = close_ups(points(*places), 0.2, (0.0,), 1)
    assert look.edge == pytest.approx([0, 0, edge])


def test_two_leaves_aside_is_near_and_more_is_not() -> None:
    for aside, edge in ((1.99, 1.0), (2.01, 0.5)):
        crown = points((0, 0, 0.5), (0, 0, -1), (0.2 * aside, 0, 1), (-0.2 * aside, 0, -1))
        (look,) = close_ups(crown, 0.2, (0.0,), 1)
        assert look.edge[2] == pytest.approx(edge)


def test_directions_are_those_of_the_cameras() -> None:
    found, whole = close_ups(CROWN, LEAF, LEVELS, AROUND), cameras(CROWN, LEVELS, AROUND)
    assert [(look.elevation, look.azimuth) for look in found] == [(each.elevation, each.azimuth) for each in whole]
    for look in found:
        away = look.edge - CROWN.bounds.mean(axis=0)
        assert away @ back_of(look) == pytest.approx(np.linalg.norm(away))  # the edge is straight towards the viewer


def test_unused_vertices_do_not_count() -> None:
    far = replace(CROWN, positions=np.concatenate([CROWN.positions, np.float32([[0, 0, 50]])]))
    for one, other in zip(close_ups(CROWN, LEAF, (0.0,), 4), close_ups(far, LEAF, (0.0,), 4), strict=True):
        assert (one.edge == other.edge).all()
        assert one.depth == other.depth


def test_all_that_lies_behind_the_edge_is_between_near_and_far() -> None:
    corners = CROWN.positions[np.unique(CROWN.faces)].astype(np.float64)
    for look in close_ups(CROWN, LEAF, LEVELS, AROUND):
        view = look.view()
        depths = np.array([pixel(look, corner)[2] for corner in corners])
        assert depths.max() < view.far
        assert view.near < pixel(look, look.edge)[2] < view.far


@pytest.mark.parametrize("elevation", [0.0, 60.0, 90.0])
def test_a_single_triangle_is_a_crown(elevation: float) -> None:
    one = quad(GREEN, x=(-0.1, 0.1), y=(-0.1, 0.1), z=3.0).select(np.array([True, False]))
    for look in close_ups(one, 0.2, (elevation,), 3):
        view = look.view()
        assert np.isfinite(view.to_clip).all()
        assert np.linalg.cond(view.to_clip) < 1e6
        assert 0 < view.near < view.far
    assert seen(one, close_ups(one, 0.2, (0.0,), 1)[0]).any()


def test_a_shift_moves_the_picture_to_the_right_by_pixels() -> None:
    (look,) = close_ups(CROWN, LEAF, (0.0,), 1)
    still, moved = (seen(CROWN, look, shift) for shift in (0.0, 3.0))
    assert still[:, :-3].any()
    assert np.array_equal(moved[:, 3:], still[:, :-3])


# ---- what is measured ----------------------------------------------------------------------------------------------


def looks(azimuths: int = 2) -> tuple[CloseUp, ...]:
    return close_ups(CROWN, LEAF, (0.0,), azimuths)


def test_a_source_against_itself_close_up() -> None:
    level = verify(TREE, TREE, FEW, close=looks()).close_up
    assert level is not None
    assert level.height == CLOSE_UP
    ours = level.candidate
    assert (ours.flip, ours.flip_worst, ours.flip_ratio, ours.iou, ours.coverage, ours.depth_cm) == (0, 0, 0, 1, 1, 0)
    assert level.invisible
    assert 0 < level.floor_half.flip < level.floor_one.flip < level.empty.flip
    assert level.floor_one.flip_ratio == 1


def test_a_candidate_moved_by_a_pixel_scores_the_floor_close_up() -> None:
    leaf = quad(GREEN, x=(-0.35, 0.35), y=(-0.35, 0.35))
    moved = replace(leaf, positions=leaf.positions + np.float32([0.7 / CLOSE_LEAF, 0, 0]))
    level = verify(leaf, moved, FEW, close=close_ups(leaf, 0.7, (0.0,), 1)).close_up
    assert level is not None
    assert level.candidate.flip_ratio == pytest.approx(1, rel=1e-3)
    assert level.candidate.iou == pytest.approx(level.floor_one.iou, rel=1e-3)


def test_a_leaf_that_fills_the_window_has_a_floor() -> None:
    """Its picture reaches the right border, where a shifted one is drawn anew instead of being moved on."""
    checked = texture(np.kron([[[200, 90, 30], [20, 120, 40]], [[20, 120, 40], [200, 90, 30]]], np.ones((8, 8, 1))))
    wall = quad(Material("wall", color_map=checked), x=(-9, 9), y=(-9, 9))
    level = verify(wall, wall, FEW, close=close_ups(wall, 0.7, (0.0,), 1)).close_up
    assert level is not None
    assert level.floor_one.coverage == 1
    assert 0 < level.floor_half.flip < level.floor_one.flip


def test_the_floor_is_the_source_drawn_a_pixel_further() -> None:
    """What fills the right half reaches the border of the picture, and leaves it when it is moved."""
    half = quad(GREEN, x=(0, 9), y=(-9, 9))
    look = CloseUp(0.0, 0.0, np.zeros(3), 0.7, 10.0)
    level = verify(half, half, FEW, close=(look,)).close_up
    assert level is not None
    with closing(Drawing(half, exact_cutouts=True)) as drawing:
        moved = score(drawing.picture(look.view()), drawing.picture(look.view(shift=1.0)))
    assert moved.flip[0] > 0
    assert (level.floor_one.flip, level.floor_one.iou) == (moved.flip[0], moved.iou[0])
    assert level.floor_one.coverage == pytest.approx(1 - 1 / (CLOSE_UP / 2), rel=1e-4)


def test_no_look_close_up_is_none() -> None:
    assert verify(TREE, TREE, FEW).close_up is None


def test_quick_leaves_the_close_up_out() -> None:
    steps: list[tuple[int, int]] = []
    report = verify(
        TREE,
        TREE,
        VerifySettings(quick=True, azimuths=1, elevations=(0.0,)),
        close=looks(),
        progress=lambda done, total: steps.append((done, total)),
    )
    assert report.close_up is None
    assert steps[-1] == (2, 2)


def test_progress_counts_the_close_ups() -> None:
    steps: list[tuple[int, int]] = []
    verify(TREE, TREE, FEW, close=looks(2), progress=lambda done, total: steps.append((done, total)))
    assert steps == [(done, 6) for done in range(1, 7)]  # one view and two close-ups, of source and candidate


def test_the_candidate_for_the_greatest_height_is_looked_at_close_up() -> None:
    settings = replace(FEW, heights=(32, 64))
    for near, far, coverage in ((TREE, NOTHING, 1), (NOTHING, TREE, 0)):
        level = verify(TREE, {64: near, 32: far}, settings, close=looks(1)).close_up
        assert level is not None
        assert level.candidate.coverage == coverage


def test_the_source_is_drawn_as_it_is_close_up_too() -> None:
    """A leaf's own fine holes are kept in the source and lost to mipmaps in the candidate."""
    holes = np.kron([[255, 0], [0, 0]], np.ones((32, 32)))[..., None].repeat(4, axis=2)
    leaves = Material("leaves", color_map=texture(holes), alpha_mode=AlphaMode.MASK, double_sided=True)
    card = quad(leaves, uvs=500.3 * np.array([(0, 1), (1, 1), (1, 0), (0, 0)]))
    level = verify(card, card, FEW, close=close_ups(card, 0.7, (0.0,), 1)).close_up
    assert level is not None
    assert level.candidate.coverage == 0


def test_close_ups_come_from_the_cache(tmp_path: Path) -> None:
    first = as_dict(verify(TREE, CROWN, FEW, tmp_path, close=looks()))
    assert len(list(tmp_path.iterdir())) == 2  # at 32 pixels and close up
    written = {path: path.stat().st_ino for path in tmp_path.iterdir()}
    assert as_dict(verify(TREE, CROWN, FEW, tmp_path, close=looks())) == first
    assert {path: path.stat().st_ino for path in tmp_path.iterdir()} == written
    verify(TREE, CROWN, FEW, tmp_path, close=close_ups(CROWN, LEAF / 2, (0.0,), 2))
    assert len(list(tmp_path.iterdir())) == 3  # nearer is another picture


def test_thresholds_are_not_about_the_close_up() -> None:
    report = verify(TREE, TREE, replace(FEW, thresholds={"ssim_min": 1.01}), close=looks())
    assert report.misses == ("ssim at 32 px is 1.000, below 1.01",)


# ---- the report ----------------------------------------------------------------------------------------------------


def test_the_report_shows_the_close_up(tmp_path: Path) -> None:
    report = verify(TREE, CROWN, FEW, close=looks())
    write_report({"crown": report}, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"crown_32px.png", "crown_close.png", "report.json"}
    assert read_image(tmp_path / "crown_close.png").shape == (CLOSE_UP, 3 * CLOSE_UP, 4)
    kept = json.loads((tmp_path / "report.json").read_text())["crown"]
    assert kept["close_up"] == as_dict(report)["close_up"]
    assert kept["close_up"]["height"] == CLOSE_UP
    assert kept["close_up"]["coverage"] < 1
    assert as_dict(verify(TREE, CROWN, FEW))["close_up"] is None


def test_the_table_ends_with_the_close_up() -> None:
    lines = format_table({"candidate": verify(TREE, CROWN, FEW, close=looks())}).splitlines()
    assert len(lines) == 1 + 2 * 4
    assert [lines[row].split()[0] for row in (1, 5)] == ["32px", "close"]
