"""Split a mesh into a solid trunk and sparse foliage ([J00] 2.1), and the foliage into leaves."""

from treebake.stages.split.split import SplitSettings, split

__all__ = ["SplitSettings", "split"]
