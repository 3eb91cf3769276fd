"""Unwrap a simplified trunk and bake what the full one looks like into its maps."""

from treebake.stages.trunk_maps.trunk_maps import TrunkMapSettings, trunk_maps

__all__ = ["TrunkMapSettings", "trunk_maps"]
