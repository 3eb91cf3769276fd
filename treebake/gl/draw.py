"""Draws a mesh as a stock glTF client does, so that what is measured is what a user will see.

Colour maps are sRGB textures whose mipmaps the driver makes at load, filtered trilinearly in linear light, without
anisotropy. MASK is tested per pixel at the material's cutoff, OPAQUE ignores alpha, and BLEND is drawn last, its
triangles sorted back to front by centroid within each material. Single-sided materials show front faces only; the
back of a double-sided one has its normal reversed. Edges are smoothed by 4 samples a pixel.

A client's mipmaps thin MASK leaves as they shrink: a chestnut of textured leaves 128 pixels high keeps a third of the
area that it covers close by. So what a tree *is*, as against what a client makes of it, is drawn with `exact_cutouts`:
the unfiltered alpha is tested at each of a pixel's samples, just as the edge of a modelled leaf would be.
"""

from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from treebake.errors import GraphicsError
from treebake.gl.context import context, program
from treebake.gl.indirect import IndirectBillboards
from treebake.gl.slicings import SlicingCards
from treebake.gl.view import View, column_major
from treebake.gl.views import ViewCards
from treebake.model import AlphaMode, Floats, IndirectTextures, Ints, Layers, Material, Mesh, Slicings, Texture, Views

_SAMPLES = 4
_RGBA8, _SRGB8_ALPHA8 = 0x8058, 0x8C43
_INDEX_BYTES = 4
_ALPHA_MODES = {AlphaMode.OPAQUE: 0, AlphaMode.MASK: 1, AlphaMode.BLEND: 2}
_OVERLAYS = {IndirectTextures: IndirectBillboards, Slicings: SlicingCards, Views: ViewCards}
_WHITE = Texture("white", np.full((1, 1, 4), 255, np.uint8))


@dataclass(frozen=True, eq=False)
class Picture:
    """What a view saw, row 0 on top.

    color: (h, w, 4) float32, linear light in 0..1, premultiplied; alpha is the covered part of the pixel.
    depth: (h, w) float32, mean distance of what covers the pixel along the optical axis in the mesh's unit; 0 where
    nothing does.
    """

    color: Floats
    depth: Floats


def renderer() -> str:
    """Name and version of the OpenGL in use; pictures are alike only where these are."""
    info = context().info
    return f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"


class Drawing:
    """A mesh, and what belongs to it and has a shader of its own, on the graphics card, to be drawn until `close`.

    Raises GraphicsError where there is no OpenGL, or a texture is larger than the driver takes.
    """

    def __init__(self, mesh: Mesh, layers: Layers | None = None, *, exact_cutouts: bool = False) -> None:
        self._gl = context()
        self._exact_cutouts = exact_cutouts
        self._owned: list[Any] = []  # in the order of making
        self._targets: dict[int, _Target] = {}
        self._textures: dict[tuple[int, bool], moderngl.Texture] = {}
        self._mesh = mesh
        order = np.argsort(mesh.face_material, kind="stable")
        self._faces = mesh.faces[order]
        ends = np.searchsorted(mesh.face_material[order], np.arange(len(mesh.materials) + 1))
        parts = [
            _Part(material, int(first), int(last))
            for material, first, last in zip(mesh.materials, ends[:-1], ends[1:], strict=True)
            if last > first
        ]
        self._parts = sorted(parts, key=lambda part: part.material.alpha_mode is AlphaMode.BLEND)
        self._overlay: IndirectBillboards | SlicingCards | ViewCards | None = None
        try:
            if layers is not None:
                self._overlay = self._own(_OVERLAYS[type(layers)](self._gl, layers))
            if self._parts:
                self._upload(mesh)
        except Exception:
            self.close()
            raise

    def picture(self, view: View) -> Picture:
        """Draw the mesh lit, over nothing."""
        target = self._target(view.size)
        target.samples.depth_mask = True
        target.samples.clear()
        gl = self._gl
        with gl.scope(target.samples, gl.DEPTH_TEST):
            gl.blend_func = gl.ONE, gl.ONE_MINUS_SRC_ALPHA
            solid = sum(part.material.alpha_mode is not AlphaMode.BLEND for part in self._parts)
            for part in self._parts[:solid]:
                self._draw(part, view, target.samples)
            if self._overlay is not None:
                self._overlay.draw(view, target.samples)
            for part in self._parts[solid:]:
                self._draw(part, view, target.samples)
        gl.copy_framebuffer(target.resolved, target.samples)
        self._check()
        color, depth = target.read()
        alpha = color[..., 3]
        # Interpolated across a sliver seen edge-on, a depth can be anything.
        depth = np.clip(depth / np.where(alpha > 0, alpha, 1), view.near, view.far)
        return Picture(color, np.where(alpha > 0, depth, 0).astype(np.float32))

    def fragments(self, view: View) -> float:
        """How many fragments the view asks to be shaded, whether or not they end up hidden or cut out."""
        target = self._target(view.size)
        gl = self._gl
        target.count.clear()
        with gl.scope(target.count, gl.BLEND):
            gl.blend_func = gl.ONE, gl.ONE
            for part in self._parts:
                self._cull(part.material)
                self._counter["to_clip"] = column_major(view.to_clip)
                self._count_array.render(vertices=3 * (part.last - part.first), first=3 * part.first)
            if self._overlay is not None:
                self._overlay.count(view)
        self._check()
        return float(_pixels(target.count, 0, 1).sum(dtype=np.float64))

    def close(self) -> None:
        """Free everything on the graphics card; the drawing cannot be used afterwards."""
        for target in self._targets.values():
            target.release()
        for resource in reversed(self._owned):
            resource.release()
        self._targets.clear()
        self._owned.clear()
        self._textures.clear()
        self._parts = []

    def _upload(self, mesh: Mesh) -> None:
        gl = self._gl
        self._program, self._counter = program("lit_exact" if self._exact_cutouts else "lit"), program("count")
        buffers = [
            (self._own(gl.buffer(np.ascontiguousarray(values, np.float32))), layout, name)
            for values, layout, name in (
                (mesh.positions, "3f", "in_position"),
                (mesh.normals, "3f", "in_normal"),
                (mesh.uvs, "2f", "in_uv"),
            )
        ]
        self._indices = self._own(gl.buffer(np.ascontiguousarray(self._faces, np.int32)))
        self._array = self._own(gl.vertex_array(self._program, buffers, self._indices))
        self._count_array = self._own(gl.vertex_array(self._counter, buffers[:1], self._indices))
        for part in self._parts:
            self._texture(part.material.color_map or _WHITE, srgb=True)
            if part.material.normal_map is not None:
                self._texture(part.material.normal_map, srgb=False)

    def _texture(self, texture: Texture, *, srgb: bool) -> moderngl.Texture:
        key = id(texture), srgb
        if key not in self._textures:
            height, width = texture.pixels.shape[:2]
            limit = self._gl.info["GL_MAX_TEXTURE_SIZE"]
            if max(height, width) > limit:
                raise GraphicsError(
                    f"texture {texture.name} is {width} x {height}, this OpenGL takes {limit} at most; make it smaller"
                )
            made = self._own(
                self._gl.texture(
                    (width, height),
                    4,
                    np.ascontiguousarray(texture.pixels),
                    internal_format=_SRGB8_ALPHA8 if srgb else _RGBA8,
                )
            )
            made.build_mipmaps()
            made.filter = self._gl.LINEAR_MIPMAP_LINEAR, self._gl.LINEAR
            self._textures[key] = made
        return self._textures[key]

    def _draw(self, part: "_Part", view: View, onto: Any) -> None:
        gl, material, lit = self._gl, part.material, self._program
        blend = material.alpha_mode is AlphaMode.BLEND
        (gl.enable if blend else gl.disable)(gl.BLEND)
        onto.depth_mask = not blend
        if blend:
            self._indices.write(self._back_to_front(part, view), offset=3 * _INDEX_BYTES * part.first)
        self._cull(material)
        lit["to_clip"] = column_major(view.to_clip)
        lit["base_color"] = material.base_color
        lit["alpha_mode"] = _ALPHA_MODES[material.alpha_mode]
        lit["alpha_cutoff"] = material.alpha_cutoff
        lit["has_normal_map"] = material.normal_map is not None
        lit["color_map"], lit["normal_map"] = 0, 1
        self._texture(material.color_map or _WHITE, srgb=True).use(0)
        if material.normal_map is not None:
            self._texture(material.normal_map, srgb=False).use(1)
        self._array.render(vertices=3 * (part.last - part.first), first=3 * part.first)

    def _back_to_front(self, part: "_Part", view: View) -> Ints:
        faces = self._faces[part.first : part.last]
        row = view.to_clip[3]
        depths = self._mesh.positions[faces].mean(axis=1) @ row[:3]
        return np.ascontiguousarray(faces[np.argsort(-depths, kind="stable")], np.int32)

    def _cull(self, material: Material) -> None:
        (self._gl.disable if material.double_sided else self._gl.enable)(self._gl.CULL_FACE)

    def _target(self, size: int) -> "_Target":
        if size not in self._targets:
            self._targets[size] = _Target(self._gl, size)
        return self._targets[size]

    def _own(self, resource: Any) -> Any:
        self._owned.append(resource)
        return resource

    def _check(self) -> None:
        if (error := self._gl.error) != "GL_NO_ERROR":
            raise GraphicsError(f"OpenGL reports {error} while drawing; update the graphics driver")


@dataclass(frozen=True, eq=False)
class _Part:
    """The faces first:last, in drawing order, that share a material."""

    material: Material
    first: int
    last: int


class _Target:
    """The framebuffers for pictures of one size."""

    def __init__(self, gl: Any, size: int) -> None:
        square = size, size
        samples = min(_SAMPLES, gl.max_samples)
        self._images = [
            gl.renderbuffer(square, 4, samples=samples, dtype="f2"),
            gl.renderbuffer(square, 1, samples=samples, dtype="f4"),
            gl.depth_renderbuffer(square, samples=samples),
            gl.renderbuffer(square, 4, dtype="f2"),
            gl.renderbuffer(square, 1, dtype="f4"),
            gl.renderbuffer(square, 1, dtype="f4"),
        ]
        self.samples = gl.framebuffer(self._images[:2], self._images[2])
        self.resolved = gl.framebuffer(self._images[3:5])
        self.count = gl.framebuffer(self._images[5:])

    def read(self) -> tuple[Floats, Floats]:
        """Colour (h, w, 4) and depth (h, w), both premultiplied."""
        return _pixels(self.resolved, 0, 4), _pixels(self.resolved, 1, 1)[..., 0]

    def release(self) -> None:
        for resource in (self.samples, self.resolved, self.count, *self._images):
            resource.release()


def _pixels(framebuffer: Any, attachment: int, channels: int) -> Floats:
    """Read an attachment as (h, w, channels) float32, row 0 on top."""
    raw = framebuffer.read(components=channels, attachment=attachment, dtype="f4")
    width, height = framebuffer.size
    return np.ascontiguousarray(np.frombuffer(raw, np.float32).reshape(height, width, channels)[::-1])
