"""Rasterise a mesh in its texture's space: which face each texel shows."""

import moderngl
import numpy as np

from treebake.gl.context import context, leave_framebuffer, program
from treebake.gl.target import check
from treebake.model import Doubles, Floats, Ints, Longs


def face_texels(uvs: Floats, faces: Ints, size: int) -> tuple[Longs, Longs, Doubles]:
    """The texels of a texture of size x size that faces cover.

    uvs: (V, 2) float32 in 0..1; what lies outside is cut off. faces: (F, 3) int32, F < 2**24.
    Gives each texel's number (T,) int64, ascending, row after row from the top; its face (T,) int64; and the weights
    (T, 3) float64 of that face's corners. A texel whose centre no face covers goes to one whose edge crosses it, so
    that what is thinner than a texel gets some too. Raises GraphicsError.
    """
    gl = context()
    corners = np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (len(faces), 1))
    number = np.repeat(np.arange(len(faces), dtype=np.float32), 3)
    vertices = gl.buffer(np.column_stack([uvs[faces].reshape(-1, 2), corners, number]).astype(np.float32))
    first = np.arange(len(faces), dtype=np.int32)[:, None] * 3
    edges = gl.buffer((first + np.array([0, 1, 1, 2, 2, 0], np.int32)).astype(np.int32))
    layout = [(vertices, "2f 3f", "in_uv", "in_face")]
    image = gl.texture((size, size), 4, dtype="f4")
    target = gl.framebuffer([image])
    with gl.scope(target, moderngl.NOTHING):
        target.clear()
        gl.vertex_array(program("uv_bake"), layout, edges).render(moderngl.LINES)
        gl.vertex_array(program("uv_bake"), layout).render(moderngl.TRIANGLES)
    check(gl)
    texels = np.frombuffer(target.read(components=4, dtype="f4"), np.float32).reshape(-1, 4)
    leave_framebuffer()
    covered = np.flatnonzero(texels[:, 3])
    second, third = texels[covered, :2].astype(np.float64).T
    return covered, texels[covered, 2].astype(np.int64), np.stack([1 - second - third, second, third], axis=1)
