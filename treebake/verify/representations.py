"""What a published asset can be drawn as."""

from collections.abc import Callable, Collection
from pathlib import Path

import numpy as np

from treebake.asset import Asset, indirect_bytes, read_indirect, read_slicings, read_views
from treebake.errors import SettingsError
from treebake.leaf_cards import leaf_cards
from treebake.meshes import read_mesh
from treebake.model import EMPTY_MESH, Layers, Mesh
from treebake.verify.protocol import REPRESENTATIONS, VerifySettings
from treebake.verify.same_bytes import with_texture_bytes

Drawn = tuple[dict[int, Mesh], Layers | None]


def representations(asset: Asset, heights: Collection[int], settings: VerifySettings) -> dict[str, Drawn]:
    """The representations of an asset that the settings ask for, by name: the mesh for each height, and layers.

    Raises AssetError where a file is damaged, and SettingsError where the asset has nothing of what is asked for.
    """
    entries, folder = asset.manifest, asset.folder

    def beside(path: Path, node: str) -> dict[int, Mesh]:
        return dict.fromkeys(heights, without(read_mesh(path), node))

    makers: dict[str, Callable[[], Drawn]] = {"cloud": lambda: (_cloud(asset, heights, None), None)}
    if entries.indirect:
        full = folder / entries.indirect.file
        makers["cloud_same_bytes"] = lambda: (_cloud(asset, heights, indirect_bytes(read_indirect(full))), None)
        makers["indirect"] = lambda: (beside(full, "cloud"), read_indirect(full))
        makers["leaves"] = lambda: (beside(full, "cloud"), leaf_cards(read_indirect(full)))
    if entries.slicings:
        sliced = folder / entries.slicings.file
        makers["slicings"] = lambda: (beside(sliced, "slices"), read_slicings(sliced))
    if views := entries.views:
        makers["views"] = lambda: (dict.fromkeys(heights, EMPTY_MESH), read_views(folder / views.file, entries.name))
    asked = settings.representations or REPRESENTATIONS
    wanted = [name for name in makers if name in asked]
    if not wanted:
        raise SettingsError(
            f"{folder} has no {' or '.join(asked)}, only {', '.join(makers)}; change verify.representations"
        )
    return {name: makers[name]() for name in wanted}


def _cloud(asset: Asset, heights: Collection[int], limit: int | None) -> dict[int, Mesh]:
    """The level for each height, with its textures cut to so many bytes."""
    levels = {path: read_mesh(path) for path in asset.level_paths}
    if limit is not None:
        levels = {path: with_texture_bytes(level, limit) for path, level in levels.items()}
    return {height: levels[asset.level_for(height)] for height in heights}


def without(mesh: Mesh, node: str) -> Mesh:
    """What a file shows beside the node that layers take the place of."""
    replaced = [index for index, name in enumerate(mesh.nodes) if name == node]
    return mesh.select(~np.isin(mesh.face_node, replaced))
