"""The corners of leaves, fitted to the sky that their vertices see, and every image that shows it."""

from dataclasses import replace

import numpy as np
import pytest
from foliage import leaf_tree, planes, random_leaves, rotation
from stems import stem, tree_of

from treebake.gl.photo import Shot, photograph
from treebake.lookup import ambient_at
from treebake.model import Doubles, Floats, Mesh, Tree
from treebake.stages.billboards import BillboardSettings, billboards
from treebake.stages.indirect import IndirectSettings, indirect
from treebake.stages.indirect.ambient import ambient
from treebake.stages.indirect.poses import poses
from treebake.stages.indirect.shapes import find_shapes
from treebake.stages.twigs import TwigSettings, twigs

ONE = [[(0.0, 0.0, 0.0)], [(0.0, 0.0, 1.0)]]


def with_sky(tree: Tree, sky: object) -> Tree:
    """The tree with what the foliage's vertices see."""
    seen = np.broadcast_to(np.asarray(sky, np.float32), len(tree.foliage.positions)).copy()
    return replace(tree, foliage=replace(tree.foliage, occlusion=seen))


def corners(tree: Tree) -> Floats:
    exact = poses(tree.foliage, tree.leaves, find_shapes(tree.foliage, tree.leaves))
    return ambient(tree.foliage, tree.leaves, exact) / np.float32(255)


def field(points: Doubles) -> Doubles:
    """A sky that brightens to the right and upwards."""
    return np.asarray(0.5 + points @ [0.8, 0.6, -0.4])


def test_corners_are_named_around_the_image() -> None:
    tree = leaf_tree(*ONE)  # left bottom, right bottom, right top, left top
    found = corners(with_sky(tree, [0.2, 0.4, 0.6, 0.8]))
    assert found == pytest.approx(np.array([[0.8, 0.6, 0.4, 0.2]]), abs=0.03)


def test_without_occlusion_all_of_the_sky_is_seen() -> None:
    tree = leaf_tree(*ONE)
    exact = poses(tree.foliage, tree.leaves, find_shapes(tree.foliage, tree.leaves))
    assert (ambient(tree.foliage, tree.leaves, exact) == 255).all()


def test_of_equal_vertices_all_corners_are_equal() -> None:
    tree = with_sky(leaf_tree([(0, 0, 0), (1, 2, 3)], [(1, 1, 1), (0, 1, 0)]), 0.6)
    assert (corners(tree) == np.float32(153) / 255).all()


def test_a_leaf_of_one_triangle_and_one_without_area_have_corners() -> None:
    tree = leaf_tree([(0, 0, 0)])
    mesh = tree.foliage.select(np.array([True, False]))
    leaves = replace(tree.leaves, face_leaf=np.zeros(1, np.int32))
    one = replace(tree, foliage=mesh, leaves=leaves)
    found = corners(with_sky(one, [0.2, 0.4, 0.6]))  # left bottom, right bottom, right top
    assert found[0, [3, 2, 1]] == pytest.approx([0.2, 0.4, 0.6], abs=0.06)
    assert 0.2 < found[0, 0] < 0.6  # of which nothing tells
    flat = replace(one, foliage=replace(mesh, positions=mesh.positions * np.float32((1, 0, 1))))
    assert np.isfinite(corners(with_sky(flat, 0.5))).all()


def test_twigs_vary_along_themselves_only() -> None:
    tree = tree_of(stem(radii=(0.02, 0.02, 0.02), length=3.0))
    moved = twigs(tree, TwigSettings(radius=0.5))
    twig = moved.leaves.is_twig
    assert twig.any()
    height = moved.foliage.positions[:, 1] / 3
    left_top, right_top, right_bottom, left_bottom = corners(with_sky(moved, height))[twig].T
    assert (left_top == right_top).all()
    assert (left_bottom == right_bottom).all()
    middle = moved.leaves.centers[twig, 1] / 3
    np.testing.assert_allclose((left_top + left_bottom) / 2, middle, atol=0.01)
    assert (np.abs(left_top - left_bottom) > 0.01).all()


def _transforms(tree: Tree, mirrored: bool) -> Doubles:
    """What takes the first leaf's square onto the others', left onto right where mirrored."""
    spans = tree.foliage.positions.reshape(-1, 4, 3).astype(np.float64)
    spans = spans - tree.leaves.centers[:, None]
    frames = np.stack([spans[:, 1] - spans[:, 0], spans[:, 3] - spans[:, 0]], axis=1)
    frames = np.concatenate([frames, np.cross(frames[:, 0], frames[:, 1])[:, None]], axis=1)
    frames /= np.linalg.norm(frames, axis=2, keepdims=True)
    flips = np.where(np.arange(len(frames))[:, None] * mirrored > 0, (-1, 1, 1), (1, 1, 1))
    linear = np.einsum("nki,nk,kj->nij", frames, flips, frames[0])
    moves = tree.leaves.centers - np.einsum("nij,j->ni", linear, tree.leaves.centers[0])
    return np.concatenate([linear, moves[..., None]], axis=2)


@pytest.mark.parametrize("mirrored", [False, True])
def test_tables_tell_what_a_place_on_a_leaf_sees(mirrored: bool) -> None:
    random = np.random.default_rng(0)
    tree = leaf_tree(random.uniform(-0.2, 0.2, (6, 3)), np.stack([rotation(seed)[2] for seed in range(6)]))
    tree = replace(tree, leaves=replace(tree.leaves, transforms=_transforms(tree, mirrored)))  # a square may be either
    tree = with_sky(tree, field(tree.foliage.positions.astype(np.float64)))
    textures = indirect(tree, planes(np.zeros(6), (0, 0, 1), 0), IndirectSettings(cell=2.0))
    places = np.array([(-0.5, -0.5), (0.5, 0.25), (0.0, 0.0), (-1.0, 1.0)])
    exact = poses(tree.foliage, tree.leaves, find_shapes(tree.foliage, tree.leaves))
    for place in places:
        points = exact.centers + np.einsum("ni,nij->nj", place * exact.halves[:, :2], exact.frames[:, :2])
        found = ambient_at(textures, np.arange(6, dtype=np.int32), np.tile(place, (6, 1)))
        np.testing.assert_allclose(found, field(points), atol=0.02)


def shot(mesh: Mesh) -> Shot:
    everything = np.arange(mesh.triangles, dtype=np.int32)
    box = np.full(3, 0.2)
    return Shot(np.eye(3), -box, box, (8, 8), everything, everything[:0], (-1e9, 1e9))


def test_images_show_it() -> None:
    tree = with_sky(leaf_tree(*ONE, size=0.4), 0.4)
    (photo,) = photograph(tree.foliage, [shot(tree.foliage)], 2)
    np.testing.assert_allclose(photo.relief[..., 3], 0.4, atol=1e-3)
    clusters = planes([0], (0, 0, 1), 0)
    cloud = billboards(tree, clusters, BillboardSettings(atlas=64)).mesh.materials[0]
    assert cloud.occlusion_map is not None
    assert cloud.color_map is not None
    height, width = cloud.color_map.pixels.shape[:2]
    assert cloud.occlusion_map.pixels.shape == (height // 2, width // 2, 4)
    assert (cloud.occlusion_map.pixels == (102, 102, 102, 255)).all()  # around the leaf too
    far = indirect(tree, clusters, IndirectSettings()).far_normal.pixels
    assert np.abs(far[..., 3].astype(int) - 102).max() <= 1


def test_where_all_of_the_sky_is_seen_there_is_no_map() -> None:
    tree = leaf_tree(random_leaves(0, 3).centers)
    cloud = billboards(tree, planes([0, 0, 0], (0, 0, 1), 0), BillboardSettings(atlas=64))
    assert cloud.mesh.materials[0].occlusion_map is None
