"""Which step of a ladder of representations a tree is drawn with, and how it fades from one to the next."""

import math

import numpy as np

from treebake.model import Doubles, Longs

FADE = 1.25  # a change is spread over heights down to the switch height over this


def switched(heights: Doubles, min_heights: tuple[int, ...]) -> tuple[Longs, Doubles, Doubles]:
    """The step of each tree, and how visible it and the next one are.

    heights: (n,) float64, pixels of the trees' bounding spheres. min_heights: of the steps from near to far, down to
    which each is drawn; that of the last one is not looked at. Returns the nearer step (n,) int64, its opacity and that
    of the step after it, (n,) float64 each. Within a change first the farther step is whole and the nearer one comes,
    then the nearer one is whole and the farther one goes, so at no time does the background show through.
    """
    switches = np.asarray(min_heights[:-1], np.float64)
    # The first step that may still be seen: its switch height, less the fade, lies below the tree's.
    step = np.searchsorted(-switches / FADE, -heights, side="right") if len(switches) else np.zeros(len(heights), int)
    nearer = np.append(switches, 0.0)[step]
    with np.errstate(divide="ignore"):
        part = np.where(nearer > 0, 1 + np.log(heights / np.where(nearer > 0, nearer, 1)) / math.log(FADE), 1.0)
    part = np.clip(part, 0, 1)
    return step.astype(np.int64), np.minimum(2 * part, 1), np.minimum(2 * (1 - part), 1)
