"""Tiny trees from leaves to indirect textures: what a viewer sees of the tables is what it saw of the leaves."""

import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from foliage import GREEN, PAINTED, frozen, leaf_tree, planes, random_leaves, rotation
from stems import empty, stem, together, tree_of
from trees import tree as file_of

from treebake.errors import BudgetError, SettingsError
from treebake.flatten import plane_frames
from treebake.gl.draw import Drawing
from treebake.gl.target import Picture
from treebake.gl.view import View
from treebake.meshes import read_mesh
from treebake.model import AlphaMode, Clusters, Doubles, IndirectTextures, Leaves, Material, Mesh, Texture, Tree
from treebake.placements import unpack
from treebake.stages.cluster import ClusterSettings, cluster
from treebake.stages.indirect import IndirectSettings, indirect
from treebake.stages.split import SplitSettings, split
from treebake.stages.split.congruence import find_shapes
from treebake.stages.twigs import TwigSettings, twigs
from treebake.verify.cameras import Camera

PLAIN = IndirectSettings()
PIXELS = 160
DIAGONAL = (0.48, 0.6, 0.64)
NOTHING_LOOKED_UP, EVERYTHING_LOOKED_UP = (1e8, 2e8), (1e-9, 2e-9)


# ---- trees ---------------------------------------------------------------------------------------------------------


def with_shapes(tree: Tree) -> Tree:
    """The tree with the copies among its leaves found, as the split finds them."""
    shape, exemplars, transforms = find_shapes(tree.foliage, tree.leaves.face_leaf, 1e-4)
    return frozen(replace(tree, leaves=replace(tree.leaves, shape=shape, exemplars=exemplars, transforms=transforms)))


def quads(centers: object, normals: object = (0.0, 0.0, 1.0), *, material: Material = PAINTED, **more: object) -> Tree:
    return with_shapes(leaf_tree(centers, normals, material=material, **more))


def colored(tree: Tree, *colors: tuple[float, float, float]) -> Tree:
    """The tree with one plain colour per leaf."""
    materials = tuple(Material(str(color), base_color=(*color, 1.0), double_sided=True) for color in colors)
    number = np.arange(len(colors), dtype=np.int32).repeat(2)
    return with_shapes(replace(tree, foliage=replace(tree.foliage, materials=materials, face_material=number)))


@cache
def crown() -> tuple[Tree, Clusters]:
    """60 leaves facing anywhere, on 5 planes."""
    leaves = random_leaves(1, 60, spread=0.5)
    tree = quads(leaves.centers, leaves.normals, size=0.25)
    return tree, frozen(cluster(tree.leaves, ClusterSettings(billboards=5)))


@cache
def crown_textures() -> IndirectTextures:
    return indirect(*crown(), PLAIN)


def one_plane(tree: Tree, normal: object = (0.0, 0.0, -1.0), offset: float = 1.0) -> Clusters:
    return planes([0] * tree.leaves.count, normal, offset)


# ---- views ---------------------------------------------------------------------------------------------------------


def parallel(normal: object, center: object, reach: float) -> View:
    """Straight at a plane, from the side to which `normal` points; `reach` is half of what is seen."""
    frame = plane_frames(np.array([normal], np.float64))[0] * np.array([[1], [1], [-1]])
    frame /= np.array([reach, reach, 20 * reach])[:, None]  # sees far in front and behind
    to_clip = np.eye(4)
    to_clip[:3, :3] = frame
    to_clip[:3, 3] = -frame @ np.array(center, np.float64)
    return View(to_clip, PIXELS, 0.0, 2.0)


def from_eye(eye: object, turn: Doubles, *, zoom: float = 1.2, size: int = PIXELS, unit: float = 1.0) -> View:
    """In perspective, up to 5 units away; turn: rows right, up, back."""
    near, far = 0.02 * unit, 5.0 * unit
    to_eye = np.eye(4)
    to_eye[:3, :3] = turn
    to_eye[:3, 3] = -turn @ np.array(eye, np.float64)
    lens = np.diag([zoom, zoom, (near + far) / (near - far), 0.0])
    lens[2, 3], lens[3, 2] = 2 * near * far / (near - far), -1.0
    return View(lens @ to_eye, size, near, far)


def around(tree: Tree, size: int = PIXELS, unit: float = 1.0) -> list[View]:
    """The whole tree from several sides, in perspective, from two units away."""
    low, high = tree.foliage.bounds.astype(np.float64)
    center, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 / unit
    turns = [rotation(seed) for seed in (5, 6, 7)]
    return [from_eye(center + 2 * unit * turn[2], turn, zoom=1.8 / radius, size=size, unit=unit) for turn in turns]


def pictures(mesh: Mesh, textures: IndirectTextures | None, views: list[View]) -> list[Picture]:
    with closing(Drawing(mesh, textures, exact_cutouts=textures is None)) as drawing:
        return [drawing.picture(view) for view in views]


def covered(mesh: Mesh, textures: IndirectTextures | None, views: list[View]) -> Doubles:
    """Pixels that each picture covers."""
    return np.array([picture.color[..., 3].sum(dtype=np.float64) for picture in pictures(mesh, textures, views)])


def assert_same_outline(source: Picture, drawn: Picture, overlap: float) -> None:
    alphas = np.stack([source.color[..., 3], drawn.color[..., 3]])
    assert alphas[0].sum() > 100  # pixels: else there is nothing to see
    assert alphas.min(axis=0).sum() > overlap * alphas.max(axis=0).sum()


def assert_alike(
    tree: Tree, textures: IndirectTextures, views: list[View], *, overlap: float = 0.97, color: float = 0.02
) -> None:
    sources, found = pictures(tree.foliage, None, views), pictures(empty(), textures, views)
    for view, source, drawn in zip(views, sources, found, strict=True):
        assert_same_outline(source, drawn, overlap)
        both = (source.color[..., 3] == 1) & (drawn.color[..., 3] == 1)
        assert both.sum() > 0.5 * source.color[..., 3].sum()
        # Where two leaves cross, either may be in front; nowhere else.
        away = np.abs(source.depth - drawn.depth)[both]
        assert (away < 0.01 * (view.far - view.near)).mean() > 0.985
        assert np.abs(source.color - drawn.color)[both].mean() < color


# ---- what is seen --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0, 1, 0), (0, -1, 0), DIAGONAL])
def test_one_leaf_looks_the_same_from_both_sides(normal: tuple[float, float, float]) -> None:
    tree = quads([(1.0, 2.0, 3.0)], normal)
    textures = indirect(tree, planes([0], normal, -(np.array(normal) @ (1, 2, 3))), PLAIN)
    assert_alike(tree, textures, [parallel(side * np.array(normal), (1, 2, 3), 0.15) for side in (1, -1)])


def test_a_leaf_off_its_plane_and_askew_stays_where_it_is() -> None:
    tree = quads([(0.1, 0.2, 0.5)], DIAGONAL)
    textures = indirect(tree, planes([0], (0, 0, 1), 0.3), PLAIN)
    assert_alike(tree, textures, [*around(tree, 400), parallel(DIAGONAL, (0.1, 0.2, 0.5), 0.2)])


def test_a_crown_looks_the_same_from_all_sides() -> None:
    assert_alike(crown()[0], crown_textures(), around(crown()[0]))


@pytest.mark.parametrize("normal", [(0, 0, 1), (0.2, -1, 0.1), DIAGONAL])
def test_a_crown_looks_the_same_without_perspective(normal: tuple[float, float, float]) -> None:
    assert_alike(crown()[0], crown_textures(), [parallel(side * np.array(normal), (0, 0, 0), 0.7) for side in (1, -1)])


@pytest.mark.parametrize("cell", [0.1, 0.4, 5.0])
def test_the_size_of_a_cell_does_not_show(cell: float) -> None:
    tree, clusters = crown()
    textures = indirect(tree, clusters, replace(PLAIN, cell=cell))
    assert_alike(tree, textures, around(tree)[:2])


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_the_unit_does_not_matter(scale: float) -> None:
    tree, clusters = crown()
    leaves = tree.leaves
    large = with_shapes(
        replace(
            tree,
            foliage=replace(tree.foliage, positions=tree.foliage.positions * np.float32(scale)),
            leaves=replace(
                leaves, centers=leaves.centers * scale, radii=leaves.radii * scale, areas=leaves.areas * scale**2
            ),
        )
    )
    textures = indirect(large, replace(clusters, offsets=clusters.offsets * scale), PLAIN)
    assert_alike(large, textures, around(large, unit=scale)[:2])


@pytest.mark.parametrize("seed", range(3))
def test_the_camera_may_stand_in_a_billboard(seed: int) -> None:
    tree, _ = crown()
    textures = indirect(tree, cluster(tree.leaves, ClusterSettings(billboards=1)), PLAIN)
    eye = (0.1 * seed, 0.05, -0.1 * seed)
    assert (np.abs(eye) < 0.3).all()  # within the leaves
    assert_alike(tree, textures, [from_eye(eye, rotation(seed))])


@pytest.mark.parametrize("normal", [(1, 0, 0), (0, 1, 0), (-1, 0, 0)])
def test_a_billboard_seen_from_its_edge_shows_its_leaves(normal: tuple[float, float, float]) -> None:
    # Leaves that face the viewer, at all depths of a billboard whose plane is at a right angle to them.
    random = np.random.default_rng(4)
    tree = quads(random.uniform((-0.5, -0.5, 0.5), (0.5, 0.5, 1.5), (20, 3)), normal)
    textures = indirect(tree, one_plane(tree), PLAIN)
    assert_alike(tree, textures, [parallel(normal, (0, 0, 1), 0.7)])


def test_a_flat_leaf_seen_from_its_edge_is_not_there() -> None:
    tree = quads([(0.0, 0.0, 1.0)])
    textures = indirect(tree, one_plane(tree), PLAIN)
    edge, near_edge = parallel((1, 0, 0), (0, 0, 1), 0.15), parallel((1, 0, 0.1), (0, 0, 1), 0.15)
    assert covered(empty(), textures, [edge])[0] < 0.01 * PIXELS**2
    assert_alike(tree, textures, [near_edge], overlap=0.95)


@pytest.mark.parametrize("side", [1, -1])
def test_of_two_leaves_in_a_billboard_the_nearer_one_wins(side: int) -> None:
    tree = colored(leaf_tree([(0.0, 0.0, 1.05), (0.1, 0.0, 1.0)]), (1, 0, 0), (0, 0, 1))
    textures = indirect(tree, one_plane(tree, offset=1.02), PLAIN)
    view = parallel((0, 0, side), (0.05, 0, 1), 0.2)
    assert_alike(tree, textures, [view])
    color = pictures(empty(), textures, [view])[0].color
    red, blue = ((color[..., channel] > 0.15).sum() for channel in (0, 2))
    assert (red if side > 0 else blue) == pytest.approx(2 * (blue if side > 0 else red), rel=0.05)


@pytest.mark.parametrize("fade", [EVERYTHING_LOOKED_UP, (PIXELS / 2, PIXELS * 1.5)], ids=["all", "half"])
def test_many_layers_are_walked_from_either_end(fade: tuple[float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    # A pile of 40 leaves in one cell, as wide as the picture: only the first and the last are ever seen.
    monkeypatch.setattr("treebake.gl.indirect.FADE", fade)
    colors = [(1.0, 0.0, 0.0), *[(0.0, 1.0, 0.0)] * 38, (0.0, 0.0, 1.0)]
    tree = colored(leaf_tree([(0.0, 0.0, 1 - 0.01 * i) for i in range(40)]), *colors)
    textures = indirect(tree, one_plane(tree), PLAIN)
    for side, channel in ((1, 0), (-1, 2)):
        (picture,) = pictures(empty(), textures, [parallel((0, 0, side), (0, 0, 1), 0.15)])
        whole = picture.color[..., 3] == 1
        assert whole.sum() > 0.4 * PIXELS**2
        # The far texture may show at the very edge, where the leaf ends.
        assert (picture.color[..., :3][whole].argmax(axis=1) == channel).mean() > 0.95


def test_light_falls_as_on_the_source() -> None:
    for shading in ((0.0, 0.8, 0.6), (0.6, 0.0, 0.8), (-0.6, -0.48, 0.64)):
        tree = quads([(0.0, 0.0, 1.0)], shading=shading)
        textures = indirect(tree, one_plane(tree), PLAIN)
        assert_alike(tree, textures, [parallel((0, 0, side), (0, 0, 1), 0.15) for side in (1, -1)])


def one_leaf_moved(linears: object, step: float = 0.3) -> Tree:
    """A painted leaf and copies of it in a row, each through its own 3 x 3 matrix; mirrored ones are wound back."""
    first = leaf_tree([(0.0, 0.0, 1.0)], material=PAINTED).foliage
    turns = np.array(linears, np.float64)
    mirrors = np.linalg.det(turns) < 0
    normals = np.cross(turns[:, :, 0], turns[:, :, 1]) * np.where(mirrors, -1, 1)[:, None]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    parts = []
    for number, (turn, mirrored, normal) in enumerate(zip(turns, mirrors, normals, strict=True)):
        moved = {
            "positions": ((first.positions - (0, 0, 1)) @ turn.T + (step * number, 0, 1)).astype(np.float32),
            "normals": np.tile(normal, (4, 1)).astype(np.float32),
            "faces": first.faces[:, [0, 2, 1]] if mirrored else first.faces,
        }
        parts.append(replace(first, **moved))
    mesh = together(*parts)
    count = len(parts)
    leaves = Leaves(
        face_leaf=np.arange(count, dtype=np.int32).repeat(2),
        centers=mesh.positions.reshape(-1, 4, 3).mean(axis=1, dtype=np.float64),
        normals=normals,
        areas=mesh.face_areas.reshape(-1, 2).sum(axis=1),
        radii=np.full(count, 0.15),
        axes=np.zeros((count, 3)),
        shape=np.zeros(count, np.int32),
        exemplars=np.zeros(1, np.int32),
        transforms=np.zeros((count, 3, 4)),
    )
    return with_shapes(Tree(empty(), mesh, leaves, ()))


MIRRORED = [np.eye(3), np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1]), rotation(3) @ np.diag([-1.0, 1, 1])]


def test_mirrored_copies_show_a_mirrored_texture() -> None:
    tree = one_leaf_moved(MIRRORED)
    assert len(tree.leaves.exemplars) == 1
    assert (np.linalg.det(tree.leaves.transforms[1:, :, :3]) < 0).all()
    textures = indirect(tree, one_plane(tree), PLAIN)
    assert unpack(textures.placements[0, :4]).mirrored.tolist() == [False, True, True, True]
    assert_alike(tree, textures, [parallel((0, 0, side), (0.45, 0, 1), 0.65) for side in (1, -1)])
    # Were the texture not mirrored, this would show.
    unmirrored = textures.placements.copy()
    unmirrored[..., 3] &= ~np.uint32(1 << 15)
    with pytest.raises(AssertionError):
        assert_alike(
            tree, replace(textures, placements=unmirrored), [parallel((0, 0, 1), (0.45, 0, 1), 0.65)], color=0.03
        )


@pytest.mark.parametrize("seed", [1, 2])
def test_turned_and_scaled_copies_look_as_in_the_source(seed: int) -> None:
    scales = np.random.default_rng(seed).uniform(0.3, 1.5, 5)
    tree = one_leaf_moved([scale * rotation(10 * seed + i) for i, scale in enumerate(scales)])
    assert len(tree.leaves.exemplars) == 1
    assert_alike(tree, indirect(tree, one_plane(tree), PLAIN), around(tree, 400))


def test_a_bent_leaf_shows_its_relief() -> None:
    x = np.linspace(-1, 1, 17)
    grid = np.stack(np.broadcast_arrays(x[:, None] * 0.1, x * 0.1, 1 + 0.04 * x[:, None] ** 2), axis=2).reshape(-1, 3)
    first = (np.arange(16)[:, None] * 17 + np.arange(16)).reshape(-1, 1)
    flat = leaf_tree([(0.0, 0.0, 1.0)])
    slopes = np.column_stack([-0.8 * grid[:, 0] * 10, np.zeros(len(grid)), np.ones(len(grid))])
    mesh = replace(
        flat.foliage,
        positions=grid.astype(np.float32),
        normals=(slopes / np.linalg.norm(slopes, axis=1, keepdims=True)).astype(np.float32),
        uvs=(grid[:, :2] * 5 + 0.5).astype(np.float32),
        faces=(first + np.array([0, 17, 18, 0, 18, 1])).reshape(-1, 3).astype(np.int32),
        face_material=np.zeros(512, np.int32),
        face_node=np.zeros(512, np.int32),
    )
    leaves = replace(flat.leaves, face_leaf=np.zeros(512, np.int32), centers=np.array([(0.0, 0.0, 1.013)]))
    tree = frozen(replace(flat, foliage=mesh, leaves=leaves))
    textures = indirect(tree, one_plane(tree), PLAIN)
    views = [parallel(normal, (0, 0, 1.02), 0.15) for normal in ((0, 0, 1), (0, 0, -1), (0.5, 0.3, 1), (1, 0, 1))]
    assert_alike(tree, textures, views, overlap=0.95)
    # The leaf's depth is that of the source, which a plane's is not.
    near = [from_eye((0, 0, 1.3), np.eye(3))]
    level = replace(textures, leaf_normal=levelled(textures.leaf_normal))
    source, bent, plane = (
        pictures(*what, near)[0].depth for what in ((mesh, None), (empty(), textures), (empty(), level))
    )
    seen = (source > 0) & (bent > 0) & (plane > 0)
    assert np.abs(source - bent)[seen].mean() < 0.1 * np.abs(source - plane)[seen].mean()


def levelled(normals: Texture) -> Texture:
    """The same normals without relief."""
    pixels = normals.pixels.copy()
    pixels[..., 2] = 128
    return replace(normals, pixels=pixels)


def test_single_sided_leaves_are_seen_from_their_front_only() -> None:
    tree = quads([(0, 0, 1.0), (0.3, 0, 1.0)], [(0, 0, 1), (0, 0, -1)], material=replace(PAINTED, double_sided=False))
    textures = indirect(tree, one_plane(tree), PLAIN)
    assert_alike(tree, textures, [parallel((0, 0, side), (0.15, 0, 1), 0.3) for side in (1, -1)])


@cache
def twig_tree() -> tuple[Tree, Clusters]:
    """Four thin tubes in 16 pieces, and three leaves above them."""
    tubes = [stem(radii=(0.05, 0.045, 0.04), length=0.8, at=(0.5 * i, 1.0, 0.5)) for i in range(4)]
    tree = twigs(tree_of(together(stem(radii=(0.4, 0.35, 0.3), sides=12), *tubes)), TwigSettings(radius=0.05))
    assert tree.leaves.is_twig.sum() == 16
    return tree, planes([0] * tree.leaves.count, (0, 0, 1), 0)


def test_twig_pieces_look_like_their_tubes() -> None:
    tree, clusters = twig_tree()
    textures = indirect(tree, clusters, PLAIN)
    views = around(tree, 400)[:2]  # the third looks along the twigs, whose pieces are open at their ends
    for source, drawn in zip(pictures(tree.foliage, None, views), pictures(empty(), textures, views), strict=True):
        assert_same_outline(source, drawn, 0.85)  # straight-sided, and their width is a few bits
        both = (source.color[..., 3] == 1) & (drawn.color[..., 3] == 1)
        assert np.abs(source.depth - drawn.depth)[both].max() < 2 * 0.05  # a rod's depth is its axis's
    assert covered(empty(), textures, views) == pytest.approx(covered(tree.foliage, None, views), rel=0.08)


def test_a_twig_is_as_wide_from_wherever_it_is_seen() -> None:
    tree, clusters = twig_tree()
    textures = indirect(tree, clusters, PLAIN)
    turned = [np.array((np.sin(angle), 0, np.cos(angle))) for angle in np.linspace(0, 2 * np.pi, 9)]
    seen = covered(empty(), textures, [parallel(normal, (0, 1.4, 0.5), 0.35) for normal in turned])
    only = covered(tree.foliage, None, [parallel(normal, (0, 1.4, 0.5), 0.35) for normal in turned])
    assert seen == pytest.approx(only, rel=0.1)


# ---- options -------------------------------------------------------------------------------------------------------


def test_flat_moves_leaves_onto_the_plane() -> None:
    tree = quads([(0.0, 0.0, 1.3), (0.3, 0.0, 0.8)], [(0.5, 0.0, 0.8), (0.0, 0.3, -1.0)])
    textures = indirect(tree, one_plane(tree), replace(PLAIN, flat=True))
    assert textures.billboards[0, 14] == pytest.approx(0, abs=1e-6)  # the box's thickness
    view = parallel((0, 0, 1), (0.15, 0, 1), 0.3)
    flat = quads([(0.0, 0.0, 1.0), (0.3, 0.0, 1.0)], [(0, 0, 1), (0, 0, -1)])
    assert covered(empty(), textures, [view]) == pytest.approx(covered(flat.foliage, None, [view]), rel=0.03)
    nearer = from_eye((0.15, 0, 2.0), np.eye(3))
    (picture,) = pictures(empty(), textures, [nearer])
    np.testing.assert_allclose(picture.depth[picture.color[..., 3] == 1], 1, rtol=1e-3)


def test_flat_leaves_in_their_own_plane_look_the_same() -> None:
    tree = quads([(x, y, 1.0) for x in (-0.3, 0.0, 0.3) for y in (-0.3, 0.0, 0.3)])
    textures = indirect(tree, one_plane(tree), replace(PLAIN, flat=True))
    assert_alike(tree, textures, [parallel((0, 0, side), (0, 0, 1), 0.5) for side in (1, -1)])
    assert_alike(tree, textures, [parallel((0.5, 0.2, 1), (0, 0, 1), 0.5)])


def test_single_lists_at_most_one_leaf_a_cell() -> None:
    tree, clusters = crown()
    settings = [replace(PLAIN, cell=0.3, single=single) for single in (False, True)]
    counts = [indirect(tree, clusters, each).hash_texture & 1023 for each in settings]
    assert counts[0].max() > 1
    assert counts[1].max() == 1


def test_single_shows_a_lone_leaf_in_fine_cells() -> None:
    tree = quads([(0.0, 0.0, 1.0)])
    textures = indirect(tree, one_plane(tree), replace(PLAIN, cell=0.05, single=True))
    assert_alike(tree, textures, [parallel((0, 0, 1), (0, 0, 1), 0.15)], overlap=0.95)


def test_single_shows_the_front_one_of_two() -> None:
    tree = colored(leaf_tree([(0.0, 0.0, 1.05), (0.0, 0.0, 0.95)]), (0, 0, 1), (1, 0, 0))
    textures = indirect(tree, one_plane(tree), replace(PLAIN, cell=0.1, single=True))
    for side in (1, -1):  # the plane's normal is -z, so its front is there
        color = pictures(empty(), textures, [parallel((0, 0, side), (0, 0, 1), 0.15)])[0].color
        assert color[..., 0].max() > 0.1
        assert color[..., 2].max() < 0.01


def test_orientations_turn_leaves_within_their_own_plane() -> None:
    angle = np.radians(20)
    turn = [(np.cos(angle), -np.sin(angle), 0), (np.sin(angle), np.cos(angle), 0), (0, 0, 1)]
    tree, upright = one_leaf_moved([turn]), one_leaf_moved([np.eye(3)])
    view = [parallel((0, 0, 1), (0, 0, 1), 0.15)]
    assert_alike(upright, indirect(tree, one_plane(tree), replace(PLAIN, orientations=4)), view)
    with pytest.raises(AssertionError):
        assert_alike(upright, indirect(tree, one_plane(tree), PLAIN), view)


# ---- the level of detail -------------------------------------------------------------------------------------------


@cache
def layers() -> tuple[Tree, IndirectTextures]:
    """50 leaves over each other in one thick billboard, all parallel to its plane, and its textures."""
    random = np.random.default_rng(2)
    tree = quads(random.uniform((-0.5, -0.5, 0.5), (0.5, 0.5, 1.5), (50, 3)))
    return tree, indirect(tree, one_plane(tree), PLAIN)


SIDES = [parallel((0, 0, side), (0, 0, 1), 0.8) for side in (1, -1)]


@pytest.mark.parametrize("far_texels", [1, 2, 4, 16])
def test_the_far_texture_alone_covers_what_the_leaves_do(monkeypatch: pytest.MonkeyPatch, far_texels: int) -> None:
    tree, _ = layers()
    textures = indirect(tree, one_plane(tree), replace(PLAIN, far_texels=far_texels))
    wanted = covered(tree.foliage, None, SIDES)
    monkeypatch.setattr("treebake.gl.indirect.FADE", NOTHING_LOOKED_UP)
    assert covered(empty(), textures, SIDES) == pytest.approx(wanted, rel=0.15)


def test_the_far_textures_of_a_crown_cover_what_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    tree, _ = crown()
    textures = indirect(tree, cluster(tree.leaves, ClusterSettings(billboards=20)), PLAIN)
    views = [*around(tree), *(parallel(rotation(i)[0], (0, 0, 0), 0.8) for i in range(12))]
    wanted = covered(tree.foliage, None, views).sum()
    monkeypatch.setattr("treebake.gl.indirect.FADE", NOTHING_LOOKED_UP)
    assert covered(empty(), textures, views).sum() == pytest.approx(wanted, rel=0.15)


def test_the_far_texture_shows_the_leaves_where_they_are_and_in_their_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = colored(leaf_tree([(-0.3, 0.2, 1.0), (0.3, -0.2, 1.0)]), (0.8, 0, 0), (0, 0, 0.8))
    textures = indirect(tree, one_plane(tree), replace(PLAIN, far_texels=16))
    monkeypatch.setattr("treebake.gl.indirect.FADE", NOTHING_LOOKED_UP)
    views = [parallel((0, 0, side), (0, 0, 1), 0.6) for side in (1, -1)]
    assert_alike(tree, textures, views, overlap=0.8, color=0.03)


def test_what_is_looked_up_grows_without_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    tree, textures = layers()
    wanted = covered(tree.foliage, None, SIDES)
    cell = PIXELS / 1.6 * 1.5 * 0.2  # pixels: 1.5 leaves of 0.2 in a view of 1.6
    shares = []
    with closing(Drawing(empty(), textures)) as drawing:
        for step in np.geomspace(0.4, 1.1, 40):
            monkeypatch.setattr("treebake.gl.indirect.FADE", (step * cell, 2 * step * cell))
            shares.append([drawing.picture(view).color[..., 3].sum(dtype=np.float64) for view in SIDES] / wanted)
    seen = np.array(shares)
    assert seen[0] == pytest.approx([1, 1], rel=0.03)  # everything is looked up
    assert np.abs(np.diff(seen, axis=0)).max() < 0.05
    assert seen.min() > 0.8
    assert seen.max() < 1.2


def test_less_is_looked_up_until_nothing_is(monkeypatch: pytest.MonkeyPatch) -> None:
    # Without its far texture a billboard shows the share that is looked up.
    _, textures = layers()
    clear = replace(textures.far_color, pixels=textures.far_color.pixels * np.array((1, 1, 1, 0), np.uint8))
    bare = replace(textures, far_color=clear)
    cell = PIXELS / 1.6 * 1.5 * 0.2
    seen = []
    for low in (0.3, 0.7, 0.8, 0.9, 1.01):
        monkeypatch.setattr("treebake.gl.indirect.FADE", (low * cell, 2 * low * cell))
        seen.append(covered(empty(), bare, SIDES))
    assert (np.diff(seen, axis=0) < 0).all()
    assert not seen[-1].any()


def test_where_everything_is_looked_up_the_far_texture_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    _, textures = layers()
    full = replace(textures, far_color=replace(textures.far_color, pixels=np.full_like(textures.far_color.pixels, 255)))
    monkeypatch.setattr("treebake.gl.indirect.FADE", EVERYTHING_LOOKED_UP)
    assert (covered(empty(), full, SIDES) == covered(empty(), textures, SIDES)).all()


@pytest.mark.parametrize("pixels", [10, 20, 40])
def test_leaves_keep_their_cover_as_they_shrink(pixels: int) -> None:
    # Leaves of the mips' sizes, looked up one by one.
    places = [(0.43 * (i % 4) - 0.63, 0.47 * (i // 4) - 0.5, 1.0) for i in range(12)]
    tree = quads(places)
    textures = indirect(tree, one_plane(tree), PLAIN)
    view = replace(parallel((0, 0, 1), (0, 0, 1), 1.0), size=pixels * 10)
    assert covered(empty(), textures, [view]) == pytest.approx(covered(tree.foliage, None, [view]), rel=0.05)


# ---- the tables ----------------------------------------------------------------------------------------------------


def test_placements_say_where_the_leaves_are() -> None:
    tree, clusters = crown()
    textures = crown_textures()
    order = np.argsort(clusters.labels, kind="stable")
    boards = textures.billboards[clusters.labels[order]].astype(np.float64)
    found = unpack(textures.placements.reshape(-1, 4)[: tree.leaves.count])
    places = np.einsum("nij,nj->ni", boards[:, :12].reshape(-1, 3, 4)[:, :, :3], tree.leaves.centers[order])
    places += boards[:, 3:12:4]
    assert np.abs(found.positions * boards[:, 12:15] - places).max() < 1e-3  # cells
    fronts = np.einsum("nij,nj->ni", boards[:, :12].reshape(-1, 3, 4)[:, :, :3], tree.leaves.normals[order])
    fronts /= np.linalg.norm(fronts, axis=1, keepdims=True)
    np.testing.assert_allclose(found.rotations[:, :, 2], -fronts, atol=2e-3)
    assert textures.leaves == tree.leaves.count


def test_the_first_placement_of_each_billboard_counts_its_leaves() -> None:
    _, clusters = crown()
    sizes = np.bincount(clusters.labels)
    assert crown_textures().billboards[:, 18].tolist() == (np.cumsum(sizes) - sizes).tolist()


def test_lists_name_leaves_of_their_billboard_only() -> None:
    _, clusters = crown()
    textures = crown_textures()
    sizes = np.bincount(clusters.labels)
    lists = textures.lists_texture.reshape(-1)
    listed = []
    for board, row in enumerate(textures.billboards[:, 12:18].astype(int)):
        cells = textures.hash_texture[row[5] : row[5] + row[1], row[4] : row[4] + row[0]].reshape(-1).tolist()
        found = [lists[cell >> 10 : (cell >> 10) + (cell & 1023)] for cell in cells]
        listed.append(np.unique(np.concatenate(found)))
        assert listed[board].tolist() == list(range(sizes[board]))  # every leaf is in some cell


def test_tables_have_one_row_for_each() -> None:
    tree, clusters = crown()
    textures = crown_textures()
    assert textures.billboards.shape == (clusters.count, 20)
    assert textures.shapes.shape == (len(tree.leaves.exemplars), 16)
    assert textures.placements.shape[:2] == textures.ambient.shape[:2] == (1, 1024)
    assert textures.far_color.pixels.shape[:2] == tuple(4 * side for side in textures.hash_texture.shape)
    assert all(np.isfinite(getattr(textures, name)).all() for name in ("billboards", "shapes"))
    assert textures.largest == pytest.approx(0.5 / 1.5)  # half a leaf in cells


@pytest.mark.parametrize("settings", [PLAIN, replace(PLAIN, flat=True, orientations=5), replace(PLAIN, single=True)])
def test_two_runs_give_the_same_bytes(settings: IndirectSettings) -> None:
    one, other = (indirect(*crown(), settings) for _ in range(2))
    for field in fields(IndirectTextures):
        values = [getattr(each, field.name) for each in (one, other)]
        parts = [value.pixels if isinstance(value, Texture) else np.asarray(value) for value in values]
        np.testing.assert_array_equal(*parts)


# ---- few and odd leaves --------------------------------------------------------------------------------------------


def as_one_leaf(uvs: object) -> Callable[[], Tree]:
    return lambda: quads([(0.0, 0.0, 1.0)], material=GREEN, uvs=uvs)


@pytest.mark.parametrize(
    "made",
    [
        lambda: tree_of(empty(), 3),
        as_one_leaf(np.full((4, 2), 0.5)),
        lambda: quads([(0.2 * i, 0.0, 1.0) for i in range(4)], material=GREEN),
        lambda: quads([(0.0, 0.0, 1.0)] * 3, material=GREEN),
    ],
    ids=["one triangle each", "equal uvs", "coplanar", "in one place"],
)
def test_odd_leaves_look_the_same(made: Callable[[], Tree]) -> None:
    tree = made()
    clusters = planes([0] * tree.leaves.count, (0, 0, 1), -tree.leaves.centers[0, 2])
    assert_alike(tree, indirect(tree, clusters, PLAIN), around(tree)[:2])


def test_a_billboard_may_hold_one_leaf() -> None:
    leaves = random_leaves(6, 10, spread=0.4)
    tree = quads(leaves.centers, leaves.normals)
    offsets = -np.einsum("ij,ij->i", tree.leaves.normals, tree.leaves.centers)
    side = np.where(offsets < 0, -1.0, 1.0)
    textures = indirect(tree, planes(np.arange(10), tree.leaves.normals * side[:, None], offsets * side), PLAIN)
    assert_alike(tree, textures, around(tree)[:3])


# ---- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell", 0.0),
        ("cell", -1.5),
        ("cell", float("nan")),
        ("orientations", -1),
        ("leaf_texels", 3),
        ("leaf_texels", 1025),
        ("atlas", 0),
        ("atlas", 32),
        ("atlas", 1000),
        ("atlas", 32768),
        ("likeness", -0.1),
        ("likeness", float("nan")),
        ("far_texels", 0),
        ("far_texels", 3),
        ("far_texels", 32),
        ("limit", 32),
        ("limit", 100),
        ("limit", 32768),
    ],
)
def test_a_setting_out_of_range_is_named(name: str, value: float) -> None:
    tree = quads([(0.0, 0.0, 1.0)])
    with pytest.raises(SettingsError, match=rf"\[indirect\] {name} is {value}; it must be"):
        indirect(tree, one_plane(tree), replace(PLAIN, **{name: value}))


def test_more_shapes_than_the_bits_hold(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = colored(leaf_tree([(0.2 * i, 0.0, 1.0) for i in range(3)]), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    stage = sys.modules["treebake.stages.indirect.indirect"]
    monkeypatch.setattr(stage, "SHAPES", 3)
    indirect(tree, one_plane(tree), PLAIN)
    monkeypatch.setattr(stage, "SHAPES", 2)
    with pytest.raises(BudgetError, match=r"3 leaf shapes and can hold 2; raise \[split\] copy_tolerance"):
        indirect(tree, one_plane(tree), PLAIN)


def test_a_hash_texture_that_does_not_fit() -> None:
    tree, clusters = crown()
    with pytest.raises(BudgetError, match=r"of 5 billboards exceeds 64 x 64 texels; raise \[indirect\] cell or limit"):
        indirect(tree, clusters, replace(PLAIN, cell=0.01, limit=64))


# ---- a real tree ---------------------------------------------------------------------------------------------------


def test_a_real_palm_keeps_its_silhouette() -> None:
    tree = split(read_mesh(file_of("treegen_palm.glb")), SplitSettings())
    clusters = cluster(tree.leaves, ClusterSettings(billboards=20))
    textures = indirect(tree, clusters, PLAIN)
    view = parallel((0, 0, 1), tree.foliage.bounds.mean(axis=0), float(np.ptp(tree.foliage.bounds, axis=0).max()) / 2)
    (source,), (drawn,) = pictures(tree.foliage, None, [view]), pictures(empty(), textures, [view])
    assert_same_outline(source, drawn, 0.9)
    assert drawn.color[..., 3].sum() == pytest.approx(source.color[..., 3].sum(), rel=0.05)


def test_a_view_along_an_axis_misses_no_column() -> None:
    tree, textures = crown()[0], crown_textures()
    view = parallel((0, 1, 0), (0, 0, 0), 0.7)  # the rays' smallest parts are rounding errors of either sign
    assert covered(empty(), textures, [view]) == pytest.approx(covered(tree.foliage, None, [view]), rel=0.02)


def test_a_leaf_before_the_far_plane_shows_though_its_box_reaches_beyond() -> None:
    tree = quads([(0.1, 0.2, 0.5)], DIAGONAL)
    textures = indirect(tree, planes([0], (0, 0, 1), 0.3), PLAIN)
    low, high = tree.foliage.bounds.astype(np.float64)
    view = Camera(0, 0, (low + high) / 2, float(np.linalg.norm(high - low) / 2)).view(160)
    assert covered(empty(), textures, [view]) == pytest.approx(covered(tree.foliage, None, [view]), rel=0.02)


def test_leaves_of_two_single_sided_faces_back_to_back_show_both() -> None:
    scattered = random_leaves(3, 40, spread=0.5)
    one_sided = replace(PAINTED, double_sided=False)
    mesh = leaf_tree(scattered.centers, scattered.normals, size=0.2, material=one_sided).foliage
    faces = np.concatenate([mesh.faces, mesh.faces[:, ::-1]]).astype(np.int32)
    zeros = np.zeros(len(faces), np.int32)
    tree = split(replace(mesh, faces=faces, face_material=zeros, face_node=zeros), SplitSettings())
    textures = indirect(tree, cluster(tree.leaves, ClusterSettings(billboards=6)), PLAIN)
    views = around(tree)
    assert covered(empty(), textures, views) == pytest.approx(covered(tree.foliage, None, views), rel=0.03)


def test_twigs_are_lit_as_round_rods() -> None:
    tree, clusters = twig_tree()
    textures = indirect(tree, clusters, PLAIN)
    for view in around(tree)[:2]:
        source, ours = (Drawing(*what).picture(view).color for what in ((tree.foliage,), (empty(), textures)))
        means = [(color[..., :3].sum(axis=(0, 1)) / color[..., 3].sum()) for color in (source, ours)]
        assert np.allclose(*means, rtol=0.2)


def test_blended_materials_do_not_keep_billboards_from_hiding_each_other() -> None:
    tree = leaf_tree([(0.0, 0.0, -0.5), (0.0, 0.0, 0.5)], size=1.0)
    textures = indirect(tree, planes([0, 1], [(0, 0, 1), (0, 0, 1)], [0.5, 0.5]), PLAIN)
    pane = replace(
        leaf_tree([(5.0, 5.0, 0.0)], size=0.1).foliage, materials=(replace(GREEN, alpha_mode=AlphaMode.BLEND),)
    )
    view = Camera(0, 0, np.zeros(3), 1.0).view(64)
    opaque, blended = (Drawing(mesh, textures).picture(view) for mesh in (empty(), pane))
    np.testing.assert_array_equal(opaque.depth, blended.depth)


def test_a_mirrored_leaf_is_lit_from_the_other_side() -> None:
    bent = leaf_tree([(0.0, 0.0, 0.0)], size=1.0, shading=(0.8, 0.0, 0.6))
    mesh = bent.foliage
    flip = np.array([-1.0, 1.0, 1.0], np.float32)
    mirror = replace(
        mesh,
        positions=mesh.positions * flip + np.float32([2, 0, 0]),
        normals=mesh.normals * flip,
        faces=mesh.faces[:, [0, 2, 1]].copy(),
    )
    tree = split(together(mesh, mirror), SplitSettings(foliage_materials=("*",)))
    assert len(tree.leaves.exemplars) == 1, "the second leaf is a mirrored copy of the first"
    textures = indirect(tree, planes([0, 0], [(0, 0, 1)], [0.0]), PLAIN)
    view = Camera(0, 0, np.array([1.0, 0.0, 0.0]), 2.0).view(96)
    source, ours = (Drawing(*what).picture(view) for what in ((tree.foliage,), (empty(), textures)))
    whole = (source.color[..., 3] == 1) & (ours.color[..., 3] == 1)
    assert np.abs(source.color - ours.color)[whole].max() < 0.03


def test_where_a_far_billboard_is_full_no_part_of_the_lists_leaves_holes(monkeypatch: pytest.MonkeyPatch) -> None:
    textures = indirect(
        leaf_tree([(0.0, 0.0, 0.0)], size=1.0), planes([0], [(0, 0, 1)], [0]), replace(PLAIN, far_texels=16)
    )
    view = Camera(0, 0, np.zeros(3), 0.8).view(96)
    whole = Drawing(empty(), textures).picture(view).color[..., 3]
    cell = 1.5 * 96 / 1.6  # pixels, about
    monkeypatch.setattr("treebake.gl.indirect.FADE", (0.0, 2 * cell))  # about half of every list
    half = Drawing(empty(), textures).picture(view).color[..., 3]
    inside = np.s_[44:84, 44:84]
    assert whole[inside].min() == 1
    assert half[inside].mean() > 0.99  # by halves of each it would be three quarters


def test_more_billboards_than_a_texture_has_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["treebake.stages.indirect.indirect"], "_MOST_TEXELS", 1)
    tree = leaf_tree([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    with pytest.raises(BudgetError, match=r"2 billboards and can hold 1; lower \[indirect_cluster\] billboards"):
        indirect(tree, planes([0, 1], [(0, 0, 1), (0, 0, 1)], [0, 0]), PLAIN)


def test_a_low_resolution_texture_beyond_what_a_card_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["treebake.stages.indirect.indirect"], "_MOST_TEXELS", 3)
    with pytest.raises(BudgetError, match=r"raise \[indirect\] cell or lower far_texels"):
        indirect(leaf_tree([(0.0, 0.0, 0.0)]), planes([0], [(0, 0, 1)], [0]), PLAIN)
