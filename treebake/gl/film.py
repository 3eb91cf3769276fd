"""What is drawn into where samples are to be averaged: some images with several samples a texel, each read as means."""

import moderngl
import numpy as np

from treebake.gl.context import program
from treebake.model import Floats


class Film:
    """Framebuffers of one size, (width, height) texels of factor x factor samples, with `count` images of RGBA."""

    def __init__(self, gl: moderngl.Context, size: tuple[int, int], factor: int, count: int) -> None:
        self._gl, self.size, self._factor = gl, size, factor
        finer = size[0] * factor, size[1] * factor
        self._images = [gl.texture(finer, 4, dtype="f2") for _ in range(count)]
        self._samples = gl.framebuffer(self._images, gl.depth_renderbuffer(finer))
        self._mean = gl.framebuffer([gl.texture(size, 4, dtype="f4")])
        self._array = gl.vertex_array(program("average"), [])

    def expose(self) -> None:
        """Clear the images and draw into them from now on, tested for depth."""
        self._samples.use()
        self._samples.clear()
        self._gl.enable_only(moderngl.DEPTH_TEST)

    def develop(self) -> list[Floats]:
        """The mean of each texel's samples, an (h, w, 4) float32 per image, in the rows' order of the framebuffer."""
        self._mean.use()
        self._gl.enable_only(moderngl.NOTHING)
        shader = self._array.program
        shader["samples"], shader["factor"] = 0, self._factor
        width, height = self.size
        found = []
        for image in self._images:
            image.use(0)
            self._array.render(moderngl.TRIANGLES, vertices=3)
            data = self._mean.read(components=4, dtype="f4")
            found.append(np.frombuffer(data, np.float32).reshape(height, width, 4))
        return found
