"""What manifest.json says; these types are its schema."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

VIEW_HEIGHT = 1080  # pixels, of the view that MSFT_screencoverage is a part of
FORMAT = 1  # raised when a reader of the number before could misread the files


@dataclass(frozen=True)
class Source:
    """The mesh that the asset was baked from. bounds: least and greatest corner, in the source's unit, Y up."""

    triangles: int
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class TranslucencyEntry:
    """What the leaves let through in the mean. color: a factor on base colour times colour map. origin: of the figures,
    "source", "broad leaf" or "needle", or several of them with commas.
    """

    factor: float
    color: tuple[float, float, float]
    origin: str


@dataclass(frozen=True)
class Level:
    """One self-contained GLB with standard materials. bytes: of the file. min_height: the height on screen, in pixels
    of the tree's bounding sphere, from which on this level is meant to be drawn. trunk_iou: of the silhouettes of a
    coarser level's trunk and the source's, at the greatest height it is for. displacement: how far the points of leaves
    were moved into its planes, root mean square, in the source's unit. trunk_maps: whose the trunk's maps are.
    """

    file: str
    representations: tuple[str, ...]  # of "cloud" and "trunk"
    billboards: int  # planes
    foliage_triangles: int
    trunk_triangles: int
    bytes: int
    min_height: int
    trunk_iou: float | None = None
    displacement: float = 0.0
    trunk_maps: str = "none"  # "tiled", the source's own; "unique", baked for it; "none"


@dataclass(frozen=True)
class Indirect:
    """The indirect textures in `file`, beside that file's standard meshes. leaves: placements, twig pieces among them.
    gpu_bytes: tables and block-compressed images with their mips.
    """

    file: str
    billboards: int
    leaves: int
    gpu_bytes: int


@dataclass(frozen=True)
class SlicingsEntry:
    """The slicings in `file`, beside standard cards and a trunk of `trunk_triangles`.

    slicings: around the tree, and one seen from above. triangles: drawn for a tree. texels_kept: part of the slices'
    texels that the atlas has room for. gpu_bytes: of what drawing looks up, block-compressed, with mips.
    """

    file: str
    slicings: int
    slices: int
    triangles: int
    trunk_triangles: int
    texels_kept: float
    gpu_bytes: int


@dataclass(frozen=True)
class Picture:
    """One layer of one view. azimuth, elevation: degrees, where it was taken from. uv: left, top, right, bottom in the
    atlas, as texture coordinates.
    """

    azimuth: float
    elevation: float
    layer: int
    uv: tuple[float, float, float, float]


@dataclass(frozen=True)
class ViewsEntry:
    """The view impostors in `file`, which may hold other trees' too. gpu_bytes: as for slicings, of the atlas."""

    file: str
    layout: str
    layers: int
    triangles: int
    gpu_bytes: int
    pictures: tuple[Picture, ...]


@dataclass(frozen=True)
class Rung:
    """One step of the ladder. level: of a cloud, its place in `levels`. min_height: the height on screen, in pixels of
    the tree's bounding sphere, down to which it is drawn. flip_ratio: FLIP over floor(1 px), measured at the greatest
    height from which it is drawn; up to 1 is invisible.
    """

    representation: str  # "leaves", "indirect", "cloud", "slicings" or "views"
    file: str
    level: int | None
    min_height: int
    flip_ratio: float
    triangles: int
    gpu_bytes: int


@dataclass(frozen=True)
class LeftOut:
    """A representation that is on no rung, and why."""

    representation: str
    file: str
    level: int | None
    reason: str


@dataclass(frozen=True)
class Ladder:
    """Rungs from near to far, what is on none of them, and the least heights of the standard levels."""

    rungs: tuple[Rung, ...]
    left_out: tuple[LeftOut, ...]
    level_heights: tuple[int, ...]


@dataclass(frozen=True)
class Image:
    """A loose copy of a texture, for engines. size: width and height in texels."""

    file: str
    size: tuple[int, int]
    color_space: str  # "sRGB", "linear", or "data" for tables, which must not be filtered or converted


@dataclass(frozen=True)
class Manifest:
    """The whole of manifest.json. Paths are relative to it; levels and ladder go from near to far. file: all levels,
    bound to each other, and the indirect textures.
    """

    format: int
    generator: str
    name: str
    source: Source
    file: str
    levels: Annotated[tuple[Level, ...], msgspec.Meta(min_length=1)]
    textures: tuple[Image, ...]
    indirect: Indirect | None = None  # these three where there is foliage and they were baked
    slicings: SlicingsEntry | None = None
    views: ViewsEntry | None = None
    ladder: tuple[Rung, ...] = ()  # from near to far; empty where it was not measured
    left_out: tuple[LeftOut, ...] = ()
    translucency: TranslucencyEntry | None = None  # None where no light goes through


@dataclass(frozen=True)
class Asset:
    """A published asset on disk."""

    folder: Path
    manifest: Manifest

    @property
    def level_paths(self) -> tuple[Path, ...]:
        """The GLB of every level, from near to far."""
        return tuple(self.folder / level.file for level in self.manifest.levels)

    def level_number(self, height: int) -> int:
        """The nearest level that reaches down to a tree `height` pixels high."""
        levels = self.manifest.levels
        return next((number for number, level in enumerate(levels) if level.min_height <= height), len(levels) - 1)

    def level_for(self, height: int) -> Path:
        """The GLB of that level."""
        return self.level_paths[self.level_number(height)]


def screen_coverage(min_heights: Sequence[int]) -> list[float]:
    """MSFT_screencoverage of levels: the part of the view's height down to which each is drawn."""
    return [height / VIEW_HEIGHT for height in min_heights]
