"""Draws once for each tree of a grove, as `grove.glsl` reads where it stands."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import moderngl
import numpy as np

from treebake.model import Floats


@contextmanager
def instanced(
    gl: moderngl.Context,
    shader: moderngl.Program,
    rows: Floats,
    buffers: Sequence[Any] = (),
    indices: moderngl.Buffer | None = None,
) -> Iterator[moderngl.VertexArray]:
    """A vertex array with an instance for each row of `Grove.instances`, freed at the end.

    buffers: of the vertices, as moderngl takes them.
    """
    where = ["in_place", "in_turn"] + ["in_opacity"] * ("in_opacity" in shader)  # what only counts does not fade
    own = gl.buffer(np.ascontiguousarray(rows))
    content = [*buffers, (own, "4f 2f 1f/i" if "in_opacity" in shader else "4f 2f 4x/i", *where)]
    array = gl.vertex_array(shader, content, indices)
    array.instances = len(rows)
    try:
        yield array
    finally:
        array.release()
        own.release()
