"""The leaves texture: what a leaf shows from either side, at the density of its source."""

from dataclasses import replace

import numpy as np
import pytest
from foliage import GREEN, frozen, leaf_tree
from stems import empty, mesh_of

from treebake.compression import compressed_mips
from treebake.errors import BudgetError
from treebake.images import to_linear
from treebake.lookup import SOFTNESS, sample_texture
from treebake.model import AlphaMode, Bytes, Doubles, Leaves, Material, Mesh, Texture, Tree
from treebake.stages.indirect.leaf_images import BLOCK, LeafImages, _leaders, draw_leaf_images
from treebake.stages.indirect.shapes import find_shapes

UVS = ((0, 1), (1, 1), (1, 0), (0, 0))


def material(pixels: Bytes, *, name: str = "leaf", mode: AlphaMode = AlphaMode.MASK, both: bool = True) -> Material:
    return Material(name, color_map=Texture(name, pixels), alpha_mode=mode, double_sided=both)


def plain(width: int, height: int, color: tuple[int, int, int, int] = (60, 160, 40, 255)) -> Bytes:
    return np.full((height, width, 4), color, np.uint8)


def disc(side: int, radius: float = 0.4) -> Bytes:
    """Opaque within a circle, clear and black without."""
    v, u = (np.mgrid[:side, :side] + 0.5) / side - 0.5
    pixels = plain(side, side)
    pixels[np.hypot(u, v) > radius] = 0
    return pixels


def each_its_own(tree: Tree) -> Tree:
    """The tree as if no leaf were another's copy."""
    count = tree.leaves.count
    own = np.arange(count, dtype=np.int32)
    leaves = replace(tree.leaves, shape=own, exemplars=own, transforms=np.tile(np.eye(3, 4), (count, 1, 1)))
    return frozen(replace(tree, leaves=leaves))


def leaf_of(mesh: Mesh, normal: object = (0.0, 0.0, 1.0)) -> Tree:
    """A tree of one leaf, which is all of a mesh."""
    points = mesh.positions[mesh.faces].astype(np.float64)
    areas = mesh.face_areas
    center = (points.mean(axis=1) * areas[:, None]).sum(axis=0) / areas.sum()
    leaves = Leaves(
        face_leaf=np.zeros(len(mesh.faces), np.int32),
        centers=center[None],
        normals=np.array([normal], np.float64),
        areas=np.array([areas.sum()]),
        radii=np.linalg.norm(points - center, axis=2).max(keepdims=True)[0],
        axes=np.zeros((1, 3)),
        shape=np.zeros(1, np.int32),
        exemplars=np.zeros(1, np.int32),
        transforms=np.eye(3, 4)[None],
    )
    return frozen(Tree(trunk=empty(), foliage=mesh, leaves=leaves, decisions=()))


def images(tree: Tree, *, leaf_texels: int = 64, atlas: int = 512, likeness: float = 0.02) -> LeafImages:
    shapes = find_shapes(tree.foliage, tree.leaves)
    return draw_leaf_images(tree.foliage, tree.leaves, shapes, leaf_texels, atlas, likeness)


def texels(found: LeafImages, place: np.ndarray) -> tuple[int, int, int, int]:
    """Where an image lies in the texture: left, top, width, height in texels."""
    height, width = found.color.pixels.shape[:2]
    exact = place * (width, height, width, height)
    assert np.allclose(exact, np.rint(exact), atol=1e-3)
    return tuple(np.rint(exact).astype(int).tolist())


def image(found: LeafImages, place: np.ndarray, *, normal: bool = False) -> Bytes:
    left, top, width, height = texels(found, place)
    texture = found.normal if normal else found.color
    return texture.pixels[top : top + height, left : left + width]


# ---- size ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(64, 32), (16, 48), (10, 7), (3, 1)])
def test_an_image_has_as_many_texels_as_its_texture(size: tuple[int, int]) -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(plain(*size))))
    # A square leaf: of its rectangle's texels there are as many as of the texture's.
    assert texels(found, found.front[0])[2:] == (pytest.approx(np.sqrt(np.prod(size)), abs=0.5),) * 2


def test_a_leaf_of_its_textures_proportions_gets_its_texels_one_to_one() -> None:
    v, u = np.mgrid[:32, :64]
    pixels = np.stack([u * 4, v * 8, 255 - u * 4, np.full_like(u, 255)], axis=2).astype(np.uint8)
    corners = np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (0, 1, 0)], np.float32)
    mesh = replace(mesh_of(corners, [(0, 1, 2), (0, 2, 3)], np.array(UVS)), materials=(material(pixels),))
    found = images(leaf_of(mesh))
    assert texels(found, found.front[0])[2:] == (64, 32)
    inner = slice(1, -1)  # a texture repeats: at its borders it is filtered with its other side
    assert np.abs(image(found, found.front[0]).astype(int) - pixels)[inner, inner].max() <= 2


def test_a_texture_that_repeats_on_a_leaf_gets_more_texels() -> None:
    repeated = leaf_tree([(0.0, 0.0, 1.0)], material=material(plain(32, 32)), uvs=2 * np.array(UVS))
    found = images(repeated)
    assert texels(found, found.front[0])[2:] == (64, 64)


@pytest.mark.parametrize("leaf_texels", [4, 30, 64])
def test_a_leaf_without_texture_gets_leaf_texels(leaf_texels: int) -> None:
    long = mesh_of([(0, 0, 0), (4, 0, 0), (4, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)], np.array(UVS))
    found = images(leaf_of(replace(long, materials=(GREEN,))), leaf_texels=leaf_texels)
    assert texels(found, found.front[0])[2:] == (2 * leaf_texels, leaf_texels // 2)


@pytest.mark.parametrize("uvs", [np.zeros((4, 2)), [(0, 0), (1, 1), (1, 1), (0, 0)]], ids=["a point", "a line"])
def test_a_leaf_whose_texture_has_no_area_gets_leaf_texels(uvs: object) -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(plain(64, 64)), uvs=uvs), leaf_texels=16)
    assert np.sqrt(np.prod(texels(found, found.front[0])[2:])) == pytest.approx(16, abs=1)


# ---- the sides -----------------------------------------------------------------------------------------------------


def test_a_flat_leaf_has_one_image_for_both_sides() -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(disc(64))))
    np.testing.assert_array_equal(found.front, found.back)
    assert found.color.pixels.shape == found.normal.pixels.shape == (64, 64, 4)


def folded(under: Material) -> Tree:
    """A red leaf over another one that faces down."""
    red = material(plain(32, 32, (220, 20, 20, 255)), name="red", both=under.double_sided)
    over = np.array([(0, 0, 0.1), (1, 0, 0.1), (1, 1, 0.1), (0, 1, 0.1)])
    mesh = mesh_of(
        np.concatenate([over, over - (0, 0, 0.2)]), [(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)], np.tile(UVS, (2, 1))
    )
    return leaf_of(replace(mesh, materials=(red, under), face_material=np.array([0, 0, 1, 1], np.int32)))


def test_a_leaf_that_folds_over_itself_has_two_images() -> None:
    found = images(folded(material(plain(32, 32, (20, 20, 220, 255)), name="blue")))
    front, back = image(found, found.front[0]), image(found, found.back[0])
    assert (front[..., 0] > 200).all()
    assert (back[..., 2] > 200).all()


def test_a_single_sided_leaf_has_no_back() -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(plain(32, 32), both=False)))
    assert not found.back.any()
    assert found.front[0, 2:].all()


def test_a_twig_piece_has_a_back_whatever_its_material() -> None:
    bark = material(plain(32, 32), both=False)
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=bark, axes=(0.0, 1.0, 0.0)), leaf_texels=20)
    np.testing.assert_array_equal(found.front, found.back)
    assert texels(found, found.front[0])[2:] == (20, 20)  # around it lies a whole tile of bark, however wide


# ---- likeness ------------------------------------------------------------------------------------------------------


def shades(*greens: int) -> Tree:
    """Leaves of different materials, none a copy of another."""
    tree = leaf_tree([(i, 0.0, 1.0) for i in range(len(greens))])
    materials = tuple(material(plain(32, 32, (60, green, 40, 255)), name=str(green)) for green in greens)
    number = np.arange(len(greens), dtype=np.int32).repeat(2)
    return each_its_own(replace(tree, foliage=replace(tree.foliage, materials=materials, face_material=number)))


def test_shapes_that_look_the_same_share_an_image() -> None:
    found = images(shades(160, 161, 60))
    np.testing.assert_array_equal(found.front[0], found.front[1])
    assert not np.array_equal(found.front[0], found.front[2])
    assert image(found, found.front[2])[..., 1].max() < 70


def test_likeness_sets_what_looks_the_same() -> None:
    places = [images(shades(160, 161, 170), likeness=likeness).front for likeness in (0, 0.02, 1)]
    assert [len(np.unique(front, axis=0)) for front in places] == [3, 1 if alike(160, 170) < 0.02 else 2, 1]


def alike(one: int, other: int) -> float:
    """RMS difference of two plain greens as the stage compares them: over colour, alpha and three parts of a normal."""
    near, far = to_linear(np.array([one, other], np.uint8))
    return float(abs(near - far) / np.sqrt(7))


def test_of_shapes_that_look_the_same_the_finest_is_drawn() -> None:
    tree = shades(160, 160)
    coarse = replace(tree.foliage.materials[0], color_map=Texture("coarse", plain(16, 16, (60, 160, 40, 255))))
    found = images(replace(tree, foliage=replace(tree.foliage, materials=(coarse, tree.foliage.materials[1]))))
    assert texels(found, found.front[0]) == texels(found, found.front[1])
    assert texels(found, found.front[0])[2:] == (32, 32)


def test_shapes_that_differ_in_their_normals_only_are_kept_apart() -> None:
    tree = shades(160, 160)
    normals = tree.foliage.normals.copy()
    normals[4:] = (0.6, 0.0, 0.8)
    found = images(replace(tree, foliage=replace(tree.foliage, normals=normals)))
    assert not np.array_equal(found.front[0], found.front[1])


# ---- what is in an image -------------------------------------------------------------------------------------------


def bent(height: Doubles, shading: object | None = None) -> Tree:
    """A square leaf on a grid, its vertices at heights (rows from the bottom up, columns)."""
    rows, columns = height.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, columns), indexing="ij")
    points = np.stack([x, y, height], axis=2).reshape(-1, 3)
    uvs = np.stack([x * 0.5 + 0.5, 0.5 - y * 0.5], axis=2).reshape(-1, 2)
    first = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1, 1)
    quads = first + np.array([0, 1, columns + 1, 0, columns + 1, columns])
    mesh = replace(mesh_of(points, quads.reshape(-1, 3), uvs), materials=(GREEN,))
    if shading is not None:
        mesh = replace(mesh, normals=np.broadcast_to(np.array(shading, np.float32), mesh.normals.shape).copy())
    return leaf_of(mesh)


RIDGE = np.linspace(-0.2, 0.4, 9)


@pytest.mark.parametrize(
    ("height", "expected"),
    [
        (np.tile(RIDGE, (9, 1)), lambda u, _: 2 * u - 1),
        (np.tile(RIDGE[:, None], (1, 9)), lambda _, v: 1 - 2 * v),
        (0.1 * np.tile(np.linspace(-1, 1, 65) ** 2, (65, 1)), lambda u, _: 2 * (2 * u - 1) ** 2 - 1),
        (-0.3 * np.tile(np.linspace(-1, 1, 65) ** 2, (65, 1)), lambda u, _: 1 - 2 * (2 * u - 1) ** 2),
    ],
    ids=["rises to the right", "rises to the top", "bowl", "arch"],
)
def test_blue_of_the_normals_is_the_height_of_a_bent_leaf(height: Doubles, expected: object) -> None:
    found = images(bent(height), leaf_texels=64)
    relief = image(found, found.front[0], normal=True)[..., 2]
    v, u = (np.mgrid[:64, :64] + 0.5) / 64
    assert relief.shape == (64, 64)
    wanted = (expected(u, v) * 0.5 + 0.5) * 255
    inner = slice(1, -1)
    assert np.abs(relief - wanted)[inner, inner].max() <= 2


def test_a_flat_leaf_is_level_at_half_height() -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(disc(32))))
    relief = image(found, found.front[0], normal=True)[..., 2]
    assert np.abs(relief.astype(int) - 127.5).max() <= 1


@pytest.mark.parametrize("shading", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8), (-0.48, 0.6, 0.64)])
def test_red_and_green_are_the_normals_right_and_up(shading: tuple[float, float, float]) -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(disc(32)), shading=shading))
    normals = image(found, found.front[0], normal=True)[..., :2] / 127.5 - 1
    assert np.abs(normals - shading[:2]).max() < 0.01


def test_colours_lie_under_the_clear_texels_as_well() -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(disc(64))))
    pixels = image(found, found.front[0])
    assert pixels[0, 0, 3] == 0
    assert np.abs(pixels[..., :3].astype(int) - (60, 160, 40)).max() <= 40
    assert pixels[..., 3].astype(float).mean() / 255 == pytest.approx(np.pi * 0.4**2, rel=0.02)


# ---- the texture ---------------------------------------------------------------------------------------------------


def many(count: int, side: int = 20) -> Tree:
    """Leaves of different sizes and colours, each with its own texture."""
    random = np.random.default_rng(7)
    tree = leaf_tree([(i, 0.0, 1.0) for i in range(count)])
    colors = random.integers(0, 256, (count, 3))
    materials = tuple(
        material(plain(side + 3 * i, side + 3 * i, (*map(int, color), 255)), name=str(i))
        for i, color in enumerate(colors)
    )
    number = np.arange(count, dtype=np.int32).repeat(2)
    return each_its_own(replace(tree, foliage=replace(tree.foliage, materials=materials, face_material=number)))


def test_images_start_on_blocks_and_keep_apart() -> None:
    found = images(many(7), likeness=0)
    used = np.zeros(found.color.pixels.shape[:2], int)
    for place in found.front:
        left, top, width, height = texels(found, place)
        assert (left % BLOCK, top % BLOCK) == (0, 0)
        used[top : -(-(top + height) // BLOCK) * BLOCK, left : -(-(left + width) // BLOCK) * BLOCK] += 1
    assert used.max() == 1
    assert [texels(found, place)[2] for place in found.front] == [20 + 3 * i for i in range(7)]
    assert all(side % BLOCK == 0 for side in used.shape)


def test_every_shape_finds_its_own_image() -> None:
    tree = many(7)
    found = images(tree, likeness=0)
    for place, source in zip(found.front, tree.foliage.materials, strict=True):
        assert source.color_map is not None
        assert np.abs(image(found, place).astype(int) - source.color_map.pixels[0, 0]).max() <= 1


def test_images_that_do_not_fit_shrink() -> None:
    found = images(many(7), likeness=0, atlas=64)
    assert max(found.color.pixels.shape[:2]) <= 64
    sides = np.array([texels(found, place)[2] for place in found.front])
    assert (sides < 20 + 3 * np.arange(7)).all()
    assert (sides >= 1).all()
    assert (np.diff(sides) >= 0).all()


def test_too_many_images_for_the_texture() -> None:
    message = r"17 leaf images do not fit into a texture of 64 x 64 texels; raise \[indirect\] atlas, .* likeness"
    with pytest.raises(BudgetError, match=message):
        images(many(17), likeness=0, atlas=64)


def test_as_many_images_as_the_texture_has_blocks_fit() -> None:
    found = images(many(16), likeness=0, atlas=64)
    assert len(np.unique(found.front[:, :2], axis=0)) == 16


# ---- thresholds ----------------------------------------------------------------------------------------------------


def stripes(side: int) -> Bytes:
    """Slanting stripes, a fifth of the area: what mips blur away."""
    v, u = (np.mgrid[:side, :side] + 0.5) / side
    pixels = plain(side, side)
    pixels[(u * 16 + v * 7) % 1 > 0.2] = 0
    return pixels


def blades(side: int) -> Bytes:
    """Wedges that run to a point."""
    v, u = (np.mgrid[:side, :side] + 0.5) / side
    pixels = plain(side, side)
    pixels[np.abs(u * 4 % 1 - 0.5) > v * 0.4] = 0
    return pixels


def passing(alpha: Doubles, threshold: float) -> float:
    """The share of texels that the soft test lets pass."""
    return float(np.clip((alpha - threshold) / (2 * SOFTNESS) + 0.5, 0, 1).mean())


SHAPES = {"disc": disc(64), "small disc": disc(64, 0.15), "blades": blades(64)}


@pytest.mark.parametrize("pixels", SHAPES.values(), ids=SHAPES)
def test_every_mip_covers_what_the_image_covers(pixels: Bytes) -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(pixels)))
    mips = compressed_mips(found.color, srgb=True)
    steps = (np.arange(80) + 0.5) / 80
    unit = np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2)

    def alpha(mip: int) -> Doubles:
        inner = 0.5 * 2**mip / 64  # the image fills the texture
        return sample_texture(mips, np.clip(unit, inner, 1 - inner), np.full(len(unit), float(mip)))[:, 3]

    covered = (alpha(0) >= 0.5).mean()
    for mip, threshold in enumerate(found.thresholds[0], 1):
        assert passing(alpha(mip), threshold) == pytest.approx(covered, abs=0.03)


def test_what_mips_blur_away_is_kept_in_part() -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(stripes(64))))
    mip = compressed_mips(found.color, srgb=True)[3][..., 3] / 255
    assert 0.1 < passing(mip, found.thresholds[0, 2]) < 0.4  # a fifth is covered, and all texels are nearly alike


def test_what_is_whole_is_whole_in_every_mip() -> None:
    found = images(leaf_tree([(0.0, 0.0, 1.0)], material=material(plain(64, 64))))
    assert (found.thresholds[0] <= 1 - SOFTNESS).all()


def test_shapes_that_share_an_image_share_its_thresholds() -> None:
    found = images(shades(160, 160, 60))
    np.testing.assert_array_equal(found.thresholds[0], found.thresholds[1])
    assert found.thresholds.shape == (3, 4)


def test_two_runs_give_the_same_bytes() -> None:
    one, other = (images(many(5), likeness=0) for _ in range(2))
    np.testing.assert_array_equal(one.color.pixels, other.color.pixels)
    np.testing.assert_array_equal(one.normal.pixels, other.normal.pixels)
    np.testing.assert_array_equal(one.front, other.front)


def test_an_image_stands_only_for_images_with_no_more_texels_either_way() -> None:
    looks = np.zeros((3, 4 * 16 * 16), np.float32)
    sizes = np.array([[64.0, 4.0], [16.0, 16.0], [8.0, 4.0]])
    assert _leaders(looks, sizes, 0.1).tolist() == [0, 1, 0]


def test_one_leaf_of_many_repeats_leaves_the_others_their_texels() -> None:
    tree = leaf_tree([(0.0, 0.0, 1.0)], material=material(plain(32, 32)), uvs=((0, 64), (64, 64), (64, 0), (0, 0)))
    found = images(tree)
    assert texels(found, found.front[0])[2:] == (128, 128)
