"""Normals turned away from the crown's middle."""

from dataclasses import replace

import numpy as np
import pytest
from foliage import leaf_tree, random_leaves
from hypothesis import given
from hypothesis import strategies as st

from treebake.errors import SettingsError
from treebake.model import Tree
from treebake.stages.normals import NormalSettings, normals

# Right and left of the middle, each facing +X and then -X.
PAIRS = [(1, 0, 0), (1, 0, 0), (-1, 0, 0), (-1, 0, 0)]
FACING = [(1, 0, 0), (-1, 0, 0), (1, 0, 0), (-1, 0, 0)]


def outward(tree: Tree) -> np.ndarray:
    away = tree.foliage.positions - np.average(tree.leaves.centers, axis=0, weights=tree.leaves.areas)
    return np.asarray(away / np.linalg.norm(away, axis=1, keepdims=True))


def test_wholly_turned_each_normal_points_outwards_on_the_side_that_was_outside() -> None:
    tree = leaf_tree(PAIRS, FACING)
    turned = normals(tree, NormalSettings(crown=1.0)).foliage.normals
    side = np.repeat([1, -1, -1, 1], 4)[:, None]
    np.testing.assert_allclose(turned, side * outward(tree), atol=1e-6)


def test_half_turned() -> None:
    tree = leaf_tree([(2, 0, 0), (-2, 0, 0)], shading=(0.6, 0.8, 0), size=1e-3)
    turned = normals(tree, NormalSettings(crown=0.5)).foliage.normals
    expected = np.array([0.6 + 1, 0.8, 0]) / np.hypot(1.6, 0.8)  # on the left it is the back that looks outwards
    np.testing.assert_allclose(turned, np.tile(expected, (8, 1)), atol=1e-3)


@given(seed=st.integers(0, 1000), crown=st.floats(0.01, 1.0))
def test_normals_stay_unit_and_no_leaf_is_turned_inside_out(seed: int, crown: float) -> None:
    leaves = random_leaves(seed, 6)
    tree = leaf_tree(leaves.centers, leaves.normals)
    found = normals(tree, NormalSettings(crown=crown))
    turned = found.foliage.normals.astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1, atol=1e-5)
    own, away = tree.foliage.normals.astype(np.float64), outward(tree)
    before, after = ((each * away).sum(axis=1).reshape(-1, 4).sum(axis=1) for each in (own, turned))
    assert (np.sign(before) == np.sign(after))[np.abs(before) > 1e-3].all()
    assert (np.abs(after) >= np.abs(before) - 1e-6).all()
    assert found.leaves is tree.leaves


def test_nothing_turns_by_default_and_without_leaves() -> None:
    tree, bare = leaf_tree(PAIRS), leaf_tree(np.zeros((0, 3)))
    assert normals(tree, NormalSettings()) is tree
    assert normals(bare, NormalSettings(crown=1.0)) is bare


def test_a_vertex_in_the_middle_keeps_its_normal() -> None:
    tree = leaf_tree([(0, 0, 0)])
    middle = replace(tree, foliage=replace(tree.foliage, positions=tree.foliage.positions * 0))
    np.testing.assert_array_equal(normals(middle, NormalSettings(crown=1.0)).foliage.normals, tree.foliage.normals)


@pytest.mark.parametrize("crown", [-0.1, 1.1])
def test_out_of_range(crown: float) -> None:
    with pytest.raises(SettingsError, match=r"\[normals\] crown"):
        normals(leaf_tree(PAIRS), NormalSettings(crown=crown))
