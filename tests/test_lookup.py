"""The shader's lookup next to its twin in numpy, pixel by pixel."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from foliage import leaf_tree, planes, random_leaves, rotation

from treebake import lookup as lookup_module
from treebake.compression import compressed_mips
from treebake.gl import context as context_module
from treebake.gl.context import context
from treebake.gl.indirect import IndirectBillboards
from treebake.gl.view import ONE_TREE, View, column_major
from treebake.grow import grow
from treebake.lookup import Images, Rays, look_up, sample_texture
from treebake.model import Doubles, IndirectTextures, Tree
from treebake.stages.cluster import ClusterSettings, cluster
from treebake.stages.indirect import IndirectSettings, indirect
from treebake.stages.split import split

SIZE = 96  # pixels a side
NEVER = 1e29
ALIKE = 0.995  # share of pixels that must name the same leaf; a pixel on an edge may see either side
UV, ALONG = 2e-3, 1e-4  # of the texture's side; of the ray


@pytest.fixture(autouse=True)
def _no_gl_error() -> Iterator[None]:
    yield
    assert context().error == "GL_NO_ERROR"


def parallel(turn: Doubles, radius: float) -> View:
    to_clip = np.eye(4)
    to_clip[:3, :3] = turn / radius
    to_clip[2] /= -4  # clip space is left-handed, and deep enough for all
    return View(to_clip, SIZE, 0.0, 1.0)


def perspective(turn: Doubles, radius: float) -> View:
    near, far = 0.5 * radius, 6.0 * radius
    to_eye = np.eye(4)
    to_eye[:3, :3] = turn
    to_eye[2, 3] = -3 * radius
    depth = [[0, 0, (near + far) / (near - far), 2 * near * far / (near - far)], [0, 0, -1, 0]]
    return View(np.array([[2.5, 0, 0, 0], [0, 2.5, 0, 0], *depth], np.float64) @ to_eye, SIZE, near, far)


def from_shader(textures: IndirectTextures, view: View, share: float, dither: float) -> np.ndarray:
    """(SIZE * SIZE, 4): placement, u, v, along; row 0 at the bottom."""
    gl = context()
    source = context_module._source(str(Path(__file__).parent / "lookup_probe.glsl"))
    head = "#version 330 core\n#define {}_STAGE\n"
    probe = gl.program(vertex_shader=head.format("VERTEX") + source, fragment_shader=head.format("FRAGMENT") + source)
    boards = IndirectBillboards(gl, textures)
    for unit, (name, texture) in enumerate(boards._textures.items()):
        texture.use(unit)
        if name in probe:
            probe[name] = unit
    probe["from_clip"] = column_major(np.linalg.inv(view.to_clip))
    probe["largest"], probe["window"], probe["share"], probe["dither"] = textures.largest, (SIZE, SIZE), share, dither
    target = gl.framebuffer(gl.texture((SIZE, SIZE), 4, dtype="f4"), gl.depth_renderbuffer((SIZE, SIZE)))
    with gl.scope(target, gl.DEPTH_TEST):
        target.clear(0, 0, 0, NEVER)
        boards._boxes(probe, view, ONE_TREE)
    found = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(-1, 4).copy()
    found[:, 0] -= 1
    boards.release()
    return found


def from_twin(textures: IndirectTextures, view: View, share: float, dither: float) -> np.ndarray:
    """The same by `look_up`, the nearest of all billboards."""
    centers = (np.arange(SIZE) + 0.5) / SIZE * 2 - 1
    x, y = (axis.ravel() for axis in np.meshgrid(centers, centers))

    def unprojected(x: Doubles, z: float) -> Doubles:
        point = np.stack([x, y, np.full_like(x, z), np.ones_like(x)], axis=1) @ np.linalg.inv(view.to_clip).T
        return point[:, :3] / point[:, 3:]

    near, far = unprojected(x, -1), unprojected(x, 1)
    aside = [np.linalg.norm(unprojected(x + 1 / SIZE, z) - at, axis=1) for z, at in ((1, far), (-1, near))]
    images = Images(compressed_mips(textures.leaf_color, srgb=True), compressed_mips(textures.leaf_normal, srgb=False))
    rays = Rays(near, far - near, np.stack(aside, axis=1))
    best = np.full((SIZE * SIZE, 4), (-1, 0, 0, NEVER))
    for number in range(len(textures.billboards)):
        hits = look_up(textures, images, number, rays, share, dither)
        nearer = (hits.placement >= 0) & (hits.along < best[:, 3])
        best[nearer] = np.column_stack([hits.placement, hits.uv, hits.along])[nearer]
    return best


def assert_alike(textures: IndirectTextures, view: View, *, share: float = 1.0, dither: float = 0.0) -> None:
    shader, twin = (each(textures, view, share, dither) for each in (from_shader, from_twin))
    same = shader[:, 0] == twin[:, 0]
    assert (twin[:, 0] >= 0).mean() > 0.02, "the view shows next to nothing"
    assert same.mean() >= ALIKE
    seen = same & (twin[:, 0] >= 0)
    # Pixels that see the same leaf on either side of a fold differ in more than rounding.
    close = (np.abs(shader - twin)[:, 1:3] < UV).all(axis=1) & (np.abs(shader - twin)[:, 3] < ALONG)
    assert close[seen].mean() >= ALIKE


def baked(tree: Tree, count: int, **settings: object) -> IndirectTextures:
    clusters = cluster(tree.leaves, ClusterSettings(billboards=count, compactness=0.5))
    return indirect(tree, clusters, IndirectSettings(**settings))


@pytest.fixture(scope="module")
def shrub() -> IndirectTextures:
    return baked(split(grow("shrub", leaves=60)), 4)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("camera", [parallel, perspective])
def test_a_crown_from_any_side(shrub: IndirectTextures, camera: object, seed: int) -> None:
    turn = rotation(seed)
    view = camera(turn, 0.6)
    center = np.eye(4)
    center[:3, 3] = -np.array([0, 0.5, 0])
    assert_alike(shrub, View(view.to_clip @ center, SIZE, view.near, view.far))


@pytest.mark.parametrize("dither", [0.0, 0.5])
@pytest.mark.parametrize("share", [0.3, 0.75])
def test_a_part_of_each_list(share: float, dither: float) -> None:
    heap = random_leaves(3, 40, spread=0.3)
    tree = leaf_tree(heap.centers, heap.normals, size=0.3)
    assert_alike(baked(tree, 2, cell=3.0), parallel(rotation(5), 0.6), share=share, dither=dither)


@pytest.mark.parametrize("settings", [{"flat": True}, {"single": True, "flat": True, "cell": 0.5}, {"orientations": 4}])
def test_every_mode(settings: dict[str, object]) -> None:
    heap = random_leaves(1, 30, spread=0.4)
    tree = leaf_tree(heap.centers, heap.normals, size=0.3)
    assert_alike(baked(tree, 3, **settings), parallel(rotation(2), 0.7))


def test_a_single_leaf_seen_from_the_front_and_from_behind() -> None:
    tree = leaf_tree([(0.0, 0.0, 0.0)], size=1.0)
    textures = indirect(tree, planes([0], [(0, 0, 1)], [0]), IndirectSettings())
    for turn in (np.eye(3), np.diag([-1.0, 1.0, -1.0])):
        assert_alike(textures, parallel(turn, 1.0))


def test_bilinear_sampling_by_hand() -> None:
    pixels = np.zeros((1, 2, 4), np.uint8)
    pixels[0, 1] = 255
    mips = [pixels, np.full((1, 1, 4), 51, np.uint8)]
    uv = np.array([[0.25, 0.5], [0.5, 0.5], [0.75, 0.5], [0.5, 0.5], [0.25, 0.5]])
    lod = np.array([0.0, 0.0, 0.0, 1.0, 0.5])
    assert np.allclose(sample_texture(mips, uv, lod)[:, 0], [0, 0.5, 1, 0.2, 0.1])


def test_the_constants_are_the_shaders() -> None:
    shader = (Path(context_module.__file__).parent / "shaders/indirect_lookup.glsl").read_text()
    for name in ("LIST_BITS", "ROW_BITS", "RELIEF_STEPS", "MOST_LOD", "SOFTNESS"):
        (value,) = re.findall(rf"const (?:int|float) {name} = ([\d.]+);", shader)
        assert float(value) == getattr(lookup_module, name)
