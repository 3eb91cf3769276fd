"""Photographs a mesh in parallel projection: the pictures that stand in for it, supersampled."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import moderngl
import numpy as np

from treebake.gl.context import context, program
from treebake.gl.film import Film
from treebake.gl.textures import upload_plain
from treebake.gl.view import column_major
from treebake.model import AlphaMode, Doubles, Floats, Ints, Material, Mesh


@dataclass(frozen=True, eq=False)
class Shot:
    """What is photographed, and from where.

    turn: (3, 3) float64, rows right, up, towards the viewer. low, high: (3,) float64, the box that is seen, along these
    axes. size: (width, height) texels. faces: (F,) int32, the faces of the mesh that are seen whole. cut: (G,) int32,
    faces of which only what lies in `slab`, (from, to) towards the viewer, is seen.
    """

    turn: Doubles
    low: Doubles
    high: Doubles
    size: tuple[int, int]
    faces: Ints
    cut: Ints
    slab: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Photo:
    """A picture, row 0 on top, all of it premultiplied by coverage.

    albedo: (h, w, 4) float32, linear, without light; alpha is coverage in 0..1. relief: (h, w, 4) float32: the
    surface's slopes to the right and up, -4 to 4 as 0 to 1; its depth, from 0 at the far end of the shot's box to
    1 at the viewer's; and the part of the sky that it sees.
    """

    albedo: Floats
    relief: Floats


def photograph(mesh: Mesh, shots: Iterable[Shot], supersample: int) -> Iterator[Photo]:
    """Take the shots one after the other, each with `supersample` squared samples a texel. O(faces + samples) each.

    Raises GraphicsError where there is no OpenGL.
    """
    gl = context()
    studio = _Studio(gl, mesh)
    for shot in shots:
        yield studio.take(shot, supersample)


class _Studio:
    """The mesh on the graphics card, and the film that the next picture goes on."""

    def __init__(self, gl: moderngl.Context, mesh: Mesh) -> None:
        self._gl, self._mesh, self._program = gl, mesh, program("photo")
        occlusion = np.ones(len(mesh.positions)) if mesh.occlusion is None else mesh.occlusion
        layout = (
            (mesh.positions, "3f", "in_position"),
            (mesh.normals, "3f", "in_normal"),
            (mesh.uvs, "2f", "in_uv"),
            (occlusion, "1f", "in_occlusion"),
        )
        self._buffers = [(gl.buffer(np.ascontiguousarray(v, np.float32)), kind, name) for v, kind, name in layout]
        self._maps = [
            (upload_plain(gl, m.color_map, srgb=True), upload_plain(gl, m.normal_map, srgb=False))
            for m in mesh.materials
        ]
        self._film: Film | None = None  # of the last shot's size; shots of one slicing have the same

    def take(self, shot: Shot, supersample: int) -> Photo:
        shader = self._program
        if self._film is None or self._film.size != shot.size:
            self._film = Film(self._gl, shot.size, supersample, count=2)
        film = self._film
        film.expose()
        shader["to_clip"] = column_major(_parallel(shot))
        shader["turn"] = column_major(shot.turn)
        shader["range"] = float(shot.low[2]), float(shot.high[2])
        for faces, slab in ((shot.faces, (-np.inf, np.inf)), (shot.cut, shot.slab)):
            shader["slab"] = tuple(np.clip(slab, -1e30, 1e30).tolist())
            self._draw(faces)
        self._gl.cull_face = "back"
        return Photo(*film.develop())

    def _draw(self, faces: Ints) -> None:
        if not len(faces):
            return
        shader, mesh = self._program, self._mesh
        faces = faces[np.argsort(mesh.face_material[faces], kind="stable")]
        indices = self._gl.buffer(np.ascontiguousarray(mesh.faces[faces], np.int32))
        array = self._gl.vertex_array(shader, self._buffers, indices)
        ends = np.searchsorted(mesh.face_material[faces], np.arange(len(mesh.materials) + 1))
        for index, material in enumerate(mesh.materials):
            first, last = int(ends[index]), int(ends[index + 1])
            if first == last:
                continue
            self._dress(index, material)
            array.render(moderngl.TRIANGLES, vertices=3 * (last - first), first=3 * first)

    def _dress(self, index: int, material: Material) -> None:
        gl, shader = self._gl, self._program
        if material.double_sided:
            gl.disable(gl.CULL_FACE)
        else:
            gl.enable(gl.CULL_FACE)
            gl.cull_face = "front"  # the picture is upside down
        for unit, (name, image) in enumerate(zip(("color_map", "normal_map"), self._maps[index], strict=True)):
            image.use(unit)
            shader[name] = unit
        shader["has_normal_map"] = material.normal_map is not None
        shader["base_color"] = material.base_color
        shader["blend"] = material.alpha_mode is AlphaMode.BLEND
        shader["alpha_cutoff"] = material.alpha_cutoff if material.alpha_mode is AlphaMode.MASK else 0.0


def _parallel(shot: Shot) -> Doubles:
    """The shot's box onto clip space, its top row first: (4, 4)."""
    middle, half = (shot.low + shot.high) / 2, (shot.high - shot.low) / 2
    scale = np.array([1.0, -1.0, -1.0]) / half
    to_clip = np.eye(4)
    to_clip[:3, :3] = scale[:, None] * shot.turn
    to_clip[:3, 3] = -scale * middle
    return to_clip
