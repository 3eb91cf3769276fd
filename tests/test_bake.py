"""The atlas's rasteriser against its readable twin: what can be worked out by hand, texel by texel."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from treebake.errors import GraphicsError
from treebake.gl import bake
from treebake.gl import context as context_module
from treebake.gl.bake import FlatTriangles, bake_atlas
from treebake.gl.context import context
from treebake.images import to_linear, to_srgb
from treebake.model import AlphaMode, Floats, Material, Texture

SIZE = (64, 32)  # texels, width and height
HALF = 1e-3  # samples are kept in half floats
WHITE = Material("white")
SEEN_FROM_FRONT = (0.0, 0.0, 1.0)


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


def box(
    x: tuple[float, float],
    y: tuple[float, float],
    *,
    depth: float = 0.0,
    material: int = 0,
    normal: tuple[float, float, float] = SEEN_FROM_FRONT,
    uvs: object = ((0, 1), (1, 1), (1, 0), (0, 0)),
    backwards: bool = False,
) -> FlatTriangles:
    """A rectangle in texels, rows downwards, whose front faces the viewer; its picture is upright."""
    corners = np.array([(x[0], y[1]), (x[1], y[1]), (x[1], y[0]), (x[0], y[0])])
    index = np.array([[0, 1, 2], [0, 2, 3]])[:, :: -1 if backwards else 1]
    positions = np.concatenate([corners, np.full((4, 1), depth)], axis=1)
    return FlatTriangles(
        positions=positions[index].astype(np.float32),
        uvs=np.array(uvs, np.float32)[index],
        normals=np.broadcast_to(np.array(normal, np.float32), (2, 3, 3)).copy(),
        values=positions[index][..., 2].astype(np.float32),
        material=np.full(2, material, np.int32),
    )


def both(*parts: FlatTriangles) -> FlatTriangles:
    names = ("positions", "uvs", "normals", "values", "material")
    return FlatTriangles(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def flat_color(rgba: tuple[int, int, int, int], **options: object) -> Material:
    pixels = np.full((2, 2, 4), rgba, np.uint8)
    return replace(Material("made", color_map=Texture("made", pixels)), **options)


def span(start: float, end: float, count: int) -> Floats:
    """How much of each of `count` unit cells lies between start and end."""
    cells = np.arange(count)
    return np.clip(np.minimum(end, cells + 1) - np.maximum(start, cells), 0, 1).astype(np.float32)


def sampled(start: float, end: float, count: int, factor: int) -> Floats:
    """The same, counted at the middles of `factor` parts a cell."""
    middles = (np.arange(count * factor) + 0.5) / factor
    return ((middles > start) & (middles < end)).reshape(count, factor).mean(axis=1).astype(np.float32)


# ---- coverage ------------------------------------------------------------------------------------------------------


def test_coverage_of_a_rectangle_is_its_area_in_each_texel() -> None:
    color, normal, _ = bake_atlas(box((3.25, 9.5), (4.75, 20.25)), [WHITE], SIZE, 4)
    assert color.shape == (32, 64, 4)
    assert normal.shape == (32, 64, 3)
    assert np.allclose(color[..., 3], np.outer(span(4.75, 20.25, 32), span(3.25, 9.5, 64)), atol=HALF)


@settings(max_examples=15, deadline=None)
@given(
    edges=st.lists(st.integers(0, 31 * 16), min_size=4, max_size=4, unique=True),
    factor=st.sampled_from([1, 2, 3, 4, 8]),
)
def test_coverage_matches_its_numpy_twin(edges: list[int], factor: int) -> None:
    # Edges at odd 32nds of a texel never meet a sample.
    x, y = (sorted(e / 16 + 1 / 32 for e in pair) for pair in (edges[:2], edges[2:]))
    color = bake_atlas(box((x[0], x[1]), (y[0], y[1])), [WHITE], SIZE, factor)[0]
    assert np.allclose(color[..., 3], np.outer(sampled(*y, 32, factor), sampled(*x, 64, factor)), atol=HALF)


def test_more_samples_come_nearer_to_the_area() -> None:
    x, y = (3.13, 9.71), (4.37, 20.59)
    exact = np.outer(span(*y, 32), span(*x, 64))
    errors = [np.abs(bake_atlas(box(x, y), [WHITE], SIZE, factor)[0][..., 3] - exact).max() for factor in (1, 2, 4, 8)]
    assert errors[0] > errors[1] > errors[2] > errors[3]
    assert errors[3] < 1 / 8


def test_row_0_is_on_top() -> None:
    color = bake_atlas(box((0, 8), (0, 4)), [WHITE], SIZE, 1)[0]
    assert color[:4, :8, 3].all()
    assert color[..., 3].sum() == 32


def test_outside_of_the_atlas_is_nothing() -> None:
    assert not bake_atlas(box((-9, -1), (2, 8)), [WHITE], SIZE, 4)[0].any()


def test_colour_is_premultiplied_by_coverage() -> None:
    material = Material("leaf", base_color=(0.8, 0.4, 0.2, 1.0))
    color, normal, _ = bake_atlas(box((0, 1.5), (0, 1)), [material], SIZE, 4)
    assert np.allclose(color[0, 0], (0.8, 0.4, 0.2, 1), atol=HALF)
    assert np.allclose(color[0, 1], (0.4, 0.2, 0.1, 0.5), atol=HALF)
    assert np.allclose(normal[0, :2], [(0, 0, 1), (0, 0, 0.5)], atol=HALF)


# ---- what is in front ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearer_triangle_wins(order: int) -> None:
    red, green = (Material(n, base_color=c) for n, c in (("red", (1, 0, 0, 1)), ("green", (0, 1, 0, 1))))
    parts = [box((0, 8), (0, 8), depth=-0.5), box((4, 12), (0, 8), depth=0.5, material=1)][::order]
    color = bake_atlas(both(*parts), [red, green], SIZE, 2)[0]
    assert np.allclose(color[:8, :4], (1, 0, 0, 1), atol=HALF)
    assert np.allclose(color[:8, 4:12], (0, 1, 0, 1), atol=HALF)


@pytest.mark.parametrize("depth", [-0.999, 0.0, 0.999])
def test_all_depths_are_drawn(depth: float) -> None:
    assert bake_atlas(box((0, 8), (0, 8), depth=depth), [WHITE], SIZE, 1)[0][..., 3].sum() == 64


def test_a_cutout_shows_what_is_behind() -> None:
    clear = flat_color((255, 0, 0, 100), alpha_mode=AlphaMode.MASK)
    green = Material("green", base_color=(0, 1, 0, 1))
    parts = both(box((0, 8), (0, 8), depth=0.5), box((0, 8), (0, 8), depth=-0.5, material=1))
    assert np.allclose(bake_atlas(parts, [clear, green], SIZE, 1)[0][:8, :8], (0, 1, 0, 1), atol=HALF)


# ---- depth ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("depth", [-0.75, 0.0, 0.5])
def test_depth_is_premultiplied_by_coverage(depth: float) -> None:
    found = bake_atlas(box((0, 1.5), (0, 1), depth=depth), [WHITE], SIZE, 4)[2]
    assert found.shape == (32, 64)
    assert np.allclose(found[0, :3], (depth, depth / 2, 0), atol=HALF)


def test_depth_is_that_of_what_is_seen() -> None:
    parts = both(box((0, 8), (0, 8), depth=-0.5), box((4, 12), (0, 8), depth=0.25))
    found = bake_atlas(parts, [WHITE], SIZE, 2)[2]
    assert np.allclose(found[:8, :4], -0.5, atol=HALF)
    assert np.allclose(found[:8, 4:12], 0.25, atol=HALF)
    assert not found[8:].any()


def test_depth_behind_a_cutout_is_what_shows_through() -> None:
    clear = flat_color((255, 0, 0, 100), alpha_mode=AlphaMode.MASK)
    parts = both(box((0, 8), (0, 8), depth=0.5), box((0, 8), (0, 8), depth=-0.25, material=1))
    assert np.allclose(bake_atlas(parts, [clear, WHITE], SIZE, 1)[2][:8, :8], -0.25, atol=HALF)


def test_values_are_interpolated_along_a_triangle() -> None:
    slanted = box((0, 32), (0, 8))
    slanted.values[:] = slanted.positions[..., 0] / 32 - 0.5
    found = bake_atlas(slanted, [WHITE], SIZE, 4)[2][:8, :32]
    assert np.allclose(found, (np.arange(32) + 0.5) / 32 - 0.5, atol=HALF)


# ---- normals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8)])
@pytest.mark.parametrize("backwards", [False, True])
def test_a_back_face_has_its_normal_reversed(normal: tuple[float, float, float], backwards: bool) -> None:
    found = bake_atlas(box((0, 8), (0, 8), normal=normal, backwards=backwards), [WHITE], SIZE, 2)[1]
    assert np.allclose(found[:8, :8], -np.array(normal) if backwards else normal, atol=HALF)


def test_interpolated_normals_are_unit() -> None:
    bent = box((0, 32), (0, 8))
    bent.normals[..., 0] = np.where(bent.positions[..., 0] > 16, 0.8, -0.8)
    bent.normals[..., 2] = 0.6
    found = bake_atlas(bent, [WHITE], SIZE, 1)[1][:8, :32]
    assert np.allclose(np.linalg.norm(found, axis=2), 1, atol=2 * HALF)
    assert (np.diff(found[0, :, 0]) > 0).all()


def test_normals_that_cancel_leave_no_hole() -> None:
    # Opposite normals meet in the middle of the leaf, where none is left.
    torn = box((0, 4), (0, 4))
    torn.normals[...] = np.where(torn.positions[..., :1] > 2, (1, 0, 0), (-1, 0, 0))
    color, normal, _ = bake_atlas(torn, [WHITE], SIZE, 1)
    assert np.isfinite(normal).all()
    none = replace(torn, normals=np.zeros_like(torn.normals))
    color, normal, _ = bake_atlas(none, [WHITE], SIZE, 2)
    assert np.isfinite(normal).all()
    assert color[:4, :4, 3].min() == 1


# ---- materials -----------------------------------------------------------------------------------------------------


def test_colour_maps_are_decoded_from_srgb() -> None:
    pixels = (200, 100, 50, 255)
    color = bake_atlas(box((0, 8), (0, 8)), [flat_color(pixels)], SIZE, 2)[0]
    assert np.allclose(to_srgb(color[:8, :8, :3]), pixels[:3], atol=1)


def test_base_colour_tints_the_map_in_linear_light() -> None:
    material = flat_color((200, 100, 50, 255), base_color=(0.5, 0.25, 1.0, 1.0))
    color = bake_atlas(box((0, 8), (0, 8)), [material], SIZE, 2)[0]
    expected = to_linear(np.array((200, 100, 50), np.uint8)) * (0.5, 0.25, 1.0)
    assert np.allclose(color[0, 0, :3], expected, atol=2 * HALF)


@pytest.mark.parametrize(
    ("mode", "cutoff", "alpha", "tint", "drawn"),
    [
        (AlphaMode.MASK, 0.5, 127, 1.0, False),
        (AlphaMode.MASK, 0.5, 128, 1.0, True),
        (AlphaMode.MASK, 0.2, 60, 1.0, True),
        (AlphaMode.MASK, 0.9, 200, 1.0, False),
        (AlphaMode.MASK, 0.5, 200, 0.5, False),  # the factor's alpha counts
        (AlphaMode.OPAQUE, 0.5, 0, 1.0, True),  # alpha is ignored
    ],
)
def test_alpha_is_cut_at_the_materials_cutoff(
    mode: AlphaMode, cutoff: float, alpha: int, tint: float, drawn: bool
) -> None:
    material = flat_color((9, 9, 9, alpha), alpha_mode=mode, alpha_cutoff=cutoff, base_color=(1, 1, 1, tint))
    color = bake_atlas(box((0, 8), (0, 8)), [material], SIZE, 2)[0]
    assert np.allclose(color[:8, :8, 3], drawn)


@pytest.mark.parametrize("alpha", [16, 100, 128, 200])
def test_blended_leaves_cover_by_their_share(alpha: int) -> None:
    material = flat_color((9, 9, 9, alpha), alpha_mode=AlphaMode.BLEND, alpha_cutoff=0.5)
    color = bake_atlas(box((0, 8), (0, 8)), [material], SIZE, 4)[0]
    assert np.allclose(color[:8, :8, 3], alpha / 255, atol=1 / 16)


def test_a_picture_lies_upright_and_repeats() -> None:
    pixels = np.zeros((2, 2, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[0, 0, 0] = pixels[0, 1, 1] = pixels[1, 0, 2] = 255  # red, green above blue, black
    material = Material("quarters", color_map=Texture("quarters", pixels))
    for shift in (0, 3, -7):  # beyond 0..1 it repeats
        uvs = np.array([(0, 1), (1, 1), (1, 0), (0, 0)]) + shift
        color = bake_atlas(box((0, 16), (0, 16), uvs=uvs), [material], SIZE, 1)[0]
        assert np.allclose(
            color[[3, 3, 12, 12], [3, 12, 3, 12], :3], [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)], atol=0.15
        )


def test_fine_cutouts_keep_their_area_however_small_they_are_drawn() -> None:
    # A leaf picture of 512 texels on 16: its mips lose what is fine, and mix in the black that lies under alpha 0.
    dots = np.random.default_rng(1).random((128, 128)) < 0.3
    pixels = (dots.repeat(4, axis=0).repeat(4, axis=1)[..., None] * (200, 100, 50, 255)).astype(np.uint8)
    material = Material("fine", color_map=Texture("fine", pixels), alpha_mode=AlphaMode.MASK)
    color = bake_atlas(box((0, 16.3), (0, 16.3)), [material], SIZE, 4)[0][:16, :16]
    assert color[..., 3].mean() == pytest.approx(0.3, rel=0.1)
    mean = color[..., :3].sum(axis=(0, 1)) / color[..., 3].sum()
    assert np.allclose(mean, to_linear(np.array((200, 100, 50), np.uint8)), rtol=0.1)


# ---- tiles ---------------------------------------------------------------------------------------------------------


def scattered() -> FlatTriangles:
    random = np.random.default_rng(3)
    places = random.integers(0, 112, (60, 2)) + random.integers(1, 32, (60, 2)) / 32
    depths = random.uniform(-1, 1, 60)
    return both(
        *(
            box((x, x + 15.5), (y, y + 9.25), depth=d, material=i % 2)
            for i, ((x, y), d) in enumerate(zip(places, depths, strict=True))
        )
    )


@pytest.mark.parametrize("size", [(128, 128), (128, 64)])
def test_tiles_leave_no_seam(size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    ramp = np.linspace(0, 255, 64, dtype=np.uint8)
    pixels = np.stack([*np.meshgrid(ramp, ramp), np.zeros((64, 64)), np.full((64, 64), 255)], axis=2).astype(np.uint8)
    materials = [Material("ramp", color_map=Texture("ramp", pixels)), Material("plain", base_color=(0, 0, 1, 1))]
    whole = bake_atlas(scattered(), materials, size, 2)
    monkeypatch.setattr(bake, "_TILE", 32)
    tiled = bake_atlas(scattered(), materials, size, 2)
    for one, other in zip(whole, tiled, strict=True):
        assert np.allclose(one, other, atol=5 * HALF)


def test_an_atlas_larger_than_a_tile() -> None:
    color = bake_atlas(box((500.5, 530.25), (10, 20)), [WHITE], (1024, 32), 2)[0]
    assert np.allclose(color[15, :, 3], sampled(500.5, 530.25, 1024, 2), atol=HALF)


def test_the_same_input_gives_the_same_bytes() -> None:
    first, second = (bake_atlas(scattered(), [WHITE, WHITE], (128, 128), 2) for _ in range(2))
    assert [part.tobytes() for part in first] == [part.tobytes() for part in second]


# ---- the context ---------------------------------------------------------------------------------------------------


def test_no_opengl_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise OSError("libEGL.so.1: cannot open shared object file")

    monkeypatch.setattr(context_module.moderngl, "create_context", refuse)
    with pytest.raises(GraphicsError, match=r"no off-screen OpenGL 3\.3 .*libEGL\.so\.1.*apt-get install libegl1"):
        context.__wrapped__()


def test_programs_are_compiled_once() -> None:
    assert context() is context()
    assert context_module.program("bake") is context_module.program("bake")


# ---- normal maps ---------------------------------------------------------------------------------------------------

BUMPS = Texture("bumps", np.full((2, 2, 4), (204, 128, 230, 255), np.uint8))  # leans towards u: (0.6, 0, 0.8)
MIRRORED = ((1, 1), (0, 1), (0, 0), (1, 0))
TURNED = ((0, 0), (0, 1), (1, 1), (1, 0))  # u runs up the picture's right side, v to the right


@pytest.mark.parametrize(
    ("uvs", "backwards", "expected"),
    [
        (((0, 1), (1, 1), (1, 0), (0, 0)), False, (0.6, 0, 0.8)),
        (MIRRORED, False, (-0.6, 0, 0.8)),
        (TURNED, False, (0, 0.6, 0.8)),
        (((0, 1), (1, 1), (1, 0), (0, 0)), True, (-0.6, 0, 0.8)),  # a bump on the front is a dent in the back
    ],
)
def test_a_normal_map_bends_the_normal(uvs: object, backwards: bool, expected: tuple[float, float, float]) -> None:
    material = Material("leaf", normal_map=BUMPS, double_sided=True)
    normal = (0.0, 0.0, -1.0) if backwards else SEEN_FROM_FRONT
    found = bake_atlas(box((0, 8), (0, 8), uvs=uvs, backwards=backwards, normal=normal), [material], SIZE, 1)[1]
    assert np.allclose(found[1:7, 1:7], expected, atol=0.01)
