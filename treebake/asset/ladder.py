"""Write what was measured of an asset into it: its ladder, and the heights at which its levels take over."""

import json
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec

from treebake.asset.manifest import LeftOut, Manifest, Rung
from treebake.asset.read import read_asset
from treebake.files import atomic

VIEW_HEIGHT = 1080  # pixels, of the view that MSFT_screencoverage is a part of


def write_ladder(folder: Path, rungs: Sequence[Rung], left_out: Sequence[LeftOut], heights: Sequence[int]) -> None:
    """Add a ladder to the asset in `folder`, and its levels' least heights, to the manifest and to NAME.glb.

    Raises AssetError where there is none, and WorkspaceError where a file cannot be written.
    """
    manifest = read_asset(folder).manifest
    levels = [replace(level, min_height=height) for level, height in zip(manifest.levels, heights, strict=True)]
    _cover(folder / manifest.file, screen_coverage(heights))
    write_manifest(folder, replace(manifest, levels=tuple(levels), ladder=tuple(rungs), left_out=tuple(left_out)))


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write manifest.json. Raises WorkspaceError."""
    with atomic(folder / "manifest.json") as file:
        file.write(msgspec.json.format(msgspec.json.encode(manifest), indent=2) + b"\n")


def screen_coverage(min_heights: Sequence[int]) -> list[float]:
    """MSFT_screencoverage of levels: the part of the view's height down to which each is drawn."""
    return [height / VIEW_HEIGHT for height in min_heights]


def _cover(path: Path, coverage: list[float]) -> None:
    """Replace the screen coverage of every node with levels in a GLB."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    for node in document.get("nodes", []):
        if "MSFT_screencoverage" in node.get("extras", {}):
            node["extras"]["MSFT_screencoverage"] = coverage
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)) + struct.pack("<I4s", len(text), b"JSON")
    with atomic(path) as file:
        file.write(head + text + rest)
