"""glTF 2.0 and GLB: the default scene as parts.

An own reader because trimesh 5.2 drops texture transforms and texcoord sets, and rounds linear colours to 8 bit.
"""

import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import DracoPy
import numpy as np

from treebake.errors import MeshError, UnsupportedError
from treebake.formats.gltf_file import Array, GltfFile, unit_range
from treebake.formats.part import LOG, Part
from treebake.glb import MORPH, TRANSMISSION
from treebake.images import mean_texel
from treebake.model import AlphaMode, Doubles, Floats, Ints, Material, Morph, Texture, Transmission

Json = dict[str, Any]

_DRACO, _INSTANCING, _TRANSFORM = "KHR_draco_mesh_compression", "EXT_mesh_gpu_instancing", "KHR_texture_transform"
_READ = {_DRACO, _INSTANCING, _TRANSFORM, "KHR_mesh_quantization"}
_HARMLESS = {"EXT_texture_webp", "KHR_lights_punctual", "KHR_xmp_json_ld", "MSFT_lod", "MSFT_screencoverage"}
_DECOMPRESS = "rewrite it without with: gltf-transform copy {name} plain.glb"
_REMEDIES = {
    "EXT_meshopt_compression": _DECOMPRESS,
    "KHR_meshopt_compression": _DECOMPRESS,
    "KHR_texture_basisu": "give it PNG textures with: gltf-transform ktxdecompress {name} plain.glb",
}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_FLOAT = 5126  # component type
_DARKEST = 1e-3  # of a colour map's mean, below which a colour is no factor on it


def read_gltf(path: Path, assigned: Collection[str] = ()) -> list[Part]:
    """Read the triangles of the default scene of a .glb or .gltf file, node transforms applied.

    Draco, quantised and sparse accessors, strips, fans and GPU instances are resolved; texture transforms are baked
    into the uvs, the strength of occlusion and the scale of normals into the texels; faces stay counter-clockwise under
    mirroring nodes. Of diffuse transmission a factor and a colour are read, the means of its textures. Vertex colours,
    skins and morphs are not read, but for a morph that is one target named "parent" of plain floats, as treebake writes
    it.
    assigned: names of materials whose colour map comes from elsewhere, and is not looked for; what goes through them is
    a factor on that map, whatever it was in the file.

    Raises MeshError for a damaged file, InputError for a missing buffer or one outside the folder, UnsupportedError
    for a required extension that is not read.
    """
    try:
        file = GltfFile(path)
        _check_extensions(file)
        _check_colors(file)
        material = cache(lambda index: _material(file, index, assigned))
        return [
            part
            for node, world in _nodes(file)
            if "mesh" in node
            for part in _parts(file, node, world @ _instances(file, node), material)
        ]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, struct.error) as error:
        raise MeshError(f"{path} is no valid glTF ({type(error).__name__}: {error}); export it again") from error


@dataclass(frozen=True)
class _UvMap:
    """Which TEXCOORD set a texture reads, and the affine map [u, v, 1] -> [u, v] on it."""

    texcoord: int = 0
    rows: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1, 0, 0), (0, 1, 0))


@dataclass(frozen=True, eq=False)
class _Surface:
    """A material, and how its textures are placed, the occlusion map apart."""

    material: Material | None = None
    uv_map: _UvMap = _UvMap()
    occlusion: _UvMap = _UvMap()


def _check_extensions(file: GltfFile) -> None:
    for name in file.json.get("extensionsRequired", []):
        if name in _READ | _HARMLESS or name.startswith("KHR_materials_"):
            continue
        remedy = _REMEDIES.get(name, "export it without").format(name=file.path.name)
        raise UnsupportedError(f"{file.path} requires the extension {name}, which treebake does not read; {remedy}")


def _check_colors(file: GltfFile) -> None:
    """Warn of vertex colours that are not plain white; once, they are not read."""
    for mesh in file.json.get("meshes", []):
        for primitive in mesh["primitives"]:
            index = primitive["attributes"].get("COLOR_0")
            if index is None or "bufferView" not in file.json["accessors"][index]:
                continue
            if not (unit_range(file.accessor(index)) == 1).all():
                LOG.warning("%s: vertex colours are not read; bake them into a texture to keep them", file.path)
                return


def _nodes(file: GltfFile) -> Iterator[tuple[Json, Doubles]]:
    """Every node of the default scene with its world matrix (4, 4), parents first."""
    nodes, scenes = file.json.get("nodes", []), file.json.get("scenes")
    if scenes:
        roots = scenes[file.json.get("scene", 0)].get("nodes", [])
    else:
        roots = sorted(set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])})
    pending = [(root, np.eye(4)) for root in reversed(roots)]
    seen: set[int] = set()
    while pending:
        index, parent = pending.pop()
        if index in seen:
            raise MeshError(f"{file.path} reaches node {index} twice, so its nodes are no tree; export it again")
        seen.add(index)
        node = nodes[index]
        world = parent @ _local(node)
        yield {"name": f"node {index}", **node}, world
        pending.extend((child, world) for child in reversed(node.get("children", [])))


def _local(node: Json) -> Doubles:
    if "matrix" in node:
        matrix: Doubles = np.array(node["matrix"], np.float64).reshape(4, 4).T
        return matrix
    rows = [node.get("translation", (0, 0, 0)), node.get("rotation", (0, 0, 0, 1)), node.get("scale", (1, 1, 1))]
    return np.asarray(_compose(*(np.array([row], np.float64) for row in rows))[0])


def _instances(file: GltfFile, node: Json) -> Doubles:
    """The matrices (I, 4, 4) at which a node draws its mesh: one, or EXT_mesh_gpu_instancing's."""
    if _INSTANCING not in node.get("extensions", {}):
        return np.eye(4)[None]
    found = {k: unit_range(file.accessor(i)) for k, i in node["extensions"][_INSTANCING]["attributes"].items()}
    count = len(next(iter(found.values())))
    return _compose(
        found.get("TRANSLATION", np.zeros((count, 3))),
        found.get("ROTATION", np.tile((0.0, 0, 0, 1), (count, 1))),
        found.get("SCALE", np.ones((count, 3))),
    )


def _compose(translation: Array, rotation: Array, scale: Array) -> Doubles:
    """(I, 4, 4) from (I, 3), quaternions xyzw (I, 4) and (I, 3)."""
    x, y, z, w = (rotation / np.linalg.norm(rotation, axis=1, keepdims=True)).T
    columns = [  # of the rotation matrix
        [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
        [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
        [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrices = np.tile(np.eye(4), (len(translation), 1, 1))
    matrices[:, :3, :3] = np.array(columns).transpose(2, 1, 0) * scale[:, None, :]
    matrices[:, :3, 3] = translation
    return matrices


def _parts(file: GltfFile, node: Json, worlds: Doubles, material: Callable[[int], _Surface]) -> Iterator[Part]:
    mesh = file.json["meshes"][node["mesh"]]
    for primitive in mesh["primitives"]:
        mode = primitive.get("mode", _TRIANGLES)
        if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in primitive["attributes"]:
            LOG.info("%s: node %s has lines or points, which are left out", file.path, node["name"])
            continue
        attributes, indices = _geometry(file, primitive)
        surface = material(primitive["material"]) if "material" in primitive else _Surface()
        faces = _triangles(indices, mode)
        still, target = attributes, _target(file, mesh, primitive)
        positions, normals, placed = _place(still["POSITION"], still.get("NORMAL"), faces, worlds)
        morph = None
        if target and "NORMAL" in still:
            there, turned, _ = _place(
                still["POSITION"] + target["POSITION"], still["NORMAL"] + target["NORMAL"], faces, worlds
            )
            morph = None if turned is None else Morph(there, turned)
        yield Part(
            node=node["name"],
            material=surface.material,
            positions=positions,
            normals=normals,
            uvs=_uvs(attributes, surface.uv_map, len(worlds)),
            faces=placed,
            morph=morph,
            occlusion_uvs=None
            if surface.occlusion == surface.uv_map
            else _uvs(attributes, surface.occlusion, len(worlds)),
        )


def _target(file: GltfFile, mesh: Json, primitive: Json) -> dict[str, Array]:
    """What the morph adds to positions and normals; empty where there is none that is read."""
    extras = mesh.get("extras")  # any value
    named = isinstance(extras, dict) and extras.get("targetNames") == [MORPH]
    if not named or not primitive.get("targets") or _DRACO in primitive.get("extensions", {}):
        return {}
    target = primitive["targets"][0]
    stored = {name: file.json["accessors"][target[name]] for name in ("POSITION", "NORMAL") if name in target}
    if len(stored) < 2 or any(each["componentType"] != _FLOAT or "sparse" in each for each in stored.values()):
        return {}
    return {name: file.accessor(target[name]) for name in stored}


def _geometry(file: GltfFile, primitive: Json) -> tuple[dict[str, Array], Ints]:
    """The attributes (V, width) that are drawn, as floats, and the indices (N,) of a primitive."""
    wanted = {k: v for k, v in primitive["attributes"].items() if k in ("POSITION", "NORMAL") or "TEXCOORD" in k}
    draco = primitive.get("extensions", {}).get(_DRACO)
    if draco:
        try:
            decoded = DracoPy.decode(file.view(draco["bufferView"]))
        except (DracoPy.FileTypeException, ValueError) as error:
            raise MeshError(f"{file.path} has damaged Draco data ({error}); export it again") from error
        by_id = {found["unique_id"]: found["data"] for found in decoded.attributes}
        stored = {k: by_id[draco["attributes"][k]] for k in wanted}
        normalized = {k: file.json["accessors"][i].get("normalized", False) for k, i in wanted.items()}
        attributes = {k: unit_range(v) if normalized[k] else v for k, v in stored.items()}
        return attributes, np.asarray(decoded.faces, np.int32).reshape(-1)
    attributes = {k: file.accessor(i) for k, i in wanted.items()}
    if "indices" not in primitive:
        return attributes, np.arange(len(attributes["POSITION"]), dtype=np.int32)
    # Indices beyond int32 wrap to negative ones, which the caller's range check refuses.
    return attributes, file.accessor(primitive["indices"])[:, 0].astype(np.int32)


def _triangles(indices: Ints, mode: int) -> Ints:
    """Indices (N,) of a list, strip or fan as faces (F, 3); an incomplete last triangle is left out."""
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    if mode == _FAN:
        return np.stack([np.full(max(len(indices) - 2, 0), indices[0]), indices[1:-1], indices[2:]], axis=1)
    faces = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces


def _place(positions: Array, normals: Array | None, faces: Ints, worlds: Doubles) -> tuple[Floats, Floats | None, Ints]:
    """Repeat a primitive at each of the matrices (I, 4, 4): positions, normals, faces."""
    linear = worlds[:, :3, :3]
    mirrored = np.linalg.det(linear) < 0
    placed = np.einsum("iab,vb->iva", linear, positions.astype(np.float64)) + worlds[:, None, :3, 3]
    if normals is not None:
        # Normals go by the cofactors, which are the inverse transpose up to scale and exist for flat scales too.
        cofactors = np.cross(linear[:, :, [1, 2, 0]], linear[:, :, [2, 0, 1]], axis=1)
        cofactors *= np.where(mirrored, -1.0, 1.0)[:, None, None]
        normals = np.einsum("iab,vb->iva", cofactors, normals.astype(np.float64)).reshape(-1, 3).astype(np.float32)
    wound = np.where(mirrored[:, None, None], faces[:, [0, 2, 1]], faces)
    wound = wound + np.arange(len(worlds), dtype=np.int32)[:, None, None] * len(positions)
    return placed.reshape(-1, 3).astype(np.float32), normals, wound.reshape(-1, 3).astype(np.int32)


def _uvs(attributes: dict[str, Array], uv_map: _UvMap, instances: int) -> Floats | None:
    """The mapped texture coordinates of all instances, (I V, 2), where there are any."""
    uvs = attributes.get(f"TEXCOORD_{uv_map.texcoord}")
    if uvs is None:
        return None
    if uv_map.rows != _UvMap.rows:
        rows = np.array(uv_map.rows)
        uvs = uvs @ rows[:, :2].T + rows[:, 2]
    return np.tile(np.asarray(uvs, np.float32), (instances, 1))


def _material(file: GltfFile, index: int, assigned: Collection[str]) -> _Surface:
    spec = file.json["materials"][index]
    name = spec.get("name") or f"material {index}"
    pbr = spec.get("pbrMetallicRoughness", {})
    color, color_map = pbr.get("baseColorFactor", (1, 1, 1, 1)), pbr.get("baseColorTexture")
    roughness, metallic = float(pbr.get("roughnessFactor", 1)), float(pbr.get("metallicFactor", 1))
    if glossy := spec.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness"):
        color, color_map = glossy.get("diffuseFactor", (1, 1, 1, 1)), glossy.get("diffuseTexture")
        roughness, metallic = 1.0, 0.0  # its gloss and its metal are not read
    red, green, blue, alpha = (float(c) for c in color)
    normal_map, roughness_map = spec.get("normalTexture"), pbr.get("metallicRoughnessTexture")
    uv_map = _uv_map(color_map or normal_map or roughness_map or {})
    for what, info in (("normal", normal_map), ("roughness", roughness_map)):
        if info and _uv_map(info) != uv_map:
            LOG.warning("%s: material %s places its %s map by other uvs; going on without it", file.path, name, what)
    material = Material(
        name=name,
        base_color=(red, green, blue, alpha),
        color_map=None if name in assigned else _texture(file, color_map),
        normal_map=_texture(file, normal_map if normal_map and _uv_map(normal_map) == uv_map else None),
        occlusion_map=_texture(file, spec.get("occlusionTexture")),
        roughness_map=_texture(file, roughness_map if roughness_map and _uv_map(roughness_map) == uv_map else None),
        roughness=roughness,
        metallic=metallic,
        alpha_mode=AlphaMode(spec.get("alphaMode", "OPAQUE")),
        alpha_cutoff=float(spec.get("alphaCutoff", 0.5)),
        double_sided=bool(spec.get("doubleSided", False)),
    )
    through = spec.get("extensions", {}).get(TRANSMISSION)
    if through is not None:
        material = replace(material, transmission=_transmission(file, through, material, color_map))
    return _Surface(material, uv_map, _uv_map(spec["occlusionTexture"]) if material.occlusion_map else uv_map)


def _texture(file: GltfFile, info: Json | None) -> Texture | None:
    """The image of a texture info, its scale (of normals) or strength (of occlusion) applied to the texels."""
    texture = file.texture(info["index"]) if info else None
    if not info or not texture:
        return None
    scale, strength = float(info.get("scale", 1)), float(info.get("strength", 1))
    if scale == strength == 1:
        return texture
    values = texture.pixels[..., :3] / 255
    if scale != 1:
        normals = (values * 2 - 1) * (scale, scale, 1)
        values = normals / np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-6) * 0.5 + 0.5
    else:
        values = np.clip(1 + strength * (values - 1), 0, 1)
    return Texture(texture.name, np.dstack([np.rint(values * 255).astype(np.uint8), texture.pixels[..., 3]]))


def _transmission(file: GltfFile, through: Json, material: Material, color_map: Json | None) -> Transmission:
    """What a material lets through, its colour as a factor on the colour map.

    A colour that does not come from that map becomes the ratio of the means, so that as much light comes through. Where
    the map comes from elsewhere, its mean is not known here: the colour as it stands is taken for the factor.
    """
    factor = float(through.get("diffuseTransmissionFactor", 0))
    if part := _texture(file, through.get("diffuseTransmissionTexture")):
        factor *= float(mean_texel(part, material)[3])
    color = np.array(through.get("diffuseTransmissionColorFactor", (1, 1, 1)), np.float64)
    own = through.get("diffuseTransmissionColorTexture")
    if not (own and color_map and own["index"] == color_map["index"]):
        if texture := _texture(file, own):
            color *= mean_texel(texture, material)[:3]
        if material.color_map:
            color /= np.maximum(mean_texel(material.color_map, material)[:3], _DARKEST)
    red, green, blue = color.tolist()
    return Transmission(min(max(factor, 0.0), 1.0), (red, green, blue))


def _uv_map(texture_info: Json) -> _UvMap:
    transform = texture_info.get("extensions", {}).get(_TRANSFORM, {})
    (u, v), (su, sv) = transform.get("offset", (0, 0)), transform.get("scale", (1, 1))
    c, s = np.cos(transform.get("rotation", 0.0)), np.sin(transform.get("rotation", 0.0))
    # The rotation's sign is the one that three.js and the Khronos sample viewer draw.
    texcoord = transform.get("texCoord", texture_info.get("texCoord", 0))
    return _UvMap(texcoord, ((float(c * su), float(s * sv), u), (float(-s * su), float(c * sv), v)))
