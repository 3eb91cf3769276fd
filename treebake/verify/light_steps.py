"""A tree as ever more of its light is counted ([GPSS07] Figure 12)."""

from dataclasses import dataclass, replace

from treebake.gl.light import DARK, DAYLIGHT
from treebake.gl.target import Picture
from treebake.gl.view import View
from treebake.verify.shaded import Shaded

_WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True, eq=False)
class LightSteps:
    """source: fully lit. wireframe: of the candidate, as are the others. diffuse: its colours alone. direct: the sun.
    shadows: behind shadows. full: with the occluded sky, and light through leaves.
    """

    source: Picture
    wireframe: Picture
    diffuse: Picture
    direct: Picture
    shadows: Picture
    full: Picture


def light_steps(source: Shaded, candidate: Shaded, view: View) -> LightSteps:
    """Draw them all from one view. Raises GraphicsError."""
    even = replace(DAYLIGHT, sun=DARK, sky=_WHITE, ground=_WHITE, occluded=False)
    sun = replace(DAYLIGHT, sky=DARK, ground=DARK)
    return LightSteps(
        source=source.picture(view, DAYLIGHT),
        wireframe=candidate.wireframe(view),
        diffuse=candidate.picture(view, even, shadows=False),
        direct=candidate.picture(view, sun, shadows=False),
        shadows=candidate.picture(view, sun),
        full=candidate.picture(view, DAYLIGHT),
    )
