"""Mesh files in: every file here is written by its test, except for the real trees."""

import base64
import json
import logging
import struct
import zlib

import DracoPy
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from trees import tree

from treebake.errors import InputError, MeshError, SettingsError, TreebakeError, UnsupportedError
from treebake.images import encode_png
from treebake.meshes import LoadSettings, read_mesh
from treebake.model import AlphaMode

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
UP = np.tile(np.float32([0, 0, 1]), (3, 1))
UVS = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
RED = np.full((2, 2, 4), (255, 0, 0, 255), np.uint8)
HOLED = np.array([[(0, 255, 0, 255), (0, 255, 0, 0)]] * 2, np.uint8)
KINDS = {"f4": 5126, "i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125}


class Gltf:
    """Builds a glTF document in memory."""

    def __init__(self, **document):
        self.binary = b""
        self.json = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": [], "meshes": [], **document}

    def view(self, data, **extra):
        self.binary += b"\0" * (-len(self.binary) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **extra})
        self.binary += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, array, **extra):
        array = np.atleast_1d(array)
        kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
        spec = {"componentType": KINDS[array.dtype.str[1:]], "count": len(array), "type": kind}
        self.json["accessors"].append({"bufferView": self.view(array.tobytes()), **spec, **extra})
        return len(self.json["accessors"]) - 1

    def mesh(self, positions=TRIANGLE, indices=None, material=None, mode=None, extensions=None, **attributes):
        arrays = {"POSITION": positions, **attributes}
        accessors = {name: v if isinstance(v, int) else self.accessor(v) for name, v in arrays.items()}
        if indices is not None:
            indices = self.accessor(np.asarray(indices, np.uint16).reshape(-1))
        optional = {"indices": indices, "material": material, "mode": mode, "extensions": extensions}
        primitive = {"attributes": accessors, **{key: v for key, v in optional.items() if v is not None}}
        self.json["meshes"].append({"primitives": [primitive]})
        self.json.setdefault("nodes", [{"mesh": 0, "name": "tree"}])
        return self

    def image(self, pixels, **extra):
        self.json.setdefault("images", []).append({"bufferView": self.view(encode_png(pixels)), **extra})
        self.json.setdefault("textures", []).append({"source": len(self.json["images"]) - 1})
        return len(self.json["textures"]) - 1

    def bytes(self):
        self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + b"\0" * (-len(self.binary) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def read(self, folder, load=LoadSettings()):  # noqa: B008
        path = folder / "tree.glb"
        path.write_bytes(self.bytes())
        return read_mesh(path, load)


def corners(mesh):
    return mesh.positions[mesh.faces]


def geometric_normals(mesh):
    a, b, c = np.swapaxes(corners(mesh), 0, 1)
    crosses = np.cross(b - a, c - a)
    return crosses / np.linalg.norm(crosses, axis=1, keepdims=True)


# glTF: nodes


def test_node_transforms_apply_from_parent_to_child(tmp_path):
    half = np.sqrt(0.5)
    nodes = [
        {"name": "leaves", "mesh": 0, "translation": [0, 0, 5]},
        {"name": "root", "children": [0], "rotation": [0, half, 0, half], "scale": [2, 2, 2]},
    ]
    mesh = Gltf(nodes=nodes, scenes=[{"nodes": [1]}]).mesh(NORMAL=UP).read(tmp_path)
    np.testing.assert_allclose(corners(mesh)[0], [[10, 0, 0], [10, 0, -2], [10, 2, 0]], atol=1e-6)
    np.testing.assert_allclose(mesh.normals, [[1, 0, 0]] * 3, atol=1e-6)
    assert mesh.nodes == ("leaves",)


def test_a_matrix_node_is_column_major(tmp_path):
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]
    mesh = Gltf(nodes=[{"mesh": 0, "matrix": matrix}]).mesh().read(tmp_path)
    np.testing.assert_allclose(corners(mesh)[0, 0], [7, 8, 9])


def test_a_mirroring_node_keeps_faces_counter_clockwise(tmp_path):
    mesh = Gltf(nodes=[{"mesh": 0, "scale": [-2, 1, 1]}]).mesh(NORMAL=UP).read(tmp_path)
    np.testing.assert_allclose(geometric_normals(mesh), [[0, 0, 1]])
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 3)


def test_normals_under_uneven_scale_stay_perpendicular(tmp_path):
    slope = np.array([[0, 0, 0], [1, 0, 1], [0, 1, 0]], np.float32)
    normal = np.tile(np.float32([-1, 0, 1]) / np.sqrt(2), (3, 1)).astype(np.float32)
    mesh = Gltf(nodes=[{"mesh": 0, "scale": [3, 1, 0.5]}]).mesh(slope, NORMAL=normal).read(tmp_path)
    np.testing.assert_allclose(mesh.normals, np.repeat(geometric_normals(mesh), 3, axis=0), atol=1e-6)


def test_only_the_default_scene_is_read(tmp_path):
    nodes = [{"mesh": 0, "name": "lod0"}, {"mesh": 0, "name": "lod1"}]
    mesh = Gltf(nodes=nodes, scenes=[{"nodes": [0]}, {"nodes": [1]}], scene=1).mesh().read(tmp_path)
    assert mesh.nodes == ("lod1",)


def test_gpu_instances_are_placed(tmp_path):
    gltf = Gltf().mesh()
    places = np.array([[0, 0, 0], [5, 0, 0], [0, 0, 9]], np.float32)
    scales = np.array([[1, 1, 1], [2, 2, 2], [-1, 1, 1]], np.float32)
    attributes = {"TRANSLATION": gltf.accessor(places), "SCALE": gltf.accessor(scales)}
    gltf.json["nodes"] = [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}]
    mesh = gltf.read(tmp_path)
    np.testing.assert_allclose(corners(mesh)[1], TRIANGLE * 2 + places[1])
    np.testing.assert_allclose(geometric_normals(mesh), [[0, 0, 1]] * 3)


# glTF: geometry


@pytest.mark.parametrize(
    ("mode", "indices", "expected"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3], [[0, 1, 2], [2, 1, 3]]),
        (6, [0, 1, 3, 2], [[0, 1, 3], [0, 3, 2]]),
    ],
)
def test_lists_strips_and_fans(tmp_path, mode, indices, expected):
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    mesh = Gltf().mesh(points, indices, mode=mode).read(tmp_path)
    np.testing.assert_allclose(corners(mesh), points[expected])
    np.testing.assert_allclose(geometric_normals(mesh), [[0, 0, 1]] * 2)


def test_lines_are_left_out(tmp_path):
    gltf = Gltf().mesh(indices=[0, 1], mode=1).mesh()
    gltf.json["nodes"] = [{"mesh": 0}, {"mesh": 1}]
    assert gltf.read(tmp_path).triangles == 1


def test_a_sparse_accessor_replaces_some_vertices(tmp_path):
    gltf = Gltf()
    moved = {
        "count": 1,
        "indices": {"bufferView": gltf.view(np.uint16([1]).tobytes()), "componentType": 5123},
        "values": {"bufferView": gltf.view(np.float32([[4, 0, 0]]).tobytes())},
    }
    mesh = gltf.mesh(gltf.accessor(TRIANGLE, sparse=moved)).read(tmp_path)
    np.testing.assert_allclose(corners(mesh)[0], [[0, 0, 0], [4, 0, 0], [0, 1, 0]])


def test_quantised_attributes_are_scaled_by_type_and_node(tmp_path):
    gltf = Gltf(extensionsRequired=["KHR_mesh_quantization"], nodes=[{"mesh": 0, "scale": [1e-3] * 3}])
    padded = np.zeros((3, 4), np.int16)  # vertices must start on 4 bytes, so the rows are wider than the type
    padded[:, :3] = TRIANGLE * 2000
    view = gltf.view(padded.tobytes(), byteStride=8)
    gltf.json["accessors"].append({"bufferView": view, "componentType": 5122, "count": 3, "type": "VEC3"})
    normals = gltf.accessor((UP * 127).astype(np.int8), normalized=True)
    uvs = gltf.accessor((UVS * 65535).astype(np.uint16), normalized=True)
    mesh = gltf.mesh(0, NORMAL=normals, TEXCOORD_0=uvs).read(tmp_path)
    np.testing.assert_allclose(corners(mesh)[0], TRIANGLE * 2)
    np.testing.assert_allclose(mesh.normals, UP)
    np.testing.assert_allclose(mesh.uvs, UVS)


def test_draco_is_decoded(tmp_path):
    data = DracoPy.encode(TRIANGLE, np.uint32([[0, 1, 2]]), quantization_bits=16, tex_coord=UVS.astype(np.float64))
    ids = {found["attribute_type"]: found["unique_id"] for found in DracoPy.decode(data).attributes}
    name = "KHR_draco_mesh_compression"
    gltf = Gltf(extensionsRequired=[name])
    gltf.json["accessors"] = [{"componentType": 5126, "count": 3, "type": kind} for kind in ("VEC3", "VEC2")]
    draco = {"bufferView": gltf.view(data), "attributes": {"POSITION": ids[0], "TEXCOORD_0": ids[3]}}
    mesh = gltf.mesh(0, TEXCOORD_0=1, extensions={name: draco}).read(tmp_path)
    order = [int(np.abs(corners(mesh)[0] - corner).sum(axis=1).argmin()) for corner in TRIANGLE]
    np.testing.assert_allclose(corners(mesh)[0][order], TRIANGLE, atol=1e-4)
    np.testing.assert_allclose(mesh.uvs[mesh.faces[0]][order], UVS, atol=1e-3)


# glTF: materials


def test_a_material_keeps_what_treebake_draws(tmp_path):
    gltf = Gltf()
    color, normal = gltf.image(HOLED, name="leaf_color"), gltf.image(RED, name="leaf_normal")
    pbr = {"baseColorFactor": [0.123456, 0.5, 1, 0.25], "baseColorTexture": {"index": color}}
    look = {"alphaMode": "MASK", "alphaCutoff": 0.3, "doubleSided": True, "normalTexture": {"index": normal}}
    gltf.json["materials"] = [{"name": "leaf", "pbrMetallicRoughness": pbr, **look}]
    (material,) = gltf.mesh(material=0, TEXCOORD_0=UVS).read(tmp_path).materials
    assert material.base_color == (0.123456, 0.5, 1, 0.25)
    assert (material.alpha_mode, material.alpha_cutoff, material.double_sided) == (AlphaMode.MASK, 0.3, True)
    assert (material.color_map.name, material.normal_map.name) == ("leaf_color", "leaf_normal")
    np.testing.assert_array_equal(material.color_map.pixels, HOLED)


def test_materials_stay_apart_by_index_and_share_textures(tmp_path):
    gltf = Gltf()
    spec = {"pbrMetallicRoughness": {"baseColorTexture": {"index": gltf.image(RED)}}}
    gltf.json["materials"] = [{"name": "same", **spec}, {"name": "same", **spec}]
    gltf.mesh(material=0, TEXCOORD_0=UVS).mesh(TRIANGLE + 1, material=1, TEXCOORD_0=UVS)
    gltf.json["nodes"] = [{"mesh": 0}, {"mesh": 1}]
    first, second = gltf.read(tmp_path).materials
    assert first is not second
    assert first.color_map is second.color_map


def test_a_texture_transform_is_baked_into_the_uvs(tmp_path):
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 10], "texCoord": 1}
    info = {"index": 0, "texCoord": 0, "extensions": {"KHR_texture_transform": transform}}
    gltf = Gltf(materials=[{"pbrMetallicRoughness": {"baseColorTexture": info}, "normalTexture": info}])
    gltf.image(RED)
    mesh = gltf.mesh(material=0, TEXCOORD_0=UVS * 0, TEXCOORD_1=UVS).read(tmp_path)
    np.testing.assert_allclose(mesh.uvs, [[0.5, 0.25], [0.5, -1.75], [10.5, 0.25]], atol=1e-6)
    assert mesh.materials[0].normal_map is mesh.materials[0].color_map


def test_a_normal_map_with_uvs_of_its_own_is_dropped_with_a_warning(tmp_path, caplog):
    materials = [
        {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": {"index": 0, "texCoord": 1}}
    ]
    gltf = Gltf(materials=materials)
    gltf.image(RED)
    mesh = gltf.mesh(material=0, TEXCOORD_0=UVS, TEXCOORD_1=UVS).read(tmp_path)
    assert mesh.materials[0].normal_map is None
    assert "normal map" in caplog.text


def test_occlusion_and_normals_are_read_as_strong_as_they_are(tmp_path):
    normal = np.full((2, 2, 4), (255, 128, 128, 255), np.uint8)  # almost flat along +X
    gltf = Gltf()
    infos = {
        "occlusionTexture": {"index": gltf.image(RED // 2), "strength": 0.5},
        "normalTexture": {"index": gltf.image(normal), "scale": 0.0},
    }
    gltf.json["materials"] = [infos]
    (material,) = gltf.mesh(material=0, TEXCOORD_0=UVS).read(tmp_path).materials
    assert material.occlusion_map.pixels[0, 0, 0] == round(255 * (1 + 0.5 * (127 / 255 - 1)))
    np.testing.assert_array_equal(material.normal_map.pixels[0, 0], [128, 128, 255, 255])


def test_an_occlusion_map_keeps_its_own_place(tmp_path):
    transform = {"KHR_texture_transform": {"scale": [0.5, 0.25]}}
    gltf = Gltf()
    base = {"baseColorTexture": {"index": gltf.image(RED)}}
    gltf.json["materials"] = [
        {"pbrMetallicRoughness": base, "occlusionTexture": {"index": 0, "texCoord": 1, "extensions": transform}},
        {"pbrMetallicRoughness": base, "occlusionTexture": {"index": 0}},
        {"pbrMetallicRoughness": base, "occlusionTexture": {"index": 0, "texCoord": 1}},
    ]
    gltf.mesh(material=0, TEXCOORD_0=UVS, TEXCOORD_1=UVS + 1).mesh(TRIANGLE + 1, material=1, TEXCOORD_0=UVS)
    gltf.mesh(TRIANGLE + 2, material=2, TEXCOORD_0=UVS)  # its second set is missing
    gltf.json["nodes"] = [{"mesh": i} for i in range(3)]
    mesh = gltf.read(tmp_path)
    own = mesh.occlusion_uvs[mesh.faces[np.argsort(mesh.face_node)]]
    np.testing.assert_allclose(own, [(UVS + 1) * (0.5, 0.25), UVS, UVS])
    np.testing.assert_allclose(mesh.uvs[mesh.faces], [UVS] * 3)
    alone = Gltf(materials=gltf.json["materials"][1:2])
    alone.image(RED)
    assert alone.mesh(material=0, TEXCOORD_0=UVS).read(tmp_path).occlusion_uvs is None


def test_metal_and_roughness_are_read_by_the_colours_uvs_only(tmp_path, caplog):
    gltf = Gltf()
    color, rough = gltf.image(RED), gltf.image(HOLED)
    pbr = {"baseColorTexture": {"index": color}, "metallicRoughnessTexture": {"index": rough}}
    gltf.json["materials"] = [{"pbrMetallicRoughness": {**pbr, "roughnessFactor": 0.5}}]
    (material,) = gltf.mesh(material=0, TEXCOORD_0=UVS).read(tmp_path).materials
    assert (material.roughness, material.metallic) == (0.5, 1.0)  # glTF's own default is metal
    np.testing.assert_array_equal(material.roughness_map.pixels, HOLED)
    pbr["metallicRoughnessTexture"]["texCoord"] = 1
    gltf.json["materials"] = [{"pbrMetallicRoughness": pbr}]
    assert gltf.read(tmp_path).materials[0].roughness_map is None
    assert "roughness map" in caplog.text


TRANSMISSION = "KHR_materials_diffuse_transmission"


def transmission(folder, base, **through):
    """What is read of a material whose texture 0 is leaf green with a hole, and texture 1 half red and half clear."""
    gltf = Gltf()
    green, clear = (0, 188, 0), (188, 0, 0)  # linear 0.5
    gltf.image(np.array([[(*green, 255), (255, 255, 255, 0)]], np.uint8))
    gltf.image(np.array([[(*clear, 51), (0, 0, 0, 255)]], np.uint8))
    look = {"pbrMetallicRoughness": base, "alphaMode": "MASK", "extensions": {TRANSMISSION: through}}
    gltf.json["materials"] = [look]
    return gltf.mesh(material=0, TEXCOORD_0=UVS).read(folder).materials[0].transmission


@pytest.mark.parametrize(
    ("base", "through", "factor", "color"),
    [
        ({}, {}, 0.0, (1, 1, 1)),
        (
            {},
            {"diffuseTransmissionFactor": 0.5, "diffuseTransmissionColorFactor": [0.1, 0.2, 0.3]},
            0.5,
            (0.1, 0.2, 0.3),
        ),
        (
            {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.1, 0.1, 0.1, 1]},
            {"diffuseTransmissionColorTexture": {"index": 0}, "diffuseTransmissionColorFactor": [0.5, 0.5, 0.5]},
            0.0,
            (0.5, 0.5, 0.5),
        ),
        (  # the mean of what comes through is the source's: 0.25 green
            {"baseColorTexture": {"index": 0}},
            {"diffuseTransmissionColorFactor": [0.0, 0.25, 0.0]},
            0.0,
            (0, 0.5, 0),
        ),
        (  # where the leaf is opaque alone: 0.25 red of a map without red
            {"baseColorTexture": {"index": 0}},
            {"diffuseTransmissionColorTexture": {"index": 1}, "diffuseTransmissionColorFactor": [0.0005, 1, 1]},
            0.0,
            (0.25, 0, 0),
        ),
        (
            {"baseColorTexture": {"index": 0}},
            {
                "diffuseTransmissionFactor": 0.5,
                "diffuseTransmissionTexture": {"index": 1},
                "diffuseTransmissionColorTexture": {"index": 0},
            },
            0.1,
            (1, 1, 1),
        ),
    ],
    ids=["nothing", "plain", "its own map", "a factor", "another map", "a part of it"],
)
def test_diffuse_transmission_is_read_as_a_factor_on_the_colour_map(tmp_path, base, through, factor, color):
    found = transmission(tmp_path, base, **through)
    assert found.factor == pytest.approx(factor, abs=1e-6)
    np.testing.assert_allclose(found.color, color, rtol=0.01, atol=1e-9)


def test_a_material_that_says_nothing_of_transmission_has_none(tmp_path):
    assert Gltf(materials=[{}]).mesh(material=0).read(tmp_path).materials[0].transmission is None


def test_specular_glossiness_colours_are_read(tmp_path):
    glossy = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 1]}}
    gltf = Gltf(materials=[{"extensions": glossy}], extensionsRequired=list(glossy))
    assert gltf.mesh(material=0).read(tmp_path).materials[0].base_color == (0.1, 0.2, 0.3, 1)


def test_a_palette_png_has_its_colours_and_alpha(tmp_path):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", 2, 1, 8, 3, 0, 0, 0))
    png += chunk(b"PLTE", bytes([10, 20, 30, 40, 50, 60])) + chunk(b"tRNS", bytes([255, 0]))
    png += chunk(b"IDAT", zlib.compress(bytes([0, 0, 1]))) + chunk(b"IEND", b"")
    info = {"baseColorTexture": {"index": 0}}
    gltf = Gltf(materials=[{"alphaMode": "MASK", "pbrMetallicRoughness": info}], textures=[{"source": 0}])
    gltf.json["images"] = [{"bufferView": gltf.view(png)}]
    mesh = gltf.mesh(material=0, TEXCOORD_0=UVS).read(tmp_path)
    np.testing.assert_array_equal(mesh.materials[0].color_map.pixels, [[[10, 20, 30, 255], [40, 50, 60, 0]]])


@pytest.mark.parametrize("image", [{"uri": "gone.png"}, {"uri": "data:image/png;base64,AAAA"}])
def test_a_missing_or_damaged_texture_is_one_warning(tmp_path, caplog, image):
    info = {"baseColorTexture": {"index": 0}}
    materials = [{"pbrMetallicRoughness": info}, {"pbrMetallicRoughness": info}]
    gltf = Gltf(materials=materials, textures=[{"source": 0}], images=[image])
    gltf.mesh(material=0, TEXCOORD_0=UVS).mesh(TRIANGLE + 1, material=1, TEXCOORD_0=UVS)
    gltf.json["nodes"] = [{"mesh": 0}, {"mesh": 1}]
    mesh = gltf.read(tmp_path)
    assert [material.color_map for material in mesh.materials] == [None, None]
    assert len(caplog.records) == 1
    assert caplog.records[0].levelno == logging.WARNING


@pytest.mark.parametrize(("value", "warned"), [(255, False), (128, True)])
def test_vertex_colours_are_left_out_with_a_warning(tmp_path, caplog, value, warned):
    gltf = Gltf()
    colors = gltf.accessor(np.full((3, 4), value, np.uint8), normalized=True)
    gltf.mesh(COLOR_0=colors).read(tmp_path)
    assert ("vertex colours are not read" in caplog.text) == warned


# glTF: files beside it


def test_external_and_embedded_files(tmp_path):
    gltf = Gltf(materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}])
    gltf.mesh(material=0, TEXCOORD_0=UVS)
    (tmp_path / "my buffer.bin").write_bytes(gltf.binary)
    (tmp_path / "textures").mkdir()
    (tmp_path / "textures" / "leaf 1.png").write_bytes(encode_png(RED))
    gltf.json |= {"textures": [{"source": 0}], "images": [{"uri": "textures/leaf%201.png"}]}
    path = tmp_path / "tree.gltf"
    data = "data:application/octet-stream;base64," + base64.b64encode(gltf.binary).decode()
    for uri in ("my%20buffer.bin", data):
        gltf.json["buffers"] = [{"uri": uri, "byteLength": len(gltf.binary)}]
        path.write_text(json.dumps(gltf.json))
        mesh = read_mesh(path)
        np.testing.assert_allclose(corners(mesh)[0], TRIANGLE)
        assert mesh.materials[0].color_map.name == "leaf 1"


@pytest.mark.parametrize(
    "uri",
    ["../secret.bin", "a/../../secret.bin", "%2e%2e/secret.bin", "..\\secret.bin", "/secret.bin", "file:///secret.bin"],
)
@pytest.mark.parametrize("kind", ["buffers", "images"])
def test_a_uri_that_leaves_the_folder_is_refused(tmp_path, uri, kind):
    (tmp_path / "secret.bin").write_bytes(bytes(100))
    folder = tmp_path / "tree"
    folder.mkdir()
    gltf = Gltf(materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}], textures=[{"source": 0}])
    gltf.mesh(material=0, TEXCOORD_0=UVS)
    (folder / "good.bin").write_bytes(gltf.binary)
    gltf.json |= {"buffers": [{"uri": "good.bin", "byteLength": len(gltf.binary)}], "images": [{"uri": "good.png"}]}
    gltf.json[kind][0]["uri"] = uri
    path = folder / "tree.gltf"
    path.write_text(json.dumps(gltf.json))
    with pytest.raises(InputError, match="outside its own folder"):
        read_mesh(path)


def test_a_missing_buffer_is_named(tmp_path):
    gltf = Gltf().mesh()
    gltf.json["buffers"] = [{"uri": "gone.bin", "byteLength": len(gltf.binary)}]
    path = tmp_path / "tree.gltf"
    path.write_text(json.dumps(gltf.json))
    with pytest.raises(InputError, match=r"gone\.bin"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("name", "remedy"), [("EXT_meshopt_compression", "gltf-transform copy"), ("ACME_leaf", "export it without")]
)
def test_an_unread_required_extension_is_refused_by_name(tmp_path, name, remedy):
    with pytest.raises(UnsupportedError, match=f"{name}.*{remedy}"):
        Gltf(extensionsRequired=[name]).mesh().read(tmp_path)


# OBJ

QUAD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def read_obj(folder, text, mtl=None, load=LoadSettings()):  # noqa: B008
    (folder / "tree.obj").write_text(text)
    if mtl is not None:
        (folder / "tree.mtl").write_text(mtl)
    return read_mesh(folder / "tree.obj", load)


def test_obj_polygons_become_triangles_in_order(tmp_path):
    mesh = read_obj(tmp_path, QUAD + "v -0.5 0.5 0\nf 1 2 3 4 5\nf 1 2 3 4\nf 1 2 3\n")
    assert mesh.triangles == 3 + 2 + 1
    np.testing.assert_allclose(geometric_normals(mesh), [[0, 0, 1]] * 6, atol=1e-6)
    np.testing.assert_allclose(mesh.face_areas.sum(), 1.25 + 1 + 0.5)


def test_a_concave_obj_polygon_keeps_its_outline(tmp_path):
    arrow = "v 0 0 0\nv 2 2 0\nv 0 1 0\nv -2 2 0\n"
    mesh = read_obj(tmp_path, arrow + "f 1 2 3 4\n" + arrow.replace(" 0\n", " 1\n") + "f 6 7 8 5\n")
    np.testing.assert_allclose(mesh.face_areas.sum(), 4)
    np.testing.assert_allclose(geometric_normals(mesh), [[0, 0, 1]] * 4, atol=1e-6)


def test_relative_obj_indices_count_from_their_own_line(tmp_path):
    first, second = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\n", "v 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 \\\n -1\n"
    mesh = read_obj(tmp_path, first + second)
    np.testing.assert_allclose(corners(mesh), [TRIANGLE, TRIANGLE + np.float32([5, 0, 0])])


def test_obj_texture_coordinates_flip_and_may_be_partial(tmp_path):
    faces = "f 1/1/1 2/2/1 3/3/1\nf 1//1 3//1 4//1\nf 1/1 3/3 4/4\nf 1 3 4\n"
    mesh = read_obj(tmp_path, QUAD + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 0.75\nvn 0 0 1\n" + faces)
    np.testing.assert_allclose(mesh.uvs[mesh.faces[0]], [[0, 1], [1, 1], [1, 0]])
    np.testing.assert_allclose(mesh.uvs[mesh.faces[1]], 0)
    np.testing.assert_allclose(mesh.uvs[mesh.faces[2]], [[0, 1], [1, 0], [0, 0.25]])
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1], (len(mesh.normals), 1)), atol=1e-6)


def test_obj_groups_are_nodes_and_usemtl_materials(tmp_path):
    (tmp_path / "leaf.png").write_bytes(encode_png(HOLED))
    mtl = "newmtl bark\nKd 0.1 0.2 0.3\nd 0.5\nnewmtl leaf\nKd 0.8 0.8 0.8\nmap_Kd -s 1 1 1 leaf.png\n"
    text = (
        "mtllib tree.mtl\n"
        + QUAD
        + "o trunk\nusemtl bark\nf 1 2 3\ng crown\nusemtl leaf\nf 1 3 4\nusemtl bark\nf 4 3 2\n"
    )
    mesh = read_obj(tmp_path, text, mtl)
    assert mesh.nodes == ("trunk", "crown")
    bark, leaf = mesh.materials
    assert (bark.name, bark.base_color, bark.alpha_mode) == ("bark", (0.1, 0.2, 0.3, 0.5), AlphaMode.BLEND)
    assert (leaf.base_color, leaf.alpha_mode, leaf.color_map.name) == ((1, 1, 1, 1), AlphaMode.MASK, "leaf")
    np.testing.assert_array_equal(mesh.face_material, [0, 1, 0])
    np.testing.assert_array_equal(mesh.face_node, [0, 1, 1])


def test_obj_map_d_becomes_the_alpha(tmp_path):
    (tmp_path / "color.png").write_bytes(encode_png(np.tile(RED, (2, 2, 1))))
    (tmp_path / "cut.png").write_bytes(encode_png(np.array([[(255, 255, 255), (0, 0, 0)]], np.uint8)))
    mesh = read_obj(
        tmp_path, "mtllib tree.mtl\nusemtl a\n" + QUAD + "f 1 2 3\n", "newmtl a\nmap_Kd color.png\nmap_d cut.png\n"
    )
    (material,) = mesh.materials
    assert material.alpha_mode is AlphaMode.MASK
    np.testing.assert_array_equal(material.color_map.pixels[..., 0], 255)
    np.testing.assert_array_equal(material.color_map.pixels[..., 3], [[255, 255, 0, 0]] * 4)


def test_a_missing_material_library_is_one_warning(tmp_path, caplog):
    mesh = read_obj(tmp_path, "mtllib gone.mtl\nusemtl a\n" + QUAD + "f 1 2 3\n")
    assert mesh.materials[0].name == "a"
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_obj_keywords_may_end_in_tabs(tmp_path):
    text = "mtllib\ttree.mtl\nusemtl\tleaf\nv\t0 0 0\nv\t1\t0 0\nv \t0 1 0\nf\t1\t2 3\n"
    mesh = read_obj(tmp_path, text, "newmtl\tleaf\nKd\t0.1 0.2\t0.3\n")
    np.testing.assert_allclose(corners(mesh)[0], TRIANGLE)
    assert mesh.materials[0].base_color == (0.1, 0.2, 0.3, 1)


@pytest.mark.parametrize("names", [("a.mtl", "b.mtl"), ("a b.mtl",)])
def test_mtllib_names_several_files_or_one_with_spaces(tmp_path, caplog, names):
    for name, material in zip(names, ("bark", "leaf"), strict=False):
        (tmp_path / name).write_text(f"newmtl {material}\nKd 0.1 0.2 0.3\n")
    used = ("bark", "leaf")[: len(names)]
    faces = "".join(f"usemtl {material}\nf 1 2 3\n" for material in used)
    mesh = read_obj(tmp_path, f"mtllib {' '.join(names)}\n" + QUAD + faces)
    assert [material.base_color for material in mesh.materials] == [(0.1, 0.2, 0.3, 1)] * len(used)
    assert not caplog.records


@pytest.mark.parametrize("file", ["C:\\art\\leaf.png", "/art/leaf.png", "../leaf.png"])
@pytest.mark.parametrize("key", ["map_Kd", "map_d"])
def test_an_assigned_texture_wins_over_one_outside_the_folder(tmp_path, key, file):
    (tmp_path / "leaf.png").write_bytes(encode_png(HOLED))
    text, mtl = "mtllib tree.mtl\nusemtl leaf\n" + QUAD + "f 1 2 3\n", f"newmtl leaf\n{key} {file}\n"
    (leaf,) = read_obj(tmp_path, text, mtl, LoadSettings(textures={"leaf": "leaf.png"})).materials
    assert (leaf.color_map.name, leaf.alpha_mode) == ("leaf", AlphaMode.MASK)
    with pytest.raises(InputError, match=r"load\.textures"):
        read_obj(tmp_path, text, mtl)


def test_an_assigned_gltf_texture_wins_over_one_outside_the_folder(tmp_path):
    (tmp_path / "leaf.png").write_bytes(encode_png(HOLED))
    leaf = {"name": "leaf", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    gltf = Gltf(materials=[leaf], textures=[{"source": 0}], images=[{"uri": "/art/leaf.png"}]).mesh(material=0)
    (leaf,) = gltf.read(tmp_path, LoadSettings(textures={"leaf": "leaf.png"})).materials
    assert leaf.color_map.name == "leaf"
    with pytest.raises(InputError, match=r"load\.textures"):
        gltf.read(tmp_path)


def test_textures_are_assigned_by_the_settings(tmp_path, caplog):
    (tmp_path / "leaf.png").write_bytes(encode_png(HOLED))
    text = QUAD + "usemtl leaf\nf 1 2 3\nusemtl bark\nf 1 3 4\n"
    leaf, bark = read_obj(tmp_path, text, load=LoadSettings(textures={"leaf": "leaf.png"})).materials
    assert (leaf.color_map.name, leaf.alpha_mode, leaf.base_color) == ("leaf", AlphaMode.MASK, (1, 1, 1, 1))
    assert bark.color_map is None
    assert not caplog.records
    leaf, _ = read_obj(tmp_path, text, load=LoadSettings(textures={"leaf": "gone.png"})).materials
    assert leaf.color_map is None
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    with pytest.raises(SettingsError, match="no material blossom to texture; it has leaf, bark"):
        read_obj(tmp_path, text, load=LoadSettings(textures={"blossom": "leaf.png"}))


# PLY


def read_ply(folder, header, body, load=LoadSettings()):  # noqa: B008
    path = folder / "tree.ply"
    path.write_bytes(f"ply\nformat {header}\nend_header\n".encode() + body)
    return read_mesh(path, load)


POINTS = "property float x\nproperty float y\nproperty float z"


def test_ply_mixes_triangles_quads_and_pentagons(tmp_path):
    header = f"ascii 1.0\nelement vertex 5\n{POINTS}\nelement face 3\nproperty list uchar int vertex_indices"
    body = b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n-0.5 0.5 0\n3 0 1 2\n4 0 1 2 3\n5 0 1 2 3 4\n"
    mesh = read_ply(tmp_path, header, body)
    np.testing.assert_allclose(mesh.face_areas.sum(), 0.5 + 1 + 1.25)
    assert mesh.triangles == 1 + 2 + 3
    assert mesh.nodes == (mesh.materials[0].name,) == ("tree",)


def test_binary_ply_has_its_uvs_normals_and_mean_colour(tmp_path):
    properties = ["nx", "ny", "nz", "s", "t"]
    rows = np.zeros(3, [("p", "<f4", 3), ("n", "<f4", 3), ("uv", "<f4", 2), ("c", "u1", 3)])
    rows["p"], rows["n"], rows["uv"], rows["c"] = TRIANGLE, UP, UVS, [[0, 0, 0], [255, 0, 0], [255, 0, 0]]
    header = "\n".join(
        ["binary_little_endian 1.0", "element vertex 3", POINTS]
        + [f"property float {name}" for name in properties]
        + [f"property uchar {name}" for name in ("red", "green", "blue")]
        + ["element face 1", "property list uchar uint vertex_index"]
    )
    mesh = read_ply(tmp_path, header, rows.tobytes() + struct.pack("<B3I", 3, 0, 1, 2))
    np.testing.assert_allclose(mesh.normals, UP)
    np.testing.assert_allclose(mesh.uvs, [[0, 1], [1, 1], [0, 0]])
    np.testing.assert_allclose(mesh.materials[0].base_color, (2 / 3, 0, 0, 1), atol=1e-6)


# Any format


def test_z_up_turns_the_tree_upright(tmp_path):
    mesh = read_obj(tmp_path, "v 1 2 3\nv 2 2 3\nv 1 3 3\nvn 0 0 1\nf 1//1 2//1 3//1\n", load=LoadSettings(up="z"))
    np.testing.assert_allclose(corners(mesh)[0], [[1, 3, -2], [2, 3, -2], [1, 3, -3]])
    np.testing.assert_allclose(mesh.normals, [[0, 1, 0]] * 3)
    with pytest.raises(SettingsError, match="up"):
        read_mesh(tmp_path / "tree.obj", LoadSettings(up="x"))


def test_missing_uvs_normals_and_material_are_filled_in(tmp_path):
    mesh = Gltf(nodes=[{"mesh": 0, "name": "Crown"}]).mesh().read(tmp_path)
    np.testing.assert_allclose(mesh.uvs, np.zeros((3, 2)))
    np.testing.assert_allclose(mesh.normals, UP)
    assert mesh.materials[0].name == "Crown"
    assert mesh.materials[0].base_color[:3] == (0.5, 0.5, 0.5)


def test_computed_normals_are_hard_on_a_cube_and_smooth_on_a_bend(tmp_path):
    cube = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    cube += "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
    mesh = read_obj(tmp_path, cube)
    np.testing.assert_allclose(
        mesh.normals[mesh.faces], np.repeat(geometric_normals(mesh)[:, None], 3, axis=1), atol=1e-6
    )
    bend = "v 0 0 0\nv 0 0 -1\nv 1 0 0\nv 1 0 -1\nv 2 -0.5 0\nv 2 -0.5 -1\nf 1 3 4 2\nf 3 5 6 4\n"
    mesh = read_obj(tmp_path, bend)
    assert len(mesh.normals) == 6
    middle = mesh.normals[np.isclose(mesh.positions[:, 0], 1)]
    assert ((middle[:, 0] > 0.1) & (middle[:, 0] < 0.4)).all()  # between the sides' 0 and 0.447


def test_zero_and_nan_normals_are_replaced(tmp_path):
    mesh = Gltf().mesh(NORMAL=np.float32([[0, 0, 0], [0, np.nan, 1], [0, 0, 2]])).read(tmp_path)
    np.testing.assert_allclose(mesh.normals, UP)


@pytest.mark.parametrize(("distance", "warned"), [(0, False), (400, False), (5e5, True)])
def test_a_tree_far_from_the_origin_is_a_warning(tmp_path, caplog, distance, warned):
    read_obj(tmp_path, "".join(f"v {x + distance} {y} 0\n" for x, y in ((0, 0), (8, 0), (0, 8))) + "f 1 2 3\n")
    assert ["far from the origin" in record.message for record in caplog.records] == [True] * warned


def test_zero_area_triangles_are_dropped(tmp_path, caplog):
    caplog.set_level(logging.INFO, "treebake")
    mesh = read_obj(tmp_path, QUAD + "v 2 0 0\nf 1 2 3\nf 1 1 2\nf 1 2 5\n")
    assert mesh.triangles == 1
    assert "2 zero-area" in caplog.text
    slender = read_obj(tmp_path, "v 0 0 0\nv 0 1000 0\nv 0.5 500 0\nf 1 3 2\n")  # a long twig's side is no zero area
    assert slender.triangles == 1


# Bad input


def cycle():
    return Gltf(nodes=[{"children": [1]}, {"children": [0]}], scenes=[{"nodes": [0]}]).mesh().bytes()


def endless():
    gltf = Gltf().mesh()
    del gltf.json["accessors"][0]["bufferView"]
    gltf.json["accessors"][0]["count"] = 10**12
    return gltf.bytes()


BAD = {
    "empty.glb": b"",
    "text.glb": b"this is not a mesh, whatever its name says",
    "cut.glb": Gltf().mesh().bytes()[:-20],
    "headless.glb": b"glTF\2\0\0\0",
    "no_triangles.glb": Gltf(nodes=[]).bytes(),
    "all_flat.glb": Gltf().mesh(TRIANGLE * 0).bytes(),
    "nan.glb": Gltf().mesh(TRIANGLE * np.float32(np.nan)).bytes(),
    "infinite.glb": Gltf().mesh(TRIANGLE + np.float32(np.inf)).bytes(),
    "beyond.glb": Gltf().mesh(indices=[0, 1, 3]).bytes(),
    "cycle.glb": cycle(),
    "endless.glb": endless(),
    "list.gltf": b"[1, 2]",
    "other.gltf": b'{"hello": "world"}',
    "binary.gltf": bytes(range(256)),
    "empty.obj": b"",
    "points.obj": QUAD.encode(),
    "zero.obj": QUAD.encode() + b"f 0 1 2\n",
    "beyond.obj": QUAD.encode() + b"f 1 2 9\n",
    "beyond_uv.obj": QUAD.encode() + b"vt 0 0\nf 1/1 2/2 3/1\n",
    "beyond_normal.obj": QUAD.encode() + b"vn 0 0 1\nf 1//1 2//1 3//2\n",
    "before.obj": QUAD.encode() + b"f -9 1 2\n",
    "words.obj": b"v a b c\nf 1 1 1\n",
    "nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "binary.obj": bytes(range(256)),
    "empty.ply": b"",
    "text.ply": b"not a mesh",
    "points.ply": f"ply\nformat ascii 1.0\nelement vertex 1\n{POINTS}\nend_header\n0 0 0\n".encode(),
    "faceless.ply": (
        f"ply\nformat ascii 1.0\nelement vertex 1\n{POINTS}\n"
        "element face 0\nproperty list uchar int vertex_index\nend_header\n0 0 0\n"
    ).encode(),
    "cut.ply": f"ply\nformat ascii 1.0\nelement vertex 9\n{POINTS}\nend_header\n0 0 0\n".encode(),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_one_clear_line(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BAD[name])
    with pytest.raises(MeshError, match=name) as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)
    assert ";" in str(caught.value)  # what is wrong; what to do


def test_paths_that_are_no_file(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_mesh(tmp_path / "gone.glb")
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(InputError, match="cannot be read"):
        read_mesh(tmp_path / "folder.obj")
    with pytest.raises(InputError, match=r"\.glb, \.gltf, \.obj, \.ply"):
        read_mesh(tmp_path / "tree.fbx")


WHOLE = {
    "glb": Gltf().mesh(indices=[0, 1, 2], NORMAL=UP, TEXCOORD_0=UVS).bytes(),
    "obj": (QUAD + "vt 0 0\no a\nusemtl b\nf 1/1 2/1 3/1 4/1\nf -1 -2 -3\n").encode(),
    "ply": (
        f"ply\nformat ascii 1.0\nelement vertex 3\n{POINTS}\nelement face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    ).encode(),
}


@pytest.mark.parametrize("suffix", WHOLE)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_anywhere_is_a_mesh_or_an_error_of_ours(tmp_path, suffix, data):
    damaged = bytearray(WHOLE[suffix])
    for _ in range(data.draw(st.integers(0, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / f"damaged.{suffix}"
    path.write_bytes(damaged[: data.draw(st.integers(0, len(damaged)))])
    try:
        mesh = read_mesh(path)
    except TreebakeError:
        pass
    else:
        assert np.isfinite(corners(mesh)).all()
        assert mesh.faces.max() < len(mesh.positions)


@settings(max_examples=50, deadline=None)
@given(st.integers(3, 12), st.floats(0.2, 0.9), st.floats(0, 6.2))
@example(5, 0.2, 0.0)
def test_star_polygons_keep_their_area(tmp_path_factory, points, inner, turn):
    angles = np.arange(2 * points) * np.pi / points + turn
    radii = np.where(np.arange(2 * points) % 2, inner, 1.0)
    x, y = np.cos(angles) * radii, np.sin(angles) * radii
    lines = [f"v {a:.9f} 0 {-b:.9f}" for a, b in zip(x, y, strict=True)]
    mesh = read_obj(
        tmp_path_factory.mktemp("star"), "\n".join(lines) + f"\nf {' '.join(map(str, range(1, len(x) + 1)))}\n"
    )
    np.testing.assert_allclose(mesh.face_areas.sum(), np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2, rtol=1e-4)
    np.testing.assert_allclose(geometric_normals(mesh)[:, 1], 1, atol=1e-4)


# Real trees


@pytest.mark.parametrize(
    ("name", "triangles", "height"),
    [
        ("ez_oak_large.glb", 22_566, 102.02),
        ("sapling_white_birch.glb", 225_932, 16.89),
        ("treegen_palm.glb", 50_780, 17.62),
        ("polyhaven_fern_02.glb", 6_232, 0.43),
        ("cypress_tree.glb", 248, 12.99),
        ("quaternius_tree_1/Tree_1.obj", 804, 5.54),
    ],
)
def test_real_trees(name, triangles, height):
    mesh = read_mesh(tree(name))
    assert mesh.triangles == triangles
    np.testing.assert_allclose(np.ptp(mesh.bounds, axis=0)[1], height, atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    shading = mesh.normals[mesh.faces].sum(axis=1)
    assert ((shading * geometric_normals(mesh)).sum(axis=1) > 0).all()


def test_real_materials():
    branches, leaves = read_mesh(tree("ez_oak_large.glb")).materials
    assert leaves.base_color[:3] == (0.6653872982754769, 0.6653872982754769, 0.6104955708001716)
    assert leaves.color_map.has_alpha  # a palette PNG
    assert branches.normal_map.name == "bark_oak_normal"
    (fern,) = read_mesh(tree("polyhaven_fern_02.glb")).materials
    assert fern.alpha_mode is AlphaMode.MASK
    assert not fern.color_map.has_alpha
    (cypress,) = read_mesh(tree("cypress_tree.glb")).materials
    assert cypress.alpha_mode is AlphaMode.OPAQUE
    textures = {"Bark": "Tree_Bark.jpg", "Tree_Leaves": "Tree_Leaves.png"}
    bark, crown = read_mesh(tree("quaternius_tree_1/Tree_1.obj"), LoadSettings(textures=textures)).materials
    assert (bark.alpha_mode, crown.alpha_mode) == (AlphaMode.OPAQUE, AlphaMode.MASK)
