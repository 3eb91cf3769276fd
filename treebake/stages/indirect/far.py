"""The low-resolution texture: what stands for the leaves that a far view does not look up ([GPSS07] 5.1)."""

import numpy as np

from treebake.flatten import flatten, plane_frames
from treebake.geometry import corner_occlusion
from treebake.gl.bake import FlatTriangles, bake_atlas
from treebake.images import color_texels, normal_texels, value_texels
from treebake.model import Clusters, Ints, Texture, Tree
from treebake.stages.indirect.boxes import Boxes

_SUPERSAMPLE = 8


def draw_far(
    tree: Tree, clusters: Clusters, boxes: Boxes, origins: Ints, shape: tuple[int, int], density: float, texels: int
) -> tuple[Texture, Texture]:
    """Draw every billboard flat, in the place of its hash cells, `texels` a cell each way: colour and normals.

    origins: (K, 2) int32, first hash texel. shape: (rows, columns) of the hash texture. density: hash texels per unit.
    The alpha of the one is coverage, that of the other the part of the sky that is seen. O(F + texels).
    """
    flat = flatten(tree.foliage, tree.leaves, clusters)
    plane = clusters.labels[flat.leaf]
    # From the plane's upright frame, whose foot is its point nearest the origin, to the box's turned one.
    turn = (boxes.frames @ np.swapaxes(plane_frames(clusters.normals), 1, 2))[plane]
    places = np.einsum("mij,mkj->mki", turn[:, :2, :2], flat.corners) - boxes.corners[plane][:, None, :2]
    cells = origins[plane][:, None] + places * density
    depth = flat.depth / (np.abs(flat.depth).max() * 1.001 + 1e-30)
    facing = np.einsum("mij,mkj->mki", turn, flat.normals) * (1, -1, -1)
    triangles = FlatTriangles(
        positions=np.concatenate([cells * texels, depth[..., None]], axis=2).astype(np.float32),
        uvs=tree.foliage.uvs[tree.foliage.faces[flat.face]],
        normals=facing.astype(np.float32),
        values=corner_occlusion(tree.foliage)[flat.face],
        material=tree.foliage.face_material[flat.face],
    )
    size = shape[1] * texels, shape[0] * texels
    color, normal, sky = bake_atlas(triangles, tree.foliage.materials, size, _SUPERSAMPLE)
    alpha = np.rint(color[..., 3] * 255).astype(np.uint8)
    normals = normal_texels(normal, color[..., 3])
    normals[..., 3] = value_texels(sky, color[..., 3])
    return Texture("far_color", np.dstack([color_texels(color), alpha])), Texture("far_normal", normals)
