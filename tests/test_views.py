"""View impostors as they are baked: from where pictures are taken, what is in them, and what the tables say of them."""

import re
import sys
from collections.abc import Callable
from dataclasses import astuple, replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from foliage import frozen, leaf_tree, random_leaves
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from stems import empty, stem, tree_of

from treebake.errors import BudgetError, SettingsError
from treebake.geometry import join, turn_to
from treebake.model import AlphaMode, Doubles, Floats, Impostor, Ints, Material, Mesh, Tree, Views
from treebake.stages.views import ViewSettings, views
from treebake.stages.views.directions import hemi_octahedron, ring
from treebake.stages.views.support import SAMPLES, support

SMALL = ViewSettings(layout="ring", count=4, side=3, layers=2, texels=32, atlas=512, gutter=2, supersample=2)
LAYOUTS = pytest.mark.parametrize("layout", ["ring", "hemi"])
SIDES = st.integers(2, 12)
NUMBERS = st.floats(-10, 10, width=32)
DIRECTIONS = st.tuples(st.floats(-1, 1), st.floats(0, 1), st.floats(-1, 1)).filter(lambda way: any(map(abs, way)))


# ---- directions ----------------------------------------------------------------------------------------------------


grid = cache(hemi_octahedron)


def assert_frames(frames: list[Doubles]) -> None:
    for frame in frames:
        assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.allclose(np.cross(frame[0], frame[1]), frame[2], atol=1e-12)  # right-handed
        assert frame[0, 1] == 0  # upright
        assert frame[1, 1] >= 0


def test_a_ring_goes_from_z_towards_x() -> None:
    frames = ring(4)
    assert_frames(frames)
    assert np.allclose([frame[2] for frame in frames], [(0, 0, 1), (1, 0, 0), (0, 0, -1), (-1, 0, 0)], atol=1e-12)
    assert np.allclose(ring(8)[1][2], (np.sqrt(0.5), 0, np.sqrt(0.5)))


@settings(deadline=None)
@given(SIDES)
def test_the_grid_looks_from_the_upper_half_from_everywhere_else_each_time(side: int) -> None:
    frames = grid(side)
    assert len(frames) == side**2
    assert_frames(frames)
    towards = np.array([frame[2] for frame in frames])
    assert towards[:, 1].min() >= 0
    apart = np.linalg.norm(towards[:, None] - towards, axis=2) + 9 * np.eye(side**2)
    assert apart.min() > 0.5 / side
    # The rim is the horizon.
    square = towards.reshape(side, side, 3)
    for edge in (square[0], square[-1], square[:, 0], square[:, -1]):
        assert np.allclose(edge[:, 1], 0, atol=1e-12)


def test_corners_of_the_grid_are_the_axes_and_its_middle_is_up() -> None:
    towards = np.array([frame[2] for frame in hemi_octahedron(3)]).reshape(3, 3, 3)
    assert np.allclose(towards[1, 1], (0, 1, 0))
    assert np.allclose(towards[0, 0], (0, 0, -1))
    assert np.allclose(towards[0, 2], (1, 0, 0))  # columns are u, which grows with x
    assert np.allclose(towards[2, 0], (-1, 0, 0))
    assert np.allclose(towards[2, 2], (0, 0, 1))


def chosen(way: Doubles, side: int) -> tuple[Ints, Doubles]:
    """The readable twin of views_card.glsl: the three pictures of the grid nearest a direction, and their shares."""
    x, y, z = way[0], max(way[1], 0.0), way[2]
    x, z = np.array([x, z]) / (abs(x) + y + abs(z))
    place = (np.array([x + z, z - x]) / 2 + 0.5) * (side - 1)
    low = np.minimum(np.floor(place), side - 2).astype(int)
    off = place - low
    start = low[1] * side + low[0]
    views = np.array([start, start + (1 if off[0] > off[1] else side), start + side + 1], np.int32)
    return views, np.array([1 - off.max(), abs(off[0] - off[1]), off.min()])


def flattened(towards: Doubles) -> Doubles:
    """Directions on the octahedron."""
    return np.asarray(towards / np.abs(towards).sum(axis=-1, keepdims=True))


@settings(deadline=None)
@given(SIDES, st.data())
def test_at_a_point_of_the_grid_its_picture_alone_is_found(side: int, data: st.DataObject) -> None:
    number = data.draw(st.integers(0, side**2 - 1))
    views, shares = chosen(grid(side)[number][2], side)
    found = np.zeros(side**2)
    np.add.at(found, views, shares)
    assert found[number] == pytest.approx(1, abs=1e-9)


@settings(deadline=None)
@given(SIDES, DIRECTIONS)
def test_three_pictures_whose_shares_reproduce_the_direction(side: int, way: tuple[float, float, float]) -> None:
    views, shares = chosen(np.array(way), side)
    assert len(set(views.tolist())) == 3
    assert views.min() >= 0
    assert shares.min() > -1e-9
    assert shares.sum() == pytest.approx(1)
    on_grid = flattened(np.array([grid(side)[view][2] for view in views]))
    mixed = shares @ on_grid
    wanted = flattened(np.array(way))
    # A triangle of an even grid may bend over an edge of the octahedron; its x and z are always met.
    assert np.allclose(mixed[[0, 2]], wanted[[0, 2]], atol=1e-9)


# ---- how far a tree reaches ----------------------------------------------------------------------------------------


def reach(points: Doubles, up: Doubles) -> Doubles:
    """The greatest d . p over points turned at will about the vertical axis, for each vertical part of d."""
    out = np.hypot(points[:, 0], points[:, 2])
    return np.asarray((np.sqrt(1 - up**2)[:, None] * out + up[:, None] * points[:, 1]).max(axis=1))


ANGLES = np.linspace(-np.pi / 2, np.pi / 2, SAMPLES)
STEPS = np.sin(ANGLES)
POINTS = arrays(np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=NUMBERS)


@settings(deadline=None)
@given(POINTS, st.lists(st.floats(-1, 1), min_size=1))
@example(np.array([[5.25, -5.75, 5.25]]), [-0.61328125])  # between two directions that are looked at
@example(np.array([[0.63, 9.98, 0.0]]), [0.998])
def test_nothing_reaches_beyond_the_support(points: Doubles, ups: list[float]) -> None:
    found = support(points)
    assert (found.dtype, found.shape) == (np.float32, (SAMPLES,))
    up = np.array(ups)
    assert (np.interp(np.arcsin(up), ANGLES, found) >= reach(points, up) - 1e-5).all()


@settings(deadline=None)
@given(POINTS)
def test_the_support_is_no_larger_than_within_a_step(points: Doubles) -> None:
    fine = np.sin(np.linspace(-np.pi / 2, np.pi / 2, 32 * 32 + 1))
    exact = np.pad(reach(points, fine), 32, mode="edge")
    most = np.lib.stride_tricks.sliding_window_view(exact, 65).max(axis=1)[::32]
    band = np.ptp(points[:, 1]) / 256  # a band's farthest and highest point need not be the same
    assert (support(points) <= most + band + 1e-4 * np.abs(most).max() + 1e-5).all()


def test_the_support_of_an_upright_line_is_tight() -> None:
    found = support(np.array([[0.0, -2, 0], [0, 3, 0]]))
    exact = np.where(STEPS > 0, 3 * STEPS, -2 * STEPS)
    assert (found >= exact).all()
    upper = ANGLES[1:-1] > 0
    assert np.allclose(found[1:-1][upper], 3 * np.sin(ANGLES[1:-1][upper] + np.pi / 32), rtol=1e-3)
    assert np.allclose(found[[0, -1]], [2, 3], rtol=1e-3)


def test_a_tree_turned_about_its_axis_reaches_as_far() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    assert np.allclose(support(points), support(points @ turn_to(0.0, 77.0)), atol=1e-6)


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
def test_a_single_point_has_a_support(point: tuple[float, float, float]) -> None:
    assert support(np.array([point])).max() == pytest.approx(point[0], rel=1e-3)


# ---- pictures ------------------------------------------------------------------------------------------------------


@cache
def crown() -> Tree:
    """A stem, and leaves facing anywhere, without symmetry."""
    leaves = random_leaves(3, 30, spread=0.5)
    tree = leaf_tree(leaves.centers * [1, 0.6, 0.8] + [0.1, 1, 0], leaves.normals, size=0.2)
    return frozen(replace(tree, trunk=stem(length=0.8, radii=(0.05, 0.05))))


def both(tree: Tree) -> Mesh:
    return join(tree.trunk, tree.foliage)


@cache
def baked(layout: str = "ring", layers: int = 2) -> Views:
    """The crown's views."""
    (impostor,) = views([crown()], replace(SMALL, layout=layout, layers=layers))
    return impostor.views


def frames(found: Views) -> list[Doubles]:
    return ring(found.side) if found.layout == "ring" else hemi_octahedron(found.side)


def texel_rectangles(found: Views) -> Ints:
    """Left, top, right and bottom texel of each picture."""
    height, width = found.atlas.coverage.pixels.shape[:2]
    texels = found.pictures[:, 4, [0, 3, 2, 1]] * [width, height, width, height]
    assert np.allclose(texels, np.rint(texels), atol=1e-3)
    return np.rint(texels).astype(np.int32)


def texel_size(found: Views) -> Doubles:
    """Of each picture that shows something, in x and y."""
    left, top, right, bottom = texel_rectangles(found).T
    bounds = found.pictures[:, 3].astype(np.float64)
    shown = right > left
    sides = np.stack([bounds[:, 2] - bounds[:, 0], bounds[:, 3] - bounds[:, 1]], axis=1)
    return np.asarray(sides[shown] / np.stack([right - left, bottom - top], axis=1)[shown])


@LAYOUTS
def test_a_picture_for_each_view_and_layer(layout: str) -> None:
    found = baked(layout)
    assert (found.layout, found.layers, found.side) == (layout, 2, 4 if layout == "ring" else 3)
    wanted = frames(found)
    assert found.pictures.shape == (2 * len(wanted), 5, 4)
    assert found.pictures.dtype == np.float32
    assert np.allclose(found.pictures[:, :3, :3], np.repeat(wanted, 2, axis=0), atol=1e-6)
    assert not found.pictures[:, 0, 3].any()


@LAYOUTS
def test_the_center_is_the_boxes_and_the_sphere_holds_all(layout: str) -> None:
    found, mesh = baked(layout), both(crown())
    assert np.allclose(found.center, mesh.bounds.mean(axis=0))
    away = np.linalg.norm(mesh.positions - found.center, axis=1)
    assert found.radius == pytest.approx(away.max())
    np.testing.assert_array_equal(found.support, support(mesh.positions.astype(np.float64) - found.center))


@LAYOUTS
def test_layers_share_the_tree_from_front_to_back(layout: str) -> None:
    found, mesh = baked(layout, 3), both(crown())
    for number, frame in enumerate(frames(found)):
        depth = (mesh.positions - found.center) @ frame[2]
        low, high = found.pictures[3 * number : 3 * number + 3, 1:3, 3].T
        assert (low < high).all()
        assert np.allclose(high[1:], low[:-1])
        assert depth.max() <= high[0] < depth.max() + 0.01
        assert depth.min() - 0.01 < low[-1] <= depth.min()


def in_place(found: Views, row: int, like: Views) -> Floats:
    """A picture's coverage over the largest rectangle around the center that any may take."""
    reach = int(np.ceil(found.radius / texel_size(like).mean())) + 2
    left, top, right, bottom = texel_rectangles(found)[row]
    alpha = np.zeros((2 * reach, 2 * reach), np.float32)
    x, y = np.rint(found.pictures[row, 3, [0, 3]] / texel_size(like).mean() * [1, -1]).astype(int) + reach
    alpha[y : y + bottom - top, x : x + right - left] = (
        found.atlas.coverage.pixels[top:bottom, left:right, 0].astype(np.float32) / 255
    )
    return alpha


def test_layers_together_show_what_one_picture_does() -> None:
    layered, flat = baked("ring", 3), baked("ring", 1)
    for number in range(4):
        alphas = np.stack([in_place(layered, 3 * number + layer, flat) for layer in range(3)])
        whole = in_place(flat, number, flat)
        threshold = 0.1  # a layer's rectangle ends where less is covered
        assert (alphas.max(axis=0) <= whole + 1e-6 + threshold).all()
        assert (alphas.sum(axis=0) >= whole - 3 * threshold).all()
        assert alphas.sum(axis=0).sum() > 1.1 * whole.sum()  # what a nearer one hides
        assert all(layer.any() for layer in alphas)


@LAYOUTS
def test_every_texel_is_a_place_on_the_tree(layout: str) -> None:
    tree = leaf_tree(crown().leaves.centers[:9], crown().leaves.normals[:9], size=0.4)
    (impostor,) = views([tree], replace(SMALL, layout=layout, texels=64, supersample=4))
    found = impostor.views
    coverage, relief = (image.pixels.astype(np.float64) / 255 for image in (found.atlas.coverage, found.atlas.relief))
    seen = set()
    for row, (left, top, right, bottom) in zip(found.pictures.astype(np.float64), texel_rectangles(found), strict=True):
        full = coverage[..., 0] == 1
        blocks = full[::2, ::2] & full[1::2, ::2] & full[::2, 1::2] & full[1::2, 1::2]
        y, x = (2 * index for index in np.nonzero(blocks))  # of four full ones the first stands for all
        inside = (left <= x) & (x < right - 1) & (top <= y) & (y < bottom - 1)
        x, y = x[inside], y[inside]
        share = np.stack([x + 0.5 - left, bottom - (y + 0.5)], axis=1) / [right - left, bottom - top]
        plane = row[3, :2] + share * (row[3, 2:] - row[3, :2])
        depth = row[1, 3] + relief[y // 2, x // 2, 2] * (row[2, 3] - row[1, 3])
        places = np.column_stack([plane, depth]) @ row[:3, :3] + found.center
        away = places[:, None] - tree.leaves.centers
        off = np.abs(np.einsum("pli,li->pl", away, tree.leaves.normals))
        on_leaf = (off < 0.02) & (np.linalg.norm(away, axis=2) < 0.2 * np.sqrt(2) + 0.02)
        assert on_leaf.any(axis=1).mean() > 0.9  # a texel that two leaves share is at neither
        seen |= set(on_leaf.argmax(axis=1).tolist())
    assert len(seen) == tree.leaves.count  # each leaf is somewhere


def test_nothing_of_the_tree_is_left_out_of_its_pictures() -> None:
    tree, found = crown(), baked("ring", 1)
    size = texel_size(found).mean()
    for number, frame in enumerate(frames(found)):
        for center, normal in zip(tree.leaves.centers, tree.leaves.normals, strict=True):
            if abs(normal @ frame[2]) < 0.3:
                continue  # too thin
            across = frame[:2] @ (center - found.center)
            left, bottom, right, top = found.pictures[number, 3]
            assert left < across[0] < right
            assert bottom < across[1] < top
            x0, _, _, y1 = texel_rectangles(found)[number]
            x, y = int(x0 + (across[0] - left) / size), int(y1 - (across[1] - bottom) / size)
            assert found.atlas.coverage.pixels[y, x, 0] > 127


def test_pictures_are_cut_to_what_they_show() -> None:
    found = baked("ring", 1)
    for left, top, right, bottom in texel_rectangles(found):
        alpha = found.atlas.coverage.pixels[top:bottom, left:right, 0]
        assert all(edge.max() > 0.07 * 255 for edge in (alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]))


@LAYOUTS
def test_pictures_lie_apart_by_two_gutters(layout: str) -> None:
    assert_apart(texel_rectangles(baked(layout)), 2 * SMALL.gutter)


def assert_apart(rectangles: Ints, gutter: int) -> None:
    for (l0, t0, r0, b0), (l1, t1, r1, b1) in combinations(rectangles.tolist(), 2):
        assert l0 - r1 >= gutter or l1 - r0 >= gutter or t0 - b1 >= gutter or t1 - b0 >= gutter


@pytest.mark.parametrize("texels", [32, 50])
def test_the_longest_side_has_as_many_texels_as_asked_for(texels: int) -> None:
    (impostor,) = views([crown()], replace(SMALL, texels=texels))
    assert np.allclose(texel_size(impostor.views), np.ptp(both(crown()).bounds, axis=0).max() / texels, rtol=1e-4)


def test_a_nearer_picture_shows_the_nearer_leaves() -> None:
    colors = [(0.8, 0, 0), (0, 0.8, 0), (0, 0, 0.8)]
    tree = leaf_tree([(0, 0, 0.6), (0, 0, 0.0), (0, 0, -0.6)], [(0.1, 0, 1)] * 3, size=1.0)
    materials = tuple(Material(str(color), base_color=(*color, 1.0), double_sided=True) for color in colors)
    number = np.arange(3, dtype=np.int32).repeat(2)
    tree = replace(tree, foliage=replace(tree.foliage, materials=materials, face_material=number))
    (impostor,) = views([tree], replace(SMALL, layers=2))
    for view, (front, back) in ((0, (0, 2)), (2, (2, 0))):
        for layer, (own, other) in enumerate(((front, back), (back, front))):
            left, top, right, bottom = (texel_rectangles(impostor.views)[2 * view + layer] + 1) // 2
            shown = impostor.views.atlas.albedo.pixels[top : bottom - 1, left : right - 1, :3].astype(int)
            assert (shown[..., other] < 40).all()
            assert (shown[..., own] > 200).any()


def of_all(impostors: tuple[Impostor, ...]) -> list[np.ndarray]:
    """Every array that is published."""
    found: list[np.ndarray] = []
    for impostor in impostors:
        atlas = impostor.views.atlas
        images = [image.pixels for image in (atlas.coverage, atlas.albedo, atlas.relief)]
        rest = [np.asarray(value) for value in astuple(replace(impostor.views, atlas=0))]
        maps = [getattr(impostor.standard.materials[0], name).pixels for name in ("color_map", "normal_map")]
        mesh = [impostor.standard.positions, impostor.standard.uvs, impostor.standard.faces]
        found += [*images, *rest, *maps, *mesh]
    return found


def test_two_runs_give_the_same_bytes() -> None:
    one, other = (of_all(views([crown()], SMALL)) for _ in range(2))
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a, b)


# ---- several trees -------------------------------------------------------------------------------------------------


@cache
def shared() -> tuple[Views, Views]:
    """The crown, and a tree half as large."""
    leaves = random_leaves(8, 20, spread=0.3)
    small = leaf_tree(leaves.centers, leaves.normals, size=0.1)
    one, other = (impostor.views for impostor in views([crown(), small], SMALL))
    return one, other


def test_trees_share_one_atlas() -> None:
    one, other = shared()
    assert one.atlas is other.atlas
    assert_apart(np.concatenate([texel_rectangles(one), texel_rectangles(other)]), 2 * SMALL.gutter)


def test_texels_are_equally_large_on_all_trees_that_share() -> None:
    one, other = shared()
    largest = np.ptp(both(crown()).bounds, axis=0).max() / SMALL.texels
    assert np.allclose(texel_size(one), largest, rtol=1e-4)
    assert np.allclose(texel_size(other), largest, rtol=1e-4)


def test_each_tree_keeps_its_own_center_and_pictures() -> None:
    one, other = shared()
    assert len(one.pictures) == len(other.pictures)
    assert other.radius < 0.8 * one.radius
    assert np.allclose(one.center, baked().center)
    rectangles, alone = texel_rectangles(one), texel_rectangles(baked())
    for (l0, t0, r0, b0), (l1, t1, r1, b1) in zip(rectangles, alone, strict=True):
        np.testing.assert_array_equal(
            one.atlas.coverage.pixels[t0:b0, l0:r0], baked().atlas.coverage.pixels[t1:b1, l1:r1]
        )


# ---- for any viewer ------------------------------------------------------------------------------------------------


def test_two_crossed_cards_stand_for_the_tree() -> None:
    ((impostor,), mesh) = views([crown()], SMALL), both(crown())
    cards = impostor.standard
    assert cards.triangles == 4
    (material,) = cards.materials
    assert (material.name, material.alpha_mode, material.double_sided) == ("views", AlphaMode.MASK, True)
    room = 4 * np.ptp(mesh.bounds, axis=0).max() / SMALL.texels
    assert np.abs(cards.bounds - mesh.bounds).max() < room
    middle = mesh.bounds.mean(axis=0)
    assert np.allclose(cards.positions[:4, 2], middle[2], atol=1e-5)  # one across Z, one across X
    assert np.allclose(cards.positions[4:, 0], middle[0], atol=1e-5)


# ---- few and odd trees ---------------------------------------------------------------------------------------------


def shown(found: Views, view: int) -> float:
    """Texels that the layers of a view cover."""
    rectangles = texel_rectangles(found)[view * found.layers : (view + 1) * found.layers]
    return sum(
        found.atlas.coverage.pixels[top:bottom, left:right, 0].sum() / 255 for left, top, right, bottom in rectangles
    )


@pytest.mark.parametrize(
    "made",
    [
        lambda: tree_of(stem(), 0),
        lambda: leaf_tree(crown().leaves.centers, crown().leaves.normals, size=0.2),
        lambda: leaf_tree([(0.3, 5.0, 0.2)], (0.48, 0.6, 0.64)),
        lambda: tree_of(empty(), 3),
    ],
    ids=["without foliage", "without trunk", "one leaf", "three triangles"],
)
@LAYOUTS
def test_odd_trees_are_photographed_too(made: Callable[[], Tree], layout: str) -> None:
    (impostor,) = views([made()], replace(SMALL, layout=layout))
    found = impostor.views
    assert all(np.isfinite(value).all() for value in (found.pictures, found.support, found.center, found.radius))
    assert max(shown(found, view) for view in range(len(frames(found)))) > 3


@pytest.mark.parametrize("layers", [1, 2, 3])
@pytest.mark.parametrize("azimuth", [0.0, 45.0])
def test_a_flat_tree_is_whole_from_its_front(azimuth: float, layers: int) -> None:
    turn = turn_to(0.0, azimuth)
    across = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    tree = leaf_tree(across @ turn[:2] + 0.3 * turn[2], turn[2], size=0.3)
    whole, found = (views([tree], replace(SMALL, count=8, layers=count))[0].views for count in (1, layers))
    front = round(azimuth / 45)
    assert shown(found, front) >= shown(whole, front) > 100


def test_crossed_cards_are_whole_from_the_front_of_each() -> None:
    tree = leaf_tree([(0.0, 0.5, 0.0)] * 2, [(0, 0, 1), (1, 0, 0)], size=1.0)
    one, two = (views([tree], replace(SMALL, layers=layers))[0].views for layers in (1, 2))
    for view in range(4):
        assert shown(two, view) >= shown(one, view) > 900  # 32 x 32


def test_a_vertex_that_no_face_uses_is_no_part_of_the_tree() -> None:
    mesh = crown().foliage
    stray = replace(mesh, positions=np.r_[mesh.positions, [[90, 90, 90]]].astype(np.float32))
    stray = replace(stray, normals=np.r_[mesh.normals, [[0, 1, 0]]].astype(np.float32))
    stray = replace(stray, uvs=np.r_[mesh.uvs, [[0, 0]]].astype(np.float32))
    one, other = (views([replace(crown(), foliage=each)], SMALL)[0].views for each in (mesh, stray))
    assert other.radius == one.radius
    np.testing.assert_array_equal(one.pictures, other.pictures)


# ---- what is refused -----------------------------------------------------------------------------------------------

REFUSED = [
    ("layout", "cube", '"ring" or "hemi"'),
    *[("count", value, "2 to 64, for example 8") for value in (0, 1, 65)],
    *[("side", value, "2 to 32, for example 12") for value in (0, 1, 33)],
    *[("layers", value, "1 to 8, for example 3") for value in (0, 9)],
    *[("texels", value, "16 to 1024, for example 128") for value in (15, 1025)],
    *[("atlas", value, "a power of two from 64 to 16384") for value in (0, 32, 100, 32768)],
    *[("gutter", value, "a power of two from 1 to 64") for value in (0, 3, 128)],
    *[("supersample", value, "1 to 4") for value in (0, 5)],
]


@pytest.mark.parametrize(("name", "value", "hint"), REFUSED)
def test_a_setting_out_of_range_is_named_with_what_works(name: str, value: object, hint: str) -> None:
    with pytest.raises(SettingsError) as caught:
        views([crown()], replace(SMALL, **{name: value}))
    assert str(caught.value) == f"[views] {name} is {value}; it must be {hint}"


@pytest.mark.parametrize(
    "change",
    [{"count": 2}, {"side": 2, "layout": "hemi"}, {"layers": 8}, {"texels": 16}, {"gutter": 1}, {"supersample": 1}],
    ids=str,
)
def test_the_least_and_most_of_the_settings_work(change: dict[str, object]) -> None:
    (impostor,) = views([leaf_tree([(0.0, 1.0, 0.0)], (0.48, 0.6, 0.64))], replace(SMALL, **change))
    assert impostor.views.atlas.coverage.pixels.any()


def test_an_atlas_too_small_names_one_that_is_large_enough() -> None:
    with pytest.raises(BudgetError) as caught:
        views([crown()], replace(SMALL, atlas=64))
    text = str(caught.value)
    found = re.fullmatch(
        r"8 pictures do not fit into an atlas of 64 texels a side; set \[views\] atlas = (\d+), "
        r"or lower \[views\] texels, layers, count or side",
        text,
    )
    assert found
    enough = int(found[1])
    views([crown()], replace(SMALL, atlas=enough))
    with pytest.raises(BudgetError):
        views([crown()], replace(SMALL, atlas=enough // 2))


def test_no_atlas_is_proposed_that_the_settings_refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    # As large as a few hundred pictures of 1024 texels are together.
    monkeypatch.setattr(sys.modules["treebake.stages.views.views"], "trimmed", lambda _used: (0, 0, 16000, 16000))
    with pytest.raises(BudgetError) as caught:
        views([leaf_tree([(0.0, 1.0, 0.0)])], replace(SMALL, atlas=16384))
    proposed = re.search(r"atlas = (\d+)", str(caught.value))
    assert proposed is None or int(proposed[1]) <= 16384
