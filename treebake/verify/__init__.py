"""The proof: draws a candidate next to its source as a stock glTF client does, and measures the difference."""

from treebake.verify.cameras import CloseUp, cameras, close_ups
from treebake.verify.figures import Figures
from treebake.verify.morph import Morphing, morphings
from treebake.verify.protocol import JUDGED, Level, Report, Sample, VerifySettings, verify
from treebake.verify.reference import SCALE
from treebake.verify.report import as_dict, format_table, write_report
from treebake.verify.representations import representations
from treebake.verify.silhouette import silhouette_iou
from treebake.verify.thresholds import failures

__all__ = [
    "JUDGED",
    "SCALE",
    "CloseUp",
    "Figures",
    "Level",
    "Morphing",
    "Report",
    "Sample",
    "VerifySettings",
    "as_dict",
    "cameras",
    "close_ups",
    "failures",
    "format_table",
    "morphings",
    "representations",
    "silhouette_iou",
    "verify",
    "write_report",
]
