"""What a candidate costs a stock client: triangles, draw calls, memory on the graphics card."""

from dataclasses import dataclass

import numpy as np

from treebake.asset import indirect_bytes
from treebake.model import IndirectTextures, Mesh, Texture

_BOX = 12  # triangles of a thick billboard


@dataclass(frozen=True)
class Cost:
    """gpu_bytes: of a mesh, each used texture once as RGBA8 with mipmaps, 32 bytes a vertex and 4 an index; of indirect
    textures, tables and block-compressed images with their mips.
    """

    triangles: int
    draw_calls: int
    gpu_bytes: int


def cost_of(mesh: Mesh, indirect: IndirectTextures | None = None) -> Cost:
    """Count what has to be kept and drawn: a draw call for each material of each node, and one for all billboards."""
    calls = len(np.unique(np.stack([mesh.face_node, mesh.face_material]), axis=1).T)
    vertices = 32 * len(mesh.positions) + 4 * mesh.faces.size
    cost = Cost(mesh.triangles, calls, vertices + sum(4 * mip_texels(texture) for texture in textures_of(mesh)))
    if indirect is None:
        return cost
    boxes = _BOX * len(indirect.billboards)
    return Cost(cost.triangles + boxes, cost.draw_calls + 1, cost.gpu_bytes + indirect_bytes(indirect))


def textures_of(mesh: Mesh) -> list[Texture]:
    """Every texture that the faces of a mesh use, once."""
    used = [mesh.materials[i] for i in np.unique(mesh.face_material)]
    found = {id(image): image for material in used for image in (material.color_map, material.normal_map) if image}
    return list(found.values())


def mip_texels(texture: Texture) -> int:
    """Texels of a texture with all its mips."""
    height, width = texture.pixels.shape[:2]
    texels = height * width
    while max(height, width) > 1:
        height, width = max(height // 2, 1), max(width // 2, 1)
        texels += height * width
    return int(texels)
