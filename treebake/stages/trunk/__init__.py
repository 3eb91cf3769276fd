"""Simplify the trunk to a triangle budget, and measure what it kept."""

from treebake.stages.trunk.report import TrunkReport, compare
from treebake.stages.trunk.trunk import TrunkSettings, trunk

__all__ = ["TrunkReport", "TrunkSettings", "compare", "trunk"]
