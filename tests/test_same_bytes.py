"""A flat atlas at another's price: the same mesh, its textures replaced by the first mips that fit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.synthetic import joined, quad
from treebake.compression import block_bytes
from treebake.images import mip_chain
from treebake.model import AlphaMode, Material, Mesh, Texture
from treebake.verify.same_bytes import with_texture_bytes


def noise(name: str, size: tuple[int, int] = (8, 8)) -> Texture:
    return Texture(name, np.random.default_rng(len(name)).integers(0, 256, (*size, 4), np.uint8))


def masked(size: tuple[int, int] = (8, 8)) -> Material:
    color, normal = noise("color", size), noise("normals", size)
    return Material("leaf", color_map=color, normal_map=normal, alpha_mode=AlphaMode.MASK)


def sizes(mesh: Mesh) -> list[tuple[int, int]]:
    return [image.pixels.shape[:2] for material in mesh.materials for image in material.maps.values()]


@pytest.mark.parametrize(
    ("limit", "side"),
    # Two images of 8 x 8 texels with their mips are 2 x (4 + 1 + 1 + 1) blocks of 16 bytes.
    [(10**9, 8), (224, 8), (223, 4), (96, 4), (95, 2), (64, 2), (63, 1), (32, 1)],
)
def test_the_first_mip_that_fits_is_taken(limit: int, side: int) -> None:
    assert sizes(with_texture_bytes(quad(masked()), limit)) == [(side, side)] * 2


@pytest.mark.parametrize("limit", [31, 1, 0])
def test_a_limit_below_one_texel_ends_at_one_texel(limit: int) -> None:
    assert sizes(with_texture_bytes(quad(masked()), limit)) == [(1, 1)] * 2


@pytest.mark.parametrize("shape", [(1, 64), (48, 5), (33, 33)])
def test_odd_shapes_go_down_as_their_mips_do(shape: tuple[int, int]) -> None:
    found = {sizes(with_texture_bytes(quad(masked(shape)), limit))[0] for limit in range(0, 6000, 16)}
    assert found == {mip.shape[:2] for mip in mip_chain(noise("color", shape).pixels, srgb=True)}


@pytest.mark.parametrize("name", ["occlusion_map", "roughness_map"])
def test_every_map_counts_and_shrinks(name: str) -> None:
    three = replace(masked(), **{name: noise("linear")})
    assert sizes(with_texture_bytes(quad(three), 3 * 112)) == [(8, 8)] * 3
    (material,) = with_texture_bytes(quad(three), 3 * 112 - 1).materials
    assert sizes(quad(material)) == [(4, 4)] * 3
    assert (material.maps[name].pixels == mip_chain(noise("linear").pixels, srgb=False)[1]).all()


def test_texels_are_those_of_the_mip() -> None:
    (material,) = with_texture_bytes(quad(masked()), 96).materials
    assert material.color_map is not None
    assert material.normal_map is not None
    assert (material.color_map.pixels == mip_chain(noise("color").pixels, srgb=True)[1]).all()
    assert (material.normal_map.pixels == mip_chain(noise("normals").pixels, srgb=False)[1]).all()


def test_all_but_the_textures_stays() -> None:
    mesh = quad(replace(masked(), alpha_cutoff=0.3, double_sided=True, base_color=(1.0, 0.5, 1.0, 1.0)))
    small = with_texture_bytes(mesh, 32)
    assert replace(small, materials=mesh.materials).positions is mesh.positions
    assert [getattr(small, name) is getattr(mesh, name) for name in ("uvs", "faces", "face_material")] == [True] * 3
    (material,) = small.materials
    assert (material.alpha_cutoff, material.double_sided, material.base_color) == (0.3, True, (1.0, 0.5, 1.0, 1.0))
    assert material.alpha_mode is AlphaMode.MASK


def test_what_fits_is_unchanged() -> None:
    mesh = quad(masked())
    (material,) = with_texture_bytes(mesh, 224).materials
    assert material.color_map is mesh.materials[0].color_map
    assert material.normal_map is mesh.materials[0].normal_map


@pytest.mark.parametrize("mode", [AlphaMode.OPAQUE, AlphaMode.BLEND])
def test_other_materials_are_left_alone_and_not_counted(mode: AlphaMode) -> None:
    bark = Material("bark", color_map=noise("bark", (64, 64)), alpha_mode=mode)
    assert with_texture_bytes(quad(bark), 0).materials == (bark,)
    both = with_texture_bytes(joined(quad(bark), quad(masked())), 96)
    assert both.materials[0] is bark
    assert sizes(both)[1:] == [(4, 4)] * 2


def test_all_masked_materials_share_the_limit() -> None:
    both = joined(quad(masked()), quad(masked((4, 4))))  # 224 bytes and 96
    assert sizes(with_texture_bytes(both, 320)) == [(8, 8)] * 2 + [(4, 4)] * 2
    assert sizes(with_texture_bytes(both, 319)) == [(4, 4)] * 2 + [(2, 2)] * 2


def test_a_material_may_lack_maps() -> None:
    plain = Material("plain", alpha_mode=AlphaMode.MASK)
    color = replace(plain, color_map=noise("color"))
    assert sizes(with_texture_bytes(quad(color), 111)) == [(4, 4)]  # 7 blocks do not fit
    (material,) = with_texture_bytes(quad(plain), 0).materials
    assert material.color_map is material.normal_map is None


@settings(max_examples=60, deadline=None)
@given(height=st.integers(1, 70), width=st.integers(1, 70), limit=st.integers(32, 20_000))
def test_textures_stay_within_the_limit_and_are_no_smaller_than_they_must_be(
    height: int, width: int, limit: int
) -> None:
    mesh = quad(masked((height, width)))
    (h, w), again = sizes(with_texture_bytes(mesh, limit))
    assert again == (h, w)
    assert 2 * block_bytes(w, h, 16) <= limit
    chain = [mip.shape[:2] for mip in mip_chain(np.zeros((height, width, 4), np.uint8), srgb=False)]
    place = chain.index((h, w))
    assert place == 0 or 2 * block_bytes(chain[place - 1][1], chain[place - 1][0], 16) > limit
