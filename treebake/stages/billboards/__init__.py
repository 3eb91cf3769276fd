"""Billboard cloud: bake the leaves of every cluster into cards that share one atlas ([GSSK05] 2, [GPSS07] 4)."""

from treebake.stages.billboards.billboards import BillboardSettings, billboards

__all__ = ["BillboardSettings", "billboards"]
