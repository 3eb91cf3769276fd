"""The container level of glTF 2.0: chunks, buffers, accessors and images, by index."""

import base64
import json
import struct
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from treebake.errors import InputError, MeshError, UnsupportedError
from treebake.formats.part import LOG, beside, texture_beside
from treebake.images import decode_image
from treebake.model import Floats, Texture

Array = NDArray[Any]

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class GltfFile:
    """An open .glb or .gltf file.

    json: the document. Raises MeshError where the file is truncated or no glTF 2.0; the lookups raise InputError,
    MeshError, or KeyError, IndexError, TypeError, ValueError where the document contradicts itself.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        data = path.read_bytes()
        chunks = _chunks(path, data) if data[:4] == b"glTF" else {b"JSON": data}
        self.json = _document(path, chunks.get(b"JSON", b""))
        self._binary = chunks.get(b"BIN\0", b"")
        self._buffer = cache(self._read_buffer)
        self._image = cache(self._read_image)

    def view(self, index: int) -> bytes:
        """The bytes of a buffer view."""
        view = self.json["bufferViews"][index]
        start = view.get("byteOffset", 0)
        data = self._buffer(view["buffer"])[start : start + view["byteLength"]]
        if len(data) < view["byteLength"]:
            raise MeshError(f"{self.path} is truncated: buffer view {index} is incomplete; export or download it again")
        return data

    def accessor(self, index: int) -> Array:
        """The values of an accessor: (count, width) in the stored type, or float32 where it is normalised."""
        spec = self.json["accessors"][index]
        count, dtype, width = spec["count"], np.dtype(_DTYPES[spec["componentType"]]), _WIDTHS[spec["type"]]
        if "bufferView" in spec:
            values = self._elements(spec["bufferView"], spec.get("byteOffset", 0), count, dtype, width)
        elif count > sum(len(self._buffer(i)) for i in range(len(self.json.get("buffers", [])))):
            # Nothing stands for its zeros in the file, so only this keeps a damaged count from filling the memory.
            raise MeshError(f"{self.path} is damaged: accessor {index} has {count} elements, no data; export it again")
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in spec:
            sparse = spec["sparse"]
            where, what = sparse["indices"], sparse["values"]
            kind = np.dtype(_DTYPES[where["componentType"]])
            rows = self._elements(where["bufferView"], where.get("byteOffset", 0), sparse["count"], kind, 1)
            values = values.copy()
            values[rows[:, 0]] = self._elements(
                what["bufferView"], what.get("byteOffset", 0), sparse["count"], dtype, width
            )
        return unit_range(values) if spec.get("normalized") else values

    def texture(self, index: int) -> Texture | None:
        """The image of a texture; None, and one warning, where it is missing, damaged or of an unread kind."""
        texture = self.json["textures"][index]
        webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
        source = webp.get("source", texture.get("source"))
        if source is None:
            LOG.warning("%s: texture %d has no PNG, JPEG or WebP image; going on without it", self.path, index)
            return None
        return self._image(source)

    def _elements(self, view: int, offset: int, count: int, dtype: np.dtype[Any], width: int) -> Array:
        data = self.view(view)
        size = dtype.itemsize * width
        stride = self.json["bufferViews"][view].get("byteStride") or size
        if count and offset + stride * (count - 1) + size > len(data):
            raise MeshError(f"{self.path} is damaged: an accessor leaves buffer view {view}; export it again")
        return np.ndarray((count, width), dtype, data, offset, (stride, dtype.itemsize))

    def _read_buffer(self, index: int) -> bytes:
        uri = self.json["buffers"][index].get("uri")
        if uri is None:
            return self._binary
        if uri.startswith("data:"):
            return _data_uri(uri)
        file = beside(self.path, uri)
        try:
            return file.read_bytes()
        except OSError as error:
            raise InputError(f"{self.path} needs {file}, which cannot be read; put it there") from error

    def _read_image(self, index: int) -> Texture | None:
        image = self.json["images"][index]
        uri = image.get("uri", "")
        if uri and not uri.startswith("data:"):
            return texture_beside(self.path, uri)
        name = image.get("name") or f"image {index}"
        try:
            return Texture(name, decode_image(_data_uri(uri) if uri else self.view(image["bufferView"]), name))
        except InputError as error:
            LOG.warning("%s: %s; going on without this texture", self.path, error)
            return None


def unit_range(values: Array) -> Array:
    """Normalised integers as float32 in 0..1 or -1..1; floats as they are."""
    if values.dtype.kind == "f":
        return values
    scaled: Floats = values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)
    return np.asarray(np.maximum(scaled, -1), np.float32)


def _chunks(path: Path, data: bytes) -> dict[bytes, bytes]:
    if len(data) < 20:
        raise MeshError(f"{path} is truncated: {len(data)} bytes; export or download it again")
    _, version, length = struct.unpack_from("<4sII", data)
    if version != 2:
        raise UnsupportedError(f"{path} is binary glTF {version}; convert it to glTF 2.0")
    if length > len(data):
        raise MeshError(f"{path} is truncated: {len(data)} of {length} bytes; export or download it again")
    chunks: dict[bytes, bytes] = {}
    offset = 12
    while offset + 8 <= length:
        size, kind = struct.unpack_from("<I4s", data, offset)
        chunks.setdefault(kind, data[offset + 8 : offset + 8 + size])
        offset += 8 + size
    return chunks


def _document(path: Path, data: bytes) -> dict[str, Any]:
    try:
        document = json.loads(data, parse_constant=_no_number)
        version = str(document["asset"]["version"])
    except (ValueError, KeyError, TypeError) as error:
        raise MeshError(f"{path} is damaged or no glTF file; export or download it again") from error
    if not version.startswith("2."):
        raise UnsupportedError(f"{path} is glTF {version}; convert it to glTF 2.0")
    found: dict[str, Any] = document
    return found


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def _data_uri(uri: str) -> bytes:
    head, _, body = uri.partition(",")
    data = unquote_to_bytes(body)
    return base64.b64decode(data) if head.endswith(";base64") else data
