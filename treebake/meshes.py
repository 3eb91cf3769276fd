"""Mesh files in: GLB, glTF, OBJ and PLY become one checked `Mesh`."""

import logging
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from treebake.errors import InputError, MeshError, SettingsError
from treebake.formats.gltf import read_gltf
from treebake.formats.obj import read_obj
from treebake.formats.part import Part
from treebake.formats.ply import read_ply
from treebake.geometry import crease_normals
from treebake.images import read_image
from treebake.model import AlphaMode, Floats, Ints, Material, Mesh, Morph, Texture

LOG = logging.getLogger("treebake")

_READERS: dict[str, Callable[[Path, Collection[str]], list[Part]]] = {
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".obj": read_obj,
    ".ply": lambda path, _: read_ply(path),
}
_CREASE = 60.0  # degrees; sharper edges stay hard where normals have to be computed
_UP = np.array((0, 1, 0), np.float32)
_EPSILON = 2.0**-23  # relative step of float32
_LOSS = 1e-4  # of the bounding radius: the step between positions above which the shape suffers
_SLIVER = 1e-7  # of the longest edge squared: twice the area below which a triangle counts as zero-area


@dataclass(frozen=True)
class LoadSettings:
    """How a mesh file is read."""

    up: str = "y"  # which axis of the file points up: "y" or "z"
    textures: dict[str, str] = field(
        default_factory=dict
    )  # material name -> image file; from the mesh's folder or here


def read_mesh(path: Path, settings: LoadSettings = LoadSettings()) -> Mesh:
    """Read a GLB, glTF, OBJ or PLY file into one mesh, node transforms applied.

    Missing normals are computed, missing uvs are zero, a missing material is grey and named after its node; zero-area
    triangles are dropped. Linear in the size of the file.

    Raises MeshError where the file is damaged, holds no triangles, non-finite vertices or indices out of range;
    InputError where it is missing, of another format or needs a file outside its folder; UnsupportedError for a named
    feature that is not read; SettingsError for an unknown axis, or a texture for an unknown material.
    """
    if settings.up not in ("y", "z"):
        raise SettingsError(f'up = "{settings.up}" is unknown; give "y" or "z"')
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"{path} has no known mesh suffix; give a {', '.join(_READERS)} file")
    try:
        parts = reader(path, settings.textures)
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist; check the path") from error
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); check the path and its permissions") from error
    mesh = _drop_slivers(path, _join(path, parts, settings.up))
    if not mesh.triangles:
        raise MeshError(f"{path} holds no triangles; export it with its faces")
    _warn_if_far(path, mesh)
    return _complete_normals(_assign_textures(path, mesh, settings.textures))


def _join(path: Path, parts: Sequence[Part], up: str) -> Mesh:
    """One mesh of all parts; a missing normal is NaN."""
    parts = [part for part in parts if len(part.faces)]
    for part in parts:
        if not 0 <= part.faces.min() <= part.faces.max() < len(part.positions):
            raise MeshError(
                f"{path}: a face of node {part.node} refers to a vertex that is not there (it has "
                f"{len(part.positions)}); export it again"
            )
        if not np.isfinite(part.positions[part.faces]).all():
            raise MeshError(f"{path}: node {part.node} has NaN or infinite vertices; repair and export it again")
    materials: dict[int, tuple[int, Material]] = {}
    nodes: dict[str, int] = {}
    face_material, face_node = [], []
    for part in parts:
        material = part.material or Material(part.node, (0.5, 0.5, 0.5, 1.0), double_sided=True)
        row, _ = materials.setdefault(id(material), (len(materials), material))
        face_material.append(np.full(len(part.faces), row))
        face_node.append(np.full(len(part.faces), nodes.setdefault(part.node, len(nodes))))
    offsets = np.cumsum([0, *(len(part.positions) for part in parts)])
    return Mesh(
        positions=_upright(_stack([part.positions for part in parts], 3), up),
        normals=_upright(_stack([_or(part.normals, part, 3, np.nan) for part in parts], 3), up),
        uvs=_join_uvs([part.uvs for part in parts], parts),
        faces=_stack([part.faces + offset for part, offset in zip(parts, offsets, strict=False)], 3).astype(np.int32),
        face_material=np.concatenate([np.zeros(0), *face_material]).astype(np.int32),
        face_node=np.concatenate([np.zeros(0), *face_node]).astype(np.int32),
        materials=tuple(material for _, material in materials.values()),
        nodes=tuple(nodes),
        morph=_join_morphs(parts, up) if any(part.morph for part in parts) else None,
        occlusion_uvs=_join_occlusion_uvs(parts),
    )


def _join_uvs(uvs: Sequence[Floats | None], parts: Sequence[Part]) -> Floats:
    """Zero where there are none."""
    joined = _stack([_or(each, part, 2, 0) for each, part in zip(uvs, parts, strict=True)], 2)
    return np.nan_to_num(joined, posinf=0, neginf=0)


def _join_occlusion_uvs(parts: Sequence[Part]) -> Floats | None:
    """Those of the parts without any are their uvs."""
    if all(part.occlusion_uvs is None for part in parts):
        return None
    return _join_uvs([part.uvs if part.occlusion_uvs is None else part.occlusion_uvs for part in parts], parts)


def _join_morphs(parts: Sequence[Part], up: str) -> Morph:
    """Of all parts, those without one staying as they are."""
    still = [Morph(part.positions, _or(part.normals, part, 3, np.nan)) for part in parts]
    found = [part.morph or base for part, base in zip(parts, still, strict=True)]
    positions, normals = (_stack([getattr(morph, name) for morph in found], 3) for name in ("positions", "normals"))
    return Morph(_upright(positions, up), _upright(normals, up))


def _stack(arrays: Sequence[Floats | Ints], width: int) -> Floats:
    return np.concatenate([np.zeros((0, width), np.float32), *arrays]).astype(np.float32, copy=False)


def _or(values: Floats | None, part: Part, width: int, default: float) -> Floats:
    return np.full((len(part.positions), width), default, np.float32) if values is None else values


def _upright(vectors: Floats, up: str) -> Floats:
    if up == "y":
        return vectors
    x, y, z = vectors.T
    return np.stack([x, z, -y], axis=1)


def _drop_slivers(path: Path, mesh: Mesh) -> Mesh:
    a, b, c = (mesh.positions[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0, initial=0)
    kept = 2 * mesh.face_areas > _SLIVER * longest
    if kept.all():
        return mesh
    LOG.info("%s: left out %d zero-area triangles", path, np.count_nonzero(~kept))
    return mesh.select(kept)


def _warn_if_far(path: Path, mesh: Mesh) -> None:
    low, high = mesh.bounds.astype(np.float64)
    if np.abs(mesh.bounds).max() * _EPSILON > _LOSS * np.linalg.norm(high - low) / 2:
        LOG.warning(
            "%s: its positions are far from the origin, where float32 loses detail; move it to the origin and export "
            "it again",
            path,
        )


def _complete_normals(mesh: Mesh) -> Mesh:
    """Unit normals; computed for the faces on vertices where they are missing, zero or not finite."""
    lengths = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
    usable = np.isfinite(lengths[:, 0]) & (lengths[:, 0] > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        normals = mesh.normals / lengths
    bare = ~usable[mesh.faces].all(axis=1)
    if not bare.any():
        return replace(mesh, normals=normals)
    computed, source, bare_faces = crease_normals(mesh.positions, mesh.faces[bare], _CREASE)
    faces = mesh.faces.copy()
    faces[bare] = bare_faces + len(mesh.positions)
    origin = np.concatenate([np.arange(len(mesh.positions)), source])
    return replace(
        mesh,
        positions=mesh.positions[origin],
        normals=np.concatenate([np.where(usable[:, None], normals, _UP), computed]),
        uvs=mesh.uvs[origin],
        faces=faces,
        morph=None,  # our own files, which have some, lack no normals
        occlusion_uvs=None if mesh.occlusion_uvs is None else mesh.occlusion_uvs[origin],
    ).select(np.ones(len(faces), bool))


def _assign_textures(path: Path, mesh: Mesh, files: dict[str, str]) -> Mesh:
    """The mesh with colour maps from the settings, as they are: white base colour, cut out where they have alpha."""
    names = [material.name for material in mesh.materials]
    for name in files:
        if name not in names:
            raise SettingsError(f"{path} has no material {name} to texture; it has {', '.join(names)}")
    textures = {file: _find_texture(path, file) for file in sorted(set(files.values()))}
    materials = []
    for material in mesh.materials:
        texture = textures.get(files.get(material.name, ""))
        if texture is not None:
            mode = AlphaMode.MASK if texture.has_alpha else AlphaMode.OPAQUE
            material = replace(material, color_map=texture, base_color=(1.0, 1.0, 1.0, 1.0), alpha_mode=mode)
        materials.append(material)
    return replace(mesh, materials=tuple(materials))


def _find_texture(path: Path, file: str) -> Texture | None:
    candidates = [path.parent / file, Path(file)]
    found = next((candidate for candidate in candidates if candidate.is_file()), None)
    if found is None:
        LOG.warning("%s: its texture %s is missing; put it beside the mesh", path, file)
        return None
    return Texture(found.stem, read_image(found))
