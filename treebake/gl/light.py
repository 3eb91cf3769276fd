"""What shines on a scene, and how its shaders light it."""

from dataclasses import dataclass, field
from enum import Enum
from functools import cache

import moderngl
import numpy as np

from treebake.gl.context import LIGHT_BLOCK, context
from treebake.model import Doubles, Transmission

Color = tuple[float, float, float]  # linear RGB

_NO_SHADOW = np.eye(4)


class Shading(Enum):
    """Variants of every shader that draws: their defines."""

    PLAIN = ()  # lit by everything everywhere, as stock clients do without shadows
    SHADED = ("SHADED",)  # with shadows, the occluded sky and what comes through leaves
    CASTER = ("CASTER",)  # solid, for depth alone


def _direction(x: float, y: float, z: float) -> Doubles:
    return np.asarray(np.array([x, y, z]) / np.linalg.norm([x, y, z]))


@dataclass(frozen=True, eq=False)
class Light:
    """A sun and a sky of two colours, in the world's frame.

    sun_direction: (3,) float64, unit, towards the sun. sun, sky, ground: linear RGB of what comes from there.
    occluded: whether the sky shines on a place only as far as it is seen from there.
    """

    sun_direction: Doubles = field(default_factory=lambda: _direction(0.5, 0.8, 0.35))
    sun: Color = (1.25, 1.15, 1.0)
    sky: Color = (0.45, 0.52, 0.62)
    ground: Color = (0.22, 0.20, 0.16)
    occluded: bool = True


DAYLIGHT = Light()
DARK: Color = (0.0, 0.0, 0.0)


def transmitted(transmission: Transmission | None) -> tuple[float, float, float, float]:
    """The uniform `transmission`: factors on the albedo for what goes through, and which part of the light that is."""
    return (*transmission.color, transmission.factor) if transmission else (0.0, 0.0, 0.0, 0.0)


def shine(light: Light, to_shadow: Doubles = _NO_SHADOW, texel: float = 0.0) -> None:
    """Light everything that is drawn from now on.

    to_shadow: (4, 4), from the world to the shadow map's texture coordinates and depth, times w. texel: the longer
    side of one of its texels where w is one, in the world's unit.
    """
    rows = [
        *to_shadow.T,
        [*light.sun_direction, texel],
        [*light.sun, float(light.occluded)],
        [*light.sky, 0.0],
        [*light.ground, 0.0],
    ]
    block = _block()
    block.write(np.array(rows, np.float32).tobytes())
    block.bind_to_uniform_block(LIGHT_BLOCK)


@cache
def _block() -> moderngl.Buffer:
    return context().buffer(reserve=8 * 16)
