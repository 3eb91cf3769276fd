"""Split: synthetic trees whose leaves are known, and the real ones."""

import time
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from trees import tree

from treebake.errors import SettingsError
from treebake.grow import grow
from treebake.meshes import LoadSettings, read_mesh
from treebake.model import AlphaMode, Material, Mesh, Texture
from treebake.stages.split import SplitSettings, split


@dataclass
class Piece:
    points: np.ndarray
    faces: np.ndarray
    material: int = 0
    node: int = 0

    def at(self, x, y=0.0, z=0.0, turn=(0, 0, 0), scale=1.0, **changes):
        points = Rotation.from_euler("xyz", turn, degrees=True).apply(self.points * scale) + np.array([x, y, z])
        return replace(self, points=points, **changes)


def build(*pieces, materials=("all",), nodes=("tree",)):
    offsets = np.cumsum([0, *(len(piece.points) for piece in pieces)])
    positions = np.concatenate([np.zeros((0, 3)), *(piece.points for piece in pieces)]).astype(np.float32)
    faces = [np.asarray(piece.faces) + offset for piece, offset in zip(pieces, offsets, strict=False)]
    return Mesh(
        positions=positions,
        normals=np.tile(np.float32([0, 1, 0]), (len(positions), 1)),
        uvs=np.zeros((len(positions), 2), np.float32),
        faces=np.concatenate([np.zeros((0, 3)), *faces]).astype(np.int32),
        face_material=np.repeat([p.material for p in pieces], [len(p.faces) for p in pieces]).astype(np.int32),
        face_node=np.repeat([p.node for p in pieces], [len(p.faces) for p in pieces]).astype(np.int32),
        materials=tuple(m if isinstance(m, Material) else Material(m) for m in materials),
        nodes=nodes,
    )


def strip(quads, bend):
    """A strip one wide of square quads, bent by `bend` degrees at each joint."""
    angles = np.radians(np.arange(quads) * bend)
    path = np.concatenate([[[0, 0]], np.cumsum(np.stack([np.cos(angles), np.sin(angles)], axis=1), axis=0)])
    points = np.array([[x, y, z] for x, y in path for z in (0, 1)])
    faces = [[2 * i + a, 2 * i + b, 2 * i + c] for i in range(quads) for a, b, c in ((0, 1, 3), (0, 3, 2))]
    return Piece(points, np.array(faces))


def tube(rings=6, sides=5, radius=0.1, bow=0.0):
    """An open upright tube of unit length with a bow sideways."""
    turn = np.arange(sides) * 2 * np.pi / sides
    heights = np.linspace(0, 1, rings)
    points = [[radius * np.cos(t) + bow * h * h, h, radius * np.sin(t)] for h in heights for t in turn]
    a = np.arange(sides * (rings - 1))
    b = a // sides * sides + (a + 1) % sides
    return Piece(
        np.array(points), np.concatenate([np.stack([a, b, b + sides], 1), np.stack([a, b + sides, a + sides], 1)])
    )


QUAD = strip(1, 0)
TRUNK = tube().at(0, scale=20)


def crossed():
    """Two quads that cross at a right angle and share the vertices of their axis."""
    points = [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 0, 1], [0, 1, 1]]
    return Piece(np.array(points, float), np.array([[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4]]))


def corner_sets(mesh, leaves, leaf):
    return mesh.positions[mesh.faces[leaves.face_leaf == leaf]].reshape(-1, 3).astype(np.float64)


def assert_transforms_hold(result, tolerance):
    """Every leaf's vertices are those of its exemplar, transformed."""
    leaves = result.leaves
    assert (leaves.shape[leaves.exemplars] == np.arange(len(leaves.exemplars))).all()
    np.testing.assert_array_equal(
        leaves.transforms[leaves.exemplars], np.tile(np.eye(3, 4), (len(leaves.exemplars), 1, 1))
    )
    for leaf in range(leaves.count):
        matrix = leaves.transforms[leaf]
        moved = (
            corner_sets(result.foliage, leaves, leaves.exemplars[leaves.shape[leaf]]) @ matrix[:, :3].T + matrix[:, 3]
        )
        gaps = np.linalg.norm(moved[:, None] - corner_sets(result.foliage, leaves, leaf)[None], axis=2).min(axis=1)
        assert gaps.max() <= tolerance * leaves.radii[leaf]


# What is a leaf


@pytest.mark.parametrize(
    ("piece", "leaves"),
    [
        (QUAD, 1),
        (strip(2, 40), 1),  # folded on its midrib
        (strip(5, 15), 1),  # gently bent
        (strip(5, 60), 5),  # cards around a corner
        (crossed(), 2),
        (strip(60, 9), range(4, 17)),  # a smooth curl of a turn and a half, neither left round nor shredded
    ],
    ids=["quad", "folded", "bent", "cards", "crossed", "curl"],
)
def test_leaves_are_the_smallest_near_planar_patches(piece, leaves):
    result = split(build(TRUNK, piece.at(5, 15, scale=0.1, material=1), materials=("bark", "leaf")))
    assert result.trunk.triangles == len(TRUNK.faces)
    assert result.leaves.count in (leaves if isinstance(leaves, range) else [leaves])
    np.testing.assert_allclose(np.linalg.norm(result.leaves.normals, axis=1), 1)


def test_leaves_that_touch_in_a_vertex_are_two():
    other = QUAD.at(0, turn=(0, 0, 90), scale=0.1)
    other = replace(other, points=other.points - other.points[0])
    result = split(build(TRUNK, QUAD.at(0, scale=0.1), other))
    assert result.leaves.count == 2


def test_a_palmate_leaf_of_leaflets_that_meet_in_a_vertex_is_one():
    leaflet = np.array([[0, 0, 0], [1, -0.2, 0.2], [1.5, -0.3, 0], [1, -0.2, -0.2]])
    leaflets = [Rotation.from_euler("y", 40 * i, degrees=True).apply(leaflet) for i in range(7)]
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(7)])
    leaf = Piece(np.concatenate(leaflets), faces)
    assert split(build(TRUNK, *(leaf.at(x, 15, scale=0.1) for x in range(4)))).leaves.count == 4


def test_one_large_leaf_may_bend_less_than_many_small_ones():
    frond = strip(8, 9)
    assert split(build(TRUNK, frond.at(5, 15, scale=0.1))).leaves.count == 1
    assert split(build(frond.at(0))).leaves.count > 1


def test_the_fields_of_a_leaf():
    result = split(build(TRUNK, QUAD.at(5, 15, 3, turn=(30, 40, 50), scale=2)))
    leaves = result.leaves
    points = QUAD.at(5, 15, 3, turn=(30, 40, 50), scale=2).points
    np.testing.assert_allclose(leaves.centers, [points.mean(axis=0)], rtol=1e-6)
    np.testing.assert_allclose(leaves.areas, [4], rtol=1e-6)
    np.testing.assert_allclose(leaves.radii, [np.sqrt(2)], rtol=1e-6)
    normal = np.cross(points[1] - points[0], points[3] - points[0]) / 4
    np.testing.assert_allclose(leaves.normals, [normal], atol=1e-6)
    assert not leaves.is_twig.any()
    np.testing.assert_array_equal(leaves.face_leaf, [0, 0])


def test_a_leaf_with_two_sides_has_the_normal_of_its_sheet():
    thin = Piece(QUAD.points, np.concatenate([QUAD.faces, QUAD.faces[:, ::-1]]))
    leaves = split(build(TRUNK, thin.at(5, 15, scale=0.1))).leaves
    assert leaves.count == 1
    np.testing.assert_allclose(np.abs(leaves.normals), [[0, 1, 0]], atol=1e-6)


# Shapes


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([QUAD, strip(2, 40), strip(3, 15)]))
def test_turned_scaled_and_mirrored_copies_share_one_shape(seed, leaf):
    rng = np.random.default_rng(seed)
    leaf = replace(leaf, points=leaf.points + (0.2, 0.1, 0.3) * leaf.points**2)  # no symmetry left
    copies = []
    for i in range(8):
        turn, where = rng.uniform(0, 360, 3), rng.uniform(-10, 10, 3)
        mirror = replace(leaf, points=leaf.points * (1, 1, -1), faces=leaf.faces[:, [0, 2, 1]])
        copies.append((mirror if i % 2 else leaf).at(*where, turn=turn, scale=rng.uniform(0.05, 0.2)))
    result = split(build(TRUNK, *copies))
    assert result.leaves.count == 8
    assert len(result.leaves.exemplars) == 1
    assert_transforms_hold(result, 1e-3)
    signs = np.sign(np.linalg.det(result.leaves.transforms[:, :, :3]))
    flat = np.isclose(leaf.points @ np.linalg.svd(leaf.points - leaf.points.mean(axis=0))[2][2], 0).all()
    if not flat and leaf.points.shape[0] > 4:
        np.testing.assert_array_equal(signs, [1, -1] * 4)


def test_other_uvs_or_another_material_make_another_shape():
    mesh = build(TRUNK, *(QUAD.at(1.5 * i, 15, scale=0.1) for i in range(4)))
    uvs = mesh.uvs.copy()
    uvs[-4:] += 0.5
    face_material = mesh.face_material.copy()
    face_material[-4:-2] = 1
    leafy = tuple(Material(name) for name in ("leaf a", "leaf b"))
    result = split(
        replace(mesh, uvs=uvs, face_material=face_material, materials=leafy), SplitSettings(foliage_nodes=("*",))
    )
    shapes = result.leaves.shape[-4:]
    assert shapes[0] == shapes[1]
    assert len(set(shapes)) == 3


def test_a_different_outline_is_its_own_shape():
    longer = replace(QUAD, points=QUAD.points * (1.1, 1, 1))
    result = split(build(TRUNK, *(QUAD.at(1.5 * i, 15, scale=0.1) for i in range(3)), longer.at(5, 15, scale=0.1)))
    assert sorted(np.bincount(result.leaves.shape)) == [1, 3]


def test_quantised_copies_still_share_one_shape():
    rng = np.random.default_rng(0)
    mesh = build(
        TRUNK, *(strip(2, 40).at(*rng.uniform(-9, 9, 3), turn=rng.uniform(0, 360, 3), scale=0.3) for _ in range(300))
    )
    step = np.float32(0.002)  # of leaves 0.3 wide, as 14 bits make it on a tree of 20
    result = split(replace(mesh, positions=np.rint(mesh.positions / step) * step))
    assert len(result.leaves.exemplars) <= 6
    assert_transforms_hold(result, 0.04)


# Trunk or foliage


def decisions(result):
    return {decision.group: decision.role for decision in result.decisions}


CUT_OUT = Texture("atlas", np.array([[(40, 120, 30, 255), (0, 0, 0, 0)]], np.uint8))


@pytest.mark.parametrize(
    ("bark", "leaf"),
    [
        (Material("Bark"), Material("Leaves")),
        (Material("a"), Material("b", color_map=CUT_OUT, alpha_mode=AlphaMode.MASK)),
        (Material("wood"), Material("Branches", color_map=CUT_OUT, alpha_mode=AlphaMode.MASK)),
        (Material("a", (0.2, 0.1, 0.05, 1)), Material("b", (0.1, 0.3, 0.05, 1))),
        (Material("a"), Material("b", double_sided=True)),
        (Material("a"), Material("b")),
    ],
    ids=["names", "alpha", "alpha against name", "colour", "sides", "geometry only"],
)
def test_materials_are_told_apart(bark, leaf):
    pieces = [TRUNK, *(QUAD.at(1.5 * i, 15, material=1) for i in range(20))]
    result = split(build(*pieces, materials=(bark, leaf)))
    assert decisions(result) == {f"material {bark.name}": "trunk", f"material {leaf.name}": "foliage"}
    assert result.leaves.count == 20
    assert all(decision.reason for decision in result.decisions)
    assert sum(decision.triangles for decision in result.decisions) == len(TRUNK.faces) + 40


def test_rgba_in_an_opaque_material_says_nothing():
    opaque = Material("b", color_map=CUT_OUT)
    result = split(build(TRUNK, tube().at(3, material=1), materials=(Material("a"), opaque)))
    assert not result.leaves.count


def test_a_second_material_that_is_both_is_split_by_geometry():
    pieces = [TRUNK, *(QUAD.at(1.5 * i, 15) for i in range(40)), QUAD.at(0, 18, material=1)]
    result = split(build(*pieces, materials=("atlas", "fruit leaf")))
    assert decisions(result) == {
        "material atlas, sheets": "foliage",
        "material atlas, solids": "trunk",
        "material fruit leaf": "foliage",
    }


def test_one_material_is_split_by_geometry():
    twigs = [tube(4, 3, 0.02, bow=0.5).at(i, 10, turn=(40, 50 * i, 0)) for i in range(10)]
    clumps = [crossed().at(i, 15, turn=(0, 77 * i, 10)) for i in range(10)]
    result = split(build(TRUNK, *twigs, *clumps))
    assert result.trunk.triangles == len(TRUNK.faces) + sum(len(twig.faces) for twig in twigs)
    assert result.leaves.count == 20
    assert decisions(result) == {"material all, sheets": "foliage", "material all, solids": "trunk"}


def test_the_user_overrides():
    pieces = [TRUNK, *(QUAD.at(1.5 * i, 15, material=1, node=1) for i in range(5)), tube().at(3, material=2, node=2)]
    mesh = build(*pieces, materials=("Bark", "Leaf", "Mystery"), nodes=("stem", "crown", "Berries_01"))
    assert decisions(split(mesh))["material Mystery"] == "trunk"
    result = split(mesh, SplitSettings(foliage_materials=("myst*",), trunk_materials=("leaf",)))
    assert decisions(result) == {"material Leaf": "trunk", "material Mystery": "foliage", "material Bark": "trunk"}
    result = split(mesh, SplitSettings(foliage_nodes=("berries_??",), trunk_materials=("*",)))
    assert decisions(result)["node Berries_01"] == "foliage"
    assert result.foliage.triangles == len(pieces[-1].faces)


def test_an_override_that_matches_nothing_names_what_there_is():
    with pytest.raises(SettingsError, match=r'foliage_materials = "leaves" matches nothing.*Bark, Leaf'):
        split(build(QUAD, materials=("Bark", "Leaf")), SplitSettings(foliage_materials=("leaves",)))
    with pytest.raises(SettingsError, match="bend"):
        split(build(QUAD), SplitSettings(bend=-1))


@pytest.mark.parametrize("materials", [("a",), ("bark", "wood")])
def test_all_trunk_warns(caplog, materials):
    result = split(build(TRUNK, tube().at(3, material=len(materials) - 1), materials=materials))
    assert (result.foliage.triangles, result.leaves.count) == (0, 0)
    assert result.leaves.transforms.shape == (0, 3, 4)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "foliage_materials" in caplog.text


@pytest.mark.parametrize("materials", [("a",), ("leaf", "flower")])
def test_all_foliage_is_fine(caplog, materials):
    result = split(build(QUAD, QUAD.at(3, material=len(materials) - 1), materials=materials))
    assert (result.trunk.triangles, result.leaves.count) == (0, 2)
    assert not caplog.records


def test_an_empty_mesh_is_an_empty_tree():
    result = split(build())
    assert (result.trunk.triangles, result.foliage.triangles, result.leaves.count) == (0, 0, 0)


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("Tree_Leaves", "foliage"),
        ("FernFrond", "foliage"),
        ("TreeCrown", "foliage"),
        ("old-stem", "trunk"),
        ("TreeRoot", "trunk"),
        ("ParticleSystem", None),
        ("catalogue", None),
        ("leaves on bark", None),
    ],
)
def test_names_that_speak_and_names_that_do_not(name, role):
    trunk_or_leaf = TRUNK if role == "foliage" else QUAD.at(0, 5)  # what the geometry alone would say is the opposite
    result = split(build(trunk_or_leaf, QUAD.at(9, material=1), materials=(name, "leaf")))
    expected = role or "foliage"
    assert decisions(result)[f"material {name}"] == expected


def test_zero_area_faces_do_no_harm():
    flat = Piece(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    result = split(build(TRUNK, QUAD.at(5, 15, material=1), flat.at(5, 15, material=1), materials=("bark", "leaf")))
    assert np.isfinite(result.leaves.centers).all()


def test_split_leaves_its_input_alone_and_repeats():
    mesh = build(TRUNK, *(QUAD.at(1.5 * i, 15) for i in range(5)))
    before = [getattr(mesh, name).copy() for name in ("positions", "faces", "face_material")]
    first, second = split(mesh), split(mesh)
    for old, name in zip(before, ("positions", "faces", "face_material"), strict=True):
        np.testing.assert_array_equal(old, getattr(mesh, name))
    np.testing.assert_array_equal(first.leaves.transforms, second.leaves.transforms)


# Whole trees


@pytest.mark.parametrize(("species", "leaves"), [("chestnut", 11_291), ("horse-chestnut", 9_366), ("maple", 3_662)])
def test_grown_trees_have_all_their_leaves_of_one_shape(species, leaves):
    mesh = grow(species)
    result = split(mesh)
    assert result.leaves.count == leaves
    assert len(result.leaves.exemplars) == 1
    nameless = replace(
        mesh,
        materials=(Material("tree"),),
        face_material=np.zeros_like(mesh.face_material),
        nodes=("n",) * len(mesh.nodes),
    )
    assert split(nameless).leaves.count == leaves


REAL = [
    ("ez_oak_large.glb", 5_280, 12_006),
    ("sapling_white_birch.glb", 9_459, 188_096),
    ("treegen_palm.glb", 3_600, 47_180),
    ("quaternius_tree_1/Tree_1.obj", 180, 444),
]


@pytest.mark.parametrize(("name", "leaves", "trunk"), REAL)
@pytest.mark.parametrize("nameless", [False, True])
def test_real_trees(name, leaves, trunk, nameless):
    mesh = read_mesh(tree(name))
    if nameless:
        erased = np.zeros_like(mesh.face_material)
        mesh = replace(mesh, face_material=erased, materials=(Material("tree"),), nodes=("node",) * len(mesh.nodes))
    result = split(mesh)
    assert result.trunk.triangles == trunk
    assert abs(result.leaves.count - leaves) <= leaves * (0.01 if "birch" in name else 0)


def test_the_quaternius_tree_with_its_textures():
    textures = {"Bark": "Tree_Bark.jpg", "Tree_Leaves": "Tree_Leaves.png"}
    result = split(read_mesh(tree("quaternius_tree_1/Tree_1.obj"), LoadSettings(textures=textures)))
    assert result.leaves.count == 180
    assert "transparent" in result.decisions[1].reason


def test_the_fern_has_no_trunk():
    result = split(read_mesh(tree("polyhaven_fern_02.glb")))
    assert result.trunk.triangles == 0
    assert 53 <= result.leaves.count <= 400  # 53 fronds, cut where they curve


def test_the_cypress_is_all_trunk(caplog):
    result = split(read_mesh(tree("cypress_tree.glb")))
    assert (result.trunk.triangles, result.leaves.count) == (248, 0)
    assert "all 248 triangles are trunk" in caplog.text


def test_the_birch_loads_and_splits_in_seconds():
    path = tree("sapling_white_birch.glb")
    begin = time.process_time()
    result = split(read_mesh(path))
    assert time.process_time() - begin < 5
    assert len(result.leaves.exemplars) < 100
    assert result.leaves.shape.max() < 100


def test_two_hundred_thousand_leaves_take_seconds():
    mesh = grow("oak", leaves=200_000)
    begin = time.process_time()
    result = split(mesh)
    assert time.process_time() - begin < 10
    assert (result.leaves.count, len(result.leaves.exemplars)) == (200_000, 1)
