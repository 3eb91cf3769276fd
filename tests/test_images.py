"""Images in and out, without a bit lost on the way."""

import resource
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its documentation uses
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from treebake.errors import InputError, WorkspaceError
from treebake.images import (
    bilinear,
    bleed,
    decode_image,
    encode_floats,
    encode_png,
    flip_error,
    mean_texel,
    mip_chain,
    read_image,
    to_linear,
    to_srgb,
    write_png,
)
from treebake.model import AlphaMode, Material, Texture

GREY, RGB, PALETTE, GREY_ALPHA, RGBA = 0, 2, 3, 4, 6  # PNG's colour types


def png(rows: np.ndarray, kind: int, depth: int = 8, chunks: tuple[tuple[bytes, bytes], ...] = ()) -> bytes:
    """A PNG file by the letter of the specification, so that what is read was not written by the same library."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", rows.shape[1], rows.shape[0], depth, kind, 0, 0, 0)
    body = b"".join(b"\0" + row.tobytes() for row in rows)
    parts = [(b"IHDR", head), *chunks, (b"IDAT", zlib.compress(body)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


def chunks_of(data: bytes) -> list[tuple[bytes, bytes]]:
    """Name and content of every chunk."""
    found, at = [], 8
    while at < len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        found.append((name, data[at + 8 : at + 8 + size]))
        at += 12 + size
    return found


def noise(channels: int, size: tuple[int, int] = (5, 7), seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*size, channels), np.uint8)


def opaque(colour: np.ndarray) -> np.ndarray:
    return np.concatenate([colour, np.full((*colour.shape[:2], 1), 255, np.uint8)], axis=2)


# ---- reading -------------------------------------------------------------------------------------------------------


def test_rgba_keeps_the_colour_of_clear_texels() -> None:
    # Alpha in PNG is unassociated: what lies under alpha 0 is the author's bleed, and mips need it.
    pixels = noise(4)
    pixels[..., 3] = np.arange(35).reshape(5, 7) * 7
    pixels[0, :, 3] = 0
    assert (decode_image(png(pixels, RGBA), "leaf") == pixels).all()


def test_rgb_is_opaque() -> None:
    pixels = noise(3)
    assert (decode_image(png(pixels, RGB), "bark") == opaque(pixels)).all()


def test_grey_becomes_rgb() -> None:
    pixels = noise(1)
    assert (decode_image(png(pixels, GREY), "mask") == opaque(pixels.repeat(3, axis=2))).all()


def test_grey_with_alpha() -> None:
    pixels = noise(2)
    expected = np.concatenate([pixels[..., :1].repeat(3, axis=2), pixels[..., 1:]], axis=2)
    assert (decode_image(png(pixels, GREY_ALPHA), "mask") == expected).all()


@pytest.mark.parametrize("with_alpha", [False, True], ids=["opaque", "tRNS"])
def test_palette_is_resolved(with_alpha: bool) -> None:
    colours, alphas = noise(3, (1, 4))[0], np.array([0, 80, 255, 255], np.uint8)
    indices = np.array([[0, 1, 2], [3, 2, 0]], np.uint8)
    extra = ((b"PLTE", colours.tobytes()), *([(b"tRNS", alphas.tobytes())] if with_alpha else []))
    found = decode_image(png(indices[..., None], PALETTE, chunks=extra), "leaf")
    assert (found[..., :3] == colours[indices]).all()
    assert (found[..., 3] == (alphas[indices] if with_alpha else 255)).all()


def test_a_gamma_chunk_changes_nothing() -> None:
    # glTF: colour-space information in an image must be ignored.
    pixels = noise(3)
    marked = png(pixels, RGB, chunks=((b"gAMA", struct.pack(">I", 100_000)),))
    assert (decode_image(marked, "normals") == opaque(pixels)).all()


def test_sixteen_bits_are_rounded_to_eight() -> None:
    pixels = noise(3)
    assert (decode_image(png((pixels.astype(">u2") * 257), RGB, depth=16), "bark") == opaque(pixels)).all()


@pytest.mark.parametrize("suffix", ["jpg", "webp", "tif"])
def test_other_formats(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"flat.{suffix}"
    spec = oiio.ImageSpec(16, 16, 3, oiio.UINT8)
    target = oiio.ImageOutput.create(str(path))
    target.open(str(path), spec)
    target.write_image(np.full((16, 16, 3), (200, 100, 50), np.uint8))
    target.close()
    for found in (read_image(path), decode_image(path.read_bytes(), "flat")) if suffix != "tif" else [read_image(path)]:
        assert found.shape == (16, 16, 4)
        assert np.allclose(found, (200, 100, 50, 255), atol=3)


def test_row_0_is_on_top(tmp_path: Path) -> None:
    pixels = np.zeros((3, 2, 3), np.uint8)
    pixels[0] = 255
    path = tmp_path / "top.png"
    path.write_bytes(png(pixels, RGB))
    assert read_image(path)[:, 0, 0].tolist() == [255, 0, 0]


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.png cannot be read as an image; give a PNG"):
        read_image(tmp_path / "none.png")


@pytest.mark.parametrize("data", [b"", b"not an image", b"\x89PNG\r\n\x1a\nrest", b"\xff\xd8\xff\xe0 cut off"])
def test_what_is_no_image_is_named(data: bytes, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the image leaf cannot be decoded; export it again"):
        decode_image(data, "leaf")
    path = tmp_path / "leaf.png"
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"leaf\.png"):
        read_image(path)


def test_truncated_file_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "half.png"
    whole = png(noise(4, (64, 64)), RGBA)
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"half\.png is a damaged image \(.+\); export it again"):
        read_image(path)


def test_an_error_does_not_linger() -> None:
    # OpenImageIO keeps errors per thread and complains at exit of those nobody asked for.
    with pytest.raises(InputError):
        decode_image(b"no", "leaf")
    assert oiio.geterror() == ""


# ---- writing -------------------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    st.sampled_from([3, 4]).flatmap(
        lambda channels: arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(channels)))
    )
)
def test_png_round_trip_is_exact(pixels: np.ndarray) -> None:
    found = decode_image(encode_png(pixels), "made")
    assert (found[..., : pixels.shape[2]] == pixels).all()
    assert pixels.shape[2] == 4 or (found[..., 3] == 255).all()


@pytest.mark.parametrize("channels", [3, 4])
def test_png_holds_pixels_and_nothing_else(channels: int) -> None:
    # No date, no tool, and no colour space: a normal map that says sRGB is bent by readers that believe it.
    data = encode_png(noise(channels))
    assert data == encode_png(noise(channels))
    assert [name for name, _ in chunks_of(data)] == [b"IHDR", b"IDAT", b"IEND"]


def test_a_view_of_an_array_is_written_right(tmp_path: Path) -> None:
    pixels = noise(4)[::-1, :, :3]
    write_png(tmp_path / "view.png", pixels)
    assert (read_image(tmp_path / "view.png")[..., :3] == pixels).all()


def test_a_png_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(WorkspaceError, match=r"file/a\.png cannot be written"):
        write_png(tmp_path / "file" / "a.png", noise(3))


def test_full_disk_is_not_taken_for_success() -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))  # bytes a file
    try:
        with pytest.raises(WorkspaceError, match=r"image\.png cannot be written \([^\n]+\); free some space"):
            encode_png(noise(4, (256, 256)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def stored(data: bytes, path: Path, kind: object) -> np.ndarray:
    """The values of an image file in the type in which they are stored."""
    path.write_bytes(data)
    file = oiio.ImageInput.open(str(path))
    assert file.spec().format == kind
    return np.asarray(file.read_image(kind))


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (2, 1024)])
def test_words_round_trip_as_a_grey_png(size: tuple[int, int], tmp_path: Path) -> None:
    words = np.random.default_rng(0).integers(0, 1 << 16, size, np.uint16)
    words.flat[-1] = 0xFF00  # the bytes of a word are not swapped
    found = stored(encode_png(words), tmp_path / "words.png", oiio.UINT16)
    assert found.shape == (*size, 1)
    assert (found[..., 0] == words).all()
    assert [name for name, _ in chunks_of(encode_png(words))] == [b"IHDR", b"IDAT", b"IEND"]


def test_words_are_grey_by_the_letter_of_the_specification() -> None:
    head = dict(chunks_of(encode_png(np.zeros((2, 3), np.uint16))))[b"IHDR"]
    assert struct.unpack(">IIBBBBB", head) == (3, 2, 16, GREY, 0, 0, 0)


@settings(max_examples=25, deadline=None)
@given(arrays(np.uint32, st.tuples(st.integers(1, 5), st.integers(1, 9), st.just(4))))
def test_floats_round_trip_to_the_bit(tmp_path_factory: pytest.TempPathFactory, bits: np.ndarray) -> None:
    # Any bits: NaN, infinities, -0.0 and subnormal numbers are among them, and the fourth value is no alpha.
    table = bits.view(np.float32)
    found = stored(encode_floats(table), tmp_path_factory.getbasetemp() / "table.exr", oiio.FLOAT)
    assert found.shape == table.shape
    assert found.tobytes() == table.tobytes()


def test_a_table_says_nothing_of_when_it_was_written(tmp_path: Path) -> None:
    table = np.ones((2, 3, 4), np.float32)
    path = tmp_path / "table.exr"
    path.write_bytes(encode_floats(table))
    dated = oiio.ImageInput.open(str(path)).spec().get_string_attribute("DateTime", "none")
    assert dated[:4] < "2000" or dated == "none"  # the day of writing would make every bake another


def test_full_disk_is_not_taken_for_a_written_table() -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    noisy = np.random.default_rng(0).random((128, 128, 4), np.float32)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(WorkspaceError, match=r"table\.exr cannot be written \([^\n]+\); free some space"):
            encode_floats(noisy)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


# ---- mips ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "below"),
    [
        ((1, 1), []),
        ((2, 2), [(1, 1)]),
        ((1, 4), [(1, 2), (1, 1)]),
        ((8, 2), [(4, 1), (2, 1), (1, 1)]),
        ((5, 3), [(2, 1), (1, 1)]),
        ((7, 13), [(3, 6), (1, 3), (1, 1)]),
    ],
)
@pytest.mark.parametrize("srgb", [False, True])
def test_mips_go_down_to_one_texel(size: tuple[int, int], below: list[tuple[int, int]], srgb: bool) -> None:
    pixels = noise(4, size)
    first, *rest = mip_chain(pixels, srgb=srgb)
    assert (first == pixels).all()
    assert [mip.shape for mip in rest] == [(*shape, 4) for shape in below]
    assert all(mip.dtype == np.uint8 for mip in rest)


def test_data_is_averaged_as_it_is() -> None:
    pixels = np.array([[[0, 10, 255, 0], [100, 10, 255, 255]], [[200, 10, 0, 0], [100, 30, 0, 255]]], np.uint8)
    assert mip_chain(pixels, srgb=False)[1].tolist() == [[[100, 15, 128, 128]]]


def test_colour_is_averaged_in_linear_light_and_alpha_as_it_is() -> None:
    pixels = np.array([[[0, 50, 255, 0], [255, 50, 255, 255]]], np.uint8)
    # Half of all light is sRGB 188, not 128.
    assert mip_chain(pixels, srgb=True)[1].tolist() == [[[188, 50, 255, 128]]]


def test_a_lone_last_row_is_left_out() -> None:
    pixels = np.zeros((3, 2, 4), np.uint8)
    pixels[:2], pixels[2] = 100, 255
    assert (mip_chain(pixels, srgb=False)[1] == 100).all()


def test_mips_are_not_rounded_on_the_way() -> None:
    # 1, 0, 0, 0 four times over: 0.25 rounds to 0, so that rounded mips of 0.5 in two texels would be lost as well.
    pixels = np.zeros((4, 4, 4), np.uint8)
    pixels[0::2, 0::2] = 2  # a quarter of the texels: 0.5 in every mip
    pixels[0, 1] = 1  # and a little more in one
    assert mip_chain(pixels, srgb=False)[2].tolist() == [[[1] * 4]]


# ---- colour --------------------------------------------------------------------------------------------------------


def test_srgb_and_linear_are_inverse_on_every_value() -> None:
    values = np.arange(256, dtype=np.uint8)
    linear = to_linear(values)
    assert linear.dtype == np.float32
    assert (to_srgb(linear) == values).all()
    assert (np.diff(linear) > 0).all()
    assert linear[[0, 255]].tolist() == [0, 1]
    assert linear[188] == pytest.approx(0.5029, abs=1e-4)  # IEC 61966-2-1
    assert linear[10] == pytest.approx(10 / 255 / 12.92)


def test_light_beyond_0_to_1_is_clipped() -> None:
    assert to_srgb(np.array([-1, -1e-9, 0, 1, 1.5, 1e9], np.float32)).tolist() == [0, 0, 0, 255, 255, 255]


@given(st.floats(0, 1, width=32))
def test_srgb_lies_between_its_neighbours(light: float) -> None:
    code = int(to_srgb(np.array(light, np.float32)))
    linear = to_linear(np.arange(256, dtype=np.uint8))
    assert linear[max(code - 1, 0)] <= light <= linear[min(code + 1, 255)]


# ---- bleed ---------------------------------------------------------------------------------------------------------


def test_holes_take_the_colour_around_them() -> None:
    red, blue = np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.1, 0.8])
    pixels = np.zeros((32, 64, 4), np.float32)
    pixels[8:24, 8:24] = [*red, 1]
    pixels[8:24, 40:56] = [*blue, 1]
    filled = bleed(pixels)
    assert np.allclose(filled[8:24, 8:24], red, atol=1e-5)
    assert np.allclose(filled[16, 26], red, atol=0.1)  # two texels out
    assert np.allclose(filled[16, 37], blue, atol=0.1)
    assert filled.max(axis=2).min() > 0.3  # no black anywhere
    assert np.allclose(filled[..., 1], 0.1, atol=1e-3)


def test_half_covered_texels_keep_their_own_colour() -> None:
    pixels = np.full((8, 8, 4), 0.0, np.float32)
    pixels[4, 4] = np.array([0.6, 0.4, 0.2, 1]) * 0.25
    assert np.allclose(bleed(pixels)[4, 4], (0.6, 0.4, 0.2), atol=1e-5)


@pytest.mark.parametrize("shape", [(1, 1), (1, 8), (64, 32)])
def test_bleed_of_nothing_is_finite(shape: tuple[int, int]) -> None:
    assert np.isfinite(bleed(np.zeros((*shape, 4), np.float32))).all()


@pytest.mark.parametrize("shape", [(1, 1), (2, 64), (64, 32)])
def test_bleed_of_one_texel_reaches_everywhere(shape: tuple[int, int]) -> None:
    pixels = np.zeros((*shape, 4), np.float32)
    pixels[0, 0] = (0.2, 0.4, 0.6, 1)
    assert np.allclose(bleed(pixels), (0.2, 0.4, 0.6), atol=1e-3)


# ---- FLIP ----------------------------------------------------------------------------------------------------------


def test_flip_of_an_image_with_itself_is_zero() -> None:
    image = np.random.default_rng(1).random((40, 50, 3), np.float32)
    error = flip_error(image, image)
    assert error.shape == (40, 50)
    assert not error.any()


def test_flip_of_black_and_white_is_one() -> None:
    error = flip_error(np.zeros((24, 24, 3), np.float32), np.ones((24, 24, 3), np.float32))
    assert error.mean() > 0.9
    assert error.max() <= 1


def test_flip_sees_where_the_difference_is() -> None:
    reference = np.full((64, 64, 3), 0.2, np.float32)
    test = reference.copy()
    test[20, 40] = 0.9
    error = flip_error(reference, test)
    assert np.unravel_index(error.argmax(), error.shape) == (20, 40)
    assert error[:8].max() == 0


# ---- means and lookups ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("mode", "mean"),
    [
        (AlphaMode.OPAQUE, 0.5),  # all count alike
        (AlphaMode.MASK, 0.0),  # the black one alone is drawn
        (AlphaMode.BLEND, 0.25),  # a third as much white is seen as black
    ],
)
def test_the_mean_of_what_is_drawn(mode: AlphaMode, mean: float) -> None:
    image = Texture("leaf", np.array([[[255, 255, 255, 80], [0, 0, 0, 240]]], np.uint8))
    found = mean_texel(image, Material("leaf", color_map=image, alpha_mode=mode))
    assert found[:3] == pytest.approx(mean)
    # Of another map too, however large, where the colour map is drawn.
    larger = Texture("larger", np.repeat(image.pixels, 3, axis=1))
    assert mean_texel(larger, Material("leaf", color_map=image, alpha_mode=mode)) == pytest.approx(found)


@pytest.mark.parametrize("mode", list(AlphaMode))
def test_where_nothing_is_drawn_all_texels_count(mode: AlphaMode) -> None:
    clear = Texture("clear", np.array([[[255, 255, 255, 0], [0, 0, 0, 0]]], np.uint8))
    assert mean_texel(clear, Material("leaf", color_map=clear, alpha_mode=mode))[:3] == pytest.approx(0.5)


def test_lookups_are_linear_between_texels_and_wrap() -> None:
    pixels = np.array([[[0] * 4, [255] * 4], [[51] * 4, [255] * 4]], np.uint8)
    places = np.array([(0.25, 0.25), (0.5, 0.25), (0.25, 0.5), (0.0, 0.25), (3.25, -0.25)])
    found = bilinear(pixels, places, srgb=False)
    np.testing.assert_allclose(found, np.array([0, 0.5, 0.1, 0.5, 0.2])[:, None].repeat(3, axis=1), atol=1e-6)
