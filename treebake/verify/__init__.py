"""The proof: draws a candidate next to its source as a stock glTF client does, and measures the difference."""

from treebake.verify.approach import Change, approach
from treebake.verify.budget import BudgetSettings, check_budget, smallest
from treebake.verify.cameras import CloseUp, cameras, close_ups
from treebake.verify.figures import Figures
from treebake.verify.forest_report import forest_facts, format_forest, write_forest_report
from treebake.verify.ladder import LadderSettings, check_ladder, ladder
from treebake.verify.light import LightReport, LightSettings, check_light, in_full_light, pictures_of
from treebake.verify.light_report import format_light, light_facts, write_light_report
from treebake.verify.morph import Morphing, morphings
from treebake.verify.protocol import JUDGED, Level, Report, Sample, VerifySettings, verify
from treebake.verify.reference import SCALE
from treebake.verify.relit import Crown
from treebake.verify.report import as_dict, format_table, write_report
from treebake.verify.representations import representations
from treebake.verify.silhouette import silhouette_iou
from treebake.verify.thresholds import failures
from treebake.verify.walk import Walk, WalkSettings, walk

__all__ = [
    "JUDGED",
    "SCALE",
    "BudgetSettings",
    "Change",
    "CloseUp",
    "Crown",
    "Figures",
    "LadderSettings",
    "Level",
    "LightReport",
    "LightSettings",
    "Morphing",
    "Report",
    "Sample",
    "VerifySettings",
    "Walk",
    "WalkSettings",
    "approach",
    "as_dict",
    "cameras",
    "check_budget",
    "check_ladder",
    "check_light",
    "close_ups",
    "failures",
    "forest_facts",
    "format_forest",
    "format_light",
    "format_table",
    "in_full_light",
    "ladder",
    "light_facts",
    "morphings",
    "pictures_of",
    "representations",
    "silhouette_iou",
    "smallest",
    "verify",
    "walk",
    "write_forest_report",
    "write_light_report",
    "write_report",
]
