"""Leaves laid into their planes: turned, never squeezed."""

import numpy as np
import pytest
from foliage import leaf_tree, planes, random_leaves, rotation
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.flatten import FlatLeaves, flatten, plane_frames
from treebake.model import Doubles, Tree

AXES = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, -1, 0), (-1, 0, 0), (0, 0, -1)]


def laid(tree: Tree, normal: object, offset: float = 0.0) -> FlatLeaves:
    """Every leaf of the tree in one plane."""
    return flatten(tree.foliage, tree.leaves, planes([0] * tree.leaves.count, normal, offset))


def areas(corners: Doubles) -> Doubles:
    """Signed area of each triangle (M, 3, 2) in its plane: positive where it faces the viewer."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def centers(flat: FlatLeaves) -> Doubles:
    """The middle of each quad, which is that of its diagonal (the side that its triangles share)."""
    return flat.corners[::2, [0, 2]].mean(axis=1)


@given(seed=st.integers(0, 1000), turn=st.sampled_from([*AXES, None]))
def test_frames_are_right_handed(seed: int, turn: tuple[float, float, float] | None) -> None:
    normal = rotation(seed)[0] if turn is None else np.array(turn, float)
    right, up, out = frame = plane_frames(normal[None])[0]
    assert np.allclose(frame @ frame.T, np.eye(3))
    assert np.linalg.det(frame) == pytest.approx(1)
    assert np.array_equal(out, normal)
    if abs(normal[1]) < 0.99:
        assert right[1] == pytest.approx(0)  # upright, so that a card's rows are level
        assert up[1] > 0


@settings(deadline=None)
@given(seed=st.integers(0, 10**6), offset=st.floats(-3, 3))
def test_leaves_keep_their_area_and_centres_land_in_the_plane(seed: int, offset: float) -> None:
    leaves = random_leaves(seed, 6)
    tree, turn = leaf_tree(leaves.centers, leaves.normals, size=0.2), rotation(seed)
    flat = laid(tree, turn[2], offset)
    assert np.allclose(areas(flat.corners), np.sign(leaves.normals @ turn[2]).repeat(2) * 0.02, atol=1e-7)
    frame = plane_frames(turn[2:])[0]
    assert np.allclose(centers(flat), leaves.centers @ frame[:2].T, atol=1e-6)
    # A flat leaf lies at one depth, that of its centre: the plane's signed distance.
    assert np.allclose(flat.depth, (leaves.centers @ turn[2] + offset)[flat.leaf, None], atol=1e-6)


def test_leaf_facing_backwards_shows_its_back() -> None:
    # Turned by the least angle, at most a right one: its corners stay where they are, only the tilt goes.
    tree = leaf_tree([(0.0, 0.0, 0.0)], (0.0, 0.6, -0.8))
    flat = laid(tree, (0, 0, 1))
    assert (areas(flat.corners) < 0).all()
    before = tree.foliage.positions[tree.foliage.faces[flat.face]]
    assert np.allclose(flat.corners[..., 0], before[..., 0], atol=1e-7)
    assert np.allclose(flat.corners[..., 1], before[..., 1] / 0.8, atol=1e-7)


@pytest.mark.parametrize("normal", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0.6, 0.8, 0)])
def test_leaf_at_right_angles_to_its_plane_is_laid_down(normal: tuple[float, float, float]) -> None:
    flat = laid(leaf_tree([(0.3, 0.2, 0.1)], normal), (0, 0, 1))
    assert np.allclose(np.abs(areas(flat.corners)), 0.02)
    assert np.allclose(flat.depth, 0.1)


def test_leaf_in_its_plane_is_not_touched() -> None:
    tree = leaf_tree([(0.3, 0.2, 2.0)])
    flat = laid(tree, (0, 0, 1), -2.0)
    assert np.allclose(flat.corners, tree.foliage.positions[tree.foliage.faces][..., :2], atol=1e-7)
    assert np.allclose(flat.depth, 0, atol=1e-7)


def test_a_bent_leaf_keeps_its_bend_as_depth() -> None:
    tree = leaf_tree([(0.0, 0.0, 0.0)])
    tree.foliage.positions.flags.writeable = True
    tree.foliage.positions[:, 2] = [0.05, 0, 0.05, 0]
    flat = laid(tree, (0, 0, 1), 1.0)
    assert np.allclose(flat.depth, [[1.05, 1, 1.05], [1.05, 1.05, 1]], atol=1e-7)


def test_normals_stay_those_of_the_source() -> None:
    tree = leaf_tree([(0.0, 0.0, 0.0)], (0.0, 0.6, 0.8), shading=(0.0, 1.0, 0.0))
    flat = laid(tree, (1, 0, 0))
    assert np.allclose(flat.normals, (0, 1, 0))  # up in the world is up in an upright plane
    assert np.allclose(laid(tree, (0, 1, 0)).normals, (0, 0, 1))


@given(seed=st.integers(0, 10**6))
def test_a_twig_is_laid_along_its_axis(seed: int) -> None:
    # A strip whose normal is off the plane's by up to a right angle: only the axis comes into the plane.
    axis, normal, _ = rotation(seed)
    tree = leaf_tree([(0.2, 0.3, 0.4)], normal, axes=axis)
    plane = rotation(seed + 1)[0]
    flat = laid(tree, plane)
    frame = plane_frames(plane[None])[0]
    spokes = np.concatenate([flat.corners, flat.depth[..., None]], axis=2) - frame @ (0.2, 0.3, 0.4)
    sources = tree.foliage.positions[tree.foliage.faces[flat.face]] - np.array((0.2, 0.3, 0.4))
    in_plane = frame[:2] @ axis / np.linalg.norm(frame[:2] @ axis)
    assert np.allclose(spokes[..., :2] @ in_plane, sources @ axis, atol=1e-6)  # lengths along the axis
    assert np.allclose(np.linalg.norm(spokes, axis=2), np.linalg.norm(sources, axis=2), atol=1e-6)  # a rotation


@pytest.mark.parametrize("sign", [1, -1])
def test_a_twig_upright_on_its_plane_falls_over(sign: int) -> None:
    tree = leaf_tree([(0.0, 0.0, 0.0)], (1.0, 0.0, 0.0), axes=(0.0, 0.0, sign))
    flat = laid(tree, (0, 0, 1))
    length = np.ptp(flat.corners.reshape(-1, 2), axis=0)
    assert length[0] == pytest.approx(0.2)  # along the plane's right
    assert np.isfinite(flat.depth).all()


def test_triangles_are_sorted_by_leaf() -> None:
    tree = leaf_tree([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    leaves = tree.leaves
    mixed = flatten(
        tree.foliage,
        type(leaves)(**{**vars(leaves), "face_leaf": np.array([1, 0, 1, 0], np.int32)}),
        planes([0, 0], (0, 0, 1), 0),
    )
    assert mixed.leaf.tolist() == [0, 0, 1, 1]
    assert mixed.face.tolist() == [1, 3, 0, 2]
