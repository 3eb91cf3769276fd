"""How a representation takes light: relit, its shadows, a whole day, each beside its source ([GPSS07] 5.2, 7).

Source and candidate are lit alike, by suns that nothing was baked or fitted with, behind shadow maps that each casts
itself. The source's sky is occluded as its own leaves and branches do it, the candidate's as its published occlusion
says.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace

import numpy as np

from treebake.checks import check
from treebake.geometry import turn_to
from treebake.gl.light import Light
from treebake.model import Doubles, Floats, Layers, Mesh
from treebake.verify.cameras import Camera
from treebake.verify.day import Day, through_day
from treebake.verify.light_steps import LightSteps, light_steps
from treebake.verify.relit import Crown, Pair, Relit, relit
from treebake.verify.shaded import Shaded
from treebake.verify.shadows import Shadows, shadows
from treebake.verify.suns import day, unseen_suns

_ROOM = 0.05  # of the tree's size, by which a candidate's cards may reach beyond its source
_DAY_CAMERA = 10.0, 30.0  # elevation, azimuth, degrees


@dataclass(frozen=True)
class LightSettings:
    """How `verify --light` lights a tree."""

    suns: int = 8  # that it is relit by, 1 to 64; every view sees one of them
    heights: dict[str, int] = field(
        default_factory=lambda: {"cloud": 256, "indirect": 512, "leaves": 512, "slicings": 128, "views": 64}
    )  # of the source's bounding sphere, pixels, at which each representation is relit, 16 to 2048
    directions: int = 512  # how many, from which the source looks at the sky, even, 2 to 4096; 0: it sees all of it
    shadow_texels: int = 1024  # of the shadow maps, a side, 64 to 8192
    elevation: float = 45.0  # of the suns whose shadows are compared, degrees, 5 to 90
    azimuths: int = 4  # of these suns, evenly spaced, 1 or more
    ground: int = 512  # pixels of the picture of the ground, a side, 16 to 2048
    hours: int = 24  # of a day through which the sun is turned, evenly spaced; 0: none
    day_height: int = 128  # pixels at which that day is drawn, 16 to 2048


@dataclass(frozen=True, eq=False)
class LightReport:
    """What was found of one representation, its source's sphere `height` pixels high; day is None where none was asked.

    suns, ground, hours: source and candidate relit by each sun, the shadows on the ground (h, w), hour by hour. steps:
    the candidate as ever more of the light is counted.
    """

    height: int
    relit: Relit
    shadows: Shadows
    day: Day | None
    suns: tuple[Pair, ...]
    ground: tuple[tuple[Floats, Floats], ...]
    hours: tuple[Pair, ...]
    steps: LightSteps


def check_light(settings: LightSettings) -> None:
    """Raise SettingsError where a setting is out of range."""
    known = LightSettings().heights
    sizes = settings.heights
    heights = bool(sizes) and sizes.keys() <= known.keys() and all(16 <= size <= 2048 for size in sizes.values())
    even = settings.directions % 2 == 0 and 0 <= settings.directions <= 4096
    rules = (
        ("suns", 1 <= settings.suns <= 64, "1 to 64"),
        ("heights", heights, f"pixels from 16 to 2048, for one or more of {', '.join(known)} and no other names"),
        ("directions", even, "an even number from 2 to 4096, or 0"),
        ("shadow_texels", 64 <= settings.shadow_texels <= 8192, "64 to 8192"),
        ("elevation", 5 <= settings.elevation <= 90, "5 to 90"),
        ("azimuths", settings.azimuths >= 1, "1 or more"),
        ("ground", 16 <= settings.ground <= 2048, "16 to 2048"),
        ("hours", settings.hours >= 0, "0 or more"),
        ("day_height", 16 <= settings.day_height <= 2048, "16 to 2048"),
    )
    check("light", settings, rules)


def in_full_light(
    source: Mesh,
    crown: Crown | None,
    candidate: Mesh,
    layers: Layers | None,
    height: int,
    views: Sequence[Camera],
    settings: LightSettings,
    done: Callable[[int], None],
) -> LightReport:
    """Draw source and candidate in full light and compare. O(pictures (faces + pixels + texels of the shadow map)).

    source: with what its vertices see of the sky. crown: None where there are no leaves. layers: of the candidate, with
    a shader of their own. views: each sees the next sun. done: is told how many more pictures are finished.
    Raises SettingsError and GraphicsError.
    """
    check_light(settings)
    points, texels = _around(source), settings.shadow_texels
    with ExitStack() as stack:
        one = stack.enter_context(closing(Shaded(source, None, points, texels, exact_cutouts=True)))
        other = stack.enter_context(closing(Shaded(candidate, layers, points, texels)))
        figures, suns = relit(one, other, crown, height, views, unseen_suns(settings.suns), done)
        view = views[0].view(height)
        cast, ground = shadows(one, other, points, view, _suns_around(settings), settings.ground, done)
        today: Day | None = None
        hours: tuple[Pair, ...] = ()
        if settings.hours:
            camera = replace(views[0], elevation=_DAY_CAMERA[0], azimuth=_DAY_CAMERA[1])
            today, hours = through_day(one, other, camera, settings.day_height, day(settings.hours), done)
        steps = light_steps(one, other, views[0].view(height))
    return LightReport(height, figures, cast, today, suns, ground, hours, steps)


def pictures_of(views: int, settings: LightSettings) -> int:
    """How many pictures `in_full_light` finishes."""
    return views + settings.azimuths + settings.hours


def _around(source: Mesh) -> Doubles:
    """(N, 3) points around all that stands for a source."""
    points = source.positions[source.used].astype(np.float64)
    middle = source.bounds.mean(axis=0, dtype=np.float64)
    return np.asarray(middle + (1 + _ROOM) * (points - middle))


def _suns_around(settings: LightSettings) -> tuple[Light, ...]:
    turns = 360.0 * np.arange(settings.azimuths) / settings.azimuths
    return tuple(Light(turn_to(settings.elevation, float(turn))[2]) for turn in turns)
