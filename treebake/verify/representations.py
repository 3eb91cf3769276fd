"""What a published asset can be drawn as."""

from collections.abc import Collection

import numpy as np

from treebake.asset import Asset, indirect_bytes, read_indirect
from treebake.errors import SettingsError
from treebake.meshes import read_mesh
from treebake.model import IndirectTextures, Mesh
from treebake.verify.protocol import REPRESENTATIONS, VerifySettings
from treebake.verify.same_bytes import with_texture_bytes

Drawn = tuple[dict[int, Mesh], IndirectTextures | None]


def representations(asset: Asset, heights: Collection[int], settings: VerifySettings) -> dict[str, Drawn]:
    """The representations of an asset that the settings ask for, by name: the mesh for each height, and billboards.

    Raises AssetError where a file is damaged, and SettingsError where the asset has nothing of what is asked for.
    """
    there = REPRESENTATIONS if asset.manifest.indirect else ("cloud",)
    asked = settings.representations or REPRESENTATIONS
    wanted = [name for name in there if name in asked]
    if not wanted:
        raise SettingsError(
            f"{asset.folder} has no {' or '.join(asked)}, only {', '.join(there)}; change verify.representations"
        )
    levels = {path: read_mesh(path) for path in asset.level_paths}
    cloud = {height: levels[asset.level_for(height)] for height in heights}
    found: dict[str, Drawn] = {"cloud": (cloud, None)}
    if asset.manifest.indirect and wanted != ["cloud"]:
        full = asset.folder / asset.manifest.indirect.file
        layers, mesh = read_indirect(full), read_mesh(full)
        limit = indirect_bytes(layers)
        smaller = {path: with_texture_bytes(level, limit) for path, level in levels.items()}
        found["cloud_same_bytes"] = {height: smaller[asset.level_for(height)] for height in heights}, None
        found["indirect"] = dict.fromkeys(heights, mesh.select(_is_trunk(mesh))), layers
    return {name: found[name] for name in wanted}


def _is_trunk(mesh: Mesh) -> np.ndarray:
    cloud = [index for index, node in enumerate(mesh.nodes) if node == "cloud"]
    return ~np.isin(mesh.face_node, cloud)
