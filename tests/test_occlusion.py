"""The sky that vertices see, against what can be worked out by hand, and how it is carried along."""

from ctypes import CDLL
from dataclasses import replace

import numpy as np
import pytest
from foliage import GREEN, PAINTED, frozen, leaf_tree
from hypothesis import given, settings
from hypothesis import strategies as st
from stems import empty, mesh_of, sphere, stem, together, tree_of

from treebake.errors import GraphicsError, SettingsError
from treebake.geometry import join
from treebake.gl.context import context
from treebake.gl.occlusion import sky_seen
from treebake.model import EMPTY_MESH, AlphaMode, Floats, Mesh, Texture
from treebake.stages.occlusion import OcclusionSettings, occlusion
from treebake.stages.trunk import TrunkSettings, trunk
from treebake.stages.twigs import TwigSettings, twigs

SMALL = {"directions": 512, "texels": 256, "seed": 1}
NEAR = 0.03  # of 512 directions


@pytest.fixture(autouse=True)
def _no_gl_error() -> object:
    yield
    assert context().error == "GL_NO_ERROR"


def seen(mesh: Mesh, *, thin: object = False, bias: float = 0.01, **more: int) -> Floats:
    sees_both = np.broadcast_to(thin, len(mesh.positions))
    return sky_seen(frozen(mesh), sees_both, bias=bias, **{**SMALL, **more})


def disc(height: float, radius: float = 1.0, corners: int = 64) -> Mesh:
    """A level disc, whose front is up."""
    around = np.arange(corners) * 2 * np.pi / corners
    rim = np.stack([np.sin(around), np.zeros(corners), np.cos(around)], axis=1) * radius
    points = np.concatenate([np.zeros((1, 3)), rim]) + np.array([0, height, 0])
    faces = [(0, 1 + i, 1 + (i + 1) % corners) for i in range(corners)]
    return mesh_of(points, faces)


@pytest.mark.parametrize("thin", [False, True])
def test_what_is_alone_sees_all(thin: bool) -> None:
    assert seen(disc(0.0), thin=thin).min() > 0.99


@pytest.mark.parametrize("height", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("thin", "half"), [(False, 1.0), (True, 0.5)])
def test_a_disc_above_hides_its_form_factor(height: float, thin: bool, half: float) -> None:
    both = join(disc(0.0, 0.1), disc(height))
    hidden = 1 / (1 + height**2)
    assert seen(both, thin=thin)[0] == pytest.approx(1 - half * hidden, abs=NEAR)


def test_a_disc_below_hides_nothing_of_a_single_side_and_half_of_a_leaf() -> None:
    both = join(disc(0.0, 0.1), disc(-0.05, 2.0))
    assert seen(both)[0] > 0.99
    assert seen(both, thin=True)[0] == pytest.approx(0.5, abs=NEAR)


def test_between_two_sheets_it_is_dark() -> None:
    both = join(join(disc(0.0, 0.1), disc(0.05, 2.0)), disc(-0.05, 2.0))
    assert seen(both, thin=True)[0] < NEAR


@pytest.mark.parametrize(
    ("alpha", "mode", "hides"),
    [(100, AlphaMode.MASK, 0), (200, AlphaMode.MASK, 1), (128, AlphaMode.BLEND, 0.5), (0, AlphaMode.OPAQUE, 1)],
)
def test_what_is_cut_out_hides_nothing(alpha: int, mode: AlphaMode, hides: float) -> None:
    clear = Texture("clear", np.full((2, 2, 4), (255, 255, 255, alpha), np.uint8))
    above = replace(disc(0.5), materials=(replace(GREEN, color_map=clear, alpha_mode=mode),))
    found = seen(join(disc(0.0, 0.1), above))[0]
    assert found == pytest.approx(1 - hides / 1.25, abs=NEAR)


def test_a_leaf_is_not_hidden_by_itself_however_it_is_slanted() -> None:
    turns = np.linalg.qr(np.random.default_rng(0).normal(size=(12, 3, 3)))[0]
    for turn in turns:
        mesh = disc(0.0)
        slanted = replace(
            mesh,
            positions=(mesh.positions @ turn).astype(np.float32),
            normals=(mesh.normals @ turn).astype(np.float32),
        )
        assert seen(slanted, thin=True, texels=64)[0] > 0.99


def test_directions_are_deterministic_and_turned_by_the_seed() -> None:
    mesh = leaf_tree(np.random.default_rng(0).uniform(-0.3, 0.3, (40, 3))).foliage
    one, again, other = (seen(mesh, thin=True, directions=64, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert 0 < np.abs(one - other).mean() < 0.06


def test_nothing_and_degenerate_faces_give_numbers() -> None:
    assert seen(EMPTY_MESH).shape == (0,)
    np.testing.assert_array_equal(seen(mesh_of([(1, 2, 3)] * 3, [(0, 1, 2)])), 1)  # a point, without a normal
    np.testing.assert_array_equal(seen(mesh_of([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)]), thin=True), 1)
    unused = disc(0.0)
    far = np.concatenate([unused.positions, [(1e6, 0, 0)]]).astype(np.float32)
    pad = {name: np.pad(getattr(unused, name), ((0, 1), (0, 0))) for name in ("normals", "uvs")}
    assert np.isfinite(seen(replace(unused, positions=far, **pad))).all()


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 1000), st.integers(1, 30))
def test_it_is_a_part_of_one(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    tree = leaf_tree(random.normal(size=(count, 3)), random.normal(size=(count, 3)), material=PAINTED)
    found = seen(tree.foliage, thin=True, directions=16, texels=32)
    assert found.dtype == np.float32
    assert ((found >= 0) & (found <= 1)).all()


def test_vertices_of_several_materials_hide_each_other() -> None:
    hole = Texture("hole", np.zeros((1, 1, 4), np.uint8))
    cut = replace(disc(0.3), materials=(replace(GREEN, color_map=hole, alpha_mode=AlphaMode.MASK),))
    assert seen(join(join(disc(0.0, 0.1), cut), disc(0.5)))[0] == pytest.approx(1 - 1 / 1.25, abs=NEAR)


def test_opengl_is_left_as_it_was() -> None:
    gl = context()
    gl.enable_only(gl.NOTHING)
    with gl.scope(gl.simple_framebuffer((3, 3)), gl.NOTHING):
        seen(disc(0.0), directions=2, texels=16)
        assert gl.fbo.size == (1, 1)  # the one that stays
        assert not CDLL("libGL.so.1").glIsEnabled(0x0BE2)  # GL_BLEND


def test_what_opengl_reports_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def out_of_memory(_gl: object) -> None:
        raise GraphicsError("OpenGL reports GL_OUT_OF_MEMORY while drawing")

    monkeypatch.setattr("treebake.gl.occlusion.check", out_of_memory)
    with pytest.raises(GraphicsError, match="GL_OUT_OF_MEMORY"):
        seen(disc(0.0), directions=2, texels=16)


def test_more_vertices_than_a_texture_takes_are_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("treebake.gl.occlusion._ROW", 1)
    many = context().info["GL_MAX_TEXTURE_SIZE"] + 1
    mesh = disc(0.0)
    unused = {name: np.zeros((many, width), np.float32) for name, width in (("normals", 3), ("uvs", 2))}
    positions = np.zeros((many, 3), np.float32)
    positions[: len(mesh.positions)] = mesh.positions
    with pytest.raises(GraphicsError, match=r"set \[occlusion\] directions = 0, or give a tree of fewer vertices"):
        seen(replace(mesh, positions=positions, **unused), directions=2, texels=16)


# ---- the stage -----------------------------------------------------------------------------------------------------


QUICK = OcclusionSettings(directions=32, texels=64)


def test_trunk_and_foliage_hide_each_other() -> None:
    tree = replace(leaf_tree([(0, 0.05, 0)], normals=(0, 1, 0), size=0.02), trunk=disc(0.0, 2.0))
    found = occlusion(tree, OcclusionSettings(directions=512))
    assert found.foliage.occlusion == pytest.approx(0.5, abs=NEAR)
    assert found.trunk.occlusion is not None
    assert found.trunk.occlusion.shape == (len(tree.trunk.positions),)
    assert found.trunk.occlusion[0] < 0.95 < 0.99 < found.trunk.occlusion[1]


def test_a_tree_may_lack_leaves_or_trunk() -> None:
    bare = tree_of(stem(), leaves=0)
    assert occlusion(bare, QUICK).trunk.occlusion is not None
    leaves = leaf_tree([(0, 0, 0)])
    found = occlusion(leaves, QUICK)
    np.testing.assert_array_equal(found.foliage.occlusion, 1)
    assert found.trunk.occlusion is not None
    assert found.trunk.occlusion.shape == (0,)


def test_no_directions_leave_the_tree_as_it_is() -> None:
    tree = leaf_tree([(0, 0, 0)])
    assert occlusion(tree, OcclusionSettings(directions=0)) is tree


@pytest.mark.parametrize("change", [{"directions": 3}, {"directions": -2}, {"texels": 8}, {"seed": -1}])
def test_settings_out_of_range_are_refused(change: dict[str, int]) -> None:
    with pytest.raises(SettingsError, match=r"\[occlusion\]"):
        occlusion(leaf_tree([(0, 0, 0)]), replace(QUICK, **change))


SKY = np.zeros((2, 4, 4), np.uint8)  # columns of 51, 102, 153, 204
SKY[..., 0], SKY[..., 1:] = [51, 102, 153, 204], 255
MAPPED = replace(GREEN, name="mapped", occlusion_map=Texture("sky", SKY))


@pytest.mark.parametrize("own", [False, True], ids=["by its uvs", "by uvs of its own"])
def test_a_map_of_the_foliage_is_a_factor_on_what_its_vertices_see(own: bool) -> None:
    tree = leaf_tree([(0, 0, 0), (5, 0, 0)], material=MAPPED)
    plain = occlusion(leaf_tree([(0, 0, 0), (5, 0, 0)]), QUICK).foliage.occlusion
    count = len(tree.foliage.positions)
    uvs = np.column_stack([np.arange(count) % 4 / 4 + 0.125, np.full(count, 0.5)]).astype(np.float32)
    uvs[0, 0] = 1.0  # midway between the last column and the first: the map repeats
    placed = {"occlusion_uvs": uvs} if own else {"uvs": uvs}
    found = occlusion(replace(tree, foliage=replace(tree.foliage, **placed)), QUICK).foliage
    said = np.array([0.2, 0.4, 0.6, 0.8])[np.arange(count) % 4]
    said[0] = 0.5
    assert plain is not None
    np.testing.assert_allclose(found.occlusion, said * plain, atol=1e-6)
    assert found.occlusion_uvs is None
    assert [material.occlusion_map for material in found.materials] == [None]
    # Done once more, as for a picture of the source, it does not count twice.
    again = occlusion(replace(tree, foliage=replace(found, occlusion=None)), QUICK).foliage
    np.testing.assert_array_equal(again.occlusion, plain)


def test_the_trunk_keeps_its_maps() -> None:
    tree = replace(leaf_tree([(9, 9, 9)]), trunk=stem())
    bark = replace(tree.trunk, materials=(MAPPED,))
    found, plain = (occlusion(each, QUICK).trunk for each in (replace(tree, trunk=bark), tree))
    assert found.materials[0] is MAPPED
    np.testing.assert_array_equal(found.occlusion, plain.occlusion)


# ---- carried along -------------------------------------------------------------------------------------------------


def by_height(mesh: Mesh) -> Mesh:
    """Occlusion that grows with height: 0.1 + 0.2 y."""
    return replace(mesh, occlusion=(0.1 + 0.2 * mesh.positions[:, 1]).astype(np.float32))


@pytest.mark.parametrize("source", [stem(radii=(0.1, 0.1, 0.1, 0.1), sides=16), sphere()], ids=["tube", "solid"])
def test_a_simplified_trunk_keeps_it_where_it_was(source: Mesh) -> None:
    found = trunk(by_height(source), TrunkSettings(triangles=source.triangles // 2))
    assert found.occlusion is not None
    np.testing.assert_allclose(found.occlusion, 0.1 + 0.2 * found.positions[:, 1], atol=0.05)
    assert trunk(source, TrunkSettings(triangles=source.triangles // 2)).occlusion is None


def test_pieces_of_twigs_keep_it_where_it_was() -> None:
    thin = by_height(together(stem(radii=(0.4, 0.35, 0.3)), stem(radii=(0.02, 0.01, 0.005), at=(1.0, 0.0, 0.0))))
    after = twigs(tree_of(thin), TwigSettings(radius=0.05))
    pieces = after.foliage.select(after.leaves.face_leaf >= 3)
    assert pieces.triangles
    assert pieces.occlusion is not None
    np.testing.assert_allclose(pieces.occlusion, 0.1 + 0.2 * pieces.positions[:, 1], atol=0.01)
    assert empty().occlusion is None
