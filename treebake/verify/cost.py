"""What a candidate costs a stock client: triangles, draw calls, memory on the graphics card."""

from dataclasses import dataclass

import numpy as np

from treebake.asset import indirect_bytes
from treebake.compression import block_bytes
from treebake.model import IndirectTextures, Mesh, Texture

_BOX = 12  # triangles of a thick billboard
_BLOCK = 16  # bytes of 4 x 4 texels: BC3, BC5 or BC7


@dataclass(frozen=True)
class Cost:
    """gpu_bytes: each used texture once, block-compressed to a byte a texel, with its mipmaps; 32 bytes a vertex and 4
    an index; of indirect textures, tables as they are and images as above.
    """

    triangles: int
    draw_calls: int
    gpu_bytes: int


def cost_of(mesh: Mesh, indirect: IndirectTextures | None = None) -> Cost:
    """Count what has to be kept and drawn: a draw call for each material of each node, and one for all billboards."""
    calls = len(np.unique(np.stack([mesh.face_node, mesh.face_material]), axis=1).T)
    vertices = 32 * len(mesh.positions) + 4 * mesh.faces.size
    cost = Cost(mesh.triangles, calls, vertices + sum(map(_bytes, _textures_of(mesh))))
    if indirect is None:
        return cost
    boxes = _BOX * len(indirect.billboards)
    return Cost(cost.triangles + boxes, cost.draw_calls + 1, cost.gpu_bytes + indirect_bytes(indirect))


def _bytes(texture: Texture) -> int:
    height, width = texture.pixels.shape[:2]
    return block_bytes(width, height, _BLOCK)


def _textures_of(mesh: Mesh) -> list[Texture]:
    """Every texture that the faces of a mesh use, once."""
    used = [mesh.materials[i] for i in np.unique(mesh.face_material)]
    found = {id(image): image for material in used for image in (material.color_map, material.normal_map) if image}
    return list(found.values())
