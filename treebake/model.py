"""The types that flow between the stages: frozen dataclasses of arrays.

Frame of every position: right-handed, Y up, the source file's unit (metres by glTF's rule, though files differ: every
default length in treebake is relative to leaf or tree size). Faces are counter-clockwise seen from outside. Texture
coordinates follow glTF: (0, 0) is the centre-less corner of the *top* left texel, v grows downwards, wrap repeats.

Arrays are never changed in place once they sit in one of these types.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Words = NDArray[np.uint32]
Longs = NDArray[np.int64]
Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Ints = NDArray[np.int32]
Bytes = NDArray[np.uint8]


class AlphaMode(StrEnum):
    """How a material's alpha is read, by glTF's names."""

    OPAQUE = "OPAQUE"  # alpha is ignored
    MASK = "MASK"  # drawn where alpha >= alpha_cutoff
    BLEND = "BLEND"  # over-blended


@dataclass(frozen=True, eq=False)
class Texture:
    """An image as stored in a file.

    pixels: (height, width, 4) uint8, row 0 on top. RGB is sRGB-encoded in a colour map and linear in a normal map;
    alpha is linear, 255 where the file had none.
    """

    name: str
    pixels: Bytes

    @property
    def has_alpha(self) -> bool:
        """Whether any texel is less than opaque."""
        return bool((self.pixels[..., 3] < 255).any())


@dataclass(frozen=True)
class Transmission:
    """Light that a thin surface lets through to its other side, scattered (KHR_materials_diffuse_transmission).

    factor: what part of the light that is not absorbed goes through instead of back, 0 to 1. color: linear RGB, factor
    on the colour map for what goes through; the base colour does not count there.
    """

    factor: float
    color: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Material:
    """The part of a glTF material that treebake draws or hands on.

    base_color: linear RGBA factor on the colour map. normal_map: tangent space, +Y up (glTF). occlusion_map: R is the
    part of the sky that is seen; it weakens light from the sky, never colour. roughness_map: G is roughness, B metal,
    as factors on `roughness` and `metallic`. transmission: None where nothing goes through.
    """

    name: str
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    color_map: Texture | None = None
    normal_map: Texture | None = None
    occlusion_map: Texture | None = None
    roughness_map: Texture | None = None
    roughness: float = 1.0
    metallic: float = 0.0
    transmission: Transmission | None = None
    alpha_mode: AlphaMode = AlphaMode.OPAQUE
    alpha_cutoff: float = 0.5
    double_sided: bool = False

    @property
    def maps(self) -> dict[str, Texture]:
        """The maps that it has, by their names above."""
        found = {name: getattr(self, name) for name in ("color_map", "normal_map", "occlusion_map", "roughness_map")}
        return {name: image for name, image in found.items() if image is not None}


@dataclass(frozen=True, eq=False)
class Morph:
    """Where a mesh's vertices are once it is wholly morphed, in the mesh's frame.

    positions: (V, 3) float32. normals: (V, 3) float32, unit.
    """

    positions: Floats
    normals: Floats

    def __getitem__(self, vertices: Ints) -> "Morph":
        """Some of the vertices: (U,) int32."""
        return Morph(self.positions[vertices], self.normals[vertices])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with materials, all in one frame (node transforms are already applied).

    positions: (V, 3) float32. normals: (V, 3) float32, unit. uvs: (V, 2) float32. faces: (F, 3) int32 into the
    vertices. face_material: (F,) int32 into `materials`. face_node: (F,) int32 into `nodes` (the names of the file's
    nodes). morph: what it can be morphed into, by linear interpolation. occlusion_uvs: (V, 2) float32, where occlusion
    maps are looked up; None: at `uvs`. occlusion: (V,) float32, the part of the sky that each vertex sees, 0 to 1, as a
    factor on the map; None: all of it, or it is not known. A mesh may be empty (no faces); a vertex may be unused.
    """

    positions: Floats
    normals: Floats
    uvs: Floats
    faces: Ints
    face_material: Ints
    face_node: Ints
    materials: tuple[Material, ...]
    nodes: tuple[str, ...]
    morph: Morph | None = None
    occlusion_uvs: Floats | None = None
    occlusion: Floats | None = None

    @property
    def triangles(self) -> int:
        """The number of faces."""
        return len(self.faces)

    @cached_property
    def used(self) -> Ints:
        """The vertices that faces use, ascending: (U,) int32."""
        is_used = np.zeros(len(self.positions), bool)
        is_used[self.faces] = True
        return np.flatnonzero(is_used).astype(np.int32)

    @cached_property
    def bounds(self) -> Floats:
        """Least and greatest corner of the used vertices: (2, 3) float32; zeros where there is no face."""
        if not len(self.faces):
            return np.zeros((2, 3), np.float32)
        used = self.positions[self.faces].reshape(-1, 3)
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @cached_property
    def face_areas(self) -> Doubles:
        """(F,) float64, unit squared."""
        a, b, c = (self.positions[self.faces[:, i]].astype(np.float64) for i in range(3))
        areas: Doubles = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        return areas

    def select(self, mask: NDArray[np.bool_]) -> "Mesh":
        """The faces where mask: (F,) bool, with the unused vertices dropped; materials and nodes stay whole."""
        faces = self.faces[mask]
        used, inverse = np.unique(faces, return_inverse=True)
        return Mesh(
            positions=self.positions[used],
            normals=self.normals[used],
            uvs=self.uvs[used],
            faces=inverse.reshape(-1, 3).astype(np.int32),
            face_material=self.face_material[mask],
            face_node=self.face_node[mask],
            materials=self.materials,
            nodes=self.nodes,
            morph=self.morph and self.morph[used],
            occlusion_uvs=None if self.occlusion_uvs is None else self.occlusion_uvs[used],
            occlusion=None if self.occlusion is None else self.occlusion[used],
        )

    def morphed(self, weight: float) -> "Mesh":
        """The mesh as drawn at a weight of its morph, 0 to 1: positions blended, and normals too, made unit."""
        if self.morph is None:
            return self
        positions = self.positions + np.float32(weight) * (self.morph.positions - self.positions)
        normals = self.normals + np.float32(weight) * (self.morph.normals - self.normals)
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = (normals / np.where(lengths > 0, lengths, 1)).astype(np.float32)
        return replace(self, positions=positions, normals=normals, morph=None)


EMPTY_MESH = Mesh(
    positions=np.zeros((0, 3), np.float32),
    normals=np.zeros((0, 3), np.float32),
    uvs=np.zeros((0, 2), np.float32),
    faces=np.zeros((0, 3), np.int32),
    face_material=np.zeros(0, np.int32),
    face_node=np.zeros(0, np.int32),
    materials=(),
    nodes=(),
)


@dataclass(frozen=True, eq=False)
class Leaves:
    """The sparse set of a tree ([J00] 2.1), one row per element: a leaf, or a piece of a twig too thin for the trunk.

    face_leaf: (F,) int32, which element each face of the foliage mesh belongs to; every element has a face.
    centers: (N, 3) float64, area-weighted. normals: (N, 3) float64, unit, area-weighted average. areas: (N,) float64.
    radii: (N,) float64, distance from the centre to the element's farthest vertex.
    axes: (N, 3) float64, unit direction of a twig piece, whose normal is free about it; zero for a leaf.
    shape: (N,) int32, which of S congruent shapes the element is a copy of.
    exemplars: (S,) int32, the element that stands for each shape.
    transforms: (N, 3, 4) float64, takes the exemplar's vertices onto the element's (rotation, uniform scale, mirror).
    """

    face_leaf: Ints
    centers: Doubles
    normals: Doubles
    areas: Doubles
    radii: Doubles
    axes: Doubles
    shape: Ints
    exemplars: Ints
    transforms: Doubles

    @property
    def count(self) -> int:
        """The number of elements."""
        return len(self.centers)

    @property
    def size(self) -> float:
        """The mean root of a leaf's area: it tells the width of slender leaves better than their length does."""
        real = ~self.is_twig
        return float(np.sqrt(self.areas[real if real.any() else slice(None)]).mean())

    @property
    def is_twig(self) -> NDArray[np.bool_]:
        """(N,) bool, whether the element is a twig piece."""
        return np.asarray(self.axes.any(axis=1))


@dataclass(frozen=True)
class Decision:
    """Where the split put one group of faces, and why, in words for the user."""

    group: str  # a material's, a node's or a kind of component's name
    role: str  # "trunk" or "foliage"
    triangles: int
    reason: str


@dataclass(frozen=True)
class Translucency:
    """What the leaves of a tree let through, in the mean.

    transmission: its colour a factor on base colour times colour map, as atlases hold it. origin: "source", "broad
    leaf" or "needle", or several of them with commas.
    """

    transmission: Transmission
    origin: str


@dataclass(frozen=True, eq=False)
class Tree:
    """A tree split in two: solid trunk and sparse foliage; either mesh may be empty.

    translucency: None where no light goes through the leaves.
    """

    trunk: Mesh
    foliage: Mesh
    leaves: Leaves
    decisions: tuple[Decision, ...]
    translucency: Translucency | None = None

    @property
    def transmission(self) -> Transmission | None:
        """What stands for the leaves lets this through."""
        return None if self.translucency is None else self.translucency.transmission


@dataclass(frozen=True, eq=False)
class Clusters:
    """Leaves gathered into planes n.p + d = 0 ([GSSK05] 2.1).

    labels: (N,) int32, the plane of each leaf. normals: (K, 3) float64, unit. offsets: (K,) float64, the d of the
    plane equation, oriented so that d >= 0. Every plane has at least one leaf, but for what `planes.with_pieces` left.
    """

    labels: Ints
    normals: Doubles
    offsets: Doubles

    @property
    def count(self) -> int:
        """The number of planes."""
        return len(self.offsets)


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Ever fewer planes for the same leaves, nested: the leaves of a plane stay together ([GSSK05] 2.4).

    levels: from the finest to the coarsest, one at least. parents: for each level but the last, (K,) int32, the plane
    of the next level that takes each plane's leaves.
    """

    levels: tuple[Clusters, ...]
    parents: tuple[Ints, ...]


@dataclass(frozen=True, eq=False)
class BillboardCloud:
    """Cards on the planes of the clusters, with one atlas.

    mesh: the cards, with one material (MASK, double-sided) whose colour, normal and occlusion maps are the atlas.
    face_cluster: (F,) int32, the plane on which each triangle of the mesh lies. displacement: how far points of leaves
    were moved for it, root mean square, in the tree's unit.
    """

    mesh: Mesh
    face_cluster: Ints
    displacement: float = 0.0


@dataclass(frozen=True, eq=False)
class IndirectTextures:
    """Billboards whose texels are looked up: hash -> lists -> placements -> leaf images ([GPSS07] 4.2).

    The tables as they are published and as the shader reads them; `asset/FORMAT.md` gives every bit and equation.
    A billboard's own frame is (right, down, away), in hash cells from the corner of its box.

    billboards: (K, 20) float32, frame, box and place in the hash texture of each billboard.
    shapes: (S, 16) float32, size, relief, images and thresholds of each leaf shape.
    hash_texture: (h, w) uint32, the list of each cell: offset and count. lists_texture: (h, w) uint16, leaves of a
    billboard, in each list ordered front to back.
    placements: (h, w, 4) uint32, pose of each leaf. ambient: (h, w, 4) uint8, the part of the sky that the corners of
    each leaf see (left top, right top, right bottom, left bottom), beside its placement.
    leaves: how many placements there are. largest: half the height of the largest leaf, in cells.
    leaf_color, leaf_normal: one image per shape and side; the second holds the normal's right and up in RG and the
    relief's height in B. far_color, far_normal: all billboards at `far_texels` a hash cell, for what is not looked up;
    the second holds the part of the sky that is seen in A. transmission: of the leaves, not of twigs.
    """

    billboards: Floats
    shapes: Floats
    hash_texture: Words
    lists_texture: NDArray[np.uint16]
    placements: Words
    ambient: Bytes
    leaves: int
    largest: float
    leaf_color: Texture
    leaf_normal: Texture
    far_color: Texture
    far_normal: Texture
    transmission: Transmission | None = None


@dataclass(frozen=True, eq=False)
class PictureAtlas:
    """Pictures that stand in for a tree or parts of it, packed into one layout that four images share.

    coverage: grey, what part of each texel is covered. albedo: sRGB, without light, half as wide and high. relief: of
    the same size; RG are the surface's slopes to the picture's right and up, -4 to 4; B is depth, from the far end of
    the picture's range to the viewer's. occlusion: grey, the part of the sky that is seen, an eighth as wide and high
    as the coverage. mips: how many of the coverage's, below its first one, show nothing of a picture's neighbours.
    """

    coverage: Texture
    albedo: Texture
    relief: Texture
    occlusion: Texture
    mips: int


@dataclass(frozen=True, eq=False)
class Slicings:
    """Foliage on parallel textured slices, in several orientations ([J00] 2.1).

    slices: (S, 3 + 2 R, 4) float32, a row per slice as `asset/FORMAT.md` tells: frame and depth range, then R
    rectangles. Slicing after slicing, around the tree from +Z towards +X and then the one seen from above, the furthest
    slice first; then, from row `far_row` on, once more with one slice each.
    count: slices of a slicing. center: (3,) float64, shared by all slicings. size: greatest extent of the foliage.
    above: whether there is a slicing seen from above. far_height: pixels of that size below which one slice is drawn.
    dropped: of the furthest slices, not drawn. brightness: m of the correction 1 + m alpha_s. exposure: factor of the
    light. untrimmed: texels of all slices before empty parts were cut off.
    """

    slices: Floats
    orientations: int
    count: int
    center: Doubles
    size: float
    above: bool
    far_row: int
    far_height: float
    dropped: int
    brightness: float
    exposure: float
    atlas: PictureAtlas
    untrimmed: int
    transmission: Transmission | None = None

    @property
    def rectangles(self) -> int:
        """R, the rectangles that a slice is trimmed to."""
        return int(self.slices.shape[1] - 3) // 2

    @property
    def triangles(self) -> int:
        """How many are drawn for a tree seen from aside: two slicings."""
        return 2 * 2 * (self.count - self.dropped) * self.rectangles


@dataclass(frozen=True, eq=False)
class SlicedFoliage:
    """Slicings and what goes with them.

    solid: what is drawn as triangles beside them: large primitives, and the trunk once it is known. standard: the
    slices of two perpendicular slicings on cards with a standard material, for viewers that know no slicings.
    """

    slicings: Slicings
    solid: Mesh
    standard: Mesh


@dataclass(frozen=True, eq=False)
class Views:
    """A whole tree in pictures from several sides, shown on a card that faces the viewer ([I11]).

    pictures: (K L, 5, 4) float32, a row per picture as `asset/FORMAT.md` tells: frame and depth range, rectangle.
    Each of K views has L layers, the nearest first.
    layout: "ring", K views around the tree from +Z towards +X, or "hemi", side x side of them on a hemi-octahedron.
    side: K, or views along a side. layers: L. center: (3,) float64. radius: of the sphere about it that holds all.
    support: (33,) float32, how far the tree reaches at elevations from -90 to 90 degrees, however turned.
    brightness, exposure, transmission: as in Slicings. The atlas may be that of other trees too.
    """

    pictures: Floats
    layout: str
    side: int
    layers: int
    center: Doubles
    radius: float
    support: Floats
    brightness: float
    exposure: float
    atlas: PictureAtlas
    transmission: Transmission | None = None

    @property
    def triangles(self) -> int:
        """Of the card, whose outline has 8 corners."""
        return 6


@dataclass(frozen=True, eq=False)
class LeafCards:
    """Each leaf on a card of its own, with the images of indirect textures.

    cards: (N, 3, 4) float32, in the tree's frame: center and shape; half the width along the image's right, and -1
    where the image is reversed sidewards; half the height along its down, and 1 for a twig, which turns about it to
    face the viewer. shapes, leaf_color, leaf_normal, transmission: as in IndirectTextures. ambient: (N, 4) uint8, that
    of each leaf.
    """

    cards: Floats
    shapes: Floats
    leaf_color: Texture
    leaf_normal: Texture
    ambient: Bytes
    transmission: Transmission | None = None

    @property
    def triangles(self) -> int:
        """One for each leaf."""
        return len(self.cards)


Layers = IndirectTextures | LeafCards | Slicings | Views  # what a shader of ours draws


@dataclass(frozen=True, eq=False)
class Impostor:
    """Views of a tree, and two crossed cards with a standard material for viewers that know no views."""

    views: Views
    standard: Mesh


@dataclass(frozen=True)
class TrunkMaps:
    """How a simplified trunk shows the full one's surface.

    kind: "tiled", by the source's own textures, which repeat or are not opaque, or whose trunk was not simplified;
    "unique", by maps of its own; "none", it has no maps. source_density, density: texels per unit of the source's
    repeating textures, 0 where none repeat, and of maps of its own.
    """

    kind: str
    source_density: float = 0.0
    density: float = 0.0


@dataclass(frozen=True, eq=False)
class MappedTrunk:
    """A simplified trunk with its maps, and how they were chosen."""

    mesh: Mesh
    maps: TrunkMaps


@dataclass(frozen=True, eq=False)
class BakedLevel:
    """A coarser level of the cloud and the trunk, either of which may be empty.

    height: pixels of the tree's bounding sphere up to which it is for. trunk_iou: of the silhouettes of its trunk, with
    what has moved into the cloud, and of the source's, at that height; None where the source has no trunk.
    silhouette_kept: area of the one over that of the other, every branch by itself.
    """

    cloud: BillboardCloud
    trunk: Mesh
    height: int
    trunk_iou: float | None = None
    silhouette_kept: float = 1.0
    trunk_maps: TrunkMaps = TrunkMaps("none")


@dataclass(frozen=True, eq=False)
class BakedTree:
    """Everything that is published of one tree; what was not baked is None. `source` is the whole source's size.

    cloud and trunk are the finest level, levels the coarser ones.
    """

    name: str
    cloud: BillboardCloud
    indirect: IndirectTextures | None
    trunk: Mesh
    source_triangles: int
    source_bounds: Floats  # (2, 3) float32
    slicings: SlicedFoliage | None = None
    views: Impostor | None = None
    levels: tuple[BakedLevel, ...] = ()
    translucency: Translucency | None = None
    trunk_maps: TrunkMaps = TrunkMaps("none")


@dataclass(frozen=True, eq=False)
class Cells:
    """The squares of a forest's ground that are drawn or left out as a whole: C of them, none without trees.

    bounds: (C, 2, 3) float32, least and greatest corner, between which every tree of the cell lies whole.
    first, count: (C,) int32, a cell's trees are rows first to first + count - 1 of the forest's.
    """

    bounds: Floats
    first: Ints
    count: Ints


@dataclass(frozen=True, eq=False)
class Forest:
    """Where n trees of several species stand, ordered by cell and within a cell by species.

    names: of the species. species: (n,) int32 into `names`. places: (n, 4) float32, a tree's origin in the world, and
    its scale. turns: (n,) float32, radians about +Y, from +Z towards +X: first turned, then scaled, then placed.
    """

    names: tuple[str, ...]
    species: Ints
    places: Floats
    turns: Floats
    cells: Cells
