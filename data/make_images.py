"""Draws the leaf and bark images of this folder: `python data/make_images.py` rewrites them all.

A leaf image is a few blades: a lanceolate, lobed or toothed outline with veins. The bark is periodic noise, stretched.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt

from treebake.images import write_png

FOLDER = Path(__file__).parent
OVERSAMPLING = 4


@dataclass(frozen=True)
class Blade:
    """One leaf blade; lengths are parts of its own length."""

    width: float = 0.3  # widest
    belly: float = 0.8  # > 1 is widest towards the tip
    roundness: float = 0.8  # < 1 is blunt, > 1 is pointed
    teeth: int = 0
    tooth: float = 0.0  # depth, part of the width
    lobed: bool = False  # round lobes in place of sharp teeth
    veins: int = 12
    colour: tuple[int, int, int] = (86, 118, 44)  # sRGB


class Canvas:
    """An image under construction, x to the right and y up from the middle of its foot, in image heights."""

    def __init__(self, width: int, height: int, seed: int) -> None:
        w, h = width * OVERSAMPLING, height * OVERSAMPLING
        self.x, self.y = np.meshgrid((np.arange(w) + 0.5 - w / 2) / h, 1 - (np.arange(h) + 0.5) / h)
        self.colour = np.zeros((h, w, 3))
        self.covered = np.zeros((h, w), bool)
        self.rng = np.random.default_rng(seed)

    def paint(self, where, colour) -> None:
        """Cover the texels `where` with a colour each."""
        self.colour[where] = np.clip(colour, 0, 255)[where]
        self.covered |= where

    def line(self, start, end, width: float, colour) -> None:
        """A tapering stroke: a twig or a stalk."""
        (along, across), length = self.frame(start, np.subtract(end, start)), np.hypot(*np.subtract(end, start))
        inside = (along > 0) & (along < length) & (np.abs(across) < width * (1 - 0.4 * along / length))
        shade = 1.15 - 0.5 * (across / width + 0.5)
        self.paint(inside, shade[..., None] * colour)

    def blade(self, foot, degrees: float, length: float, blade: Blade) -> None:
        """A blade from its foot; 0 degrees points up the image, positive ones lean to the right."""
        angle = np.deg2rad(degrees)
        along, across = self.frame(foot, (np.sin(angle), np.cos(angle)))
        y, x = along / length, across / length
        t = np.clip(y, 0, 1)
        notch = 0.5 + 0.5 * np.cos(2 * np.pi * t * blade.teeth) if blade.lobed else (t * blade.teeth) % 1
        outline = blade.width / 2 * np.sin(np.pi * t**blade.belly) ** blade.roundness * (1 - blade.tooth * notch)
        inside = (y > 0) & (y < 1) & (np.abs(x) < outline)
        side = np.abs(x)
        rib = np.exp(-((side / 0.012) ** 2))
        vein = np.abs(((y - 0.7 * side) * blade.veins) % 1 - 0.5) * 2
        shade = self.rng.uniform(0.85, 1.1) * (0.86 + 0.2 * vein**0.5 * (1 - t * 0.2) - 0.1 * side / blade.width)
        shade *= np.where(x > 0, 1.05, 0.95)  # the halves of a folded blade
        tint = blade.colour + rib[..., None] * np.array([38, 34, 16])
        tint = tint + (1 - vein)[..., None] ** 4 * np.array([16, 14, 4]) + self.rng.normal(0, 5, 3) * [1, 0.7, 0.5]
        self.paint(inside, shade[..., None] * tint)

    def frame(self, origin, direction):
        """Coordinates along a direction from an origin, and across it to the right."""
        dx, dy = np.array(direction) / np.hypot(*direction)
        x, y = self.x - origin[0], self.y - origin[1]
        return x * dx + y * dy, x * dy - y * dx

    def save(self, name: str) -> None:
        """Shrink, and bleed the colour of the nearest covered texel under the alpha."""
        h, w = (size // OVERSAMPLING for size in self.covered.shape)
        blocks = (h, OVERSAMPLING, w, OVERSAMPLING)
        alpha = self.covered.reshape(blocks).mean(axis=(1, 3))
        colour = (
            self.colour.reshape(*blocks, 3).sum(axis=(1, 3)) / (OVERSAMPLING**2 * np.maximum(alpha, 1e-6))[..., None]
        )
        rows, columns = distance_transform_edt(alpha == 0, return_distances=False, return_indices=True)
        rgba = np.dstack([colour[rows, columns], alpha * 255])
        write_png(FOLDER / f"{name}.png", np.rint(rgba).astype(np.uint8))


def spray(
    name: str, seed: int, leaf, length: float, pairs: int, *, alternate: float = 0.03, spread: float = 72
) -> None:
    """Leaves in pairs along a twig, the last at its tip; leaf(canvas, foot, degrees, length) draws one."""
    canvas = Canvas(256, 256, seed)
    top = 0.98 - length
    canvas.line((0, 0), (0, top + 0.02), 0.01, (104, 84, 56))
    for i in range(pairs):
        height = 0.1 + (top - 0.06) * i / pairs
        for side in (-1, 1):
            degrees = side * (spread - 30 * i / pairs + canvas.rng.normal(0, 4))
            leaf(canvas, (0, height + side * alternate), degrees, min(length, 0.49))
    leaf(canvas, (0, top), canvas.rng.normal(0, 4), length)
    canvas.save(name)


def palmate(canvas: Canvas, foot, degrees: float, length: float, blade: Blade, stalk: float, arms) -> None:
    """Blades that spread from the end of a stalk; arms are (degrees, part of the length), to both sides."""
    heading = np.array([np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))])
    middle = foot + heading * length * stalk
    canvas.line(foot, middle + heading * length * 0.03, 0.009, (128, 124, 66))
    for arm, part in arms:
        for side in (-1, 1) if arm else (1,):
            canvas.blade(middle, degrees + side * arm, part * length, blade)


def bark(name: str, seed: int, dark, light, grain: tuple[float, float], furrow: float, size: int = 256) -> None:
    """Periodic noise; grain: waves across and along the tile, furrow: how much the noise is folded into ridges."""
    rng = np.random.default_rng(seed)
    fy, fx = np.meshgrid(*[np.fft.fftfreq(size, 1 / size)] * 2, indexing="ij")

    def noise(across: float, along: float):
        radius = np.hypot(fx / across, fy / along)
        spectrum = np.fft.fft2(rng.normal(size=(size, size))) * radius * np.exp(-radius)
        field = np.fft.ifft2(spectrum).real
        return field / field.std()

    coarse, fine = noise(*grain), noise(40, 30)
    ridges = 1 - np.abs(coarse) * 1.2
    height = np.clip(0.5 + 0.35 * (furrow * -ridges + (1 - furrow) * coarse) + 0.08 * fine, 0, 1)[..., None]
    colour = np.array(dark) * (1 - height) + np.array(light) * height
    write_png(FOLDER / f"{name}.png", np.rint(np.clip(colour, 0, 255)).astype(np.uint8))


def main() -> None:
    """Draw every image."""
    canvas = Canvas(128, 256, 1)
    canvas.line((0, 0), (0, 0.1), 0.009, (120, 132, 66))
    canvas.blade((0, 0.08), 0, 0.91, Blade(0.38, 0.85, 0.8, teeth=17, tooth=0.22, veins=17, colour=(88, 124, 44)))
    canvas.save("leaf_chestnut")

    canvas = Canvas(256, 256, 2)
    finger = Blade(0.44, 1.6, 0.9, teeth=22, tooth=0.08, veins=16, colour=(70, 108, 40))
    palmate(canvas, (0, 0), 0, 1, finger, 0.49, [(130, 0.3), (88, 0.4), (44, 0.47), (0, 0.5)])
    canvas.save("leaf_horse-chestnut")

    def simple(blade: Blade):
        return lambda canvas, foot, degrees, length: canvas.blade(foot, degrees, length, blade)

    def maple(canvas: Canvas, foot, degrees: float, length: float) -> None:
        lobe = Blade(0.56, 0.9, 0.85, teeth=4, tooth=0.35, veins=8, colour=(104, 136, 48))
        palmate(canvas, foot, degrees, length, lobe, 0.28, [(108, 0.36), (52, 0.6), (0, 0.72)])

    spray("leaf_maple", 3, maple, 0.5, 2, alternate=0, spread=80)
    oak = Blade(0.52, 1.25, 0.6, teeth=4, tooth=0.4, lobed=True, veins=8, colour=(78, 104, 38))
    spray("leaf_oak", 4, simple(oak), 0.46, 3)
    cork = Blade(0.46, 0.95, 0.7, teeth=6, tooth=0.1, veins=12, colour=(92, 108, 62))
    spray("leaf_cork", 5, simple(cork), 0.38, 4)
    alder = Blade(0.78, 0.95, 0.55, teeth=16, tooth=0.06, veins=12, colour=(66, 102, 40))
    spray("leaf_alder", 6, simple(alder), 0.34, 3)
    shrub = Blade(0.52, 0.95, 0.8, veins=9, colour=(98, 132, 58))
    spray("leaf_shrub", 7, simple(shrub), 0.34, 5)

    bark("bark_furrowed", 11, (52, 42, 34), (132, 116, 98), (9, 2.2), 0.8)
    bark("bark_cork", 12, (58, 44, 36), (158, 140, 120), (7, 3.5), 1.0)
    bark("bark_scaly", 13, (74, 66, 58), (140, 130, 118), (8, 8), 0.6)
    bark("bark_smooth", 14, (96, 92, 84), (136, 130, 118), (5, 12), 0.0)


if __name__ == "__main__":
    main()
