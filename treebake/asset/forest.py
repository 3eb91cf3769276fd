"""A forest as one GLB: instances of published assets, and `extras.treebake.forest`, from which our renderers draw."""

import os
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from treebake.asset.extras import Extras, read_extras
from treebake.asset.manifest import FORMAT, Asset, screen_coverage
from treebake.asset.read import files_of
from treebake.errors import AssetError, WorkspaceError
from treebake.formats.gltf_file import GltfFile
from treebake.glb import Instances, Node, write_glb
from treebake.meshes import read_mesh
from treebake.model import Cells, Floats, Forest, Mesh

# Values and width of the tables' accessors; of the forest or of its cells, whose bounds take two rows each.
TABLES = {"places": ("f4", 4), "turns": ("f4", 1), "species": ("u2", 1)}
CELLS = {"bounds": ("f4", 3), "first": ("u4", 1), "count": ("u4", 1)}


def asset_bounds(asset: Asset) -> Floats:
    """Least and greatest corner of all that an asset shows of its tree: (2, 3) float32.

    That is more than the source's, for cards stand out a little. Raises InputError where a level's file is damaged.
    """
    boxes = [asset.manifest.source.bounds, *(read_mesh(level).bounds for level in asset.level_paths)]
    corners = np.array(boxes, np.float32)
    return np.stack([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def write_forest(path: Path, forest: Forest, assets: Sequence[Asset]) -> None:
    """Write a forest of the species that the assets show.

    The trees of one species in one cell are a node with instances and the levels of the asset, whose meshes all cells
    share. O(bytes of the levels + trees).

    Raises AssetError where a species has no asset, WorkspaceError where the file would replace one of an asset's or
    cannot be written, and InputError where a level's file is damaged.
    """
    known = {asset.manifest.name: asset for asset in assets}
    if missing := [name for name in forest.names if name not in known]:
        raise AssetError(f"no asset is named {missing[0]}, as a species of the forest is; there are {', '.join(known)}")
    species = [known[name] for name in forest.names]
    for asset in species:
        for file in ("manifest.json", *files_of(asset.manifest)):
            if path.exists() and path.samefile(asset.folder / file):
                raise WorkspaceError(f"{path} is a file of the asset {asset.folder}; give another name with -o")
    where = {
        "assets": [{"name": asset.manifest.name, "path": _beside(asset.folder, path)} for asset in species],
        "table": _table(forest) if len(forest.places) else None,
    }
    write_glb(path, list(_nodes(forest, species)), {"treebake": {"format": FORMAT, "forest": where}})


def read_forest(path: Path) -> tuple[Forest, tuple[Path, ...]]:
    """Read a forest, and the folder of each species' asset.

    Raises AssetError where the file is missing, holds no forest, is of an unknown format or damaged.
    """
    return read_extras(path, "forest", lambda file, extras: _read(path.parent, file, extras))


def _beside(folder: Path, path: Path) -> str:
    """A folder's path from where a file lies."""
    return Path(os.path.relpath(folder.resolve(), path.parent.resolve())).as_posix()


def _table(forest: Forest) -> dict[str, Any]:
    return {
        name: getattr(owner, name).reshape(-1, width).astype(kind)
        for owner, tables in ((forest, TABLES), (forest.cells, CELLS))
        for name, (kind, width) in tables.items()
    }


def _nodes(forest: Forest, species: Sequence[Asset]) -> Iterator[Node]:
    """One for each run of trees of one cell and one species: the nodes' instances, joined, are the table's rows."""

    @cache
    def levels(number: int) -> list[Mesh]:
        return [read_mesh(level) for level in species[number].level_paths]

    starts = np.union1d(forest.cells.first, 1 + np.flatnonzero(np.diff(forest.species))).astype(int)
    for first, end in zip(starts, [*starts[1:], len(forest.places)], strict=False):
        number = int(forest.species[first])
        near, *far = levels(number)
        manifest = species[number].manifest
        coverage = screen_coverage([level.min_height for level in manifest.levels]) if far else []
        yield Node(manifest.name, near, far, coverage, _instances(forest, slice(first, end)))


def _instances(forest: Forest, rows: slice) -> Instances:
    places, half = forest.places[rows], forest.turns[rows].astype(np.float64) / 2
    rotations = np.column_stack([0 * half, np.sin(half), 0 * half, np.cos(half)]).astype(np.float32)
    return Instances(places[:, :3], rotations, np.repeat(places[:, 3:], 3, axis=1))


def _read(folder: Path, file: GltfFile, extras: Extras) -> tuple[tuple[Forest, tuple[Path, ...]], str]:
    where = extras.forest
    if where is None:
        raise ValueError("there is none")
    found: dict[str, Any] = {}
    for name, (kind, width) in (TABLES | CELLS).items():
        empty = np.zeros((0, width), kind)
        found[name] = empty if where.table is None else file.accessor(getattr(where.table, name))
        if found[name].dtype != empty.dtype or found[name].shape[1] != width:
            raise ValueError(f"table {name} has values of another kind")
    species, first, count = (found[name][:, 0].astype(np.int32) for name in ("species", "first", "count"))
    places, turns, bounds = found["places"], found["turns"][:, 0], found["bounds"]
    trees = len(places)
    checks = (
        (len(species) == len(turns) == trees, "its tables are of different lengths"),
        ((species < len(where.assets)).all(), "a tree is of a species that it does not name"),
        (np.isfinite(places).all() and np.isfinite(turns).all(), "a tree's place is no number"),
        (np.isfinite(bounds).all(), "a cell's bounds are no numbers"),
        (np.array_equal([*first, trees], np.cumsum([0, *count])), "its cells do not hold its trees"),
        (len(bounds) == 2 * len(first), "it has more or fewer bounds than cells"),
    )
    damage = next((what for sound, what in checks if not sound), "")
    names = tuple(asset.name for asset in where.assets)
    cells = Cells(bounds[: len(bounds) // 2 * 2].reshape(-1, 2, 3), first, count)
    folders = tuple(folder / asset.path for asset in where.assets)
    return (Forest(names, species, places, turns, cells), folders), damage
