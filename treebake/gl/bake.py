"""Rasterise flattened leaves into an atlas: linear colour, coverage, normals and a value more, supersampled."""

from collections.abc import Sequence
from dataclasses import dataclass

import moderngl
import numpy as np

from treebake.gl.context import context, program
from treebake.gl.film import Film
from treebake.gl.textures import upload_plain
from treebake.model import AlphaMode, Floats, Ints, Material

_TILE = 512  # texels; with supersampling by 4 a tile needs 2048 x 2048 samples


@dataclass(frozen=True, eq=False)
class FlatTriangles:
    """Triangles already placed in the atlas.

    positions: (M, 3, 3) float32, x and y in texels (row 0 on top), depth between -1 and 1, greatest in front.
    uvs: (M, 3, 2). normals: (M, 3, 3) in the card's frame (right, up, towards the viewer), as seen from the triangle's
    front. values: (M, 3), of each corner, whatever they mean. material: (M,) int32.
    """

    positions: Floats
    uvs: Floats
    normals: Floats
    values: Floats
    material: Ints


def bake_atlas(
    triangles: FlatTriangles, materials: Sequence[Material], size: tuple[int, int], supersample: int
) -> tuple[Floats, Floats, Floats]:
    """Draw the triangles into an atlas of size (width, height), with `supersample` squared samples a texel.

    Returns colour (h, w, 4) float32, linear and premultiplied by its alpha, which is coverage in 0..1; normals
    (h, w, 3) float32 in the card's frame; and the triangles' values (h, w) float32; both premultiplied likewise. Tiled,
    so that memory stays below 200 MB of samples.
    """
    gl = context()
    width, height = size
    color = np.empty((height, width, 4), np.float32)
    normal = np.empty((height, width, 4), np.float32)  # the value last
    batches = [_upload(gl, triangles, index, materials[index]) for index in np.unique(triangles.material)]
    tile = min(_TILE, max(width, height))
    film = Film(gl, (tile, tile), supersample, count=2)
    for y in range(0, height, tile):
        for x in range(0, width, tile):
            film.expose()
            for batch in batches:
                batch.draw((x, y, tile, tile))
            rows, columns = min(tile, height - y), min(tile, width - x)
            for sheet, mean in zip((color, normal), film.develop(), strict=True):
                sheet[y : y + rows, x : x + columns] = mean[:rows, :columns]
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
    parts = triangles.positions, triangles.uvs, triangles.normals, triangles.values[..., None]
    vertices = np.concatenate([part[mask] for part in parts], axis=2)
    buffer = gl.buffer(np.ascontiguousarray(vertices, np.float32))
    layout = [(buffer, "3f 2f 3f 1f", "in_position", "in_uv", "in_normal", "in_value")]
    array = gl.vertex_array(program("bake"), layout)
    color_map = upload_plain(gl, material.color_map, srgb=True)
    return _Batch(array, color_map, upload_plain(gl, material.normal_map, srgb=False), material)
