"""The types that flow between stages: what they work out by themselves."""

import numpy as np
import pytest
from foliage import leaves_at
from stems import empty
from synthetic import joined, quad

from treebake.model import Material, Texture

SIZES = ((0.0, 2.0), (0.0, 1.0)), ((5.0, 6.0), (-4.0, -1.0))


def two_quads():
    return joined(*(quad(Material(str(i)), x=x, y=y, z=i) for i, (x, y) in enumerate(SIZES)))


def test_bounds_and_areas():
    mesh = two_quads()
    assert mesh.triangles == 4
    assert mesh.bounds.tolist() == [[0, -4, 0], [6, 1, 1]]
    assert mesh.bounds.dtype == np.float32
    assert np.allclose(mesh.face_areas, [1, 1, 1.5, 1.5])


def test_bounds_leave_unused_vertices_out():
    mesh = two_quads().select(np.array([True, True, False, False]))
    assert len(mesh.positions) == 4
    assert mesh.bounds.tolist() == [[0, 0, 0], [2, 1, 0]]


def test_select_keeps_materials_nodes_and_geometry():
    mesh = two_quads()
    part = mesh.select(np.array([False, False, False, True]))
    assert part.materials is mesh.materials
    assert part.nodes is mesh.nodes
    assert part.face_material.tolist() == part.face_node.tolist() == [1]
    for name in ("positions", "normals", "uvs"):
        assert (getattr(part, name)[part.faces] == getattr(mesh, name)[mesh.faces[3:]]).all()


def test_select_nothing_and_all():
    mesh = two_quads()
    nothing = mesh.select(np.zeros(4, bool))
    assert (nothing.triangles, len(nothing.positions)) == (0, 0)
    assert not nothing.bounds.any()
    everything = mesh.select(np.ones(4, bool))
    assert (everything.positions[everything.faces] == mesh.positions[mesh.faces]).all()


def test_an_empty_mesh_has_no_extent():
    assert empty().bounds.tolist() == [[0, 0, 0], [0, 0, 0]]
    assert empty().face_areas.shape == (0,)
    assert empty().triangles == 0


@pytest.mark.parametrize(("alpha", "expected"), [(255, False), (254, True), (0, True)])
def test_one_texel_makes_a_texture_clear(alpha, expected):
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[2, 1, 3] = alpha
    assert Texture("leaf", pixels).has_alpha is expected


def test_twig_pieces_are_told_by_their_axes():
    assert leaves_at(np.zeros((3, 3)), axes=[(0, 0, 0), (0, -1, 0), (1, 0, 0)]).is_twig.tolist() == [False, True, True]
    assert leaves_at([]).is_twig.shape == (0,)
    assert leaves_at([]).count == 0
