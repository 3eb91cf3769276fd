"""What a published asset can be drawn as."""

from dataclasses import dataclass

import numpy as np

from treebake.asset import Asset, read_indirect, read_slicings, read_views
from treebake.leaf_cards import leaf_cards
from treebake.meshes import read_mesh
from treebake.model import EMPTY_MESH, Layers, Mesh

_ENTRIES = {"leaves": "indirect", "indirect": "indirect", "slicings": "slicings", "views": "views"}  # of the manifest


@dataclass(frozen=True, eq=False)
class Candidate:
    """One way to draw a tree. level: of a cloud, its place in the manifest's levels. displacement: how far it moves the
    leaves, in the source's unit; what has depth shows them where they are.
    """

    representation: str
    file: str
    level: int | None
    mesh: Mesh
    layers: Layers | None
    displacement: float = 0.0

    @property
    def name(self) -> str:
        """For people."""
        return self.representation if self.level is None else f"{self.representation} LOD{self.level}"


def drawn_as(asset: Asset, representation: str, level: int | None = None) -> Candidate:
    """One representation of an asset that has it, a cloud at one of its levels. Raises AssetError and InputError."""
    manifest, folder = asset.manifest, asset.folder
    entry = getattr(manifest, _ENTRIES[representation]) if level is None else manifest.levels[level]
    path, rest = folder / entry.file, EMPTY_MESH
    layers: Layers | None = None
    match representation:
        case "cloud":
            rest = read_mesh(path)
        case "leaves":
            rest, layers = without(read_mesh(path), "cloud"), leaf_cards(read_indirect(path))
        case "indirect":
            rest, layers = without(read_mesh(path), "cloud"), read_indirect(path)
        case "slicings":
            rest, layers = without(read_mesh(path), "slices"), read_slicings(path)
        case "views":
            layers = read_views(path, manifest.name)
    displacement = 0.0 if level is None else manifest.levels[level].displacement
    return Candidate(representation, entry.file, level, rest, layers, displacement)


def has(asset: Asset, representation: str) -> bool:
    """Whether an asset has what is no cloud."""
    return getattr(asset.manifest, _ENTRIES[representation]) is not None


def candidates(asset: Asset) -> tuple[Candidate, ...]:
    """Everything that an asset can be drawn as. Raises AssetError and InputError where a file is damaged."""
    there = [name for name in _ENTRIES if has(asset, name)]
    clouds = [drawn_as(asset, "cloud", level) for level in range(len(asset.manifest.levels))]
    return (*(drawn_as(asset, name) for name in there), *clouds)


def without(mesh: Mesh, node: str) -> Mesh:
    """What a file shows beside the node that layers take the place of."""
    replaced = [index for index, name in enumerate(mesh.nodes) if name == node]
    return mesh.select(~np.isin(mesh.face_node, replaced))
