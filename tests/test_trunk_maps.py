"""The maps of simplified trunks: which are made, that they show the source, and what odd trunks do."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stems import empty, flat_shaded, mesh_of, sphere, stem, together
from synthetic import joined

from treebake.errors import SettingsError
from treebake.gl.uv_bake import face_texels
from treebake.images import to_linear
from treebake.model import AlphaMode, MappedTrunk, Material, Mesh, Texture, Transmission, TrunkMaps
from treebake.stages.trunk import TrunkSettings, trunk
from treebake.stages.trunk_maps import TrunkMapSettings, trunk_maps

SMALL = TrunkMapSettings(size=128, height=64)
FULL = stem(radii=np.linspace(0.3, 0.1, 24), sides=16)


def textured(mesh: Mesh, **maps: object) -> Mesh:
    return replace(mesh, materials=(Material("bark", **maps),))


def image(*columns: object) -> Texture:
    """A row of texels, the same in each of 64 rows, 64 texels wide."""
    colors = np.repeat(np.array(columns, np.uint8), 64 // len(columns), axis=0)
    pixels = np.full((64, len(colors), 4), 255, np.uint8)
    pixels[..., :3] = colors
    return Texture("image", pixels)


def baked(simple: Mesh, full: Mesh, settings: TrunkMapSettings = SMALL) -> MappedTrunk:
    return trunk_maps(simple, full, full, None, settings)


def simplified(mesh: Mesh, triangles: int = 60) -> Mesh:
    return trunk(mesh, TrunkSettings(triangles))


def untiled(mesh: Mesh) -> Mesh:
    """The whole mesh within one tile."""
    uvs = mesh.uvs / np.maximum(np.ptp(mesh.uvs, axis=0), 1e-6) * 0.98 + 0.01
    return replace(mesh, uvs=uvs.astype(np.float32))


def shown(mesh: Mesh, texture: Texture) -> np.ndarray:
    """(T, 3) the texels of a texture that lie on faces."""
    size = texture.pixels.shape[0]
    number, _, _ = face_texels(mesh.uvs if mesh.occlusion_uvs is None else mesh.occlusion_uvs, mesh.faces, size)
    return texture.pixels.reshape(-1, 4)[number, :3]


def places(mesh: Mesh, size: int) -> np.ndarray:
    """(T, 3) where those texels lie on the mesh."""
    uvs = mesh.uvs if mesh.occlusion_uvs is None else mesh.occlusion_uvs
    _, face, weights = face_texels(uvs, mesh.faces, size)
    return np.einsum("ni,nij->nj", weights, mesh.positions[mesh.faces[face]])


def test_a_repeating_texture_stays():
    full = textured(FULL, color_map=image((90, 60, 30), (20, 10, 5)))  # v runs to 23
    simple = simplified(full)
    mapped = baked(simple, full)
    assert mapped.mesh is simple
    assert mapped.maps.kind == "tiled"
    # 64 x 64 texels on one segment of 2 / 23 in length, about 1.26 around
    assert mapped.maps.source_density == pytest.approx(64 / np.sqrt(2 / 23 * 1.26), rel=0.05)
    assert mapped.maps.source_density > mapped.maps.density


def test_a_repeating_texture_gets_light_beside_it():
    seen = np.clip(FULL.positions[:, 1] / 2, 0, 1)
    occluded = image((255, 255, 255), (255, 255, 255))
    occluded.pixels[..., :3] = 128
    full = replace(textured(FULL, color_map=image((90, 60, 30)), occlusion_map=occluded), occlusion=seen)
    simple = simplified(full)
    mapped = baked(simple, full)
    (material,) = mapped.mesh.materials
    assert mapped.maps.kind == "tiled"
    assert material.color_map is full.materials[0].color_map
    assert material.occlusion_map is not None
    assert mapped.mesh.occlusion is None  # it is in the map
    assert set(map(tuple, mapped.mesh.uvs)) == set(map(tuple, simple.uvs[simple.used]))
    found = shown(mapped.mesh, material.occlusion_map)
    height = places(mapped.mesh, material.occlusion_map.pixels.shape[0])[:, 1]
    assert np.abs(found[:, 0] / 255 - np.clip(height / 2, 0, 1) * 128 / 255).max() < 0.02  # what both tell, multiplied


def test_a_texture_used_once_is_baked_in_linear_light():
    full = untiled(textured(FULL, color_map=image((200, 40, 40), (40, 40, 200)), base_color=(0.5, 1.0, 1.0, 1.0)))
    mapped = baked(simplified(full), full)
    assert (mapped.maps.kind, mapped.maps.source_density) == ("unique", 0.0)
    (material,) = mapped.mesh.materials
    assert (material.name, material.base_color) == ("trunk", (1, 1, 1, 1))
    found = shown(mapped.mesh, material.color_map)
    where = places(mapped.mesh, material.color_map.pixels.shape[0])
    around = np.mod(np.arctan2(where[:, 0], where[:, 2]) / (2 * np.pi), 1)  # as the texture runs
    red, blue = (np.abs(around - middle) < 0.2 for middle in (0.25, 0.75))
    linear = to_linear(found)
    expected = to_linear(np.array([[200, 40, 40], [40, 40, 200]], np.uint8)) * (0.5, 1, 1)
    assert np.abs(linear[red] - expected[0]).max() < 0.01
    assert np.abs(linear[blue] - expected[1]).max() < 0.01


@pytest.mark.parametrize("mirrored", [False, True])
def test_normals_are_the_full_trunks(mirrored: bool):
    bumpy = stem(radii=0.3 + 0.02 * np.sin(np.arange(60)), sides=24, mirrored=mirrored)
    wavy = mesh_of(bumpy.positions, bumpy.faces, bumpy.uvs)
    mapped = baked(simplified(wavy, 40), wavy)
    texture = mapped.mesh.materials[0].normal_map
    bumps = shown(mapped.mesh, texture) / 255 * 2 - 1
    assert np.abs(np.linalg.norm(bumps, axis=1) - 1).max() < 0.02
    size = texture.pixels.shape[0]
    _, face, weights = face_texels(mapped.mesh.uvs, mapped.mesh.faces, size)
    normals = world_normals(mapped.mesh, face, weights, bumps)
    where = places(mapped.mesh, size)
    nearest = np.linalg.norm(wavy.positions[:, None] - where[None, ::7], axis=2).argmin(axis=0)
    plain = np.einsum("ni,nij->nj", weights, mapped.mesh.normals[mapped.mesh.faces[face]])
    plain /= np.linalg.norm(plain, axis=1, keepdims=True)
    inside = (where[::7, 1] > 0.1) & (where[::7, 1] < 1.9)
    errors = [np.linalg.norm((found[::7] - wavy.normals[nearest])[inside], axis=1).mean() for found in (normals, plain)]
    assert errors[0] < 0.6 * errors[1]


def world_normals(mesh: Mesh, face: np.ndarray, weights: np.ndarray, bumps: np.ndarray) -> np.ndarray:
    """What normal_map.glsl makes of tangent-space normals, by the rule of glTF: +Y is against v."""
    p, uv = mesh.positions[mesh.faces[face]].astype(float), mesh.uvs[mesh.faces[face]].astype(float)
    edges, steps = p[:, 1:] - p[:, :1], uv[:, 1:] - uv[:, :1]
    along_u, along_v = np.moveaxis(np.linalg.solve(steps, edges), 1, 0)
    normal = np.einsum("ni,nij->nj", weights, mesh.normals[mesh.faces[face]].astype(float))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = along_u - normal * (along_u * normal).sum(axis=1, keepdims=True)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    up = np.cross(normal, tangent)
    up *= -np.sign((up * along_v).sum(axis=1, keepdims=True))
    return tangent * bumps[:, :1] + up * bumps[:, 1:2] + normal * bumps[:, 2:]


def test_plain_materials_keep_their_factors():
    full = textured(FULL, base_color=(0.2, 0.1, 0.05, 1.0), roughness=0.7, metallic=0.1)
    (material,) = baked(simplified(full), full).mesh.materials
    assert (material.base_color, material.color_map) == ((0.2, 0.1, 0.05, 1.0), None)
    assert (material.roughness, material.metallic, material.roughness_map) == (0.7, 0.1, None)
    assert material.occlusion_map is None


def test_two_materials_one_with_a_texture():
    left = untiled(textured(FULL, color_map=image((200, 0, 0)), roughness=0.5))
    right = replace(stem(radii=[0.2] * 24, sides=16, at=(2, 0, 0)), materials=(Material("moss", (0, 1, 0, 1)),))
    full = joined(left, right)
    mapped = baked(simplified(full, 120), full)
    (material,) = mapped.mesh.materials
    assert mapped.maps.kind == "unique"
    where = places(mapped.mesh, material.color_map.pixels.shape[0])[:, 0] > 1
    found = shown(mapped.mesh, material.color_map).astype(int)
    assert np.abs(found[~where] - (200, 0, 0)).max() <= 1
    assert np.abs(found[where] - (0, 255, 0)).max() <= 1
    rough = shown(mapped.mesh, material.roughness_map).astype(int)  # the factors differ
    assert (material.roughness, material.metallic, material.occlusion_map) == (1, 1, None)
    assert np.abs(rough[:, 1:] - np.where(where[:, None], (255, 0), (128, 0))).max() <= 1


def test_one_image_holds_occlusion_roughness_and_metal():
    rough = image((0, 100, 50))
    full = replace(untiled(textured(FULL, roughness_map=rough, metallic=1.0)), occlusion=np.full(len(FULL.uvs), 0.5))
    (material,) = baked(simplified(full), full).mesh.materials
    assert material.occlusion_map is material.roughness_map
    found = shown(replace(FULL, uvs=FULL.uvs * 0 + 0.5), material.occlusion_map)
    assert np.abs(found.astype(int) - (128, 100, 50)).max(initial=0) <= 1


@pytest.mark.parametrize(
    ("simple", "full"),
    [(empty(), empty()), (empty(), FULL), (mesh_of(np.eye(3), []), FULL)],
    ids=["no trunk", "nothing left", "vertices only"],
)
def test_no_trunk(simple: Mesh, full: Mesh):
    mapped = baked(simple, full)
    assert (mapped.mesh, mapped.maps.kind) == (simple, "none")


def test_switched_off():
    mapped = baked(simplified(FULL), FULL, replace(SMALL, enabled=False))
    assert mapped.maps.kind == "none"


def test_a_trunk_that_was_not_simplified_has_no_use_for_maps():
    mesh = untiled(textured(FULL, color_map=image((200, 40, 40))))
    mapped = baked(mesh, mesh)
    assert (mapped.mesh, mapped.maps.kind) == (mesh, "tiled")


def test_a_trunk_that_lost_its_twigs_alone_keeps_its_maps():
    kept = untiled(textured(FULL, color_map=image((200, 40, 40))))
    full = joined(kept, stem(radii=[0.01] * 9, at=(1, 0, 0)))
    mapped = trunk_maps(kept, kept, full, None, SMALL)
    assert (mapped.mesh, mapped.maps.kind) == (kept, "tiled")
    assert trunk_maps(simplified(kept), kept, full, None, SMALL).maps.kind == "unique"


def with_alpha(texture: Texture) -> Texture:
    texture.pixels[:8, :, 3] = 0
    return texture


def test_light_looked_up_apart_is_baked():
    shade = image((255, 255, 255), (0, 0, 0))
    shade.pixels[..., :3] = np.linspace(0, 255, 64).astype(np.uint8)[:, None, None]
    full = replace(textured(FULL, color_map=image((90, 60, 30)), occlusion_map=shade), occlusion_uvs=untiled(FULL).uvs)
    mapped = baked(simplified(full), full)
    texture = mapped.mesh.materials[0].occlusion_map
    height = places(mapped.mesh, texture.pixels.shape[0])[:, 1] / 2
    assert mapped.maps.kind == "tiled"
    middle = np.abs(height - 0.5) < 0.25  # a map repeats, so that its ends are filtered into each other
    assert np.abs(shown(mapped.mesh, texture)[:, 0] / 255 - height)[middle].max() < 0.05


@pytest.mark.parametrize("mode", [AlphaMode.MASK, AlphaMode.BLEND])
@pytest.mark.parametrize("where", ["factor", "map"])
def test_bark_that_is_not_opaque_keeps_its_materials(mode: AlphaMode, where: str):
    colors = image((200, 40, 40))
    clear = {"base_color": (1, 1, 1, 0.5)} if where == "factor" else {"color_map": with_alpha(colors)}
    full = untiled(textured(FULL, **({"color_map": colors, "alpha_mode": mode, "alpha_cutoff": 0.4} | clear)))
    simple = simplified(full)
    assert (baked(simple, full).mesh, baked(simple, full).maps.kind) == (simple, "tiled")
    seen = replace(full, occlusion=np.full(len(full.uvs), 0.5, np.float32))
    (material,) = baked(simplified(seen), seen).mesh.materials
    assert (material.alpha_mode, material.alpha_cutoff) == (mode, 0.4)
    assert material.color_map is full.materials[0].color_map
    assert material.occlusion_map is not None


def test_bark_that_light_goes_through_keeps_its_material():
    full = untiled(textured(FULL, color_map=image((200, 40, 40)), transmission=Transmission(0.5, (1, 1, 1))))
    assert baked(simplified(full), full).maps.kind == "tiled"


@pytest.mark.parametrize("mode", AlphaMode)
def test_alpha_that_does_not_count(mode: AlphaMode):
    colors = image((200, 40, 40))
    leaf = Material("leaf", color_map=with_alpha(image((0, 200, 0))), alpha_mode=AlphaMode.MASK)  # no face uses it
    full = textured(FULL, color_map=with_alpha(colors) if mode is AlphaMode.OPAQUE else colors, alpha_mode=mode)
    full = replace(untiled(full), materials=(*full.materials, leaf))
    assert baked(simplified(full), full).maps.kind == "unique"


def test_all_levels_decide_as_the_finest():
    full = textured(FULL, color_map=image((90, 60, 30), (20, 10, 5)))
    simple, density = simplified(full), baked(simplified(full), full).maps.source_density
    assert baked(simple, full).maps.kind == "tiled"
    for near, kind in ((2 * density, "unique"), (density / 2, "tiled")):
        finest = TrunkMaps(kind, density, near)
        for height in (16, 64, 256):
            coarser = replace(SMALL, size=1024, height=height)
            assert trunk_maps(simple, full, full, finest, coarser).maps.kind == kind


@pytest.mark.parametrize("uvs", [((0, 0),) * 3, ((0, 0), (3, 0), (0, 3)), ((0, 0), (1, 0), (0, 1))])
def test_a_single_triangle(uvs: object):
    full = textured(stem(), color_map=image((10, 200, 10)))
    mapped = baked(mesh_of(np.eye(3), [(0, 1, 2)], uvs), replace(full, uvs=full.uvs * 0))
    (material,) = mapped.mesh.materials
    assert np.abs(shown(mapped.mesh, material.color_map).astype(int) - (10, 200, 10)).max() <= 1


ODD = {
    "without uvs": replace(FULL, uvs=np.zeros_like(FULL.uvs)),
    "uvs far out": replace(FULL, uvs=FULL.uvs * 100 - 1000),
    "overlapping uvs": together(FULL, stem(radii=[0.2] * 12, at=(1, 0, 0))),
    "mirrored uvs": stem(radii=[0.2] * 24, sides=16, mirrored=True),
    "no tube": sphere(),
    "flat-shaded": flat_shaded(FULL),
    "capped": stem(radii=[0.2] * 24, sides=16, capped=True),
    "hundreds of open tubes": together(*(stem(radii=[0.01] * 5, at=(i % 20, 0, i // 20)) for i in range(300))),
    "three faces at an edge": together(
        FULL, mesh_of([(0, 0, 0.3), (0, 2, 0.3), (0, 1, 0.6)], [(0, 1, 2), (1, 0, 2), (0, 1, 2)])
    ),
    "zero-area faces": together(FULL, mesh_of([(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0)], [(0, 1, 2), (0, 0, 3)])),
}


@pytest.mark.parametrize("name", ODD)
def test_odd_trunks_show_their_source_everywhere(name: str):
    full = textured(ODD[name], base_color=(0.4, 0.3, 0.2, 1.0))
    moss = Material("moss", (0.1, 0.3, 0.1, 1.0))  # another colour, so that both are baked
    full = replace(full, materials=(*full.materials, moss), face_material=np.where(np.arange(full.triangles) % 2, 0, 1))
    full = replace(full, face_material=full.face_material.astype(np.int32))
    simple = simplified(replace(full, face_material=full.face_material * 0), max(full.triangles // 3, 3))
    mapped = baked(simple, full)
    mesh, (material,) = mapped.mesh, mapped.mesh.materials
    assert mapped.maps.kind == "unique"
    assert mesh.triangles == (simple.face_areas > 0).sum()
    assert np.isfinite(mesh.uvs).all()
    assert (mesh.uvs >= 0).all()
    assert (mesh.uvs <= 1).all()
    assert np.array_equal(
        mesh.positions[mesh.faces], simple.positions[simple.faces[simple.face_areas > 0]], equal_nan=True
    )
    colors = to_linear(shown(mesh, material.color_map))
    low, high = np.array((0.1, 0.3, 0.1)) - 0.01, np.array((0.4, 0.3, 0.2)) + 0.01
    assert len(colors)
    assert ((colors >= low) & (colors <= high)).all()
    for texture in (material.color_map, material.normal_map):
        if texture:
            assert texture.pixels.shape[0] == texture.pixels.shape[1] <= SMALL.size
            assert texture.pixels.shape[0].bit_count() == 1


def test_no_texel_serves_two_faces():
    full = together(*(stem(radii=np.linspace(0.3, 0.1, 12), at=(i, 0, 0), capped=i == 0) for i in range(6)))
    mesh = baked(simplified(full, 200), full, replace(SMALL, size=256, height=256)).mesh
    d1, d2 = (mesh.uvs[mesh.faces[:, end]] - mesh.uvs[mesh.faces[:, 0]] for end in (1, 2))
    area = np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]).sum() / 2
    size = 2048
    number, _, _ = face_texels(mesh.uvs, mesh.faces, size)
    assert area <= len(number) / size**2  # edges count on top


@given(
    radii=st.lists(st.floats(0.02, 0.5), min_size=6, max_size=20),
    sides=st.integers(5, 12),
    scale=st.floats(0.01, 30),
    capped=st.booleans(),
)
@settings(max_examples=25, deadline=None)
def test_every_tube_is_unwrapped_alike_twice(radii: list[float], sides: int, scale: float, capped: bool):
    full = stem(radii=radii, sides=sides, capped=capped)
    full = replace(full, positions=full.positions * np.float32(scale))
    simple = simplified(full, full.triangles // 3)
    one, other = (baked(simple, full) for _ in range(2))
    assert one.mesh.uvs.tobytes() == other.mesh.uvs.tobytes()
    maps = [each.mesh.materials[0].normal_map for each in (one, other)]
    assert (maps[0] and maps[0].pixels.tobytes()) == (maps[1] and maps[1].pixels.tobytes())
    assert one.mesh.triangles == simple.triangles
    assert (one.mesh.uvs >= 0).all()
    assert (one.mesh.uvs <= 1).all()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"size": 100}, r"\[trunk_maps\] size is 100; it must be a power of two, 16 to 4096"),
        ({"height": 8}, r"\[trunk_maps\] height is 8; it must be 16 to 4096"),
    ],
)
def test_settings_out_of_range(changed: dict[str, int], message: str):
    with pytest.raises(SettingsError, match=message):
        baked(FULL, FULL, replace(SMALL, **changed))


def test_more_charts_than_texels():
    full = ODD["hundreds of open tubes"]
    with pytest.raises(SettingsError, match=r"\[trunk_maps\] size is 16, too few texels for the 300 charts"):
        baked(simplified(full, full.triangles // 2), full, replace(SMALL, size=16))
