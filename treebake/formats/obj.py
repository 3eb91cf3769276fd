"""Wavefront OBJ with its MTL files.

An own reader because trimesh 5.2 resolves relative indices from the end of the whole file, drops texture coordinates
and normals where only some faces have them, and does not read map_d.
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from treebake.errors import MeshError
from treebake.formats.part import LOG, Part, beside, texture_beside
from treebake.geometry import triangulate
from treebake.model import AlphaMode, Floats, Material, Texture


def read_obj(path: Path, assigned: Collection[str] = ()) -> list[Part]:
    """Read the faces of an OBJ file, one part per object or group and material.

    Polygons of any size are triangulated, indices may be relative, v is flipped into glTF's. Materials are
    double-sided, since the format does not say; one with a cut-out texture is MASK. Smoothing groups, lines and curves
    are not read. assigned: names of materials whose textures come from elsewhere, and are not looked for.

    Raises MeshError where the file is damaged, InputError for a file outside the folder.
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").replace("\\\n", " ").splitlines()
        return _parts(path, _scan(lines), assigned)
    except (ValueError, IndexError) as error:
        raise MeshError(f"{path} is damaged or no OBJ file ({error}); export it again") from error


@dataclass(eq=False)
class _Scan:
    """What the lines hold. A face corner is an index into `corners`, whose rows are (v, vt, vn), -1 for none."""

    positions: list[list[str]] = field(default_factory=list)
    uvs: list[list[str]] = field(default_factory=list)
    normals: list[list[str]] = field(default_factory=list)
    corners: dict[tuple[int, int, int], int] = field(default_factory=dict)
    groups: dict[tuple[str, str], list[list[int]]] = field(default_factory=dict)  # (node, material) -> polygons
    libraries: list[str] = field(default_factory=list)


def _scan(lines: list[str]) -> _Scan:
    """Read all lines; one pass in Python, linear in their number."""
    scan = _Scan()
    node, material = "", ""
    polygons: list[list[int]] | None = None
    known: dict[str, int] = {}  # corners by their text, where that holds no relative index
    for line in lines:
        key, rest = _statement(line)
        if key == "v":
            scan.positions.append(rest.split()[:3])
        elif key == "vt":
            scan.uvs.append([*rest.split(), "0"][:2])
        elif key == "vn":
            scan.normals.append(rest.split()[:3])
        elif key == "f":
            if polygons is None:
                polygons = scan.groups.setdefault((node, material), [])
            polygon = []
            for token in rest.split():
                corner = known.get(token)
                if corner is None:
                    corner = _corner(scan, token)
                    if "-" not in token:
                        known[token] = corner
                polygon.append(corner)
            polygons.append(polygon)
        elif key in ("o", "g"):
            node, polygons = rest, None
        elif key == "usemtl":
            material, polygons = rest, None
        elif key == "mtllib":
            scan.libraries.append(rest)
    return scan


def _statement(line: str) -> tuple[str, str]:
    """The keyword of a line and what follows it, after spaces or tabs."""
    words = line.split(None, 1)
    return words[0] if words else "", words[1].strip() if len(words) > 1 else ""


def _corner(scan: _Scan, token: str) -> int:
    """The id of a corner such as 3/1/2, 3//2, 3/1, 3 or -1/-1/-1; 0 and out-of-range indices are refused."""
    row = [-1, -1, -1]
    for i, (text, data) in enumerate(zip(token.split("/"), (scan.positions, scan.uvs, scan.normals), strict=False)):
        if text:
            index = int(text)
            row[i] = index - 1 if index > 0 else len(data) + index
            if index == 0 or row[i] < 0:
                raise ValueError(f"index {text} of a face is out of range")
    return scan.corners.setdefault((row[0], row[1], row[2]), len(scan.corners))


def _parts(path: Path, scan: _Scan, assigned: Collection[str]) -> list[Part]:
    corners = np.array(list(scan.corners), np.int64).reshape(-1, 3)
    kinds = (("vertex", scan.positions), ("texture coordinate", scan.uvs), ("normal", scan.normals))
    for (kind, rows), greatest in zip(kinds, corners.max(axis=0, initial=-1), strict=True):
        if greatest >= len(rows):
            raise MeshError(f"{path} has a face on {kind} {greatest + 1} of {len(rows)}; export it again")
    positions = _gather(_table(scan.positions, 3), corners[:, 0])
    uvs = np.nan_to_num(_gather(_table(scan.uvs, 2), corners[:, 1]), nan=0.0)
    uvs[:, 1] = np.where(corners[:, 1] >= 0, 1 - uvs[:, 1], 0)
    normals = _gather(_table(scan.normals, 3), corners[:, 2])
    materials = _materials(path, scan, assigned)
    parts = []
    for (node, material), polygons in scan.groups.items():
        sizes = np.fromiter(map(len, polygons), np.int32, len(polygons))
        flat = np.fromiter((corner for polygon in polygons for corner in polygon), np.int32, int(sizes.sum()))
        used, local = np.unique(flat, return_inverse=True)
        parts.append(
            Part(
                node=node or path.stem,
                material=materials.get(material),
                positions=positions[used],
                normals=normals[used] if scan.normals else None,
                uvs=uvs[used] if scan.uvs else None,
                faces=triangulate(positions[used], local.astype(np.int32), sizes),
            )
        )
    return parts


def _table(rows: list[list[str]], width: int) -> Floats:
    return np.array(rows, np.float32).reshape(-1, width)


def _gather(table: Floats, rows: NDArray[np.int64]) -> Floats:
    """The rows of a table, NaN where the row is missing."""
    padded = np.concatenate([table, np.full((1, table.shape[1]), np.nan, np.float32)])
    found: Floats = padded[np.where((rows >= 0) & (rows < len(table)), rows, len(table))]
    return found


def _materials(path: Path, scan: _Scan, assigned: Collection[str]) -> dict[str, Material]:
    """Every material that a face uses; a grey one where no library defines it."""
    defined: dict[str, dict[str, str]] = {}
    for library in (name for names in scan.libraries for name in _library_names(path, names)):
        defined.update(_library(path, library))
    textures: dict[str, Texture | None] = {}
    used = dict.fromkeys(material for _, material in scan.groups if material)
    for name in used:
        if name in assigned:
            defined[name] = {k: v for k, v in defined.get(name, {}).items() if not k.startswith("map_")}
    return {name: _material(path, name, defined.get(name, {}), textures) for name in used}


def _library_names(path: Path, names: str) -> list[str]:
    """What one mtllib names: a single file, whose name may hold spaces, or else several."""
    several = names.split()
    if beside(path, names).is_file() or not any(beside(path, name).is_file() for name in several):
        return [names]
    return several


def _library(path: Path, name: str) -> dict[str, dict[str, str]]:
    """The statements of each material of an MTL file, by lower-case key."""
    try:
        lines = beside(path, name).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        LOG.warning("%s: its material library %s is missing; put it beside it to get colours", path, name)
        return {}
    found: dict[str, dict[str, str]] = {}
    statements: dict[str, str] = {}
    for line in lines:
        key, rest = _statement(line)
        if key == "newmtl":
            statements = found.setdefault(rest, {})
        else:
            statements[key.lower()] = rest
    return found


def _material(path: Path, name: str, statements: dict[str, str], textures: dict[str, Texture | None]) -> Material:
    def texture(key: str) -> Texture | None:
        uri = _texture_file(statements.get(key, ""))
        if uri and uri not in textures:
            textures[uri] = texture_beside(path, uri)
        return textures.get(uri)

    color, alpha = _color(statements), _alpha(statements)
    color_map, cut_out = texture("map_kd"), texture("map_d")
    if cut_out is not None:
        color_map = _with_alpha(color_map, cut_out)
    if color_map is not None:
        # Exporters write a placeholder Kd beside a texture, which other readers ignore too.
        color = (1.0, 1.0, 1.0)
    masked = color_map is not None and color_map.has_alpha
    mode = AlphaMode.MASK if masked else AlphaMode.BLEND if alpha < 1 else AlphaMode.OPAQUE
    return Material(name, (*color, alpha), color_map, alpha_mode=mode, double_sided=True)


def _color(statements: dict[str, str]) -> tuple[float, float, float]:
    values = [float(text) for text in statements.get("kd", "0.5").split()]
    red, green, blue = values if len(values) == 3 else values[:1] * 3
    return red, green, blue


def _alpha(statements: dict[str, str]) -> float:
    if "d" in statements:
        return float(statements["d"].split()[-1])
    return 1 - float(statements.get("tr", "0"))


def _texture_file(text: str) -> str:
    """The file of a map statement, without options such as -s 1 1 1."""
    words = text.split()
    while words and words[0].startswith("-"):
        words.pop(0)
        while words and (words[0] in ("on", "off") or words[0].replace(".", "").lstrip("-").isdigit()):
            words.pop(0)
    return " ".join(words)


def _with_alpha(color: Texture | None, cut_out: Texture) -> Texture:
    """The colour map (white where there is none) with the alpha of a cut-out map: its own alpha, else its red."""
    alpha = cut_out.pixels[..., 3 if cut_out.has_alpha else 0]
    if color is None:
        return Texture(cut_out.name, np.dstack([np.full((*alpha.shape, 3), 255, np.uint8), alpha]))
    height, width = color.pixels.shape[:2]
    rows = np.arange(height) * alpha.shape[0] // height
    columns = np.arange(width) * alpha.shape[1] // width
    return Texture(color.name, np.dstack([color.pixels[..., :3], alpha[rows[:, None], columns]]))
