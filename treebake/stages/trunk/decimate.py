"""Edge collapse for the parts of a trunk that are no tubes, with texture coordinates carried over.

Measured on a welded tree of 104,902 triangles: fast-simplification keeps 95, 91 and 76 % of the area at 8,000, 3,500
and 1,000 triangles, pyfqmr 95, 90 and 75 %, meshoptimizer 96, 90 and 74 %.
"""

import fast_simplification
import numpy as np

from treebake.model import Doubles, Longs, Mesh
from treebake.nearest import Triangles, barycentric
from treebake.tubes.surface import Surface, find_surface

_AGGRESSION = (7.0, 10.0)  # fast-simplification's haste, tried in turn: at 10 it always arrives, and loses more area
_INSET = 0.1  # a corner's attributes come from where it lies this far towards its face's centre
_UV_STEPS, _NORMAL_STEPS = 4096, 64  # vertices nearer than this part of a tile, of a unit, are shared


def decimate(mesh: Mesh, triangles: int) -> Mesh:
    """Collapse edges of the welded mesh until at most `triangles` are left, dropping the smallest components at last.

    Texture coordinates, normals and occlusion of each corner are those of the nearest source face, across a seam by
    whole tiles. O(F log F).
    """
    surface = find_surface(mesh)
    if not len(surface.ids) or triangles <= 0:
        return mesh.select(np.zeros(mesh.triangles, np.bool_))
    points, faces = surface.positions, surface.faces
    for aggression in _AGGRESSION:
        if len(faces) > triangles:
            found = fast_simplification.simplify(
                surface.positions.astype(np.float32),
                surface.faces.astype(np.int32),
                target_count=triangles,
                agg=aggression,
            )
            points, faces = (np.asarray(part) for part in found)
    bare = _bare(mesh, surface, points.astype(np.float64), faces.astype(np.int64))
    return _largest(bare, triangles)


def _bare(mesh: Mesh, surface: Surface, points: Doubles, faces: Longs) -> Mesh:
    """The simplified faces as a mesh with the source's attributes."""
    source = surface.positions[surface.faces]
    nearest = Triangles(source).nearest_point
    corners = points[faces]
    middles = corners.mean(axis=1)
    home, _ = nearest(middles)
    inner = corners + _INSET * (middles[:, None] - corners)
    face, _ = nearest(inner.reshape(-1, 3))
    raw = mesh.faces[surface.ids]
    uv, normal = mesh.uvs[raw].astype(np.float64), mesh.normals[raw].astype(np.float64)

    within = barycentric(source[face], corners.reshape(-1, 3))
    within = np.maximum(within, 0) / np.maximum(within, 0).sum(axis=1, keepdims=True)
    uvs = np.einsum("ni,nij->nj", within, uv[face]).reshape(-1, 3, 2)
    normals = np.einsum("ni,nij->nj", within, normal[face])
    sky = None if mesh.occlusion is None else np.einsum("ni,ni->n", within, mesh.occlusion[raw[face]])
    here = np.einsum("ni,nij->nj", barycentric(source[home], middles), uv[home])[:, None]
    around = barycentric(np.repeat(source[home], 3, axis=0), corners.reshape(-1, 3))
    straight = np.einsum("ni,nij->nj", around, np.repeat(uv[home], 3, axis=0)).reshape(-1, 3, 2)
    uvs += np.rint(here - uvs)
    # A corner beyond a seam that is not whole tiles wide: run on as the face's middle does.
    torn = np.abs(uvs - here).max(axis=2) > 2 * np.abs(straight - here).max(axis=2) + 1 / _UV_STEPS
    uvs[torn] = straight[torn]

    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(length > 0, length, 1)
    flat = uvs.reshape(-1, 2)
    key = np.column_stack([faces.ravel(), np.rint(flat * _UV_STEPS), np.rint(normals * _NORMAL_STEPS)])
    _, first, shared = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return Mesh(
        positions=points[faces.ravel()[first]].astype(np.float32),
        normals=normals[first].astype(np.float32),
        uvs=flat[first].astype(np.float32),
        faces=shared.reshape(-1, 3).astype(np.int32),
        face_material=mesh.face_material[surface.ids[home]],
        face_node=mesh.face_node[surface.ids[home]],
        materials=mesh.materials,
        nodes=mesh.nodes,
        occlusion=None if sky is None else sky[first].astype(np.float32),
    )


def _largest(mesh: Mesh, triangles: int) -> Mesh:
    """The largest components by area that fit into the budget, whole."""
    if mesh.triangles <= triangles:
        return mesh
    surface = find_surface(mesh)
    comp = surface.face_comp
    area = np.bincount(comp, mesh.face_areas[surface.ids], surface.count)
    order = np.argsort(-area, kind="stable")
    fits = np.zeros(surface.count, np.bool_)
    fits[order] = np.cumsum(np.bincount(comp, minlength=surface.count)[order]) <= triangles
    kept = np.zeros(mesh.triangles, np.bool_)
    kept[surface.ids] = fits[comp]
    return mesh.select(kept)
