"""Meshes out: binary glTF 2.0 that any viewer draws, byte-identical for the same input."""

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from treebake import __version__
from treebake.files import atomic
from treebake.geometry import reject, texture_axes
from treebake.images import encode_texture, mean_texel
from treebake.model import AlphaMode, Floats, Ints, Material, Mesh, Morph, Texture, Transmission

_VERTICES, _INDICES = 34962, 34963  # bufferView targets
_UINT16, _UINT32, _FLOAT = 5123, 5125, 5126  # component types
_TABLES = {"u1": 5121, "u2": _UINT16, "u4": _UINT32, "f4": _FLOAT}
_SAMPLER = {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}  # linear, trilinear, repeat
_UINT16_VERTICES = 65535  # index 65535 itself is reserved for primitive restart
_LOD, _INSTANCING = "MSFT_lod", "EXT_mesh_gpu_instancing"

MORPH = "parent"  # the name of a mesh's morph target
TRANSMISSION = "KHR_materials_diffuse_transmission"

Json = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Instances:
    """Where a node's mesh is drawn, once for each of n instances (EXT_mesh_gpu_instancing).

    translations: (n, 3) float32. rotations: (n, 4) float32, unit quaternions x, y, z, w. scales: (n, 3) float32.
    """

    translations: Floats
    rotations: Floats
    scales: Floats


@dataclass(frozen=True, eq=False)
class Node:
    """A mesh, or several by name below one node, with coarser levels of detail, in one place or in many.

    levels: what stands for `mesh` farther away, from near to far (MSFT_lod); a level may be empty, where nothing is
    drawn. coverage: MSFT_screencoverage, the least part of the view's height at which each level is meant to be drawn,
    that of `mesh` first; () without levels. instances: of a single mesh; None for one at the origin.
    """

    name: str
    mesh: Mesh | Sequence[tuple[str, Mesh]]
    levels: Sequence[Mesh | Sequence[tuple[str, Mesh]]] = ()
    coverage: Sequence[float] = ()
    instances: Instances | None = None


def write_glb(path: Path, nodes: Sequence[tuple[str, Mesh] | Node], extras: Json | None = None) -> None:
    """Write `encode_glb` to a file, whole or not at all.

    Raises WorkspaceError where the file cannot be written.
    """
    data = encode_glb(nodes, extras)
    with atomic(path) as file:
        file.write(data)


def encode_glb(nodes: Sequence[tuple[str, Mesh] | Node], extras: Json | None = None) -> bytes:
    """Encode (name, mesh) pairs and nodes as one GLB: a glTF node and mesh each, one primitive per used material.

    A mesh without faces is left out, and so is a node without instances; a morph becomes a target, whose weight is 0.
    Meshes, materials, textures and arrays are written once each, shared by object identity, and equal images once.
    extras: data for the root's `extras`; in it an array (N, 1 to 4) of uint8, uint16, uint32 or float32, N > 0, becomes
    the index of an accessor that holds it, and a Texture the index of a glTF texture. O(vertices + faces) a primitive.
    """
    writer = _Writer()
    for node in nodes:
        writer.add_node(node if isinstance(node, Node) else Node(*node))
    return writer.to_bytes(extras)


@dataclass
class _Writer:
    """A glTF document under construction: its top-level arrays and its binary chunk."""

    binary: bytearray = field(default_factory=bytearray)
    arrays: dict[str, list[Json]] = field(default_factory=dict)
    roots: list[int] = field(default_factory=list)  # the scene's nodes
    used: set[str] = field(default_factory=set)  # extensions
    meshes: dict[int, int] = field(default_factory=dict)  # id(mesh) -> index
    materials: dict[tuple[int, int], int] = field(default_factory=dict)  # (id(material), occlusion's set) -> index
    textures: dict[tuple[int, bool], int] = field(default_factory=dict)  # (id(texture), with alpha) -> index
    images: dict[tuple[str, bytes], int] = field(default_factory=dict)  # (name, PNG) -> index of the texture
    tables: dict[int, int] = field(default_factory=dict)  # id(array) -> index of the accessor

    def append(self, array: str, entry: Json) -> int:
        entries = self.arrays.setdefault(array, [])
        entries.append(entry)
        return len(entries) - 1

    def add_node(self, node: Node) -> None:
        meshes = [node.mesh, *node.levels]
        if not any(mesh.triangles if isinstance(mesh, Mesh) else mesh for mesh in meshes):
            return
        if node.instances is not None and not len(node.instances.translations):
            return
        names = [f"{node.name}_LOD{level}" if level else node.name for level in range(len(meshes))]
        first, *others = (
            self.level(name, mesh, node.instances) if isinstance(mesh, Mesh) else self.parent(name, mesh, level)
            for level, (name, mesh) in enumerate(zip(names, meshes, strict=True))
        )
        self.roots.append(first)
        if others:
            self.used.add(_LOD)
            entry = self.arrays["nodes"][first]
            entry.setdefault("extensions", {})[_LOD] = {"ids": others}
            entry["extras"] = {"MSFT_screencoverage": list(node.coverage)}

    def parent(self, name: str, parts: Sequence[tuple[str, Mesh]], level: int) -> int:
        children = [self.level(f"{part}_LOD{level}" if level else part, mesh, None) for part, mesh in parts]
        return self.append("nodes", {"name": name, **({"children": children} if children else {})})

    def level(self, name: str, mesh: Mesh, instances: Instances | None) -> int:
        entry: Json = {"name": name}
        if mesh.triangles:
            entry["mesh"] = self.mesh(name, mesh)
            if instances is not None:
                self.used.add(_INSTANCING)
                attributes = {
                    "TRANSLATION": instances.translations,
                    "ROTATION": instances.rotations,
                    "SCALE": instances.scales,
                }
                entry["extensions"] = {_INSTANCING: {"attributes": self.resolved(attributes)}}
        return self.append("nodes", entry)

    def mesh(self, name: str, mesh: Mesh) -> int:
        if id(mesh) not in self.meshes:
            used = np.unique(mesh.face_material).tolist()
            entry: Json = {"name": name, "primitives": [self.primitive(mesh, index) for index in used]}
            if mesh.morph:
                entry |= {"weights": [0], "extras": {"targetNames": [MORPH]}}
            self.meshes[id(mesh)] = self.append("meshes", entry)
        return self.meshes[id(mesh)]

    def primitive(self, mesh: Mesh, index: int) -> Json:
        vertices, faces = _compact(mesh.faces[mesh.face_material == index], len(mesh.positions))
        material = mesh.materials[index]
        attributes = {
            "POSITION": self.vertex_accessor(mesh.positions[vertices], bounds=True),
            "NORMAL": self.vertex_accessor(mesh.normals[vertices]),
        }
        if material.color_map or material.normal_map or material.occlusion_map or material.roughness_map:
            attributes["TEXCOORD_0"] = self.vertex_accessor(mesh.uvs[vertices])
        if material.occlusion_map and mesh.occlusion_uvs is not None:
            attributes["TEXCOORD_1"] = self.vertex_accessor(mesh.occlusion_uvs[vertices])
        if material.normal_map:  # viewers that must make up the tangents do not agree on them
            tangents = _tangents(mesh.positions[vertices], mesh.normals[vertices], mesh.uvs[vertices], faces)
            attributes["TANGENT"] = self.vertex_accessor(tangents)
        primitive: Json = {
            "attributes": attributes,
            "indices": self.index_accessor(faces, len(vertices)),
            "material": self.material(material, int("TEXCOORD_1" in attributes)),
        }
        if mesh.morph:
            primitive["targets"] = [self.target(mesh, mesh.morph, vertices, faces, "TANGENT" in attributes)]
        return primitive

    def target(self, mesh: Mesh, morph: Morph, vertices: Ints, faces: Ints, with_tangents: bool) -> Json:
        """What a morph adds to the attributes."""
        start, end = Morph(mesh.positions, mesh.normals)[vertices], morph[vertices]
        target = {
            "POSITION": self.vertex_accessor(end.positions - start.positions, bounds=True),
            "NORMAL": self.vertex_accessor(end.normals - start.normals),
        }
        if with_tangents:
            one, other = (_tangents(at.positions, at.normals, mesh.uvs[vertices], faces) for at in (start, end))
            target["TANGENT"] = self.vertex_accessor((other - one)[:, :3])
        return target

    def vertex_accessor(self, values: Floats, bounds: bool = False) -> int:
        accessor: Json = {
            "bufferView": self.view(values.astype("<f4").tobytes(), _VERTICES),
            "componentType": _FLOAT,
            "count": len(values),
            "type": f"VEC{values.shape[1]}",
        }
        if bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self.append("accessors", accessor)

    def index_accessor(self, faces: Ints, vertices: int) -> int:
        small = vertices <= _UINT16_VERTICES
        accessor = {
            "bufferView": self.view(faces.astype("<u2" if small else "<u4").tobytes(), _INDICES),
            "componentType": _UINT16 if small else _UINT32,
            "count": faces.size,
            "type": "SCALAR",
        }
        return self.append("accessors", accessor)

    def resolved(self, value: Any) -> Any:
        """Extras as JSON: arrays and textures are stored, and stand as their indices."""
        if isinstance(value, dict):
            return {key: self.resolved(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self.resolved(item) for item in value]
        if isinstance(value, np.ndarray):
            return self.table_accessor(value)
        return self.texture(value, with_alpha=value.has_alpha) if isinstance(value, Texture) else value

    def table_accessor(self, values: np.ndarray) -> int:
        if id(values) not in self.tables:
            self.tables[id(values)] = self.append("accessors", self.table_entry(values))
        return self.tables[id(values)]

    def table_entry(self, values: np.ndarray) -> Json:
        count, width = values.shape
        kind = values.dtype.str[1:]
        return {
            "bufferView": self.view(values.astype(f"<{kind}").tobytes()),
            "componentType": _TABLES[kind],
            "count": count,
            "type": "SCALAR" if width == 1 else f"VEC{width}",
        }

    def view(self, data: bytes, target: int | None = None) -> int:
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        self.binary += data + bytes(-len(data) % 4)
        return self.append("bufferViews", view if target is None else view | {"target": target})

    def material(self, material: Material, occlusion_set: int) -> int:
        key = id(material), occlusion_set
        if key not in self.materials:
            self.materials[key] = self.append("materials", self.material_entry(material, occlusion_set))
        return self.materials[key]

    def material_entry(self, material: Material, occlusion_set: int) -> Json:
        surface: Json = {"metallicFactor": material.metallic, "roughnessFactor": material.roughness}
        entry: Json = {"name": material.name, "pbrMetallicRoughness": surface}
        if material.base_color != (1, 1, 1, 1):
            surface["baseColorFactor"] = list(material.base_color)
        if material.color_map:
            with_alpha = material.alpha_mode is not AlphaMode.OPAQUE and material.color_map.has_alpha
            surface["baseColorTexture"] = {"index": self.texture(material.color_map, with_alpha)}
        if material.roughness_map:
            surface["metallicRoughnessTexture"] = {"index": self.texture(material.roughness_map, with_alpha=False)}
        if material.normal_map:
            entry["normalTexture"] = {"index": self.texture(material.normal_map, with_alpha=False)}
        if material.occlusion_map:
            entry["occlusionTexture"] = {"index": self.texture(material.occlusion_map, with_alpha=False)}
            if occlusion_set:
                entry["occlusionTexture"]["texCoord"] = occlusion_set
        if material.transmission:
            self.used.add(TRANSMISSION)
            through = _transmission(material, material.transmission, surface.get("baseColorTexture"))
            entry["extensions"] = {TRANSMISSION: through}
        if material.alpha_mode is not AlphaMode.OPAQUE:
            entry["alphaMode"] = material.alpha_mode.value
        if material.alpha_mode is AlphaMode.MASK:
            entry["alphaCutoff"] = material.alpha_cutoff
        if material.double_sided:
            entry["doubleSided"] = True
        return entry

    def texture(self, texture: Texture, with_alpha: bool) -> int:
        key = (id(texture), with_alpha)
        if key not in self.textures:
            named = texture.name, encode_texture(texture, with_alpha=with_alpha)
            if named not in self.images:  # levels that were read from files of their own bring theirs along
                self.images[named] = self.image(*named)
            self.textures[key] = self.images[named]
        return self.textures[key]

    def image(self, name: str, png: bytes) -> int:
        if not self.images:
            self.append("samplers", _SAMPLER)
        image = self.append("images", {"name": name, "mimeType": "image/png", "bufferView": self.view(png)})
        return self.append("textures", {"sampler": 0, "source": image})

    def to_bytes(self, extras: Json | None) -> bytes:
        stored = self.resolved(extras)
        document = {
            "asset": {"version": "2.0", "generator": f"treebake {__version__}"},
            "scene": 0,
            "scenes": [{"nodes": self.roots} if self.roots else {}],
            **self.arrays,
        }
        if self.used:
            document["extensionsUsed"] = sorted(self.used)
        if _INSTANCING in self.used:
            document["extensionsRequired"] = [_INSTANCING]  # a viewer without it would show a single instance
        if self.binary:
            document["buffers"] = [{"byteLength": len(self.binary)}]
        if stored:
            document["extras"] = stored
        text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()
        chunks = _chunk(b"JSON", text + b" " * (-len(text) % 4))
        if self.binary:
            chunks += _chunk(b"BIN\0", bytes(self.binary))
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _transmission(material: Material, transmission: Transmission, color_map: Json | None) -> Json:
    """The extension's content. Its colour ends at 1, ours is a factor: beyond 1 the map's mean stands for the map."""
    color = np.array(transmission.color)
    entry: Json = {"diffuseTransmissionFactor": transmission.factor}
    if material.color_map and color_map:
        if (color <= 1).all():
            entry["diffuseTransmissionColorTexture"] = color_map
        else:
            color *= mean_texel(material.color_map, material)[:3]
    return entry | {"diffuseTransmissionColorFactor": np.minimum(color, 1).tolist()}


def _compact(faces: Ints, vertices: int) -> tuple[Ints, Ints]:
    """The vertices that faces use, in order, and the faces renumbered to them: (U,) int32 and (F, 3) int32."""
    is_used = np.zeros(vertices, bool)
    is_used[faces] = True
    renumber = np.cumsum(is_used, dtype=np.int32) - 1
    return np.flatnonzero(is_used).astype(np.int32), renumber[faces]


def _tangents(positions: Floats, normals: Floats, uvs: Floats, faces: Ints) -> Floats:
    """glTF's TANGENT: the direction of growing u, area-weighted over a vertex' faces, and the side on which v falls.

    (V, 4) float32; where the texture coordinates leave the direction open it is any one at right angles to the normal.
    """
    n = normals.astype(np.float64)
    along_u, _, winding = texture_axes(positions[faces].astype(np.float64), uvs[faces].astype(np.float64))
    tangents, sides = np.zeros_like(n), np.zeros(len(n))
    for corner in faces.T:
        np.add.at(tangents, corner, along_u)
        np.add.at(sides, corner, -winding)  # positive where the image is not mirrored: v grows downwards
    tangents = reject(tangents, n)
    lost = np.linalg.norm(tangents, axis=1) < 1e-12
    tangents[lost] = reject(np.eye(3)[np.abs(n[lost]).argmin(axis=1)], n[lost])
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    return np.column_stack([tangents, np.where(sides < 0, -1, 1)]).astype(np.float32)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack("<I4s", len(data), kind) + data
