"""How much of the sky the vertices of a mesh see: ambient occlusion by depth maps ([GPSS07] 5.2)."""

import moderngl
import numpy as np
from numpy.typing import NDArray

from treebake.gl.context import context, leave_framebuffer, program
from treebake.gl.target import check
from treebake.gl.textures import upload_plain, upload_table
from treebake.gl.view import column_major
from treebake.model import AlphaMode, Doubles, Floats, Material, Mesh

_ROW = 1024  # vertices of a row of their image
_HINT = "set [occlusion] directions = 0, or give a tree of fewer vertices"
_NOTHING = -2.0  # below all that a map can hold
_GOLDEN = np.pi * (3 - np.sqrt(5))  # radians from one direction to the next


def sky_seen(mesh: Mesh, thin: NDArray[np.bool_], *, directions: int, texels: int, bias: float, seed: int) -> Floats:
    """The part of the sky that each vertex sees, weighted by the cosine to its normal: (V,) float32, 0 to 1.

    thin: (V,) bool, of leaves, which are seen and lit from both sides; all others see the half before their normal.
    directions: an even number, evenly spread over the sphere and turned at random by the seed. texels: of a depth map's
    side. bias: how far a vertex is moved towards the sky, in the mesh's unit, so that it is not hidden by itself.
    All faces hide from both sides; what is cut out by alpha does not. A vertex without a normal sees all.
    O(directions (F + V + texels^2)).

    Opposite directions share a pass, which keeps both the greatest and the least depth: half the time of a depth
    buffer for each (2.7 s and 5.2 s for 128 directions and 159,000 triangles in software).
    Raises GraphicsError where there is no OpenGL, or there are more vertices than its textures take: 16 million where
    those have 16,384 rows.
    """
    if not mesh.triangles:
        return np.ones(len(mesh.positions), np.float32)
    gl = context()
    low, high = mesh.bounds.astype(np.float64)
    middle = (low + high) / 2
    radius = float(np.linalg.norm(mesh.positions[mesh.used] - middle, axis=1).max()) * (1 + 1e-3) or 1.0
    sphere = {"middle": tuple(middle.tolist()), "radius": radius}
    places, uvs = (gl.buffer(np.ascontiguousarray(values, np.float32)) for values in (mesh.positions, mesh.uvs))
    occluders = [_Occluder(gl, mesh, index, places, uvs) for index in np.unique(mesh.face_material)]
    reach = gl.texture((texels, texels), 2, dtype="f4")
    reach.filter = moderngl.NEAREST, moderngl.NEAREST
    film = gl.framebuffer([reach])
    receivers = _Receivers(gl, mesh, thin, reach)
    for turn in _turns(directions // 2, seed):
        values = {**sphere, "turn": column_major(turn)}
        film.clear(_NOTHING, _NOTHING)
        with gl.scope(film, moderngl.BLEND):
            gl.blend_func, gl.blend_equation = (moderngl.ONE, moderngl.ONE), moderngl.MAX
            for occluder in occluders:
                occluder.draw(values)
            gl.blend_equation = moderngl.FUNC_ADD
        receivers.add({**values, "bias": bias / radius})
    check(gl)
    seen = receivers.seen()
    leave_framebuffer()
    return seen


class _Occluder:
    """The faces of one material."""

    def __init__(
        self, gl: moderngl.Context, mesh: Mesh, index: int, places: moderngl.Buffer, uvs: moderngl.Buffer
    ) -> None:
        material = mesh.materials[index]
        faces = gl.buffer(np.ascontiguousarray(mesh.faces[mesh.face_material == index], np.int32))
        layout = [(places, "3f", "in_position")]
        self._material: Material | None = None
        variant = []
        if material.alpha_mode is not AlphaMode.OPAQUE:
            self._material = material
            layout.append((uvs, "2f", "in_uv"))
            self._color_map = upload_plain(gl, material.color_map, srgb=True)
            variant = ["CUT_OUT"]
        self._array = gl.vertex_array(program("sky_depth", *variant), layout, faces)

    def draw(self, values: dict[str, object]) -> None:
        shader, material = self._array.program, self._material
        if material:
            self._color_map.use(0)
            blend = material.alpha_mode is AlphaMode.BLEND
            cut = {"color_map": 0, "base_alpha": material.base_color[3], "blend": blend}
            values = {**values, **cut, "alpha_cutoff": material.alpha_cutoff}
        for name, value in values.items():
            shader[name] = value
        self._array.render(moderngl.TRIANGLES)


class _Receivers:
    """The vertices, a texel each, and what they have seen so far."""

    def __init__(self, gl: moderngl.Context, mesh: Mesh, thin: NDArray[np.bool_], reach: moderngl.Texture) -> None:
        self._gl, self._count = gl, len(mesh.positions)
        self._size = _ROW, -(-self._count // _ROW)
        self._images = {
            "places": self._upload(np.column_stack([mesh.positions, thin])),
            "normals": self._upload(np.pad(mesh.normals, ((0, 0), (0, 1)))),
            "planes": self._upload(np.pad(_face_normals(mesh), ((0, 0), (0, 1)))),
            "reach": reach,
        }
        self._sum = gl.framebuffer([gl.texture(self._size, 2, dtype="f4")])
        self._sum.clear()
        self._array = gl.vertex_array(program("sky_seen"), [])

    def add(self, values: dict[str, object]) -> None:
        shader = self._array.program
        for unit, (name, image) in enumerate(self._images.items()):
            image.use(unit)
            shader[name] = unit
        for name, value in values.items():
            shader[name] = value
        with self._gl.scope(self._sum, moderngl.BLEND):
            self._gl.blend_func = moderngl.ONE, moderngl.ONE
            self._array.render(moderngl.TRIANGLES, vertices=3)

    def seen(self) -> Floats:
        sums = np.frombuffer(self._sum.read(components=2, dtype="f4"), np.float32).reshape(-1, 2)[: self._count]
        seen = np.where(sums[:, 1] > 0, sums[:, 0] / np.where(sums[:, 1] > 0, sums[:, 1], 1), 1)
        return np.clip(seen, 0, 1).astype(np.float32)

    def _upload(self, values: Floats) -> moderngl.Texture:
        padded = np.zeros((self._size[0] * self._size[1], 4), np.float32)
        padded[: self._count] = values
        return upload_table(self._gl, padded.reshape(-1, _ROW, 4), "f4", _HINT)


def _face_normals(mesh: Mesh) -> Doubles:
    """Normals of the faces around each vertex, averaged by area, where shading normals may be bent: (V, 3) float64."""
    a, b, c = (mesh.positions[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    areas = np.cross(b - a, c - a)
    corners, count = mesh.faces.reshape(-1), len(mesh.positions)
    sums = np.stack([np.bincount(corners, np.repeat(axis, 3), count) for axis in areas.T], axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.asarray(sums / np.where(lengths > 0, lengths, 1))


def _turns(count: int, seed: int) -> Doubles:
    """Frames whose third rows are spread over a half sphere as on a Fibonacci lattice: (count, 3, 3) float64."""
    step = np.arange(count) + 0.5
    z, around = 1 - step / count, step * _GOLDEN
    ring = np.sqrt(1 - z**2)
    lattice = np.stack([ring * np.cos(around), ring * np.sin(around), z], axis=1)
    random = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    towards = lattice @ random.T
    across = np.eye(3)[np.abs(towards).argmin(axis=1)]
    right = np.cross(across, towards)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return np.stack([right, np.cross(towards, right), towards], axis=1)
