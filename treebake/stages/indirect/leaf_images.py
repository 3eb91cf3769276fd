"""The leaves texture: one image per leaf shape and side, at the source's own texel density ([GPSS07] 4.2, 5).

A shape's back has an image of its own only where it looks different from the front: where a leaf folds over itself.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from treebake.errors import BudgetError
from treebake.gl.bake import FlatTriangles, bake_atlas
from treebake.images import bleed, color_texels, normal_texels
from treebake.model import Doubles, Floats, Leaves, Longs, Mesh, Texture
from treebake.packing import pack_cells
from treebake.stages.indirect.shapes import Shapes, faces_of

BLOCK = 16  # texels: images start and end on its multiples, so that four mips keep them apart
_SUPERSAMPLE = 4
_MIPS = 4  # that are read
_LEAST = 0.02  # threshold: below it compression's errors would show
_SLENDER = 8  # times leaf_texels that the image of a leaf without texture is long at the most
_SHRINK = 0.9  # of all images, until they fit
_THUMB = 16  # texels each way at which images are compared


@dataclass(frozen=True, eq=False)
class LeafImages:
    """color: sRGB with coverage as alpha. normal: right and up in RG, height in B. front, back: (S, 4) float32, the
    place of each shape's box in texture coordinates, corner and size; a back that is never seen has no size.
    thresholds: (S, 4) float32, the alpha above which mips 1 to 4 of the front cover what mip 0 covers above 0.5.
    """

    color: Texture
    normal: Texture
    front: Floats
    back: Floats
    thresholds: Floats


def draw_leaf_images(
    foliage: Mesh, leaves: Leaves, shapes: Shapes, leaf_texels: int, atlas: int, tolerance: float
) -> LeafImages:
    """Draw every shape from both sides; images that differ by less than `tolerance` are stored once. O(texels).

    leaf_texels: along the greatest side of a shape without texture. atlas: the greatest side of the texture; images
    shrink until they fit. Raises BudgetError where they cannot.
    """
    count = len(shapes.exemplars)
    sides = _Sides(foliage, leaves, shapes)
    sizes = np.tile(sides.texel_sizes(leaf_texels), (2, 1))
    leader = _leaders(sides.thumbs(), sizes, tolerance)
    drawn, image = np.unique(leader, return_inverse=True)
    extent, origins, size = _pack(sizes[drawn], atlas)
    color, normal, depth = sides.draw(drawn, origins, extent, size, _SUPERSAMPLE)
    places = (np.concatenate([origins, extent], axis=1) / np.tile(size, 2)).astype(np.float32)[image]
    back = np.where(sides.double_sided[:, None], places[count:], 0)
    coverage = color[..., 3]
    normals = normal_texels(normal, coverage)
    normals[..., 2] = np.rint((bleed(np.dstack([depth, depth, depth, coverage]))[..., 0] * 0.5 + 0.5) * 255)
    return LeafImages(
        color=Texture("leaf_color", np.dstack([color_texels(color), np.rint(coverage * 255).astype(np.uint8)])),
        normal=Texture("leaf_normal", normals),
        front=places[:count],
        back=back.astype(np.float32),
        thresholds=_thresholds(coverage, origins, extent)[image[:count]],
    )


def _thresholds(coverage: Floats, origins: Longs, extent: Doubles) -> Floats:
    """The alpha that mips 1 to 4 of each image exceed on the area on which mip 0 exceeds 0.5: (images, 4) float32."""
    result = np.full((len(origins), _MIPS), 0.5, np.float32)
    for row, ((x, y), (width, height)) in enumerate(zip(origins.tolist(), extent.astype(int).tolist(), strict=True)):
        alpha = coverage[y : y + -(-height // BLOCK) * BLOCK, x : x + -(-width // BLOCK) * BLOCK]
        covered = (alpha > 0.5).mean()
        for mip in range(_MIPS):
            alpha = (alpha[::2, ::2] + alpha[1::2, ::2] + alpha[::2, 1::2] + alpha[1::2, 1::2]) / np.float32(4)
            result[row, mip] = np.clip(np.quantile(alpha, 1 - covered), _LEAST, 1 - _LEAST)
    return result


def _pack(sizes: Doubles, atlas: int) -> tuple[Doubles, Longs, tuple[int, int]]:
    """The sizes that images get, where they go, and the (width, height) of the texture, in texels."""
    wanted = sizes
    while sizes.max() >= 1:
        blocks = np.ceil(np.maximum(sizes, 1) / BLOCK).astype(np.int32)
        if packed := pack_cells(blocks, atlas // BLOCK):
            return (
                np.maximum(np.floor(sizes), 1),
                packed[0].astype(np.int64) * BLOCK,
                (packed[1][0] * BLOCK, packed[1][1] * BLOCK),
            )
        sizes = sizes * _SHRINK
    raise BudgetError(
        f"{len(wanted)} leaf images do not fit into a texture of {atlas} x {atlas} texels; raise [indirect] atlas, "
        "or [indirect] likeness so that more of them are shared"
    )


class _Sides:
    """The exemplars' faces, ready to be drawn: image i < S is the front of shape i, S + i its back.

    Both are drawn as seen from the front, so that where a leaf does not fold over itself they are the same image.
    """

    def __init__(self, foliage: Mesh, leaves: Leaves, shapes: Shapes) -> None:
        self.foliage, self.shapes = foliage, shapes
        self.faces, self.shape = faces_of(leaves, shapes.exemplars)
        self.starts = np.searchsorted(self.shape, np.arange(len(shapes.exemplars) + 1))
        vertices = foliage.faces[self.faces]
        frames = shapes.frames[self.shape]
        spokes = foliage.positions[vertices].astype(np.float64) - shapes.centers[self.shape][:, None]
        self.places = np.einsum("fij,fkj->fki", frames, spokes) / shapes.halves[self.shape][:, None]
        self.normals = np.einsum("fij,fkj->fki", frames, foliage.normals[vertices].astype(np.float64)) * (1, -1, -1)
        materials = foliage.face_material[self.faces]
        two_sided = np.array([material.double_sided for material in foliage.materials])[materials]
        self.double_sided = np.logical_or.reduceat(two_sided, self.starts[:-1]) | shapes.is_twig

    def texel_sizes(self, leaf_texels: int) -> Doubles:
        """(S, 2) whole texels of each shape's image at the density of its textures."""
        areas = np.maximum(self.foliage.face_areas[self.faces], 1e-300)
        uvs = self.foliage.uvs[self.foliage.faces[self.faces]].astype(np.float64)
        d1, d2 = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
        maps = [material.color_map for material in self.foliage.materials]
        texels = np.array([0 if image is None else np.prod(image.pixels.shape[:2]) for image in maps])
        texels = texels[self.foliage.face_material[self.faces]] * np.abs(d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]) / 2
        count = len(self.shapes.exemplars)
        density = np.sqrt(np.bincount(self.shape, texels, count) / np.bincount(self.shape, areas, count))
        sides = 2 * self.shapes.halves[:, :2]
        size = np.maximum(np.sqrt(sides.prod(axis=1)), sides.max(axis=1) / _SLENDER)
        density = np.where(density > 0, density, leaf_texels / size)
        # Around a twig lies a whole tile of bark, so its texels are not square and their area says nothing.
        density = np.where(self.shapes.is_twig, leaf_texels / sides.max(axis=1), density)
        return np.maximum(np.rint(sides * density[:, None]), 1)

    def thumbs(self) -> Floats:
        """Every image with its normals, small: (2 S, values)."""
        images = np.arange(2 * len(self.shapes.exemplars))
        across = int(np.ceil(np.sqrt(len(images))))
        origins = np.stack([images % across, images // across], axis=1) * _THUMB
        size = across * _THUMB
        color, normal, _ = self.draw(images, origins, np.full((len(images), 2), _THUMB), (size, size), 2)
        both = np.concatenate([color, 0.5 * normal], axis=2)
        tiles = both.reshape(across, _THUMB, across, _THUMB, -1).transpose(0, 2, 1, 3, 4)
        return np.ascontiguousarray(tiles.reshape(across * across, -1)[: len(images)])

    def draw(
        self, images: Longs, origins: Longs, extent: Doubles, size: tuple[int, int], supersample: int
    ) -> tuple[Floats, Floats, Floats]:
        """Draw some images at origins with extents, in texels, as `bake_atlas` does."""
        back, shape = np.divmod(images, len(self.shapes.exemplars))
        number = np.diff(self.starts)[shape]
        row = np.repeat(np.arange(len(images)), number)
        face = np.arange(len(row)) - np.repeat(np.cumsum(number) - number, number) + self.starts[shape][row]
        place = self.places[face]
        texels = origins[row, None] + (place[..., :2] + 1) / 2 * extent[row, None]
        depth = -0.999 * place[..., 2:] * np.where(back[row] > 0, -1, 1)[:, None, None]
        triangles = FlatTriangles(
            positions=np.concatenate([texels, depth], axis=2).astype(np.float32),
            uvs=self.foliage.uvs[self.foliage.faces[self.faces[face]]],
            normals=self.normals[face].astype(np.float32),
            material=self.foliage.face_material[self.faces[face]],
        )
        color, normal, height = bake_atlas(triangles, self.foliage.materials, size, supersample)
        return color, normal, height


def _leaders(looks: Floats, sizes: Doubles, tolerance: float) -> Longs:
    """The image that stands for each: itself, or a larger one that looks the same."""
    # Images that are alike are alike in the mean of each quarter too, which few numbers tell.
    half = _THUMB // 2
    quarters = looks.reshape(len(looks), 2, half, 2, half, -1).mean(axis=(2, 4)).reshape(len(looks), -1)
    near = cKDTree(quarters)
    reach = tolerance * np.sqrt(quarters.shape[1]) * (1 + 1e-6) + 1e-9
    leader = np.full(len(looks), -1, np.int64)
    for image in np.argsort(-np.prod(sizes, axis=1), kind="stable"):
        if leader[image] < 0:
            others = np.array(near.query_ball_point(quarters[image], reach))
            others = others[leader[others] < 0]
            alike = np.sqrt(((looks[others] - looks[image]) ** 2).mean(axis=1)) <= tolerance
            leader[others[alike]] = image
            leader[image] = image
    return leader
