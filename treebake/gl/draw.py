"""Draws a mesh as a stock glTF client does, so that what is measured is what a user will see.

Colour maps are sRGB textures whose mipmaps the driver makes at load, filtered trilinearly in linear light, without
anisotropy. MASK is tested per pixel at the material's cutoff, OPAQUE ignores alpha, and BLEND is drawn last, its
triangles sorted back to front by centroid within each material. Single-sided materials show front faces only; the
back of a double-sided one has its normal reversed. Edges are smoothed by 4 samples a pixel.

A client's mipmaps thin MASK leaves as they shrink: a chestnut of textured leaves 128 pixels high keeps a third of the
area that it covers close by. So what a tree *is*, as against what a client makes of it, is drawn with `exact_cutouts`:
the unfiltered alpha is tested at each of a pixel's samples, just as the edge of a modelled leaf would be.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from treebake.errors import GraphicsError
from treebake.gl.context import context, leave_framebuffer, program
from treebake.gl.indirect import IndirectBillboards
from treebake.gl.instances import instanced
from treebake.gl.leaf_triangles import LeafTriangles
from treebake.gl.light import DAYLIGHT, Light, Shading, transmitted
from treebake.gl.shadow import ShadowMap, shine_through
from treebake.gl.slicings import SlicingCards
from treebake.gl.target import Picture, Target
from treebake.gl.textures import WHITE
from treebake.gl.view import ONE_TREE, Grove, View, column_major
from treebake.gl.views import ViewCards
from treebake.model import (
    AlphaMode,
    IndirectTextures,
    Ints,
    Layers,
    LeafCards,
    Material,
    Mesh,
    Slicings,
    Texture,
    Views,
)

_RGBA8, _SRGB8_ALPHA8 = 0x8058, 0x8C43
_INDEX_BYTES = 4
_DARKEST = 1e-9  # nothing in half floats
_ALPHA_MODES = {AlphaMode.OPAQUE: 0, AlphaMode.MASK: 1, AlphaMode.BLEND: 2}
_OVERLAYS = {IndirectTextures: IndirectBillboards, LeafCards: LeafTriangles, Slicings: SlicingCards, Views: ViewCards}


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
        self._targets: dict[tuple[int, int], Target] = {}
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
        self._solid = sum(part.material.alpha_mode is not AlphaMode.BLEND for part in parts)
        self._overlay: IndirectBillboards | LeafTriangles | SlicingCards | ViewCards | None = None
        try:
            if layers is not None:
                self._overlay = self._own(_OVERLAYS[type(layers)](self._gl, layers))
            if self._parts:
                self._upload(mesh)
        except Exception:
            self.close()
            raise

    def picture(self, view: View, light: Light = DAYLIGHT, shadows: ShadowMap | None = None) -> Picture:
        """Draw one tree lit, over nothing.

        Without shadows as a client without them does, and the whole sky shines everywhere; with them it is behind what
        they hide, the sky is occluded, and light comes through leaves.
        """
        shading = shine_through(shadows, light)
        target = self._target(view.window)
        target.samples.depth_mask = True
        target.samples.clear()
        with self._gl.scope(target.samples, self._gl.DEPTH_TEST):
            self.draw_solid(view, target.samples, ONE_TREE, shading)
            self.draw_blended(view, target.samples, ONE_TREE, shading)
        return target.picture(view)

    def fragments(self, view: View) -> float:
        """How many fragments the view asks to be shaded, whether or not they end up hidden or cut out."""
        target = self._target(view.window)
        target.count.clear()
        with self._gl.scope(target.count, self._gl.BLEND):
            self._gl.blend_func = self._gl.ONE, self._gl.ONE
            self.count(view, ONE_TREE)
        return target.total()

    def wireframe(self, view: View) -> Picture:
        """The edges of one tree's triangles, hidden ones too, black over nothing."""
        target = self._target(view.window)
        target.count.clear()
        self._gl.wireframe = True
        try:
            with self._gl.scope(target.count, self._gl.BLEND):
                self._gl.blend_func = self._gl.ONE, self._gl.ONE
                self.count(view, ONE_TREE)
        finally:
            self._gl.wireframe = False
        return target.counted()

    def draw_solid(
        self, view: View, onto: moderngl.Framebuffer, grove: Grove, shading: Shading = Shading.PLAIN
    ) -> None:
        """Draw the part of some trees that hides what is behind it, into `onto`, the framebuffer in use."""
        self._draw_parts(self._parts[: self._solid], view, onto, grove, shading)
        if isinstance(self._overlay, (IndirectBillboards, LeafTriangles)):
            self._overlay.draw(view, onto, grove, shading)

    def draw_blended(
        self, view: View, onto: moderngl.Framebuffer, grove: Grove, shading: Shading = Shading.PLAIN
    ) -> None:
        """Draw what is blended over what is there already: last of all, and of several drawings the farthest first."""
        if isinstance(self._overlay, (SlicingCards, ViewCards)):
            self._overlay.draw(view, onto, grove, shading)
        if self._solid < len(self._parts):
            center = self._mesh.bounds.mean(axis=0, dtype=np.float64)
            for tree in np.argsort(-grove.away(view.eye, center), kind="stable"):
                self._draw_parts(self._parts[self._solid :], view, onto, grove.select(np.array([tree])), shading)

    def count(self, view: View, grove: Grove) -> None:
        """Add the fragments that some trees ask to be shaded to the framebuffer in use, which adds up."""
        if self._parts and len(grove.turns):
            with self._instanced(self._counter, view, grove) as array:
                self._counter["to_clip"] = column_major(view.to_clip)
                for part in self._parts:
                    self._cull(part.material)
                    part.render(array)
        if self._overlay is not None:
            self._overlay.count(view, grove)

    @property
    def blended(self) -> bool:
        """Whether other trees must be drawn before the part of this one that is blended over them."""
        return isinstance(self._overlay, (SlicingCards, ViewCards)) or self._solid < len(self._parts)

    @property
    def triangles(self) -> int:
        """Of one tree."""
        return self._mesh.triangles + (0 if self._overlay is None else self._overlay.triangles)

    def calls(self, view: View, grove: Grove) -> int:
        """Draw calls that some trees take."""
        trees = len(grove.turns)
        own = (self._solid + (len(self._parts) - self._solid) * trees) if trees else 0
        return own + (0 if self._overlay is None else self._overlay.calls(view, grove))

    def close(self) -> None:
        """Free everything on the graphics card; the drawing cannot be used afterwards."""
        leave_framebuffer()
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
        self._counter = program("count")
        self._buffers = [
            (self._own(gl.buffer(np.ascontiguousarray(values, np.float32))), layout, name)
            for values, layout, name in (
                (mesh.positions, "3f", "in_position"),
                (mesh.normals, "3f", "in_normal"),
                (mesh.uvs, "2f", "in_uv"),
                (mesh.uvs if mesh.occlusion_uvs is None else mesh.occlusion_uvs, "2f", "in_occlusion_uv"),
                (np.ones(len(mesh.uvs)) if mesh.occlusion is None else mesh.occlusion, "1f", "in_occlusion"),
            )
        ]
        self._indices = self._own(gl.buffer(np.ascontiguousarray(self._faces, np.int32)))
        for part in self._parts:
            self._texture(part.material.color_map or WHITE, srgb=True)
            for texture in (part.material.normal_map, part.material.occlusion_map):
                self._texture(texture or WHITE, srgb=False)

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

    def _instanced(
        self, shader: moderngl.Program, view: View, grove: Grove
    ) -> AbstractContextManager[moderngl.VertexArray]:
        """The mesh with an instance for each tree, the nearest first: it hides most of the others."""
        center = self._mesh.bounds.mean(axis=0, dtype=np.float64)
        buffers = [buffer for buffer in self._buffers if buffer[-1] in shader]
        return instanced(self._gl, shader, grove.instances(view.eye, center)[::-1], buffers, self._indices)

    def _draw_parts(self, parts: "list[_Part]", view: View, onto: Any, grove: Grove, shading: Shading) -> None:
        if parts and len(grove.turns):
            self._gl.blend_func = self._gl.ONE, self._gl.ONE_MINUS_SRC_ALPHA
            lit = program("lit", *shading.value, *["EXACT_CUTOUTS"] * self._exact_cutouts)
            with self._instanced(lit, view, grove) as array:
                for part in parts:
                    blend = part.material.alpha_mode is AlphaMode.BLEND and shading is not Shading.CASTER
                    self._draw(part, lit, view, onto, array, grove, blend)

    def _draw(
        self, part: "_Part", lit: moderngl.Program, view: View, onto: Any, array: Any, grove: Grove, blend: bool
    ) -> None:
        gl, material = self._gl, part.material
        (gl.enable if blend else gl.disable)(gl.BLEND)
        onto.depth_mask = not blend
        if blend:
            self._indices.write(self._back_to_front(part, view, grove), offset=3 * _INDEX_BYTES * part.first)
        self._cull(material)
        values = {
            "to_clip": column_major(view.to_clip),
            "base_color": (*_base(material), material.base_color[3]),
            "alpha_mode": _ALPHA_MODES[material.alpha_mode],
            "alpha_cutoff": material.alpha_cutoff,
            "has_normal_map": material.normal_map is not None,
            "transmission": _on_base_color(material),
            "color_map": 0,
            "normal_map": 1,
            "occlusion_map": 2,
        }
        for name, value in values.items():
            if name in lit:
                lit[name] = value
        self._texture(material.color_map or WHITE, srgb=True).use(0)
        self._texture(material.normal_map or WHITE, srgb=False).use(1)
        self._texture(material.occlusion_map or WHITE, srgb=False).use(2)
        part.render(array)

    def _back_to_front(self, part: "_Part", view: View, grove: Grove) -> Ints:
        """The faces of a part of one tree."""
        faces = self._faces[part.first : part.last]
        cosine, sine = np.cos(grove.turns[0]), np.sin(grove.turns[0])
        turn = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        depths = self._mesh.positions[faces].mean(axis=1) @ (view.to_clip[3, :3] @ turn)
        return np.ascontiguousarray(faces[np.argsort(-depths, kind="stable")], np.int32)

    def _cull(self, material: Material) -> None:
        (self._gl.disable if material.double_sided else self._gl.enable)(self._gl.CULL_FACE)

    def _target(self, window: tuple[int, int]) -> Target:
        if window not in self._targets:
            self._targets[window] = Target(self._gl, window)
        return self._targets[window]

    def _own(self, resource: Any) -> Any:
        self._owned.append(resource)
        return resource


def _on_base_color(material: Material) -> tuple[float, float, float, float]:
    """What a material lets through, as factors on the colour map times the base colour."""
    *color, factor = transmitted(material.transmission)
    red, green, blue = (c / base for c, base in zip(color, _base(material), strict=True))
    return red, green, blue, factor


def _base(material: Material) -> tuple[float, ...]:
    """The base colour, so far above black that another colour can be a factor on it."""
    return tuple(max(c, _DARKEST) for c in material.base_color[:3])


@dataclass(frozen=True, eq=False)
class _Part:
    """The faces first:last, in drawing order, that share a material."""

    material: Material
    first: int
    last: int

    def render(self, array: Any) -> None:
        array.render(vertices=3 * (self.last - self.first), first=3 * self.first)
