"""The published asset: the one place that knows its files. FORMAT.md describes them."""

from treebake.asset.forest import asset_bounds, read_forest, write_forest
from treebake.asset.indirect import indirect_bytes, leaf_card_bytes, read_indirect
from treebake.asset.manifest import Asset, Ladder, LeftOut, Level, Manifest, Rung
from treebake.asset.pictures import atlas_bytes, read_slicings, read_views
from treebake.asset.read import files_of, read_asset
from treebake.asset.write import SHARED, write_asset, write_shared_views

__all__ = [
    "SHARED",
    "Asset",
    "Ladder",
    "LeftOut",
    "Level",
    "Manifest",
    "Rung",
    "asset_bounds",
    "atlas_bytes",
    "files_of",
    "indirect_bytes",
    "leaf_card_bytes",
    "read_asset",
    "read_forest",
    "read_indirect",
    "read_slicings",
    "read_views",
    "write_asset",
    "write_forest",
    "write_shared_views",
]
