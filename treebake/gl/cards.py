"""Draws the cards of many trees with tables and images looked up by their shaders: what slicings and views share."""

from collections.abc import Mapping
from typing import Any

import moderngl

from treebake.gl.instances import instanced
from treebake.gl.view import Grove, View, column_major
from treebake.model import Doubles


def draw_cards(
    gl: moderngl.Context,
    shader: moderngl.Program,
    textures: Mapping[str, moderngl.Texture],
    values: Mapping[str, Any],
    view: View,
    grove: Grove,
    center: Doubles,
    vertices: int,
) -> None:
    """Draw a number of vertices for each tree of a grove, the farthest tree first, in one call.

    textures, values: of the uniforms of the same names, as far as the shader has them. center: (3,), of the tree.
    """
    if not len(grove.turns):
        return
    for unit, (name, texture) in enumerate(textures.items()):
        texture.use(unit)
        if name in shader:
            shader[name] = unit
    seen = {
        "to_clip": column_major(view.to_clip),
        "eye": tuple(view.eye),
        "center": tuple(center),
        "focus": view.eye_focus,
    }
    for name, value in {**seen, **values}.items():
        if name in shader:
            shader[name] = value
    gl.disable(gl.CULL_FACE)
    with instanced(gl, shader, grove.instances(view.eye, center)) as array:
        array.render(moderngl.TRIANGLES, vertices=vertices)


def far_and_near(view: View, grove: Grove, center: Doubles, size: float, pixels: float) -> tuple[Grove, Grove]:
    """The trees beyond and within the distance at which the largest of them is `pixels` high.

    One distance for all, so that what is drawn first lies behind what is drawn second. size: of the tree, unscaled.
    """
    near = grove.away(view.eye, center) * pixels <= size * view.eye_focus * float(grove.places[:, 3].max(initial=0))
    return grove.select(~near), grove.select(near)
