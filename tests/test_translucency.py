"""What leaves let through: the source's own, or by their shape, and the mean of all."""

from dataclasses import replace

import numpy as np
import pytest
from foliage import GREEN, frozen, leaf_tree
from stems import empty, tree_of
from synthetic import texture

from treebake.errors import SettingsError
from treebake.geometry import join
from treebake.model import AlphaMode, Material, Transmission, Tree
from treebake.stages.billboards import BillboardSettings, billboards
from treebake.stages.cluster import ClusterSettings, cluster
from treebake.stages.translucency import TranslucencySettings, translucency

AUTO, OFF = TranslucencySettings(), TranslucencySettings(enabled=False)
OWN = Transmission(0.25, (0.5, 0.25, 0.125))
BROAD, NEEDLE = Transmission(0.5, (0.8, 1.0, 0.5)), Transmission(0.18, (0.7, 1.0, 0.45))


def stretched(tree: Tree, along: float) -> Tree:
    """The same squares as rectangles of the same area, longer upwards."""
    corners = tree.foliage.positions.reshape(-1, 4, 3)
    middle = corners.mean(axis=1, keepdims=True)
    longer = (corners - middle) * np.float32([1 / np.sqrt(along), np.sqrt(along), 1])
    radii = np.linalg.norm(longer, axis=2).max(axis=1).astype(np.float64)
    foliage = replace(tree.foliage, positions=(longer + middle).reshape(-1, 3).astype(np.float32))
    return frozen(replace(tree, foliage=foliage, leaves=replace(tree.leaves, radii=radii)))


def mixed(first: Material, second: Material, areas: tuple[float, float] = (1.0, 1.0)) -> Tree:
    """A leaf of each material."""
    tree = leaf_tree([(0, 0, 0), (1, 0, 0)])
    scale = np.sqrt(areas).astype(np.float32).repeat(4)[:, None]
    foliage = replace(
        tree.foliage,
        positions=tree.foliage.positions * scale,
        materials=(first, second),
        face_material=np.int32([0, 0, 1, 1]),
    )
    return frozen(replace(tree, foliage=foliage))


@pytest.mark.parametrize(
    ("along", "kind", "expected", "origin"),
    [
        (1.0, "auto", BROAD, "broad leaf"),
        (8.0, "auto", BROAD, "broad leaf"),
        (12.0, "auto", NEEDLE, "needle"),
        (1.0, "needle", NEEDLE, "needle"),
        (12.0, "broad", BROAD, "broad leaf"),
    ],
)
def test_a_slender_leaf_is_a_needle(along: float, kind: str, expected: Transmission, origin: str) -> None:
    white = replace(GREEN, base_color=(1, 1, 1, 1))
    tree = leaf_tree([(0, 0, 0), (40, 0, 0)], material=white)
    made = translucency(stretched(tree, along), TranslucencySettings(leaf_type=kind))
    assert made.foliage.materials[0].transmission == expected
    assert made.translucency
    assert (made.transmission, made.translucency.origin) == (expected, origin)


def test_slender_leaves_that_are_long_are_no_needles() -> None:
    palm = translucency(stretched(leaf_tree([(0, 0, 0), (3, 0, 0)]), 20.0), AUTO).translucency
    assert palm
    assert palm.origin == "broad leaf"


def test_the_tint_is_a_factor_on_the_base_colour_in_the_material_and_relative_to_it_in_the_mean() -> None:
    made = translucency(leaf_tree([(0, 0, 0)], material=GREEN), AUTO)
    own = made.foliage.materials[0].transmission
    assert own
    np.testing.assert_allclose(own.color, np.multiply(BROAD.color, GREEN.base_color[:3]))
    assert made.transmission == BROAD


def test_the_source_wins_and_the_trunk_and_unused_materials_get_none() -> None:
    spare = Material("spare")
    tree = tree_of(empty())
    foliage = replace(tree.foliage, materials=(replace(GREEN, transmission=OWN), spare))
    made = translucency(replace(tree, foliage=foliage), AUTO)
    assert made.foliage.materials[0] is foliage.materials[0]
    assert made.foliage.materials[1] is spare
    assert made.trunk is tree.trunk
    assert made.translucency
    assert made.translucency.origin == "source"


def test_a_source_that_says_nothing_goes_through_is_believed() -> None:
    dark = replace(GREEN, transmission=Transmission(0.0, (1, 1, 1)))
    assert translucency(leaf_tree([(0, 0, 0)], material=dark), AUTO).translucency is None


def test_disabled_nothing_goes_through_not_even_where_the_source_says_so() -> None:
    tree = leaf_tree([(0, 0, 0)], material=replace(GREEN, transmission=OWN))
    tree = replace(tree, trunk=replace(tree.trunk, materials=tree.foliage.materials))
    made = translucency(tree, OFF)
    assert made.translucency is None
    assert made.foliage.materials[0].transmission is None
    assert made.foliage.materials[0].base_color == GREEN.base_color
    assert len(join(made.trunk, made.foliage).materials) == 1  # trunk and leaves still share it


def test_the_mean_sends_as_much_light_through_as_all_leaves_together() -> None:
    half = texture(np.full((2, 2, 3), 188))  # linear 0.5
    one = Material("one", (1.0, 0.5, 0.25, 1.0), half, transmission=Transmission(0.5, (1.0, 1.0, 0.0)))
    other = Material("other", (0.5, 0.5, 0.5, 1.0), transmission=Transmission(0.25, (0.25, 0.5, 0.75)))
    found = translucency(mixed(one, other, (3.0, 1.0)), AUTO).transmission
    assert found
    seen = 0.75 * np.array([1.0, 0.5, 0.25]) * 0.5 + 0.25 * 0.5
    through = 0.75 * 0.5 * np.array([1.0, 1.0, 0.0]) * 0.5 + 0.25 * 0.25 * np.array([0.25, 0.5, 0.75])
    assert found.factor == pytest.approx(0.75 * 0.5 + 0.25 * 0.25)
    np.testing.assert_allclose(found.factor * np.array(found.color) * seen, through, rtol=0.01)


def test_clear_texels_do_not_count() -> None:
    holed = texture(np.array([[(188, 188, 188, 255), (255, 0, 0, 0)]]))
    plain = texture(np.array([[(188, 188, 188, 255)]]))
    materials = [
        Material("leaf", color_map=each, transmission=OWN, alpha_mode=AlphaMode.MASK) for each in (holed, plain)
    ]
    one, other = (translucency(mixed(each, GREEN), AUTO).transmission for each in materials)
    assert one == other


def test_origins_are_all_named() -> None:
    made = translucency(mixed(GREEN, replace(GREEN, transmission=OWN)), AUTO).translucency
    assert made
    assert made.origin == "broad leaf, source"


def test_twig_pieces_do_not_count() -> None:
    tree = leaf_tree([(0, 0, 0), (1, 0, 0)], axes=[(0, 1, 0), (0, 0, 0)])
    bark = Material("bark")
    tree = replace(tree, foliage=replace(tree.foliage, materials=(bark, GREEN), face_material=np.int32([0, 0, 1, 1])))
    made = translucency(tree, AUTO)
    assert made.foliage.materials[0] is bark
    assert made.transmission == BROAD
    twigs = leaf_tree([(0, 0, 0)], axes=[(0, 1, 0)])
    assert translucency(twigs, AUTO) is twigs


def test_a_tree_without_leaves_is_left_alone() -> None:
    bare = leaf_tree(np.zeros((0, 3)))
    assert translucency(bare, AUTO) is bare


def test_an_unknown_type_of_leaf_is_refused() -> None:
    with pytest.raises(SettingsError, match=r'leaf_type.*"auto", "broad" or "needle"'):
        translucency(leaf_tree([(0, 0, 0)]), TranslucencySettings(leaf_type="moss"))


def test_cards_let_through_what_their_leaves_do() -> None:
    tree = translucency(leaf_tree([(0, 0, 0), (1, 0, 0)]), AUTO)
    clusters = cluster(tree.leaves, ClusterSettings(billboards=1))
    (material,) = billboards(tree, clusters, BillboardSettings(leaf_texels=8, supersample=1)).mesh.materials
    assert material.transmission == BROAD
