"""The lights under which a tree is looked at: suns that no texture was made with, and those of one day."""

import math

import numpy as np

from treebake.geometry import turn_to
from treebake.gl.light import DAYLIGHT, Light

_LOWEST, _HIGHEST = 15.0, 75.0  # degrees of elevation
_GOLDEN = 180.0 * (3.0 - math.sqrt(5.0))  # degrees: keeps any number of azimuths apart
_LATITUDE, _DECLINATION = math.radians(45.0), math.radians(23.44)  # midsummer: the sun reaches high and low places
_SUN = np.array([1.7, 1.65, 1.55])  # above the air
_AIR = np.array([0.10, 0.17, 0.32])  # that the air takes from a sun in the zenith, as an optical depth
_SKY, _GROUND = np.array(DAYLIGHT.sky), np.array(DAYLIGHT.ground)  # at noon
_NIGHT = np.array([0.012, 0.016, 0.03])  # a sky without a sun


def unseen_suns(count: int) -> tuple[Light, ...]:
    """Suns from everywhere that a sun stands, in the light of noon. None is the one that brightness is fitted with."""
    elevations = np.linspace(_LOWEST, _HIGHEST, count) if count > 1 else np.array([45.0])
    return tuple(Light(turn_to(float(up), (step * _GOLDEN) % 360)[2]) for step, up in enumerate(elevations))


def day(hours: int) -> tuple[Light, ...]:
    """The light of `hours` evenly spaced times of a midsummer day at 45 degrees north, from midnight on.

    The sun rises at +X, stands highest at +Z, and reddens near the horizon; below it only the sky is left.
    """
    return tuple(_at(2 * math.pi * hour / hours - math.pi) for hour in range(hours))


def _at(angle: float) -> Light:
    """angle: of the sun around the pole, 0 at noon."""
    east = -math.cos(_DECLINATION) * math.sin(angle)
    up = math.sin(_LATITUDE) * math.sin(_DECLINATION) + math.cos(_LATITUDE) * math.cos(_DECLINATION) * math.cos(angle)
    south = math.sin(_LATITUDE) * math.cos(_DECLINATION) * math.cos(angle) - math.cos(_LATITUDE) * math.sin(
        _DECLINATION
    )
    dusk = float(np.clip((up + 0.1) / 0.3, 0, 1))  # from 6 degrees below the horizon on the sky gets light
    sun = np.zeros(3)
    if up > 0:
        sun = _SUN * np.exp(-_AIR / (up + 0.05))
    sky, ground = (np.maximum(dusk * color, _NIGHT * share) for color, share in ((_SKY, 1.0), (_GROUND, 0.3)))
    (sr, sg, sb), (kr, kg, kb), (gr, gg, gb) = (color.tolist() for color in (sun, sky, ground))
    return Light(
        np.array([east, max(up, 0.01), south]) / math.hypot(east, max(up, 0.01), south),
        (sr, sg, sb),
        (kr, kg, kb),
        (gr, gg, gb),
    )
