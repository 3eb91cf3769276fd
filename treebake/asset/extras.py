"""The root's `extras.treebake` of a GLB. FORMAT.md describes it, and the types here are its schema."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from treebake.asset.manifest import FORMAT
from treebake.errors import AssetError, InputError
from treebake.formats.gltf_file import GltfFile
from treebake.model import Transmission

T = TypeVar("T")

Index = Annotated[int, msgspec.Meta(ge=0)]
Count = Annotated[int, msgspec.Meta(ge=1)]
Length = Annotated[float, msgspec.Meta(gt=0)]
Point = tuple[float, float, float]
Part = Annotated[float, msgspec.Meta(ge=0, le=1)]
Positive = Annotated[float, msgspec.Meta(ge=0)]


@dataclass(frozen=True)
class TransmissionExtras:
    """What light goes through: what part of it, and as a factor on the colour images."""

    factor: Part
    color: tuple[Positive, Positive, Positive]


@dataclass(frozen=True)
class IndirectExtras:
    """Where the tables and images lie: accessors of the tables, glTF textures of the images."""

    billboards: Index
    shapes: Index
    hash_texture: Index
    hash_width: Count  # texels of a row of the hash texture
    lists_texture: Index
    placements: Index
    ambient: Index
    leaves: Count  # placements in use, twig pieces among them
    largest: Length  # half the height of the largest leaf, in hash cells
    leaf_color: Index
    leaf_normal: Index
    far_color: Index
    far_normal: Index
    transmission: TransmissionExtras | None = None


@dataclass(frozen=True)
class AtlasExtras:
    """glTF textures of an atlas of pictures."""

    coverage: Index
    albedo: Index
    relief: Index
    occlusion: Index
    mips: Index  # of the coverage, below its first one, that show no picture's neighbours


@dataclass(frozen=True)
class SlicingsExtras:
    """Slicings: an accessor of the slices' table, and how they are drawn."""

    atlas: AtlasExtras
    slices: Index
    rectangles: Count  # of a slice
    orientations: Count
    count: Count  # slices of a slicing
    center: Point
    size: Length
    above: bool
    far_row: Index
    far_height: float
    dropped: Index
    brightness: float
    exposure: Length
    untrimmed: Count
    transmission: TransmissionExtras | None = None


@dataclass(frozen=True)
class TreeViewsExtras:
    """The views of one tree: accessors of the pictures' table and of the support, and how they are drawn."""

    name: str
    pictures: Index
    layout: str  # "ring" or "hemi"
    side: Count
    layers: Count
    center: Point
    radius: Length
    support: Index
    brightness: float
    exposure: Length
    transmission: TransmissionExtras | None = None


@dataclass(frozen=True)
class ViewsExtras:
    """View impostors of the trees that share an atlas."""

    atlas: AtlasExtras
    trees: Annotated[tuple[TreeViewsExtras, ...], msgspec.Meta(min_length=1)]


@dataclass(frozen=True)
class ForestTable:
    """Accessors: a row per tree, and a row (of bounds two) per cell of the culling grid."""

    places: Index
    turns: Index
    species: Index
    bounds: Index
    first: Index
    count: Index


@dataclass(frozen=True)
class ForestAsset:
    """A species: the asset's name, and its folder relative to the file."""

    name: str
    path: str


@dataclass(frozen=True)
class ForestExtras:
    """Instances of other assets; table is null where there are no trees."""

    assets: Annotated[tuple[ForestAsset, ...], msgspec.Meta(min_length=1)]
    table: ForestTable | None


@dataclass(frozen=True)
class Extras:
    """The value of the root's `extras.treebake`: what else the file holds."""

    format: int
    indirect: IndirectExtras | None = None
    slicings: SlicingsExtras | None = None
    views: ViewsExtras | None = None
    forest: ForestExtras | None = None


_UNREADABLE = (
    OSError,
    InputError,
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    AttributeError,
    OverflowError,
    RecursionError,
    msgspec.ValidationError,
)


def extras_schema() -> str:
    """The JSON schema of `extras.treebake`, which is kept as `extras.schema.json` beside this file."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **msgspec.json.schema(Extras)}
    return json.dumps(schema, indent=2) + "\n"


def transmission_extras(transmission: Transmission | None) -> dict[str, Any] | None:
    """What light goes through, as JSON."""
    return None if transmission is None else {"factor": transmission.factor, "color": list(transmission.color)}


def read_transmission(extras: TransmissionExtras | None) -> Transmission | None:
    """The reverse."""
    return None if extras is None else Transmission(extras.factor, extras.color)


def read_extras(path: Path, what: str, read: Callable[[GltfFile, Extras], tuple[T, str]]) -> T:
    """Open a GLB and let `read` take something from it and say what is wrong with it, or nothing.

    what: for the messages. Raises AssetError where it is missing, of an unknown format or damaged.
    """
    try:
        file = GltfFile(path)
        content = file.json["extras"]["treebake"]
        if content["format"] != FORMAT:
            raise AssetError(
                f"{path} is of format {content['format']}, and this treebake reads {FORMAT}; bake the tree again"
            )
        value, damage = read(file, msgspec.convert(content, Extras))
    except _UNREADABLE as error:
        raise AssetError(f"{path} holds no usable {what} ({error}); bake the tree again") from error
    if damage:
        raise AssetError(f"{path} is damaged: {damage}; bake the tree again")
    return value
