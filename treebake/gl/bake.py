"""Rasterise flattened leaves into an atlas: linear colour, coverage and normals, supersampled."""

from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from treebake.gl.context import context, program
from treebake.model import AlphaMode, Floats, Ints, Material, Texture

_TILE = 512  # texels; with supersampling by 4 a tile needs 2048 x 2048 samples
_SRGB8_ALPHA8 = 0x8C43


@dataclass(frozen=True, eq=False)
class FlatTriangles:
    """Triangles already placed in the atlas.

    positions: (M, 3, 3) float32, x and y in texels (row 0 on top), depth between -1 and 1, greatest in front.
    uvs: (M, 3, 2). normals: (M, 3, 3) in the card's frame (right, up, towards the viewer), as seen from the triangle's
    front.
    material: (M,) int32.
    """

    positions: Floats
    uvs: Floats
    normals: Floats
    material: Ints


def bake_atlas(
    triangles: FlatTriangles, materials: Sequence[Material], size: tuple[int, int], supersample: int
) -> tuple[Floats, Floats, Floats]:
    """Draw the triangles into an atlas of size (width, height), with `supersample` squared samples a texel.

    Returns colour (h, w, 4) float32, linear and premultiplied by its alpha, which is coverage in 0..1; normals
    (h, w, 3) float32 in the card's frame; and depth (h, w) float32; both premultiplied likewise. Tiled, so that memory
    stays below 200 MB of samples.
    """
    gl = context()
    width, height = size
    color = np.empty((height, width, 4), np.float32)
    normal = np.empty((height, width, 4), np.float32)  # the depth last
    batches = [_upload(gl, triangles, index, materials[index]) for index in np.unique(triangles.material)]
    tile = min(_TILE, max(width, height))
    images, samples = _target(gl, tile * supersample, "f2", depth=True)
    averaged = _target(gl, tile, "f4", depth=False)[1]
    average = gl.vertex_array(program("average"), [])
    for y in range(0, height, tile):
        for x in range(0, width, tile):
            samples.use()
            samples.clear()
            gl.enable_only(moderngl.DEPTH_TEST)
            for batch in batches:
                batch.draw((x, y, tile, tile))
            averaged.use()
            gl.enable_only(moderngl.NOTHING)
            for unit, image in enumerate(images):
                image.use(unit)
            average.program["first"], average.program["second"] = 0, 1
            average.program["factor"] = supersample
            average.render(moderngl.TRIANGLES, vertices=3)
            rows, columns = min(tile, height - y), min(tile, width - x)
            color[y : y + rows, x : x + columns] = _pixels(averaged, 0, tile)[:rows, :columns]
            normal[y : y + rows, x : x + columns] = _pixels(averaged, 1, tile)[:rows, :columns]
    return color, normal[..., :3], normal[..., 3]


@dataclass(frozen=True, eq=False)
class _Batch:
    """The triangles of one material, on the GPU."""

    array: moderngl.VertexArray
    color_map: moderngl.Texture
    normal_map: moderngl.Texture
    material: Material

    def draw(self, window: tuple[int, int, int, int]) -> None:
        shader = self.array.program
        self.color_map.use(0)
        self.normal_map.use(1)
        shader["color_map"], shader["normal_map"] = 0, 1
        shader["has_normal_map"] = self.material.normal_map is not None
        shader["window"] = window
        shader["base_color"] = self.material.base_color
        shader["blend"] = self.material.alpha_mode is AlphaMode.BLEND
        shader["alpha_cutoff"] = 0.0 if self.material.alpha_mode is AlphaMode.OPAQUE else self.material.alpha_cutoff
        self.array.render(moderngl.TRIANGLES)


def _upload(gl: moderngl.Context, triangles: FlatTriangles, index: int, material: Material) -> _Batch:
    mask = triangles.material == index
    vertices = np.concatenate([triangles.positions[mask], triangles.uvs[mask], triangles.normals[mask]], axis=2)
    buffer = gl.buffer(np.ascontiguousarray(vertices, np.float32))
    layout = [(buffer, "3f 2f 3f", "in_position", "in_uv", "in_normal")]
    array = gl.vertex_array(program("bake"), layout)
    color_map = _texture(gl, material.color_map, internal_format=_SRGB8_ALPHA8)
    return _Batch(array, color_map, _texture(gl, material.normal_map), material)


def _texture(gl: moderngl.Context, texture: Texture | None, **options: int) -> moderngl.Texture:
    pixels = np.full((1, 1, 4), 255, np.uint8) if texture is None else texture.pixels
    made = gl.texture((pixels.shape[1], pixels.shape[0]), 4, np.ascontiguousarray(pixels), **options)
    made.filter = (moderngl.LINEAR, moderngl.LINEAR)
    return made


def _target(
    gl: moderngl.Context, size: int, dtype: str, *, depth: bool
) -> tuple[list[moderngl.Texture], moderngl.Framebuffer]:
    images = [gl.texture((size, size), 4, dtype=dtype) for _ in range(2)]
    buffer = gl.depth_renderbuffer((size, size)) if depth else None
    return images, gl.framebuffer(images, buffer)


def _pixels(target: moderngl.Framebuffer, attachment: int, size: int) -> Floats:
    data = target.read(components=4, attachment=attachment, dtype="f4")
    return np.frombuffer(data, np.float32).reshape(size, size, 4)
