"""What pictures are drawn on, and read from."""

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from treebake.errors import GraphicsError
from treebake.gl.view import View
from treebake.model import Floats

_SAMPLES = 4


@dataclass(frozen=True, eq=False)
class Picture:
    """What a view saw, row 0 on top.

    color: (h, w, 4) float32, linear light in 0..1, premultiplied; alpha is the covered part of the pixel.
    depth: (h, w) float32, mean distance of what covers the pixel along the optical axis in the mesh's unit; 0 where
    nothing does.
    """

    color: Floats
    depth: Floats


class Target:
    """The framebuffers for pictures of one size: `samples` to draw on, with 4 samples a pixel, and `count`."""

    def __init__(self, gl: moderngl.Context, window: tuple[int, int]) -> None:
        self._gl = gl
        samples = min(_SAMPLES, gl.max_samples)
        self._images = [
            gl.renderbuffer(window, 4, samples=samples, dtype="f2"),
            gl.renderbuffer(window, 1, samples=samples, dtype="f4"),
            gl.depth_renderbuffer(window, samples=samples),
            gl.renderbuffer(window, 4, dtype="f2"),
            gl.renderbuffer(window, 1, dtype="f4"),
            gl.renderbuffer(window, 1, dtype="f4"),
        ]
        self.samples = gl.framebuffer(self._images[:2], self._images[2])
        self.count = gl.framebuffer(self._images[5:])
        self._resolved = gl.framebuffer(self._images[3:5])

    def picture(self, view: View) -> Picture:
        """What was drawn on `samples`. Raises GraphicsError where OpenGL found fault with how."""
        self._gl.copy_framebuffer(self._resolved, self.samples)
        check(self._gl)
        color, depth = _pixels(self._resolved, 0, 4), _pixels(self._resolved, 1, 1)[..., 0]
        alpha = color[..., 3]
        # Interpolated across a sliver seen edge-on, a depth can be anything.
        depth = np.clip(depth / np.where(alpha > 0, alpha, 1), view.near, view.far)
        return Picture(color, np.where(alpha > 0, depth, 0).astype(np.float32))

    def counted(self) -> Picture:
        """Where anything was added to `count`, black. Raises GraphicsError likewise."""
        check(self._gl)
        drawn = _pixels(self.count, 0, 1) > 0
        color = np.concatenate([np.zeros((*drawn.shape[:2], 3)), drawn], axis=2).astype(np.float32)
        return Picture(color, np.zeros(drawn.shape[:2], np.float32))

    def total(self) -> float:
        """The sum of what was added to `count`. Raises GraphicsError likewise."""
        check(self._gl)
        return float(_pixels(self.count, 0, 1).sum(dtype=np.float64))

    def release(self) -> None:
        """Free everything on the graphics card."""
        for resource in (self.samples, self._resolved, self.count, *self._images):
            resource.release()


def check(gl: moderngl.Context) -> None:
    """Raise GraphicsError where OpenGL reports an error."""
    if (error := gl.error) != "GL_NO_ERROR":
        raise GraphicsError(f"OpenGL reports {error} while drawing; update the graphics driver")


def _pixels(framebuffer: Any, attachment: int, channels: int) -> Floats:
    """Read an attachment as (h, w, channels) float32, row 0 on top."""
    raw = framebuffer.read(components=channels, attachment=attachment, dtype="f4")
    width, height = framebuffer.size
    return np.ascontiguousarray(np.frombuffer(raw, np.float32).reshape(height, width, channels)[::-1])
