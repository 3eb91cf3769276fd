import json
import struct
from dataclasses import fields, replace

import numpy as np
import pytest
from gltf_validate import assert_valid
from hypothesis import given
from hypothesis import strategies as st

from treebake import __version__
from treebake.errors import WorkspaceError
from treebake.formats.gltf_file import GltfFile
from treebake.glb import Instances, Node, encode_glb, write_glb
from treebake.images import decode_image
from treebake.meshes import read_mesh
from treebake.model import AlphaMode, Material, Mesh, Texture, Transmission

FORMATS = {5123: np.dtype("<u2"), 5125: np.dtype("<u4"), 5126: np.dtype("<f4")}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def parse(glb):
    """The JSON and the binary chunk of a GLB, by the letter of the specification."""
    magic, version, length = struct.unpack_from("<4sII", glb)
    assert (magic, version, length) == (b"glTF", 2, len(glb))
    size, kind = struct.unpack_from("<I4s", glb, 12)
    assert kind == b"JSON"
    assert size % 4 == 0
    document = json.loads(glb[20 : 20 + size])
    binary = b""
    if len(glb) > 20 + size:
        binary_size, kind = struct.unpack_from("<I4s", glb, 20 + size)
        assert kind == b"BIN\0"
        binary = glb[28 + size :]
        assert binary_size == len(binary) == document["buffers"][0]["byteLength"]
    return document, binary


def view_bytes(document, binary, index):
    view = document["bufferViews"][index]
    assert view["byteOffset"] % 4 == 0
    return binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]


def array(document, binary, index):
    accessor = document["accessors"][index]
    values = np.frombuffer(view_bytes(document, binary, accessor["bufferView"]), FORMATS[accessor["componentType"]])
    assert values.size == accessor["count"] * WIDTHS[accessor["type"]]
    return values.reshape(-1, WIDTHS[accessor["type"]]).squeeze()


def texture(name, alpha=255):
    pixels = np.random.default_rng(len(name)).integers(0, 256, (4, 8, 4), np.uint8)
    pixels[0, :, 3] = alpha
    pixels[1:, :, 3] = 255
    return Texture(name, pixels)


def quads(*materials):
    """One unit quad per material, each at its own height, with one unused vertex between them."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1], [9, 9, 9]], np.float32)
    n = len(materials)
    positions = np.concatenate([corners + np.float32([0, i, 0]) for i in range(n)] or [corners]).astype(np.float32)
    return Mesh(
        positions=positions,
        normals=np.tile(np.float32([0, 1, 0]), (len(positions), 1)),
        uvs=np.ascontiguousarray(positions[:, [0, 2]]),
        faces=np.concatenate(
            [np.int32([[0, 1, 2], [0, 2, 3]]) + 5 * i for i in range(n)] or [np.zeros((0, 3), np.int32)]
        ),
        face_material=np.repeat(np.arange(n, dtype=np.int32), 2),
        face_node=np.zeros(2 * n, np.int32),
        materials=materials,
        nodes=("quads",),
    )


LEAF = Material(
    "leaf",
    (1, 0.5, 1, 1),
    texture("leaf", alpha=0),
    texture("bumps"),
    alpha_mode=AlphaMode.MASK,
    alpha_cutoff=0.3,
    double_sided=True,
)
FULL = replace(
    LEAF,
    occlusion_map=texture("occlusion"),
    roughness_map=texture("roughness"),
    roughness=0.75,
    metallic=0.25,
    transmission=Transmission(0.5, (0.25, 1.0, 0.125)),
)


def test_every_primitive_keeps_its_own_geometry():
    mesh = quads(LEAF, Material("bark", color_map=texture("bark")), Material("plain"))
    document, binary = parse(encode_glb([("tree", mesh)]))
    assert document["nodes"] == [{"name": "tree", "mesh": 0}]
    primitives = document["meshes"][0]["primitives"]
    assert [document["materials"][p["material"]]["name"] for p in primitives] == ["leaf", "bark", "plain"]
    for i, primitive in enumerate(primitives):
        positions, normals = (array(document, binary, primitive["attributes"][k]) for k in ("POSITION", "NORMAL"))
        indices = array(document, binary, primitive["indices"]).reshape(-1, 3)
        faces = mesh.faces[mesh.face_material == i]
        np.testing.assert_array_equal(positions[indices], mesh.positions[faces])
        np.testing.assert_array_equal(normals[indices], mesh.normals[faces])
        assert len(positions) == 4  # the unused vertex is dropped
        accessor = document["accessors"][primitive["attributes"]["POSITION"]]
        assert (accessor["min"], accessor["max"]) == ([0, i, -1], [1, i, 0])
        if i < 2:
            uvs = array(document, binary, primitive["attributes"]["TEXCOORD_0"])
            np.testing.assert_array_equal(uvs[indices], mesh.uvs[faces])
    assert "TEXCOORD_0" not in primitives[2]["attributes"]


@pytest.mark.parametrize("mirrored", [False, True])
def test_tangents_follow_u_and_bitangents_point_up_the_image(mirrored):
    mesh = quads(LEAF)
    uvs = mesh.uvs * np.float32([-1, 1] if mirrored else [1, 1])
    document, binary = parse(encode_glb([("leaf", replace(mesh, uvs=uvs))]))
    tangents = array(document, binary, document["meshes"][0]["primitives"][0]["attributes"]["TANGENT"])
    np.testing.assert_allclose(tangents[:, :3], [[-1 if mirrored else 1, 0, 0]] * 4)
    bitangents = np.cross([0, 1, 0], tangents[:, :3]) * tangents[:, 3:]
    np.testing.assert_allclose(bitangents, [[0, 0, -1]] * 4)  # v grows with z, so up the image is -z


def test_tangents_without_a_direction_are_unit_and_at_right_angles():
    mesh = quads(LEAF)
    document, binary = parse(encode_glb([("leaf", replace(mesh, uvs=np.zeros_like(mesh.uvs)))]))
    tangents = array(document, binary, document["meshes"][0]["primitives"][0]["attributes"]["TANGENT"])
    np.testing.assert_allclose(np.linalg.norm(tangents[:, :3], axis=1), 1)
    np.testing.assert_allclose(tangents[:, 1], 0)


def test_material_fields_follow_the_specification():
    document, _ = parse(encode_glb([("a", quads(LEAF)), ("b", quads(Material("plain")))]))
    leaf, plain = document["materials"]
    assert leaf == {
        "name": "leaf",
        "pbrMetallicRoughness": {
            "metallicFactor": 0,
            "roughnessFactor": 1,
            "baseColorFactor": [1, 0.5, 1, 1],
            "baseColorTexture": {"index": 0},
        },
        "normalTexture": {"index": 1},
        "alphaMode": "MASK",
        "alphaCutoff": 0.3,
        "doubleSided": True,
    }
    assert plain == {"name": "plain", "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}
    assert document["samplers"] == [{"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}]
    assert document["asset"] == {"version": "2.0", "generator": f"treebake {__version__}"}


def test_light_that_comes_through_takes_its_colour_from_the_colour_map_itself():
    document, _ = parse(encode_glb([("leaf", quads(FULL))]))
    (leaf,) = document["materials"]
    assert document["extensionsUsed"] == ["KHR_materials_diffuse_transmission"]
    assert "extensionsRequired" not in document
    assert leaf["extensions"]["KHR_materials_diffuse_transmission"] == {
        "diffuseTransmissionFactor": 0.5,
        "diffuseTransmissionColorTexture": leaf["pbrMetallicRoughness"]["baseColorTexture"],
        "diffuseTransmissionColorFactor": [0.25, 1.0, 0.125],
    }
    assert len(document["images"]) == 4


def test_occlusion_has_texture_coordinates_of_its_own_only_where_the_mesh_has_them():
    near = quads(FULL, Material("bark"))
    far = replace(near, occlusion_uvs=near.uvs * 0.5)
    document, binary = parse(encode_glb([("near", near), ("far", far)]))
    sets = [[p["attributes"].get(f"TEXCOORD_{i}") for i in (0, 1)] for m in document["meshes"] for p in m["primitives"]]
    assert [[each is not None for each in pair] for pair in sets] == [
        [True, False],
        [False, False],
        [True, True],
        [False, False],
    ]
    np.testing.assert_array_equal(array(document, binary, sets[2][1]), far.occlusion_uvs[:4])
    infos = [document["materials"][m["primitives"][0]["material"]]["occlusionTexture"] for m in document["meshes"]]
    assert infos == [{"index": infos[0]["index"]}, {"index": infos[0]["index"], "texCoord": 1}]


def assert_same_material(found, written):
    for field in fields(Material):
        one, other = getattr(found, field.name), getattr(written, field.name)
        if isinstance(other, Texture):
            assert one.name == other.name
            np.testing.assert_array_equal(one.pixels, other.pixels)
        elif isinstance(other, Transmission):
            assert one.factor == other.factor
            np.testing.assert_allclose(one.color, other.color, rtol=1e-6)
        else:
            assert one == other, field.name


PARTS = st.floats(0, 1, allow_subnormal=False)


@st.composite
def materials(draw):
    maps = {name: texture(name) for name in ("normal_map", "occlusion_map", "roughness_map") if draw(st.booleans())}
    mode = draw(st.sampled_from(AlphaMode))
    color = texture("leaf", alpha=255 if mode is AlphaMode.OPAQUE else 0) if draw(st.booleans()) else None
    through = st.builds(Transmission, PARTS, st.tuples(PARTS, PARTS, PARTS))
    return Material(
        "drawn",
        draw(st.tuples(PARTS, PARTS, PARTS, PARTS)),
        color,
        **maps,
        roughness=draw(PARTS),
        metallic=draw(PARTS),
        transmission=draw(st.none() | through),
        alpha_mode=mode,
        alpha_cutoff=draw(PARTS) if mode is AlphaMode.MASK else 0.5,
        double_sided=draw(st.booleans()),
    )


@given(material=materials(), own=st.booleans())
def test_a_written_material_is_read_back(tmp_path_factory, material, own):
    path = tmp_path_factory.getbasetemp() / "material.glb"
    mesh = quads(material)
    written = replace(mesh, occlusion_uvs=mesh.uvs[:, ::-1] if own else None)
    write_glb(path, [("quad", written)])
    found = read_mesh(path)
    assert_same_material(*found.materials, material)
    assert (found.occlusion_uvs is not None) == (own and material.occlusion_map is not None)
    if found.occlusion_uvs is not None:
        np.testing.assert_array_equal(found.occlusion_uvs[found.faces], written.occlusion_uvs[written.faces])


def test_light_brighter_than_the_colour_map_comes_through_in_the_mean(tmp_path):
    bright = replace(FULL, transmission=Transmission(0.5, (1.5, 2.0, 0.5)))
    write_glb(tmp_path / "bright.glb", [("leaf", quads(bright))])
    assert_same_material(*read_mesh(tmp_path / "bright.glb").materials, bright)


def test_textures_are_shared_and_keep_alpha_only_where_it_is_read():
    shared = texture("shared", alpha=0)
    masked, opaque = (
        Material("masked", color_map=shared, alpha_mode=AlphaMode.MASK),
        Material("opaque", color_map=shared),
    )
    document, binary = parse(encode_glb([("a", quads(masked, opaque)), ("b", quads(masked))]))
    assert len(document["materials"]) == len(document["images"]) == len(document["textures"]) == 2
    with_alpha, without = (
        decode_image(view_bytes(document, binary, image["bufferView"]), image["name"]) for image in document["images"]
    )
    np.testing.assert_array_equal(with_alpha, shared.pixels)
    np.testing.assert_array_equal(without[..., :3], shared.pixels[..., :3])
    assert (without[..., 3] == 255).all()


@pytest.mark.parametrize(("vertices", "kind"), [(65535, 5123), (65536, 5125)])
def test_index_width_avoids_the_restart_value(vertices, kind):
    grid = np.arange(vertices, dtype=np.int32)
    mesh = replace(
        quads(Material("m")),
        positions=np.stack([grid, grid % 7, grid % 5], axis=1).astype(np.float32),
        normals=np.tile(np.float32([0, 1, 0]), (vertices, 1)),
        uvs=np.zeros((vertices, 2), np.float32),
        faces=np.stack([grid, np.roll(grid, 1), np.roll(grid, 2)], axis=1),
        face_material=np.zeros(vertices, np.int32),
    )
    document, _ = parse(encode_glb([("m", mesh)]))
    assert document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]["componentType"] == kind


def test_empty_meshes_are_left_out():
    document, binary = parse(encode_glb([("nothing", quads()), ("quad", quads(LEAF))]))
    assert [node["name"] for node in document["nodes"]] == ["quad"]
    document, binary = parse(encode_glb([("nothing", quads())]))
    assert "nodes" not in document
    assert not binary


def table(kind, width, rows=5):
    """Random bits, NaNs among them, one row an odd number of bytes where the kind is."""
    bits = np.random.default_rng(width).integers(0, 256, rows * width * np.dtype(kind).itemsize, np.uint8)
    return bits.view(kind).reshape(rows, width)


def numbers(kind, width):
    """As `table`, but numbers only: the validator looks at the values."""
    return np.arange(5 * width, dtype=kind).reshape(5, width)


@pytest.mark.parametrize("width", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32, np.float32])
def test_tables_in_extras_come_back_to_the_bit(tmp_path, kind, width):
    tables = {"first": table(kind, width), "second": table(kind, width, rows=3)}
    write_glb(tmp_path / "tables.glb", [], tables)
    file = GltfFile(tmp_path / "tables.glb")
    for name, values in tables.items():
        found = file.accessor(file.json["extras"][name])
        assert (found.dtype, found.shape) == (values.dtype, values.shape)
        assert found.tobytes() == values.tobytes()


def test_a_view_of_a_table_is_stored_right(tmp_path):
    values = table(np.uint32, 4)[::-2, 1:3]
    write_glb(tmp_path / "view.glb", [], {"rows": values})
    file = GltfFile(tmp_path / "view.glb")
    np.testing.assert_array_equal(file.accessor(file.json["extras"]["rows"]), values)


@pytest.mark.parametrize("alpha", [0, 255])
def test_textures_in_extras_come_back_to_the_bit(tmp_path, alpha):
    image = texture("image", alpha=alpha)
    write_glb(tmp_path / "image.glb", [], {"image": image})
    file = GltfFile(tmp_path / "image.glb")
    found = file.texture(file.json["extras"]["image"])
    assert found.name == "image"
    np.testing.assert_array_equal(found.pixels, image.pixels)


def test_a_texture_that_a_material_uses_is_stored_once():
    shared = LEAF.color_map
    document, _ = parse(encode_glb([("leaf", quads(LEAF))], {"again": shared}))
    assert document["extras"]["again"] == document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"]
    assert len(document["images"]) == 2


def test_extras_are_nested_and_keep_what_is_plain(tmp_path):
    plain = {"format": 1, "name": "Ä", "list": [1, 2.5, None], "none": None, "empty": {}}
    write_glb(tmp_path / "nested.glb", [("leaf", quads(LEAF))], {"a": {"b": table(np.uint16, 2), **plain}, "c": plain})
    file = GltfFile(tmp_path / "nested.glb")
    stored = file.json["extras"]
    assert stored["c"] == plain
    np.testing.assert_array_equal(file.accessor(stored["a"].pop("b")), table(np.uint16, 2))
    assert stored["a"] == plain


def test_tables_leave_the_meshes_as_they_were():
    without, binary = parse(encode_glb([("leaf", quads(LEAF))]))
    document, longer = parse(encode_glb([("leaf", quads(LEAF))], {"rows": table(np.uint8, 3)}))
    assert longer[: len(binary)] == binary
    assert document["meshes"] == without["meshes"]
    assert document["accessors"][: len(without["accessors"])] == without["accessors"]
    assert "target" not in document["bufferViews"][-1]  # neither vertices nor indices


def placed(n):
    """n instances: a row along x, each turned by a half about +Y and twice as high."""
    return Instances(
        np.float32([[3 * i, 0, 0] for i in range(n)]).reshape(n, 3),
        np.tile(np.float32([0, 1, 0, 0]), (n, 1)),
        np.tile(np.float32([1, 2, 1]), (n, 1)),
    )


def test_levels_go_from_near_to_far_and_only_the_nearest_is_in_the_scene():
    near, middle, far = (quads(LEAF) for _ in range(3))
    nodes = [Node("oak", near, (middle, far), (0.5, 0.25, 0)), ("stone", quads(Material("stone")))]
    document, _ = parse(encode_glb(nodes))
    oak, *coarser, _ = document["nodes"]
    assert [node["name"] for node in document["nodes"]] == ["oak", "oak_LOD1", "oak_LOD2", "stone"]
    assert document["scenes"] == [{"nodes": [0, 3]}]
    assert (oak["extensions"], oak["extras"]) == (
        {"MSFT_lod": {"ids": [1, 2]}},
        {"MSFT_screencoverage": [0.5, 0.25, 0]},
    )
    assert coarser == [{"name": "oak_LOD1", "mesh": 1}, {"name": "oak_LOD2", "mesh": 2}]
    assert document["extensionsUsed"] == ["MSFT_lod"]
    assert "extensionsRequired" not in document


def test_an_empty_level_draws_nothing():
    document, _ = parse(encode_glb([Node("oak", quads(LEAF), (quads(),), (0.5, 0)), Node("no", quads(), (quads(),))]))
    assert [node.get("mesh") for node in document["nodes"]] == [0, None]
    assert document["scenes"] == [{"nodes": [0]}]


def test_instances_are_the_same_for_all_levels_and_meshes_are_written_once():
    near, far, many = quads(LEAF), quads(LEAF), placed(3)
    document, binary = parse(encode_glb([Node(name, near, (far,), (0.5, 0), many) for name in ("a", "b")]))
    assert len(document["meshes"]) == 2
    assert [node["mesh"] for node in document["nodes"]] == [0, 1, 0, 1]
    (attributes,) = {
        tuple(node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"].items()) for node in document["nodes"]
    }
    for name, index in attributes:
        values = {"TRANSLATION": many.translations, "ROTATION": many.rotations, "SCALE": many.scales}[name]
        np.testing.assert_array_equal(array(document, binary, index), values)
    assert document["extensionsUsed"] == ["EXT_mesh_gpu_instancing", "MSFT_lod"]
    assert document["extensionsRequired"] == ["EXT_mesh_gpu_instancing"]


def test_a_node_without_instances_is_left_out():
    document, _ = parse(encode_glb([Node("none", quads(LEAF), instances=placed(0)), ("one", quads(LEAF))]))
    assert [node["name"] for node in document["nodes"]] == ["one"]
    assert "extensionsUsed" not in document


def test_instances_are_read_where_they_were_written(tmp_path):
    write_glb(tmp_path / "row.glb", [Node("row", quads(Material("m")), instances=placed(2))])
    found = read_mesh(tmp_path / "row.glb")
    np.testing.assert_allclose(found.bounds, [[-1, 0, 0], [3, 0, 1]], atol=1e-6)
    assert found.triangles == 4


def test_equal_images_are_stored_once():
    again = replace(LEAF, color_map=Texture("leaf", LEAF.color_map.pixels.copy()))
    other = replace(LEAF, color_map=Texture("leaf", LEAF.color_map.pixels[::-1].copy()))
    for material, images in ((again, 2), (other, 3)):
        document, _ = parse(encode_glb([("a", quads(LEAF)), ("b", quads(material))]))
        assert len(document["images"]) == len(document["textures"]) == images
        assert len(document["materials"]) == 2


def test_same_input_gives_the_same_bytes():
    assert encode_glb([("a", quads(LEAF))], {"b": 1}) == encode_glb([("a", quads(LEAF))], {"b": 1})
    one, other = (encode_glb([], {"b": table(np.float32, 4), "c": texture("c")}) for _ in range(2))
    assert one == other


def test_validator_finds_nothing(tmp_path):
    write_glb(tmp_path / "full.glb", [("tree", quads(LEAF, Material("bark")))], {"treebake": {"name": "Ä"}})
    bare = replace(FULL, color_map=None, normal_map=None, roughness_map=None)
    lit = quads(FULL, bare, replace(FULL, transmission=Transmission(1.0, (3.0, 1.0, 1.0))))
    write_glb(tmp_path / "lit.glb", [("one", lit), ("other", replace(lit, occlusion_uvs=lit.uvs * 0.5))])
    write_glb(tmp_path / "empty.glb", [])
    # Of any width: a row of three bytes is an odd accessor, but nothing draws it.
    kinds = (np.uint8, np.uint16, np.uint32, np.float32)
    tables = {f"{kind.__name__} {width}": numbers(kind, width) for kind in kinds for width in (1, 2, 3, 4)}
    extras = {"treebake": {"tables": tables, "image": texture("image", alpha=0)}}
    write_glb(tmp_path / "tables.glb", [("leaf", quads(LEAF))], extras)
    write_glb(tmp_path / "alone.glb", [], extras)
    levels = quads(LEAF), (quads(LEAF), quads()), (0.5, 0.25, 0)
    write_glb(tmp_path / "levels.glb", [Node("one", *levels), Node("many", *levels, placed(3))])
    assert_valid(*(tmp_path / f"{name}.glb" for name in ("full", "lit", "empty", "tables", "alone", "levels")))


def test_writing_replaces_whole_or_not_at_all(tmp_path):
    path = tmp_path / "tree.glb"
    write_glb(path, [])
    before = path.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        write_glb(path, [("quad", quads(LEAF))], {"not a number": float("nan")})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["tree.glb"]
    with pytest.raises(WorkspaceError, match=r"tree\.glb/inside\.glb cannot be written"):
        write_glb(tmp_path / "tree.glb/inside.glb", [])


def test_a_failed_rename_leaves_no_temporary_file(tmp_path):
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(WorkspaceError):
        write_glb(tmp_path / "folder.glb", [])
    assert [p.name for p in tmp_path.iterdir()] == ["folder.glb"]
