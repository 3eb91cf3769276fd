"""Unwraps a mesh: everything that touches xatlas.

A tube's own texture coordinates, around and along, are a chart already, with its seam where vertices are doubled
anyway. xatlas cuts wherever a side turns by more than 45 degrees, so of a three-sided tube it makes three charts:
measured on a chestnut's trunk of 8,000 triangles, 3,999 charts and 15,996 vertices instead of the 10,664 it had. So
xatlas packs the charts that there are, and makes its own only where these are missing, folded over or distorted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import xatlas

from treebake.errors import SettingsError
from treebake.geometry import components, texture_axes
from treebake.model import Doubles, Floats, Ints, Longs, Mesh

_STRETCH = 4.0  # a chart's own coordinates may be longer or shorter than the surface by this factor
_SOUND = 0.9  # on this part of its area at least
_LONGEST = 0.5  # of a chart, over the side of a square as large as the surface; longer ones are cut
_RESOLUTION = 1024  # texels in which xatlas lays out the charts that it makes, before they are packed with the others
_TRIES = 12  # packings until one fits
_SLACK = 1.2  # a texture twice as wide, for less than this in density, is not worth its texels


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """A mesh cut into charts on a square texture, apart by two texels or so.

    vertices: (U,) int32, which of the mesh's vertices each new one is. uvs: (U, 2) float32, in 0..1. faces: (F, 3)
    int32, in the mesh's order. size: of the texture, texels, a power of two. density: texels per unit.
    """

    vertices: Ints
    uvs: Floats
    faces: Ints
    size: int
    density: float


def unwrap(mesh: Mesh, density: float, largest: int) -> Unwrapped:
    """Cut a mesh into charts and pack them.

    mesh: every face of it has an area. density: wanted, texels per unit; it gets lower where the texture would be wider
    than `largest` texels, a power of two. The same mesh gives the same charts. O(F log F).
    Raises SettingsError where the charts do not fit at all.
    """
    chart, corners = _charts(mesh)
    span = len(mesh.positions)
    key, first, faces = np.unique(
        chart[:, None].astype(np.int64) * span + mesh.faces, return_index=True, return_inverse=True
    )
    flat = corners.reshape(-1, 2)[first]
    faces = faces.reshape(-1, 3)
    packed, size, density = _packed(flat, faces, chart, density, largest)
    again, corner, uvs = packed[0]
    texels = uvs.astype(np.float64) * (packed.width, packed.height)
    return Unwrapped(
        vertices=(key % span)[again].astype(np.int32),
        uvs=(texels / size).astype(np.float32),
        faces=corner.astype(np.int32).reshape(-1, 3),
        size=size,
        density=density,
    )


def _packed(flat: Doubles, faces: Longs, chart: Longs, density: float, largest: int) -> tuple[Any, int, float]:
    """The atlas, the side of the texture that holds it, and the density."""
    side = largest
    for _ in range(_TRIES):
        atlas = xatlas.Atlas()
        atlas.add_uv_mesh(flat.astype(np.float32), faces.astype(np.uint32), chart.astype(np.uint32).reshape(-1, 1))
        atlas.generate(xatlas.ChartOptions(), _options(texels_per_unit=density))
        needed = max(atlas.width, atlas.height)
        if needed <= side:
            return atlas, max(1 << (needed - 1).bit_length(), 1), density
        side = min(largest, 1 << (int(needed / _SLACK) - 1).bit_length())
        density *= min(0.97 * side / needed, 0.97)
    raise SettingsError(
        f"[trunk_maps] size is {largest}, too few texels for the {len(np.unique(chart))} charts of a trunk of "
        f"{len(faces)} triangles; raise it"
    )


def _options(**chosen: float) -> Any:
    options = xatlas.PackOptions()
    options.padding, options.bruteForce, options.create_image = 1, False, False
    for name, value in chosen.items():
        setattr(options, name, value)
    return options


def _charts(mesh: Mesh) -> tuple[Longs, Doubles]:
    """The chart of each face (F,), and its corners' places there (F, 3, 2), in units of length."""
    pairs = np.concatenate([mesh.faces[:, :2], mesh.faces[:, 1:]])
    _, part = np.unique(components(pairs, len(mesh.positions))[mesh.faces[:, 0]], return_inverse=True)
    corners, sound = _own_coordinates(mesh, part)
    chart = _cut(part, corners, float(mesh.face_areas.sum()))
    rest = np.flatnonzero(~sound[part])
    if len(rest):
        made, places = _new_charts(mesh.positions, mesh.faces[rest])
        chart[rest] = chart.max() + 1 + made
        corners[rest] = places
    return np.unique(chart, return_inverse=True)[1], corners


def _own_coordinates(mesh: Mesh, part: Longs) -> tuple[Doubles, Longs]:
    """The texture coordinates (F, 3, 2), scaled to lengths for each part, and whether they make a chart of it."""
    count, areas = int(part.max()) + 1, mesh.face_areas
    corners = mesh.uvs[mesh.faces].astype(np.float64)
    along_u, along_v, det = texture_axes(mesh.positions[mesh.faces].astype(np.float64), corners)
    flat = np.abs(det) <= 1e-9 * np.abs(corners).max(axis=(1, 2), initial=1e-9) ** 2
    inverse = (1 / np.where(flat, np.inf, np.abs(det)))[:, None]
    along_u, along_v = along_u * inverse, along_v * inverse
    total = np.bincount(part, areas, count)
    scale = np.stack(
        [np.bincount(part, areas * np.linalg.norm(along, axis=1), count) / total for along in (along_u, along_v)],
        axis=1,
    )
    usable = (scale > 0).all(axis=1)
    scale[~usable] = 1
    u, v = along_u / scale[part, :1], along_v / scale[part, 1:]
    half, mixed = ((u * u).sum(axis=1) + (v * v).sum(axis=1)) / 2, (u * v).sum(axis=1)
    apart = np.sqrt((half - (u * u).sum(axis=1)) ** 2 + mixed**2)
    good = (half + apart <= _STRETCH**2) & (half - apart >= _STRETCH**-2)
    one_way = np.bincount(part, np.sign(det) * ~flat, count)
    usable &= np.abs(one_way) == np.bincount(part, minlength=count)
    usable &= np.bincount(part, areas * good, count) >= _SOUND * total
    return corners * scale[part, None], usable


def _cut(part: Longs, corners: Doubles, area: float) -> Longs:
    """The chart of each face: parts, cut evenly where they are too long to be packed well."""
    longest = _LONGEST * np.sqrt(area)
    middle = corners.mean(axis=1)
    chart = part.astype(np.int64)
    for axis in (0, 1):
        low, high = (np.full(int(part.max()) + 1, bound) for bound in (np.inf, -np.inf))
        np.minimum.at(low, part, middle[:, axis])
        np.maximum.at(high, part, middle[:, axis])
        pieces = np.ceil(np.maximum((high - low) / longest, 1))[part]
        extent = np.where(high > low, high - low, 1)[part]
        piece = np.minimum((middle[:, axis] - low[part]) / extent * pieces, pieces - 1).astype(np.int64)
        chart = np.unique(chart * (int(pieces.max()) + 1) + piece, return_inverse=True)[1]
    return chart


def _new_charts(positions: Floats, faces: Ints) -> tuple[Longs, Doubles]:
    """The same as `_charts`, by xatlas; what it makes no chart of has one of its own, without extent."""
    used, local = np.unique(faces, return_inverse=True)
    atlas = xatlas.Atlas()
    atlas.add_mesh(positions[used], local.reshape(-1, 3).astype(np.uint32))
    options = xatlas.ChartOptions()
    options.max_iterations = 1
    atlas.generate(options, _options(resolution=_RESOLUTION))
    _, corner, uvs = atlas[0]
    _, chart = atlas.get_mesh_vertex_assignment(0)
    texels = uvs.astype(np.float64) * (atlas.width, atlas.height) / (atlas.texels_per_unit or 1.0)
    corner = corner.astype(np.int64).reshape(-1, 3)
    return np.unique(chart[corner[:, 0]], return_inverse=True)[1], texels[corner]
