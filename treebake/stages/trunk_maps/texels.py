"""Finds what each texel of a simplified trunk shows of the full one."""

from dataclasses import dataclass

import numpy as np

from treebake.geometry import reject, texture_axes
from treebake.gl.uv_bake import face_texels
from treebake.images import bleed
from treebake.model import Doubles, Floats, Longs, Mesh
from treebake.nearest import Triangles


@dataclass(frozen=True, eq=False)
class Frame:
    """Where N points lie on a textured surface: along_u, along_v (N, 3) are the surface's directions of growing u and
    v, zero where texture coordinates leave them open; normals (N, 3) the interpolated ones, unit. All float64.
    """

    along_u: Doubles
    along_v: Doubles
    normals: Doubles

    @property
    def axes(self) -> Doubles:
        """(N, 3, 3) the rows tangent, bitangent and normal that a tangent-space normal counts in; its +Y is against v.

        The twin of `normal_map.glsl`; tangent and bitangent are zero where there is no texture direction.
        """
        tangent = reject(self.along_u, self.normals)
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        tangent /= np.where(length > 0, length, 1)
        bitangent = np.cross(self.normals, tangent)
        bitangent *= np.where((bitangent * self.along_v).sum(axis=1, keepdims=True) > 0, -1, 1)
        return np.stack([tangent, bitangent, self.normals], axis=1)


@dataclass(frozen=True, eq=False)
class Texels:
    """The covered texels of a square texture and the points of the source that they show.

    size: side of the texture. density: texels per unit. number: (T,) int64, row after row from the top. frame: on the
    simplified trunk. face, weights: (T,), (T, 3), the source's face and the weights of its corners.
    """

    size: int
    density: float
    number: Longs
    frame: Frame
    face: Longs
    weights: Doubles

    def image(self, values: Doubles) -> Floats:
        """(size, size, C + 1) float32: values (T, C), premultiplied by their coverage, which is the last channel."""
        sheet = np.zeros((self.size * self.size, values.shape[1] + 1), np.float32)
        sheet[self.number, :-1], sheet[self.number, -1] = values, 1
        return sheet.reshape(self.size, self.size, -1)

    def spread(self, values: Doubles) -> Floats:
        """(size, size, 3) float32: values (T, 3), and between the charts what lies around."""
        return bleed(self.image(values))


def find_texels(mesh: Mesh, uvs: Floats, size: int, density: float, source: Mesh) -> Texels:
    """Rasterise a mesh at `uvs` (V, 2) and look up the nearest point of the source for every texel.

    Rays along the normals would miss an open tube, or meet another one. Raises GraphicsError.
    """
    number, face, weights = face_texels(uvs, mesh.faces, size)
    places = blended(mesh.positions[mesh.faces], face, weights)
    frame = frame_at(mesh, uvs, face, weights)
    surface = Triangles(source.positions[source.faces].astype(np.float64))
    found, within = surface.nearest_point(places, frame.normals)
    return Texels(size, density, number, frame, found, within)


def blended(corners: Floats, face: Longs, weights: Doubles) -> Doubles:
    """(N, C) values of corners (F, 3, C) at points given by face (N,) and weights (N, 3)."""
    return np.asarray(np.einsum("ni,nic->nc", weights, corners[face].astype(np.float64)))


def frame_at(mesh: Mesh, uvs: Floats, face: Longs, weights: Doubles) -> Frame:
    """The frames of points of a mesh at `uvs` (V, 2)."""
    corners = mesh.positions[mesh.faces].astype(np.float64)
    along_u, along_v, _ = texture_axes(corners, uvs[mesh.faces].astype(np.float64))
    normals = blended(mesh.normals[mesh.faces], face, weights)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    flat_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[face]
    flat_normals /= np.linalg.norm(flat_normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1), flat_normals)
    return Frame(along_u[face], along_v[face], normals)
