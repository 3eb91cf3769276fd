"""The billboard cloud as every glTF viewer draws it: flat cards with one alpha-masked atlas ([GSSK05]).

Cards have their plane's normal, and the atlas the leaves'. [GPSS07] 5.2 corrects a plane's normal towards its leaves';
the mean normal of each card's leaves in its vertices, with an atlas relative to that, was tried. On the chestnut, FLIP
over floor(1 px), the plane's normal and then the leaves' mean:

                      2000 cards, 256 px   64 px          LOD1, 256 px   LOD3, 64 px    LOD5, 32 px
    normal map drawn  1.399 1.399          1.386 1.386    1.767 1.766    1.753 1.753    1.588 1.588
    and left out      1.439 1.437          1.394 1.397    1.796 1.795    1.704 1.768    1.503 1.609

With the map nothing changes, and without it the light of a mean normal is not the mean light of leaves that face many
ways: planes spread the light better.
"""

import logging
from dataclasses import dataclass, replace

import numpy as np

from treebake.checks import check, is_power_of_two
from treebake.coverage import preserve_coverage
from treebake.flatten import FlatLeaves, flatten, plane_frames
from treebake.geometry import corner_occlusion
from treebake.gl.bake import FlatTriangles, bake_atlas
from treebake.images import color_texels, normal_texels, occlusion_map
from treebake.model import (
    AlphaMode,
    BillboardCloud,
    Clusters,
    Doubles,
    Floats,
    Ints,
    Leaves,
    Material,
    Mesh,
    Texture,
    Tree,
)
from treebake.packing import pack, texel_sizes
from treebake.planes import displacement
from treebake.stages.billboards.cards import Cards, cut_cards
from treebake.stages.billboards.silhouette import covered_area

LOG = logging.getLogger("treebake")


@dataclass(frozen=True)
class BillboardSettings:
    """How clusters become cards and an atlas."""

    atlas: int = 2048  # greatest side of the atlas in texels, a power of two, 64 to 16384
    leaf_texels: float = 24.0  # texels along the root of a leaf's area that are enough, > 0; the atlas is then smaller
    triangles: int = 4000  # of all cards, at most; one card per plane is always made
    padding: int = 2  # texels kept free around each card, 1 or more
    supersample: int = 4  # samples per texel each way, 1 to 8
    cutoff: float = 0.5  # alphaCutoff of the cards, 0.1 to 0.9
    height: int = 384  # pixels of the tree at which, and at half of which, the covered area is fitted, 16 to 2048


def billboards(tree: Tree, clusters: Clusters, settings: BillboardSettings) -> BillboardCloud:
    """Flatten, cut, pack, draw: the tree's leaves on textured cards. O(faces + texels).

    Raises SettingsError where a setting is out of range and BudgetError where the cards exceed the atlas.
    """
    _check(settings)
    _warn_of_one_sided_leaves(tree)
    flat = flatten(tree.foliage, tree.leaves, clusters)
    density_limit = settings.leaf_texels / tree.leaves.size
    margin = settings.padding / min(density_limit, _density_guess(tree.leaves, settings.atlas))
    cards = cut_cards(flat, clusters.labels, settings.triangles // 2, margin)
    origins, density, size = pack(cards.sizes, settings.atlas, density_limit, settings.padding)
    triangles = _placed(tree.foliage, flat, cards, origins, density)
    color, normal, sky = bake_atlas(triangles, tree.foliage.materials, size, settings.supersample)
    texels, normals = color_texels(color), normal_texels(normal, color[..., 3])
    occlusion = occlusion_map("foliage_occlusion", sky, color[..., 3])

    def cloud(alpha: Floats) -> BillboardCloud:
        material = Material(
            name="foliage",
            color_map=Texture("foliage_color", np.dstack([texels, np.rint(alpha * 255).astype(np.uint8)])),
            normal_map=Texture("foliage_normal", normals),
            occlusion_map=occlusion,
            alpha_mode=AlphaMode.MASK,
            alpha_cutoff=settings.cutoff,
            double_sided=True,
            transmission=tree.transmission,
        )
        return _cloud(cards, clusters, origins, density, size, settings.padding, material)

    # Leaves that hide each other once they lie in one plane, and cards seen at a grazing angle, cover too little.
    wanted = covered_area(tree.foliage, tree.foliage, settings.height, exact=True)

    def drawn(alpha: Floats) -> float:
        return covered_area(cloud(alpha).mesh, tree.foliage, settings.height, exact=False) / wanted if wanted else 1.0

    made = cloud(preserve_coverage(color[..., 3], settings.cutoff, drawn))
    return replace(made, displacement=displacement(tree.leaves, clusters))


def _check(settings: BillboardSettings) -> None:
    rules = (
        ("atlas", is_power_of_two(settings.atlas, 64, 16384), "a power of two from 64 to 16384"),
        ("leaf_texels", settings.leaf_texels > 0, "above 0"),
        ("triangles", settings.triangles >= 2, "2 or more"),
        ("padding", settings.padding >= 1, "1 or more"),
        ("supersample", 1 <= settings.supersample <= 8, "1 to 8"),
        ("cutoff", 0.1 <= settings.cutoff <= 0.9, "0.1 to 0.9"),
        ("height", 16 <= settings.height <= 2048, "16 to 2048"),
    )
    check("textures", settings, rules)


def _warn_of_one_sided_leaves(tree: Tree) -> None:
    of_leaf = ~tree.leaves.is_twig[tree.leaves.face_leaf]
    for index in np.unique(tree.foliage.face_material[of_leaf]):
        material = tree.foliage.materials[index]
        if not material.double_sided:
            LOG.warning(
                "the leaves of material %s are single-sided and a card shows both sides: the crown may look denser; "
                "set doubleSided in the source if its leaves are meant to be seen from behind",
                material.name,
            )


def _density_guess(leaves: Leaves, atlas: int) -> float:
    """Texels per unit to expect before the cards are known: leaves usually fill a quarter of them."""
    return float(np.sqrt(atlas**2 / 4 / leaves.areas.sum()))


def _placed(foliage: Mesh, flat: FlatLeaves, cards: Cards, origins: Ints, density: float) -> FlatTriangles:
    """The flat triangles in atlas texels. Rows run downwards, a card's vertical axis upwards."""
    card = cards.leaf_card[flat.leaf]
    right, up = cards.right[card], cards.right[card] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    along = np.stack([_dot(flat.corners, right), _dot(flat.corners, up)], axis=-1)
    offset = np.stack([along[..., 0] - cards.low[card, None, 0], cards.high[card, None, 1] - along[..., 1]], axis=-1)
    texels = origins[card][:, None, :] + offset * density
    depth = flat.depth / (np.abs(flat.depth).max() * 1.001 + 1e-30)
    normals = np.stack(
        [_dot(flat.normals[..., :2], right), _dot(flat.normals[..., :2], up), flat.normals[..., 2]], axis=-1
    )
    return FlatTriangles(
        positions=np.concatenate([texels, depth[..., None]], axis=-1).astype(np.float32),
        uvs=foliage.uvs[foliage.faces[flat.face]],
        normals=normals.astype(np.float32),
        values=corner_occlusion(foliage)[flat.face],
        material=foliage.face_material[flat.face],
    )


def _dot(corners: Doubles, axis: Doubles) -> Doubles:
    return np.asarray(np.einsum("mki,mi->mk", corners, axis))


def _cloud(
    cards: Cards,
    clusters: Clusters,
    origins: Ints,
    density: float,
    size: tuple[int, int],
    padding: int,
    material: Material,
) -> BillboardCloud:
    """Two triangles per card; a card reaches `padding` texels past its leaves, where mips spread them."""
    count = len(cards.plane)
    frames = plane_frames(clusters.normals)[cards.plane]
    foot = -clusters.offsets[cards.plane, None] * clusters.normals[cards.plane]  # the plane's point nearest the origin
    right = np.einsum("ci,cij->cj", cards.right, frames[:, :2])
    up = np.cross(clusters.normals[cards.plane], right)
    # Left bottom, right bottom, right top, left top, in whole texels from the content's top left.
    content = texel_sizes(cards.sizes, density)
    steps = np.array([[0, 1], [1, 1], [1, 0], [0, 0]])
    texels = steps * (content[:, None, :] + 2 * padding) - padding
    along = cards.low[:, None, 0] + texels[..., 0] / density
    above = cards.high[:, None, 1] - texels[..., 1] / density
    positions = foot[:, None, :] + along[..., None] * right[:, None, :] + above[..., None] * up[:, None, :]
    quads = np.arange(count, dtype=np.int32)[:, None, None] * 4 + np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    mesh = Mesh(
        positions=positions.reshape(-1, 3).astype(np.float32),
        normals=clusters.normals[cards.plane].repeat(4, axis=0).astype(np.float32),
        uvs=((origins[:, None, :] + texels) / np.array(size)).reshape(-1, 2).astype(np.float32),
        faces=quads.reshape(-1, 3),
        face_material=np.zeros(2 * count, np.int32),
        face_node=np.zeros(2 * count, np.int32),
        materials=(material,),
        nodes=("foliage",),
    )
    return BillboardCloud(mesh=mesh, face_cluster=cards.plane.repeat(2).astype(np.int32))
