"""The leaves texture: one image per leaf shape and side, at the source's own texel density ([GPSS07] 4.2, 5).

A shape's back has an image of its own only where it looks different from the front: where a leaf folds over itself.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from treebake.compression import compressed_mips
from treebake.errors import BudgetError
from treebake.gl.bake import FlatTriangles, bake_atlas
from treebake.images import bleed, color_texels, normal_texels
from treebake.lookup import MOST_LOD, SOFTNESS, sample_texture
from treebake.model import Bytes, Doubles, Floats, Leaves, Longs, Mesh, Texture
from treebake.packing import pack_cells
from treebake.stages.indirect.shapes import Shapes, faces_of

BLOCK = 16  # texels: images start and end on its multiples, so that four mips keep them apart
_SUPERSAMPLE = 4
_MIPS = int(MOST_LOD)  # that are read, besides the image itself
_SLENDER = 8  # times leaf_texels that the image of a leaf without texture is long at the most
_BISECTIONS = 16
_PROBES = 64  # points each way
_REPEATS = 4  # of a map across a leaf, that its image has texels for
_SHRINK = 0.9  # of all images, until they fit
_THUMB = 16  # texels each way at which images are compared


@dataclass(frozen=True, eq=False)
class LeafImages:
    """color: sRGB with coverage as alpha. normal: right and up in RG, height in B. front, back: (S, 4) float32, the
    place of each shape's box in texture coordinates, corner and size; a side that is never seen has no size.
    thresholds: (S, 4) float32, the alpha at which mips 1 to 4 cover what mip 0 covers from 0.5 on.
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

    leaf_texels: along the root of the area of a shape without texture. atlas: the greatest side of the texture; images
    shrink until they fit. Raises BudgetError where they cannot.
    """
    count = len(shapes.exemplars)
    sides = _Sides(foliage, leaves, shapes)
    seen = np.flatnonzero(sides.seen)
    sizes = np.tile(sides.texel_sizes(leaf_texels), (2, 1))[seen]
    leader = _leaders(sides.thumbs(seen), sizes, tolerance)
    drawn, image = np.unique(leader, return_inverse=True)
    extent, origins, size = _pack(sizes[drawn], atlas)
    color, normal, depth = sides.draw(seen[drawn], origins, extent, size, _SUPERSAMPLE)
    coverage = color[..., 3]
    colors = Texture("leaf_color", np.dstack([color_texels(color), np.rint(coverage * 255).astype(np.uint8)]))
    normals = normal_texels(normal, coverage)
    normals[..., 2] = np.rint((bleed(np.dstack([depth, depth, depth, coverage]))[..., 0] * 0.5 + 0.5) * 255)
    places, thresholds = np.zeros((2 * count, 4), np.float32), np.zeros((2 * count, _MIPS), np.float32)
    of_drawn = (np.concatenate([origins, extent], axis=1) / np.tile(size, 2)).astype(np.float32)
    places[seen] = of_drawn[image]
    thresholds[seen] = _thresholds(compressed_mips(colors, srgb=True), of_drawn)[image]
    return LeafImages(
        color=colors,
        normal=Texture("leaf_normal", normals),
        front=places[:count],
        back=places[count:],
        thresholds=np.where(sides.seen[:count, None], thresholds[:count], thresholds[count:]),
    )


def _thresholds(mips: list[Bytes], places: Floats) -> Floats:
    """The alpha at which mips 1 to 4 of each image cover what mip 0 covers from 0.5 on: (images, 4) float32.

    places: (images, 4), corner and size in texture coordinates. Measured in points across each, as lookups read it.
    """
    steps = (np.arange(_PROBES) + 0.5) / _PROBES
    unit = np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2)
    size = np.array(mips[0].shape[1::-1])
    result = np.full((len(places), _MIPS), 0.5, np.float32)
    for row, place in enumerate(places.astype(np.float64)):

        def alpha(mip: int, place: Doubles = place) -> Doubles:
            inner = np.minimum(0.5 * 2**mip / size, place[2:] / 2)
            uv = place[:2] + np.clip(unit * place[2:], inner, place[2:] - inner)
            return sample_texture(mips, uv, np.full(len(uv), float(mip)))[:, 3]

        covered = float((alpha(0) >= 0.5).mean())
        result[row] = [_threshold(alpha(mip), covered) for mip in range(1, _MIPS + 1)]
    return result


def _threshold(alpha: Doubles, covered: float) -> float:
    """Where the soft test of `SOFTNESS` lets the share `covered` of some values pass."""
    low, high = -SOFTNESS, 1 + SOFTNESS
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        passing = np.clip((alpha - middle) / (2 * SOFTNESS) + 0.5, 0, 1).mean()
        low, high = (middle, high) if passing > covered else (low, middle)
    return (low + high) / 2


def _pack(sizes: Doubles, atlas: int) -> tuple[Doubles, Longs, tuple[int, int]]:
    """The sizes that images get, where they go, and the (width, height) of the texture, in texels."""
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
        f"{len(sizes)} leaf images do not fit into a texture of {atlas} x {atlas} texels; raise [indirect] atlas, "
        "or [indirect] likeness so that more of them are shared"
    )


class _Sides:
    """The exemplars' faces, ready to be drawn: image i < S is the front of shape i, S + i its back.

    Both are drawn as seen from the front, so that where a leaf does not fold over itself they are the same image.
    seen: (2 S,) bool, whether any face shows on that side.
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
        two_sided = np.array([material.double_sided for material in foliage.materials])
        both = two_sided[foliage.face_material[self.faces]] | shapes.is_twig[self.shape]
        (ux, uy), (vx, vy) = (np.moveaxis(self.places[:, i, :2] - self.places[:, 0, :2], 1, 0) for i in (1, 2))
        to_front = ux * vy - uy * vx < 0  # counter-clockwise, and rows run down
        self.seen = np.concatenate(
            [np.logical_or.reduceat(both | facing, self.starts[:-1]) for facing in (to_front, ~to_front)]
        )

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
        # One leaf across which a map repeats many times must not take the room of all others.
        most = np.zeros(count)
        side = np.array([0 if image is None else max(image.pixels.shape[:2]) for image in maps], np.float64)
        np.maximum.at(most, self.shape, side[self.foliage.face_material[self.faces]])
        density = np.where(most > 0, np.minimum(density, _REPEATS * most / sides.max(axis=1)), density)
        # Around a twig lies a whole tile of bark, so its texels are not square and their area says nothing.
        density = np.where(self.shapes.is_twig, leaf_texels / sides.max(axis=1), density)
        return np.maximum(np.rint(sides * density[:, None]), 1)

    def thumbs(self, images: Longs) -> Floats:
        """Some images with their normals, small: (images, values)."""
        across = int(np.ceil(np.sqrt(len(images))))
        tile = np.arange(len(images))
        origins = np.stack([tile % across, tile // across], axis=1) * _THUMB
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
        depth = np.clip(-place[..., 2:] * np.where(back[row] > 0, -1, 1)[:, None, None], -0.999, 0.999)
        triangles = FlatTriangles(
            positions=np.concatenate([texels, depth], axis=2).astype(np.float32),
            uvs=self.foliage.uvs[self.foliage.faces[self.faces[face]]],
            normals=self.normals[face].astype(np.float32),
            values=depth[..., 0].astype(np.float32),
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
            others = others[(leader[others] < 0) & (sizes[others] <= sizes[image]).all(axis=1)]
            alike = np.sqrt(((looks[others] - looks[image]) ** 2).mean(axis=1)) <= tolerance
            leader[others[alike]] = image
            leader[image] = image
    return leader
