"""How far a tree reaches in any direction: what cuts the card of an impostor to an outline of 8 corners."""

import numpy as np

from treebake.model import Doubles, Floats

SAMPLES = 33  # of the elevation of the direction, from -90 to 90 degrees
_FINE = 8  # directions looked at between two samples
_BANDS = 256  # of the tree's height, of each of which only the farthest point counts


def support(points: Doubles) -> Floats:
    """The support function of points (N, 3) turned about the vertical axis through the origin: (33,) float32.

    support[i] is at least the greatest d . p over all points p and all unit directions d whose elevation is within one
    step of -90 + i * 180 / 32 degrees: linear interpolation between two entries cuts nothing off. O(N).
    """
    height, out = points[:, 1], np.hypot(points[:, 0], points[:, 2])
    span = float(np.ptp(height)) or 1.0
    band = np.minimum(((height - height.min()) / span * _BANDS).astype(np.int64), _BANDS - 1)
    farthest, top, bottom = (np.full(_BANDS, fill) for fill in (-np.inf, -np.inf, np.inf))
    np.maximum.at(farthest, band, out)
    np.maximum.at(top, band, height)
    np.minimum.at(bottom, band, height)
    used = np.isfinite(farthest)
    elevations = np.linspace(-np.pi / 2, np.pi / 2, (SAMPLES - 1) * _FINE + 1)
    up, aside = np.sin(elevations), np.maximum(np.cos(elevations), 0)
    highest = np.where(up[:, None] > 0, up[:, None] * top[used], up[:, None] * bottom[used])
    reach = (aside[:, None] * farthest[used] + highest).max(axis=1)
    padded = np.pad(reach, _FINE, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _FINE + 1)
    between = np.cos(np.pi / (SAMPLES - 1) / _FINE / 2)  # of what is reached halfway between two fine directions
    found = windows.max(axis=1)[::_FINE]
    return np.asarray(found + (1 / between - 1) * np.abs(found) + 1e-6 * np.abs(found).max(), np.float32)
