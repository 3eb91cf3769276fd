"""The proof: draws a candidate next to its source as a stock glTF client does, and measures the difference."""

from treebake.verify.figures import Figures
from treebake.verify.protocol import Level, Report, Sample, VerifySettings, verify
from treebake.verify.report import as_dict, format_table, write_report
from treebake.verify.thresholds import failures

__all__ = [
    "Figures",
    "Level",
    "Report",
    "Sample",
    "VerifySettings",
    "as_dict",
    "failures",
    "format_table",
    "verify",
    "write_report",
]
