"""The representations of an asset that are judged, at each height."""

from collections.abc import Callable, Collection
from functools import partial

from treebake.asset import Asset, indirect_bytes, read_indirect
from treebake.errors import SettingsError
from treebake.meshes import read_mesh
from treebake.model import Layers, Mesh
from treebake.verify.drawn_as import drawn_as, has
from treebake.verify.protocol import REPRESENTATIONS, VerifySettings
from treebake.verify.same_bytes import with_texture_bytes

Drawn = tuple[dict[int, Mesh], Layers | None]


def representations(asset: Asset, heights: Collection[int], settings: VerifySettings) -> dict[str, Drawn]:
    """The representations of an asset that the settings ask for, by name: the mesh for each height, and layers.

    Raises AssetError where a file is damaged, and SettingsError where the asset has nothing of what is asked for.
    """
    makers: dict[str, Callable[[], Drawn]] = {"cloud": lambda: (_cloud(asset, heights, None), None)}
    if entry := asset.manifest.indirect:
        tables = asset.folder / entry.file
        makers["cloud_same_bytes"] = lambda: (_cloud(asset, heights, indirect_bytes(read_indirect(tables))), None)
    for name in ("indirect", "leaves", "slicings", "views"):
        if has(asset, name):
            makers[name] = partial(_layered, asset, name, heights)
    asked = settings.representations or REPRESENTATIONS
    wanted = [name for name in makers if name in asked]
    if not wanted:
        raise SettingsError(
            f"{asset.folder} has no {' or '.join(asked)}, only {', '.join(makers)}; change verify.representations"
        )
    return {name: makers[name]() for name in wanted}


def _layered(asset: Asset, name: str, heights: Collection[int]) -> Drawn:
    drawn = drawn_as(asset, name)
    return dict.fromkeys(heights, drawn.mesh), drawn.layers


def _cloud(asset: Asset, heights: Collection[int], limit: int | None) -> dict[int, Mesh]:
    """The level for each height, with its textures cut to so many bytes."""
    levels = {path: read_mesh(path) for path in asset.level_paths}
    if limit is not None:
        levels = {path: with_texture_bytes(level, limit) for path, level in levels.items()}
    return {height: levels[asset.level_for(height)] for height in heights}
