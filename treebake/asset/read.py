"""Read a published asset's manifest; the GLBs themselves are read like anyone's."""

from pathlib import Path

import msgspec

from treebake.asset.manifest import FORMAT, Asset, Manifest
from treebake.errors import AssetError


def read_asset(folder: Path) -> Asset:
    """Open the asset in `folder` and check that its manifest is known and its files are there.

    Raises AssetError where the manifest is missing, damaged or of an unknown format, or a file is missing.
    """
    path = folder / "manifest.json"
    try:
        data = path.read_bytes()
        number = msgspec.json.decode(data, type=_Numbered).format
        if number != FORMAT:
            raise AssetError(
                f"{path} is of format {number}, and this treebake reads format {FORMAT}; bake the tree again, "
                "or use the treebake that wrote it"
            )
        manifest = msgspec.json.decode(data, type=Manifest)
    except OSError as error:
        raise AssetError(f"{folder} is no published asset: {path.name} cannot be read ({error.strerror})") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise AssetError(f"{path} is damaged ({error}); bake the tree again") from error
    for file in files_of(manifest):
        if not (folder / file).is_file():
            raise AssetError(f"{folder / file} is named by the manifest and is missing; bake the tree again")
    return Asset(folder, manifest)


def files_of(manifest: Manifest) -> list[str]:
    """Every file that a manifest names, each once."""
    entries = [entry for entry in (manifest.indirect, manifest.slicings, manifest.views) if entry]
    told = (*manifest.levels, *manifest.textures, *entries, *manifest.ladder, *manifest.left_out)
    return list(dict.fromkeys([manifest.file, *(each.file for each in told)]))


class _Numbered(msgspec.Struct):
    """The one key that every format has."""

    format: int
