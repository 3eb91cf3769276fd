"""A billboard cloud with as many texels as fit into given bytes: what a flat atlas is worth at another's price."""

from dataclasses import replace
from typing import Any

from treebake.compression import block_bytes
from treebake.images import mip_chain
from treebake.model import AlphaMode, Material, Mesh, Texture

_BLOCK = 16  # bytes of 4 x 4 texels: BC3, BC5 or BC7


def with_texture_bytes(mesh: Mesh, limit: int) -> Mesh:
    """The mesh with its alpha-masked materials' textures replaced by their first mips that take at most `limit` bytes.

    Bytes are those of block-compressed textures with their mips, of all masked materials together.
    """
    masked = [material for material in mesh.materials if material.alpha_mode is AlphaMode.MASK]
    images = {id(image): image for material in masked for image in material.maps.values()}
    drop = 0
    while sum(_bytes(image, drop) for image in images.values()) > limit:
        drop += 1

    def smaller(material: Material) -> Material:
        if material not in masked:
            return material
        maps: Any = {name: _mip(image, drop, srgb=name == "color_map") for name, image in material.maps.items()}
        return replace(material, **maps)

    return replace(mesh, materials=tuple(map(smaller, mesh.materials)))


def _bytes(image: Texture, drop: int) -> int:
    height, width = image.pixels.shape[:2]
    return block_bytes(max(width >> drop, 1), max(height >> drop, 1), _BLOCK) if max(width, height) >> drop else 0


def _mip(image: Texture, drop: int, *, srgb: bool) -> Texture:
    if not drop:
        return image
    chain = mip_chain(image.pixels, srgb=srgb)
    return Texture(image.name, chain[min(drop, len(chain) - 1)])
