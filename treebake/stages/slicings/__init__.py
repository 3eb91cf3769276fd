"""Slicings: the foliage on parallel slices in several orientations ([J00])."""

from treebake.stages.slicings.slicings import SlicingSettings, slicings

__all__ = ["SlicingSettings", "slicings"]
