"""What a candidate costs a stock client: triangles, draw calls, memory on the graphics card."""

from dataclasses import dataclass

import numpy as np

from treebake.asset import atlas_bytes, indirect_bytes, leaf_card_bytes
from treebake.compression import block_bytes
from treebake.model import IndirectTextures, Layers, LeafCards, Mesh, Slicings, Texture

_BOX = 12  # triangles of a thick billboard
_BLOCK = 16  # bytes of 4 x 4 texels: BC3, BC5 or BC7


@dataclass(frozen=True)
class Cost:
    """gpu_bytes: each used texture once, block-compressed to a byte a texel, with its mipmaps; 32 bytes a vertex, and 8
    where occlusion has texture coordinates of its own; 4 an index; of layers, tables as they are and images
    block-compressed too.
    """

    triangles: int
    draw_calls: int
    gpu_bytes: int


def cost_of(mesh: Mesh, layers: Layers | None = None) -> Cost:
    """Count what has to be kept and drawn: a draw call for each material of each node, and one for the layers.

    Of slicings, two are drawn at a time; a third one from above only.
    """
    calls = len(np.unique(np.stack([mesh.face_node, mesh.face_material]), axis=1).T)
    own = 0 if mesh.occlusion_uvs is None else np.count_nonzero((mesh.occlusion_uvs != mesh.uvs).any(axis=1))
    vertices = 32 * len(mesh.positions) + 8 * int(own) + 4 * mesh.faces.size
    cost = Cost(mesh.triangles, calls, vertices + sum(map(_bytes, _textures_of(mesh))))
    if layers is None:
        return cost
    if isinstance(layers, IndirectTextures):
        triangles, size = _BOX * len(layers.billboards), indirect_bytes(layers)
    elif isinstance(layers, LeafCards):
        triangles, size = layers.triangles, leaf_card_bytes(layers)
    else:
        table = layers.slices if isinstance(layers, Slicings) else layers.pictures
        triangles, size = layers.triangles, atlas_bytes(layers.atlas) + table.nbytes
    return Cost(cost.triangles + triangles, cost.draw_calls + 1, cost.gpu_bytes + size)


def _bytes(texture: Texture) -> int:
    height, width = texture.pixels.shape[:2]
    return block_bytes(width, height, _BLOCK)


def _textures_of(mesh: Mesh) -> list[Texture]:
    """Every texture that the faces of a mesh use, once."""
    used = [mesh.materials[i] for i in np.unique(mesh.face_material)]
    found = {id(image): image for material in used for image in material.maps.values()}
    return list(found.values())
