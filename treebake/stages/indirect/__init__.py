"""Multi-layered indirect textures: every leaf where it is, at source resolution, in tables ([GPSS07] 3 to 6)."""

from treebake.stages.indirect.indirect import IndirectSettings, indirect

__all__ = ["IndirectSettings", "indirect"]
