"""Stanford PLY, through plyfile: trimesh 5.2 refuses files that mix triangles and quads."""

import warnings
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement, PlyParseError

from treebake.errors import MeshError
from treebake.formats.part import Part
from treebake.geometry import triangulate
from treebake.images import to_linear
from treebake.model import Floats, Material

_NORMALS, _COLORS = ("nx", "ny", "nz"), ("red", "green", "blue")
_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))


def read_ply(path: Path) -> list[Part]:
    """Read the faces of a text or binary PLY file as one part named after the file.

    Polygons of any size are triangulated, v is flipped into glTF's. The material is double-sided, since the format
    does not say, and of the mean vertex colour where the file has colours.

    Raises MeshError where the file is damaged or holds no faces.
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # numpy warns of an element without rows
            file = PlyData.read(str(path))
        vertices, faces = file["vertex"], file["face"]
        polygons = faces[_first(faces, ("vertex_indices", "vertex_index"))]
        positions = _columns(vertices, ("x", "y", "z"))
    except (PlyParseError, KeyError, ValueError, IndexError, TypeError, MemoryError) as error:
        raise MeshError(f"{path} is damaged or no PLY mesh ({error}); export it again") from error
    sizes = np.fromiter(map(len, polygons), np.int32, len(polygons))
    corners = np.concatenate([np.zeros(0, np.int64), *polygons])
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(positions):
        raise MeshError(f"{path} has a face on a vertex beyond its {len(positions)}; export it again")
    stored_uvs = next((_columns(vertices, names) for names in _UV_NAMES if _has(vertices, names)), None)
    return [
        Part(
            node=path.stem,
            material=Material(path.stem, (*_mean_color(vertices), 1.0), double_sided=True),
            positions=positions,
            normals=_columns(vertices, _NORMALS) if _has(vertices, _NORMALS) else None,
            uvs=None if stored_uvs is None else np.stack([stored_uvs[:, 0], 1 - stored_uvs[:, 1]], axis=1),
            faces=triangulate(positions, corners.astype(np.int32), sizes),
        )
    ]


def _has(element: PlyElement, names: tuple[str, ...]) -> bool:
    return {found.name for found in element.properties}.issuperset(names)


def _first(element: PlyElement, names: tuple[str, ...]) -> str:
    return next((name for name in names if _has(element, (name,))), names[0])


def _columns(element: PlyElement, names: tuple[str, ...]) -> Floats:
    return np.stack([np.asarray(element[name], np.float32) for name in names], axis=1)


def _mean_color(vertices: PlyElement) -> tuple[float, float, float]:
    """Linear; mid grey where the file has no colours."""
    if not (_has(vertices, _COLORS) and vertices.count and vertices["red"].dtype == np.uint8):
        return 0.5, 0.5, 0.5
    stored = np.stack([vertices[name] for name in _COLORS], axis=1)
    red, green, blue = (float(c) for c in to_linear(stored).mean(axis=0, dtype=np.float64))
    return red, green, blue
