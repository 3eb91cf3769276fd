"""The published asset: the one place that knows its files. FORMAT.md describes them."""

from treebake.asset.indirect import indirect_bytes, read_indirect
from treebake.asset.manifest import Asset, Level, Manifest
from treebake.asset.read import read_asset
from treebake.asset.write import write_asset

__all__ = ["Asset", "Level", "Manifest", "indirect_bytes", "read_asset", "read_indirect", "write_asset"]
