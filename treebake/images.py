"""Images in and out, and the FLIP metric: everything that touches OpenImageIO.

In memory an image is a numpy array, row 0 on top: (h, w, 4) uint8 as stored in files, or float32 where it is light.
"""

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its documentation uses
from numpy.typing import NDArray

from treebake.errors import InputError, WorkspaceError
from treebake.files import atomic
from treebake.model import AlphaMode, Bytes, Doubles, Floats, Material, Texture

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec. 709


def read_image(path: Path) -> Bytes:
    """Read any common image file as (h, w, 4) uint8; a missing alpha is 255, a palette is resolved.

    Raises InputError where the file is missing or no image.
    """
    keep_alpha_unassociated = oiio.ImageSpec()
    keep_alpha_unassociated.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), keep_alpha_unassociated)
    if source is None:
        oiio.geterror()
        raise InputError(f"{path} cannot be read as an image; give a PNG, JPEG, WebP, TIFF or EXR file")
    pixels = source.read_image(oiio.UINT8)
    source.close()
    if pixels is None:
        raise InputError(f"{path} is a damaged image ({_line(source.geterror())}); export it again")
    return _rgba(pixels)


def decode_image(data: bytes, name: str) -> Bytes:
    """Decode an image file held in memory, as `read_image` does; `name` is for the message.

    Raises InputError where the bytes are no image.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"image{_suffix(data)}"
        path.write_bytes(data)
        try:
            return read_image(path)
        except InputError:
            raise InputError(f"the image {name} cannot be decoded; export it again as PNG or JPEG") from None


def encode_png(pixels: Bytes | NDArray[np.uint16]) -> bytes:
    """Encode (h, w, 3 or 4) uint8 or grey (h, w) uint16 as PNG, alpha unassociated as glTF wants it.

    The same pixels give the same bytes. Raises WorkspaceError where there is no room for a temporary file.
    """
    return _pixels_only(_encode(pixels.reshape(*pixels.shape[:2], -1), "image.png"))


def encode_floats(table: Floats) -> bytes:
    """Encode a table (h, w, 4) float32 as EXR, to the bit."""
    return _encode(table, "table.exr")


_NO_DATE = "1970:01:01 00:00:00"  # EXR would have the time of writing, and files would differ


def _encode(pixels: NDArray[Any], name: str) -> bytes:
    height, width, channels = pixels.shape
    kinds = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float32": oiio.FLOAT}
    spec = oiio.ImageSpec(width, height, channels, kinds[pixels.dtype.name])
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("png:compressionLevel", 6)
    spec.attribute("DateTime", _NO_DATE)
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        target = oiio.ImageOutput.create(str(path))
        written = target.open(str(path), spec) and target.write_image(np.ascontiguousarray(pixels)) and target.close()
        error = target.geterror()  # a full disk is told here only
        if error or not written:
            raise WorkspaceError(f"{path} cannot be written ({_line(error)}); free some space")
        return path.read_bytes()


@lru_cache(maxsize=32)  # an asset has some twenty
def encode_texture(texture: Texture, *, with_alpha: bool) -> bytes:
    """Encode a texture as PNG, with or without its alpha; kept, because it goes into GLBs and beside them."""
    return encode_png(texture.pixels if with_alpha else texture.pixels[..., :3])


def write_png(path: Path, pixels: Bytes) -> None:
    """Write (h, w, 3 or 4) uint8 as `encode_png` encodes it, whole or not at all.

    Raises WorkspaceError where the file cannot be written.
    """
    with atomic(path) as file:
        file.write(encode_png(pixels))


def to_linear(srgb: Bytes) -> Floats:
    """Decode sRGB uint8 to linear float32 in 0..1 (IEC 61966-2-1)."""
    return _LINEAR[srgb]


def to_srgb(linear: Floats) -> Bytes:
    """Encode linear 0..1 to sRGB uint8; values outside are clipped."""
    x = np.clip(linear, 0, 1)
    encoded = np.where(x <= 0.0031308, x * 12.92, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(encoded * 255), np.uint8)


def mean_texel(texture: Texture, material: Material) -> Doubles:
    """The mean linear RGB, and alpha, of a texture's texels where a material's colour map is drawn: (4,) float64, 0..1.

    What is blended counts by its alpha. The texture may be of another size than the colour map. Where nothing is drawn,
    or there is no such map, all count.
    """
    height, width = texture.pixels.shape[:2]
    shown = np.ones((height, width))
    if material.color_map and material.alpha_mode is not AlphaMode.OPAQUE:
        alpha = material.color_map.pixels[..., 3]
        rows, columns = (np.arange(n) * there // n for n, there in zip((height, width), alpha.shape, strict=True))
        alpha = alpha[np.ix_(rows, columns)]
        blended = material.alpha_mode is AlphaMode.BLEND
        drawn = alpha / 255 if blended else (alpha >= max(material.alpha_cutoff * 255, 1)).astype(np.float64)
        shown = drawn if drawn.any() else shown
    counts = [np.bincount(texture.pixels[..., c].reshape(-1), shown.reshape(-1), minlength=256) for c in range(4)]
    values = [*[_LINEAR.astype(np.float64)] * 3, np.arange(256) / 255]
    mean: Doubles = np.array([count @ value for count, value in zip(counts, values, strict=True)]) / shown.sum()
    return mean


def bilinear(pixels: Bytes, uvs: Doubles, *, srgb: bool) -> Doubles:
    """An image that repeats, filtered in linear light at texture coordinates (N, 2): RGB, (N, 3) float64."""
    height, width = pixels.shape[:2]
    values = to_linear(pixels[..., :3]) if srgb else pixels[..., :3].astype(np.float32) / np.float32(255)
    place = uvs * (width, height) - 0.5
    low = np.floor(place).astype(np.int64)
    (x, y), (right, down) = low.T, (place - low).T[..., None]
    left_x, right_x, top_y, bottom_y = x % width, (x + 1) % width, y % height, (y + 1) % height
    top = values[top_y, left_x] * (1 - right) + values[top_y, right_x] * right
    bottom = values[bottom_y, left_x] * (1 - right) + values[bottom_y, right_x] * right
    return np.asarray(top * (1 - down) + bottom * down, np.float64)


def bleed(pixels: Floats) -> Floats:
    """Fill what the coverage leaves open with the colours around it, by push-pull (Gortler et al. 1996).

    pixels: (h, w, 4) float32, premultiplied by its last channel. Returns (h, w, 3) float32, defined everywhere.
    """
    filled = oiio.ImageBufAlgo.fillholes_pushpull(_buffer(pixels))
    result = np.asarray(filled.get_pixels(oiio.FLOAT), np.float32)
    return np.asarray(result[..., :3] / np.maximum(result[..., 3:], 1e-6), np.float32)


def color_texels(color: Floats) -> Bytes:
    """sRGB texels of a premultiplied linear image (h, w, 4): (h, w, 3) uint8.

    Colours are bled under the transparent texels, so that no mip mixes in black.
    """
    return to_srgb(bleed(color))


def normal_texels(normal: Floats, coverage: Floats) -> Bytes:
    """Tangent-space normals as glTF packs them, bled like the colour: (h, w, 4) uint8, alpha 255.

    normal: (h, w, 3) float32, premultiplied by coverage (h, w). None of the result points away from the viewer.
    """
    spread = bleed(np.concatenate([normal, coverage[..., None]], axis=2))
    spread[..., 2] = np.maximum(spread[..., 2], 0.05)
    spread /= np.linalg.norm(spread, axis=2, keepdims=True)
    texels = np.full((*coverage.shape, 4), 255, np.uint8)
    texels[..., :3] = np.rint((spread * 0.5 + 0.5) * 255)
    return texels


def value_texels(values: Floats, coverage: Floats) -> Bytes:
    """A value in 0..1, premultiplied by coverage, bled like the colour: both (h, w) float32, gives (h, w) uint8."""
    spread = bleed(np.dstack([values, values, values, coverage]))[..., 0]
    return np.asarray(np.rint(np.clip(spread, 0, 1) * 255), np.uint8)


def occlusion_map(name: str, sky: Floats, coverage: Floats) -> Texture | None:
    """The part of the sky that is seen, premultiplied by coverage, as a grey map of half the size each way: smooth.

    sky, coverage: (h, w) float32; a side that is odd stays whole. Bled like the colour. None where all sees all.
    """
    if np.array_equal(sky, coverage):
        return None
    both = np.dstack([sky, coverage])
    for axis in (0, 1):
        if both.shape[axis] % 2 == 0:
            both = _halved(both, axis)
    grey = value_texels(both[..., 0], both[..., 1])
    return Texture(name, np.dstack([grey, grey, grey, np.full_like(grey, 255)]))


def mip_chain(pixels: Bytes, *, srgb: bool) -> list[Bytes]:
    """A texture (h, w, 4) uint8 and its mips down to one texel, averaged 2 x 2 as a graphics driver does.

    srgb: whether RGB is averaged in linear light. Of an odd side the last row or column is left out.
    """
    values: Floats = pixels.astype(np.float32) / np.float32(255)
    if srgb:
        values[..., :3] = to_linear(pixels[..., :3])
    chain = [pixels]
    while max(values.shape[:2]) > 1:
        values = _halved(_halved(values, 0), 1)
        color = to_srgb(values[..., :3]) if srgb else np.rint(values[..., :3] * 255).astype(np.uint8)
        chain.append(np.dstack([color, np.rint(values[..., 3] * 255).astype(np.uint8)]))
    return chain


def _halved(values: Floats, axis: int) -> Floats:
    count = values.shape[axis] // 2
    if not count:
        return values
    pairs = np.moveaxis(values, axis, 0)[: 2 * count]
    return np.asarray(np.moveaxis((pairs[::2] + pairs[1::2]) / 2, 0, axis), np.float32)


def flip_error(reference: Floats, test: Floats) -> Floats:
    """LDR-FLIP error map of two linear (h, w, 3) float32 images at 67 pixels per degree: (h, w) float32 in 0..1."""
    result = oiio.ImageBufAlgo.FLIP_diff(_buffer(reference), _buffer(test), hdr=0)
    return np.asarray(result.get_pixels(oiio.FLOAT), np.float32)[..., 0]


def _buffer(pixels: Floats) -> "oiio.ImageBuf":
    return oiio.ImageBuf(np.ascontiguousarray(pixels, np.float32))


def _line(error: str) -> str:
    return error.partition("\n")[0]


def _pixels_only(png: bytes) -> bytes:
    """Drop every chunk that PNG calls ancillary: a normal map must not claim to be sRGB."""
    kept, start = [png[:8]], 8
    while start < len(png):
        end = start + 12 + int.from_bytes(png[start : start + 4], "big")
        if png[start + 4 : start + 5].isupper():
            kept.append(png[start:end])
        start = end
    return b"".join(kept)


def _rgba(pixels: Bytes) -> Bytes:
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    colour, alpha = {1: (0, None), 2: (0, 1)}.get(pixels.shape[2], (slice(0, 3), 3 if pixels.shape[2] > 3 else None))
    result = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    result[..., :3] = pixels[..., colour] if isinstance(colour, slice) else pixels[..., colour, None]
    if alpha is not None:
        result[..., 3] = pixels[..., alpha]
    return result


def _suffix(data: bytes) -> str:
    if data[:4] == b"\x89PNG":
        return ".png"
    return ".webp" if data[8:12] == b"WEBP" else ".jpg"


def _linear_table() -> Floats:
    x = np.arange(256) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


_LINEAR = _linear_table()
