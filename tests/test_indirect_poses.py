"""Where leaves lie: shapes, poses and boxes agree with the meshes that they were found in."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foliage import GREEN, frozen, planes, rotation
from hypothesis import given, settings
from hypothesis import strategies as st
from stems import empty, mesh_of

from treebake.model import Clusters, Doubles, Leaves, Material, Tree
from treebake.stages.indirect.boxes import box
from treebake.stages.indirect.poses import Poses, laid_flat, poses, snapped
from treebake.stages.indirect.shapes import Shapes, faces_of, find_shapes

seeds = st.integers(0, 2**32 - 1)
few = settings(max_examples=15, deadline=None)
SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])

# A bent leaf without symmetry, counter-clockwise seen from +Z, and where its vertices lie in the texture.
BENT = np.array([(-0.4, -0.5, 0.0), (0.5, -0.4, 0.1), (0.3, 0.7, 0.25), (-0.4, 0.4, 0.05)])
BENT_UVS = np.array([(0.1, 0.9), (0.9, 0.8), (0.7, 0.1), (0.1, 0.2)])
FACES = np.array([(0, 1, 2), (0, 2, 3)])
SQUARE = np.array([(-0.5, -0.5, 0.0), (0.5, -0.5, 0.0), (0.5, 0.5, 0.0), (-0.5, 0.5, 0.0)])


def copies(
    transforms: Doubles,
    points: Doubles = BENT,
    uvs: Doubles = BENT_UVS,
    faces: object = FACES,
    *,
    axes: object | None = None,
    materials: tuple[Material, ...] = (GREEN,),
    material: object = 0,
) -> Tree:
    """Leaves that are copies of the first; transforms: (N, 3, 4), those of determinant below 0 mirror.

    axes: (N, 3), makes twig pieces of those that have one. material: number of each leaf's, or one.
    """
    count, index = len(transforms), np.asarray(faces)
    placed = np.einsum("nij,vj->nvi", transforms[:, :, :3], points) + transforms[:, None, :, 3]
    mirrors = np.linalg.det(transforms[:, :, :3]) < 0
    wound = np.where(mirrors[:, None, None], index[:, [0, 2, 1]], index)  # as the split finds them: wound the other way
    all_faces = wound + np.arange(count)[:, None, None] * len(points)
    mesh = mesh_of(placed.reshape(-1, 3), all_faces.reshape(-1, 3), np.tile(uvs, (count, 1)))
    each = np.broadcast_to(np.asarray(material), count)
    mesh = replace(mesh, materials=materials, face_material=each.repeat(len(index)).astype(np.int32))
    corners = placed[np.arange(count)[:, None, None], wound]
    sides = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    areas = np.linalg.norm(sides, axis=2) / 2
    normals = sides.sum(axis=1)
    centers = (corners.mean(axis=2) * areas[:, :, None]).sum(axis=1) / areas.sum(axis=1)[:, None]
    first = np.linalg.inv(np.vstack([transforms[0], (0, 0, 0, 1)]))
    leaves = Leaves(
        face_leaf=np.arange(count, dtype=np.int32).repeat(len(index)),
        centers=centers,
        normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
        areas=areas.sum(axis=1),
        radii=np.linalg.norm(placed - centers[:, None], axis=2).max(axis=1),
        axes=np.zeros((count, 3)) if axes is None else np.array(axes, np.float64),
        shape=np.zeros(count, np.int32),
        exemplars=np.zeros(1, np.int32),
        transforms=transforms[:, :, :3] @ first[:3] + np.pad(transforms[:, :, 3:], ((0, 0), (0, 0), (3, 0))),
    )
    return frozen(Tree(trunk=empty(), foliage=mesh, leaves=leaves, decisions=()))


def motions(seed: int, count: int = 8) -> Doubles:
    """Random similarities (N, 3, 4), every other one with a reflection."""
    random = np.random.default_rng(seed)
    turns = np.stack([rotation(int(each)) for each in random.integers(0, 2**31, count)])
    turns[1::2] *= -1
    linear = turns * random.uniform(0.2, 1.5, (count, 1, 1))
    return np.concatenate([linear, random.uniform(-1, 1, (count, 3, 1))], axis=2)


def posed(tree: Tree) -> tuple[Shapes, Poses]:
    shapes = find_shapes(tree.foliage, tree.leaves)
    return shapes, poses(tree.foliage, tree.leaves, shapes)


def assert_frames(frames: Doubles) -> None:
    np.testing.assert_allclose(frames @ np.swapaxes(frames, 1, 2), np.tile(np.eye(3), (len(frames), 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(frames), 1)


def from_images(images: Doubles, at: Poses) -> Doubles:
    """Image coordinates (N, V, 3) of the leaves' vertices in the tree's frame, as FORMAT.md has it."""
    sideways = np.where(at.mirrored, -1.0, 1.0)[:, None] * (1, 0, 0) + (0, 1, 1)
    edges = at.frames * (at.halves * sideways)[:, :, None]
    return at.centers[:, None] + np.einsum("nvi,nij->nvj", images, edges)


def on_image(points: Doubles, shapes: Shapes, shape: int) -> Doubles:
    """Points of an exemplar (V, 3) on its image: right, down, away, all -1..1."""
    return (points - shapes.centers[shape]) @ shapes.frames[shape].T / shapes.halves[shape]


# ---- poses ---------------------------------------------------------------------------------------------------------


@few
@given(seeds)
def test_every_vertex_is_where_its_pose_says(seed: int) -> None:
    tree = copies(motions(seed))
    shapes, at = posed(tree)
    vertices = tree.foliage.positions.reshape(-1, len(BENT), 3).astype(np.float64)
    image = on_image(vertices[0], shapes, 0)
    assert np.abs(image).max() == pytest.approx(1)
    np.testing.assert_allclose(from_images(np.tile(image, (len(vertices), 1, 1)), at), vertices, atol=1e-6)
    assert at.mirrored.any()
    assert not at.mirrored.all()


@few
@given(seeds)
def test_frames_are_right_handed_and_unit(seed: int) -> None:
    shapes, at = posed(copies(motions(seed)))
    assert_frames(shapes.frames)
    assert_frames(at.frames)


@few
@given(seeds)
def test_a_leafs_image_is_seen_from_its_front(seed: int) -> None:
    tree = copies(motions(seed))
    _, at = posed(tree)
    np.testing.assert_allclose(at.frames[:, 2], -tree.leaves.normals, atol=1e-6)


def test_sizes_are_those_of_the_copies() -> None:
    moved = motions(3)
    _, at = posed(copies(moved))
    scale = np.cbrt(np.abs(np.linalg.det(moved[:, :, :3])))
    np.testing.assert_allclose(at.halves / scale[:, None], np.tile(at.halves[0] / scale[0], (len(scale), 1)), rtol=1e-6)


def test_the_first_of_the_copies_may_be_the_mirrored_one() -> None:
    moved = motions(4)[::-1]
    tree = copies(moved)
    shapes, at = posed(tree)
    vertices = tree.foliage.positions.reshape(-1, len(BENT), 3).astype(np.float64)
    image = on_image(vertices[0], shapes, 0)
    np.testing.assert_allclose(from_images(np.tile(image, (len(vertices), 1, 1)), at), vertices, atol=1e-6)
    assert not at.mirrored[0]
    assert at.mirrored[1]


# ---- shapes --------------------------------------------------------------------------------------------------------


def upright(points: Doubles = SQUARE, uvs: object = ((0, 1), (1, 1), (1, 0), (0, 0)), faces: object = FACES) -> Tree:
    return copies(np.eye(3, 4)[None], points, np.array(uvs, np.float64), faces)


@pytest.mark.parametrize("turns", range(4))
def test_an_image_lies_along_its_texture(turns: int) -> None:
    uvs = np.roll([(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 0.0)], turns, axis=0)
    shapes = find_shapes(upright(uvs=uvs).foliage, upright(uvs=uvs).leaves)
    right, down = SQUARE[uvs.tolist().index([1, 1])] - SQUARE[uvs.tolist().index([0, 1])], shapes.frames[0, 1]
    np.testing.assert_allclose(shapes.frames[0, 0], right, atol=1e-6)
    np.testing.assert_allclose(down, SQUARE[uvs.tolist().index([0, 1])] - SQUARE[uvs.tolist().index([0, 0])], atol=1e-6)


def test_a_reversed_texture_keeps_the_frame_right_handed() -> None:
    tree = upright(uvs=[(1, 1), (0, 1), (0, 0), (1, 0)])
    shapes = find_shapes(tree.foliage, tree.leaves)
    assert_frames(shapes.frames)
    np.testing.assert_allclose(np.abs(shapes.frames[0, 0]), (1, 0, 0), atol=1e-6)


@pytest.mark.parametrize("uvs", [np.zeros((5, 2)), np.full((5, 2), 0.3), np.linspace(0, 1, 5)[:, None] * (1, 1)])
def test_without_texture_coordinates_an_image_lies_along_the_leaf(uvs: object) -> None:
    fan = [(4, side, (side + 1) % 4) for side in range(4)]
    long = np.vstack([SQUARE, (0, 0, 0)]) * (0.2, 1, 1) @ rotation(3).T
    tree = upright(long, uvs, fan)
    shapes = find_shapes(tree.foliage, tree.leaves)
    assert_frames(shapes.frames)
    np.testing.assert_allclose(shapes.halves[0, :2], (0.5, 0.1), rtol=1e-5)


def test_a_leaf_of_one_triangle_has_a_flat_box() -> None:
    tree = upright(SQUARE[:3], [(0, 1), (1, 1), (1, 0)], FACES[:1])
    shapes, at = posed(tree)
    assert_frames(at.frames)
    np.testing.assert_allclose(shapes.centers, [(0, 0, 0)], atol=1e-7)
    np.testing.assert_allclose(at.halves[0], (0.5, 0.5, 0), atol=1e-7)
    assert (at.halves > 0).all()  # is divided by


@few
@given(seeds)
def test_a_box_fits_tight_around_its_leaf(seed: int) -> None:
    tree = copies(motions(seed))
    shapes, _ = posed(tree)
    image = on_image(tree.foliage.positions[: len(BENT)].astype(np.float64), shapes, 0)
    np.testing.assert_allclose([image.min(axis=0), image.max(axis=0)], [(-1, -1, -1), (1, 1, 1)], atol=1e-5)


def test_faces_of_leaves_come_leaf_by_leaf() -> None:
    leaves = replace(copies(motions(1, 3)).leaves, face_leaf=np.array([2, 0, 1, 2, 0, 1], np.int32))
    faces, row = faces_of(leaves, np.array([2, 0], np.int32))
    assert faces.tolist() == [0, 3, 1, 4]
    assert row.tolist() == [0, 0, 1, 1]


# ---- twig pieces ---------------------------------------------------------------------------------------------------


@cache
def twigs() -> Tree:
    """Two leaves and four pieces of different lengths, along +Y in its own frame, of two materials."""
    moved = motions(8, 6)
    moved[:, :, :3] = np.stack([rotation(i) for i in range(6)]) * np.array([1, 1, 0.5, 1, 1.5, 2])[:, None, None]
    axes = np.where(np.arange(6)[:, None] < 2, 0, moved[:, :, 1])
    axes[2:] /= np.linalg.norm(axes[2:], axis=1, keepdims=True)
    bark = Material("bark")
    strip = SQUARE * (0.1, 1, 1) + (0, 0.3, 0)
    tree = copies(moved, strip, BENT_UVS, axes=axes, materials=(GREEN, bark, bark), material=(0, 0, 1, 1, 1, 2))
    # Every piece of a twig is a shape of its own to the split.
    own = np.arange(6, dtype=np.int32)
    own[1] = 0
    exemplars, shape = np.unique(own, return_inverse=True)
    transforms = tree.leaves.transforms.copy()
    transforms[2:] = np.eye(3, 4)
    return frozen(replace(tree, leaves=replace(tree.leaves, shape=shape, exemplars=exemplars, transforms=transforms)))


def test_twig_pieces_share_one_shape_per_material() -> None:
    shapes, _ = posed(twigs())
    assert shapes.of_leaf.tolist() == [0, 0, 1, 1, 1, 2]
    assert shapes.is_twig.tolist() == [False, True, True]
    assert shapes.exemplars.tolist() == [0, 3, 5]  # of three pieces the middle one


def test_twig_pieces_are_rods_along_their_axes() -> None:
    tree = twigs()
    _, at = posed(tree)
    leaves, pieces = tree.leaves, slice(2, None)
    assert_frames(at.frames)
    np.testing.assert_allclose(at.frames[pieces, 1], leaves.axes[pieces], atol=1e-9)
    np.testing.assert_allclose(2 * at.halves[pieces, 1], (0.5, 1, 1.5, 2), rtol=1e-5)
    np.testing.assert_allclose(2 * at.halves[pieces, 0], np.array((0.5, 1, 1.5, 2)) * 0.1, rtol=1e-5)
    np.testing.assert_array_equal(at.halves[pieces, 0], at.halves[pieces, 2])
    middles = tree.foliage.positions.reshape(6, 4, 3).mean(axis=1)
    np.testing.assert_allclose(at.centers, middles, atol=1e-6)
    assert not at.mirrored.any()


def test_a_twigs_image_runs_down_along_its_axis() -> None:
    tree = twigs()
    shapes, _ = posed(tree)
    np.testing.assert_allclose(shapes.frames[1:, 1], tree.leaves.axes[shapes.exemplars[1:]], atol=1e-9)


def test_a_piece_off_its_centre_is_moved_along_its_axis_only() -> None:
    # Heavier at one end, as a tapering piece is: its centre of area is not the middle of its length.
    wedge = np.array([(-0.1, -0.5, 0.0), (0.1, -0.5, 0.0), (0.01, 0.5, 0.0), (-0.01, 0.5, 0.0)])
    tree = copies(np.eye(3, 4)[None], wedge, axes=[(0.0, 1.0, 0.0)])
    assert tree.leaves.centers[0, 1] < -0.1
    _, at = posed(tree)
    np.testing.assert_allclose(at.centers, [(0, 0, 0)], atol=1e-6)
    np.testing.assert_allclose(at.halves[0], (0.055, 0.5, 0.055), rtol=1e-4)


# ---- laid flat -----------------------------------------------------------------------------------------------------


def split_in_two(tree: Tree) -> Clusters:
    """Two planes, neither of which is a leaf's own."""
    labels = np.arange(tree.leaves.count) % 2
    return planes(labels, [(0.6, 0.0, 0.8), (0.0, -1.0, 0.0)], [0.3, 0.2])


@few
@given(seeds)
def test_leaves_laid_flat_lie_in_their_planes(seed: int) -> None:
    tree = copies(motions(seed))
    _, exact = posed(tree)
    clusters = split_in_two(tree)
    flat = laid_flat(exact, tree.leaves, clusters)
    normals = clusters.normals[clusters.labels]
    away = np.einsum("ni,ni->n", flat.centers, normals) + clusters.offsets[clusters.labels]
    np.testing.assert_allclose(away, 0, atol=1e-9)
    assert_frames(flat.frames)
    np.testing.assert_allclose(np.abs(np.einsum("ni,ni->n", flat.frames[:, 2], normals)), 1)
    np.testing.assert_array_equal(flat.halves, exact.halves * (1, 1, 0))
    np.testing.assert_array_equal(flat.mirrored, exact.mirrored)
    # They are moved along the normal only, and turned to the side on which their front was.
    np.testing.assert_allclose(np.cross(flat.centers - exact.centers, normals), 0, atol=1e-9)
    fronts = [-np.einsum("ni,ni->n", each.frames[:, 2], normals) for each in (exact, flat)]
    assert (fronts[0] * fronts[1] >= 0).all()


def test_twig_pieces_laid_flat_keep_their_length() -> None:
    tree = twigs()
    _, exact = posed(tree)
    clusters = split_in_two(tree)
    flat = laid_flat(exact, tree.leaves, clusters)
    np.testing.assert_allclose(
        np.einsum("ni,ni->n", flat.frames[2:, 1], clusters.normals[clusters.labels[2:]]), 0, atol=1e-9
    )
    np.testing.assert_array_equal(flat.halves[:, :2], exact.halves[:, :2])


def test_leaves_that_lie_in_their_plane_stay() -> None:
    tree = upright()
    _, exact = posed(tree)
    flat = laid_flat(exact, tree.leaves, planes([0], (0, 0, 1), 0))
    np.testing.assert_allclose(flat.centers, exact.centers, atol=1e-9)
    np.testing.assert_allclose(flat.frames, exact.frames, atol=1e-9)


# ---- snapped -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 4, 7, 360])
@few
@given(seeds)
def test_snapping_turns_by_at_most_half_a_step(count: int, seed: int) -> None:
    _, exact = posed(copies(motions(seed, 16)))
    turned = snapped(exact, count)
    assert_frames(turned.frames)
    np.testing.assert_array_equal(turned.frames[:, 2], exact.frames[:, 2])
    cosine = np.einsum("ni,ni->n", turned.frames[:, 0], exact.frames[:, 0])
    assert cosine.min() >= np.cos(np.pi / count) - 1e-9
    np.testing.assert_array_equal(turned.centers, exact.centers)
    np.testing.assert_array_equal(turned.halves, exact.halves)
    np.testing.assert_allclose(snapped(turned, count).frames, turned.frames, atol=1e-9)


def test_leaves_of_one_plane_are_snapped_to_so_many_directions() -> None:
    angles = np.linspace(0, 2 * np.pi, 50)
    turns = np.zeros((50, 3, 4))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles)
    turns[:, 1, 0], turns[:, 0, 1], turns[:, 2, 2] = np.sin(angles), -np.sin(angles), 1
    _, exact = posed(copies(turns, SQUARE))
    found = np.unique(np.round(snapped(exact, 6).frames[:, 0] + 0.0, 6) + 0.0, axis=0)
    assert len(found) == 6


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0)])
def test_leaves_that_lie_level_can_be_snapped(up: tuple[float, float, float]) -> None:
    turn = np.zeros((1, 3, 4))
    turn[0, :, 0], turn[0, :, 2] = (0.6, 0.0, 0.8), up
    turn[0, :, 1] = np.cross(turn[0, :, 2], turn[0, :, 0])
    _, exact = posed(copies(turn, SQUARE))
    turned = snapped(exact, 8)
    assert_frames(turned.frames)
    assert turned.frames[0, 0] @ exact.frames[0, 0] >= np.cos(np.pi / 8) - 1e-6


# ---- boxes ---------------------------------------------------------------------------------------------------------


def corners_of(at: Poses) -> Doubles:
    """The 8 corners of every leaf's box: (N, 8, 3)."""
    return at.centers[:, None] + np.einsum("si,nij->nsj", SIGNS, at.frames * at.halves[:, :, None])


@few
@given(seeds, st.floats(0.05, 2))
def test_every_leaf_lies_in_its_billboards_box(seed: int, cell: float) -> None:
    tree = copies(motions(seed))
    _, exact = posed(tree)
    clusters = split_in_two(tree)
    both = exact, laid_flat(exact, tree.leaves, clusters)
    boxes = box(clusters, both, cell)
    assert_frames(boxes.frames)
    np.testing.assert_allclose(boxes.frames[:, 2], -clusters.normals)
    for at in both:
        places = boxes.local(corners_of(at).reshape(-1, 3), clusters.labels.repeat(8))
        room = np.column_stack([boxes.sizes * cell, boxes.depths])[clusters.labels.repeat(8)]
        assert (places >= -1e-9).all()
        assert (places <= room + 1e-9).all()


@few
@given(seeds)
def test_boxes_are_as_small_as_whole_cells_allow(seed: int) -> None:
    tree = copies(motions(seed))
    _, exact = posed(tree)
    clusters = split_in_two(tree)
    boxes = box(clusters, (exact,), 0.1)
    places = boxes.local(corners_of(exact).reshape(-1, 3), clusters.labels.repeat(8))
    for board in range(clusters.count):
        inside = places[clusters.labels.repeat(8) == board]
        np.testing.assert_allclose(inside.min(axis=0), 0, atol=1e-9)
        assert inside[:, 2].max() == pytest.approx(boxes.depths[board])
        assert (inside[:, :2].max(axis=0) > (boxes.sizes[board] - 1) * 0.1).all()


def test_the_front_is_on_the_normals_side() -> None:
    near, far = np.eye(3, 4), np.eye(3, 4)
    near[2, 3], far[2, 3] = 1.0, -1.0
    tree = copies(np.stack([near, far]), SQUARE)
    _, exact = posed(tree)
    boxes = box(planes([0, 0], (0, 0, 1), 0.25), (exact,), 1.0)
    places = boxes.local(exact.centers, np.zeros(2, np.int32))
    np.testing.assert_allclose(places[:, 2], (0, 2), atol=1e-6)
    assert boxes.depths[0] == pytest.approx(2)
    assert boxes.planes[0] == pytest.approx(1.25)  # the plane z = -0.25 lies behind z = 1


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 1, 0), (0.48, 0.6, 0.64)])
def test_a_flat_cloud_has_no_thickness(normal: tuple[float, float, float]) -> None:
    tree = copies(motions(2))
    _, exact = posed(tree)
    clusters = planes([0] * 8, normal, 0.7)
    boxes = box(clusters, (laid_flat(exact, tree.leaves, clusters),), 0.2)
    np.testing.assert_allclose(boxes.depths, 0, atol=1e-9)
    np.testing.assert_allclose(boxes.planes, 0, atol=1e-9)


@pytest.mark.parametrize("turn", [0, 30, 45])
def test_a_box_is_turned_to_the_leaf(turn: int) -> None:
    angle = np.radians(turn)
    moved = np.eye(3, 4)[None].copy()
    moved[0, :2, :2] = [(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))]
    tree = copies(moved, SQUARE * (1, 0.2, 1), np.array([(0, 1), (1, 1), (1, 0), (0, 0)]))
    _, exact = posed(tree)
    boxes = box(planes([0], (0, 0, 1), 0), (exact,), 0.101)
    assert sorted(boxes.sizes[0].tolist()) == [2, 10]


def test_a_leaf_seen_edge_on_gets_a_cell_across() -> None:
    tree = upright()
    _, exact = posed(tree)
    boxes = box(planes([0], (1, 0, 0), 0), (exact,), 0.25)
    assert sorted(boxes.sizes[0].tolist()) == [1, 4]
    assert boxes.depths[0] == pytest.approx(1, abs=1e-6)


def test_leaves_and_planes_are_not_changed() -> None:
    # `copies` and `planes` make read-only arrays.
    tree = twigs()
    shapes, exact = posed(tree)
    for value in (shapes, exact):
        frozen(value)
    clusters = split_in_two(tree)
    flat = laid_flat(exact, tree.leaves, clusters)
    box(clusters, (frozen(snapped(exact, 5)), frozen(flat)), 0.3)
