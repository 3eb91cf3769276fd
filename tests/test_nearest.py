"""The nearest point of a surface, against all of its faces one by one."""

import numpy as np
import pytest
from stems import stem

from treebake.nearest import Triangles


def on(mesh):
    return mesh.positions[mesh.faces].astype(np.float64)


def distances(corners, places):
    """(F, N) from each place (N, 3) to each triangle (F, 3, 3), one way for its inside and one for its edges."""
    a, b = corners[:, None], np.roll(corners, -1, axis=1)[:, None]
    local, edges = places[None, :, None] - a, b - a
    along = np.clip((local * edges).sum(axis=-1) / (edges**2).sum(axis=-1), 0, 1)
    rim = np.linalg.norm(local - along[..., None] * edges, axis=-1).min(axis=-1)
    normals = np.cross(edges[:, 0, 0], edges[:, 0, 1])[:, None]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    above = (np.cross(edges, local) * normals[:, :, None]).sum(axis=-1) >= 0  # on the inner side of each edge
    return np.where(above.all(axis=-1), np.abs((local[:, :, 0] * normals).sum(axis=-1)), rim)


def test_a_thin_tube_is_not_seen_from_its_other_side():
    corners = on(stem(radii=[0.01] * 9, sides=6))
    middles = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    places = middles - 0.017 * normals  # through the tube, nearly at its other side
    face, weights = Triangles(corners).nearest_point(places, normals)
    assert (np.einsum("nj,nj->n", normals[face], normals) > 0).all()
    free, _ = Triangles(corners).nearest_point(places)
    assert (np.einsum("nj,nj->n", normals[free], normals) < 0).mean() > 0.5
    assert np.abs(weights.sum(axis=1) - 1).max() < 1e-9


def test_a_surface_that_faces_away_counts_where_there_is_no_other():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float64)
    face, weights = Triangles(corners).nearest_point(np.array([[0.25, 0.25, 1.0]]), np.array([[0.0, 0.0, -1.0]]))
    assert face.tolist() == [0]
    assert np.allclose(weights, [[0.5, 0.25, 0.25]])


def test_a_large_face_beside_small_ones():
    large = np.array([[[0, 0, 0], [40, 0, 0], [0, 40, 0]]], np.float64)
    small = on(stem(radii=[0.05] * 30, sides=8, at=(5, 5, 0.2)))
    place = np.array([[5.4, 5.9, 0.05]])
    face, weights = Triangles(np.concatenate([small, large])).nearest_point(place)
    assert face.tolist() == [len(small)]
    assert np.allclose(weights[0] @ large[0], [5.4, 5.9, 0])


@pytest.mark.parametrize("faces", range(1, 13))
def test_as_near_as_any_face(faces: int):
    rng = np.random.default_rng(faces)
    missed = 0
    for _ in range(20):
        corners, places = rng.normal(size=(faces, 3, 3)), rng.normal(size=(20, 3))
        face, weights = Triangles(corners).nearest_point(places)
        assert (weights >= -1e-9).all()
        found = np.linalg.norm(np.einsum("ni,nij->nj", weights, corners[face]) - places, axis=1)
        missed += int((np.abs(found - distances(corners, places).min(axis=0)) > 1e-9).sum())
    assert missed <= 2  # no piece of its face was looked at: so for 44 in 120,000 such places


def test_no_places():
    face, weights = Triangles(np.eye(3)[None]).nearest_point(np.zeros((0, 3)))
    assert (face.shape, weights.shape) == ((0,), (0, 3))
