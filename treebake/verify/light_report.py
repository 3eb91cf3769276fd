"""What `verify --light` found, for people and for machines: a table, light.json, sheets of pictures."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from treebake.files import atomic
from treebake.images import encode_png, to_srgb
from treebake.model import Bytes, Floats
from treebake.verify.light import LightReport
from treebake.verify.metrics import SKY, over
from treebake.verify.relit import Pair
from treebake.verify.tables import aligned, cell, rounded

_SHEETS = ("suns", "ground", "day", "light")
_FIGURES = ("relit", "shadows", "day")
_PAPER = (1.0, 1.0, 1.0)
_ROW = 8  # hours side by side
_COLUMNS = (  # heading, part, figure, format
    ("FLIP", "relit", "flip", ".4f"),
    ("/floor", "relit", "flip_ratio", ".3f"),
    ("worst sun", "relit", "flip_ratio_worst", ".3f"),
    ("leaf depth", "relit", "leaf_depth", ".3f"),
    ("ground IoU", "shadows", "ground_iou", ".3f"),
    ("self shadow", "shadows", "self_shadow", ".3f"),
    ("source's", "shadows", "source_self_shadow", ".3f"),
    ("depth map cm", "shadows", "depth_map_cm", ".1f"),
    ("its IoU", "shadows", "depth_map_iou", ".3f"),
    ("day", "day", "brightness", ".3f"),
    ("worst hour", "day", "brightness_worst", ".3f"),
    ("day /floor", "day", "flip_ratio", ".3f"),
)


def light_facts(reports: Mapping[str, LightReport]) -> dict[str, Any]:
    """Everything of every representation as plain values for JSON, rounded to 5 decimals."""
    return {
        name: {
            "height": report.height,
            **{part: rounded(asdict(figures)) if (figures := getattr(report, part)) else None for part in _FIGURES},
        }
        for name, report in reports.items()
    }


def format_light(reports: Mapping[str, LightReport]) -> str:
    """Lay the figures out for a terminal, a line for each representation."""
    lines = [["", "px", *(heading for heading, *_ in _COLUMNS)]]
    for name, report in reports.items():
        cells = [_cell(getattr(report, part), figure, form) for _, part, figure, form in _COLUMNS]
        lines.append([name, str(report.height), *cells])
    return "\n".join(aligned(lines, left=0))


def write_light_report(reports: Mapping[str, LightReport], folder: Path) -> None:
    """Write light.json, and for each representation the sheets NAME_suns.png, NAME_ground.png, NAME_day.png, of source
    above candidate, and NAME_light.png, the steps of its light from left to right.

    Raises WorkspaceError where the folder cannot be written.
    """
    for what in _SHEETS:
        for sheet in folder.glob(f"*_{what}.png"):  # of an earlier run, which light.json will not tell of
            sheet.unlink(missing_ok=True)
    for name, report in reports.items():
        steps = [getattr(report.steps, field.name) for field in fields(report.steps)]
        sheets = {
            "suns": _sheet(report.suns),
            "ground": np.concatenate([_grey(np.concatenate(pair)) for pair in report.ground], axis=1),
            "light": np.concatenate([to_srgb(over(step, _PAPER)) for step in steps], axis=1),
        }
        if report.hours:
            rows = [report.hours[first : first + _ROW] for first in range(0, len(report.hours), _ROW)]
            sheets["day"] = _stacked([_sheet(row) for row in rows])
        for what, pixels in sheets.items():
            with atomic(folder / f"{name}_{what}.png") as file:
                file.write(encode_png(pixels))
    with atomic(folder / "light.json") as file:
        file.write((json.dumps(light_facts(reports), indent=2) + "\n").encode())


def _sheet(pairs: Sequence[Pair]) -> Bytes:
    return np.concatenate([np.concatenate([to_srgb(over(each, SKY)) for each in pair]) for pair in pairs], axis=1)


def _stacked(rows: Sequence[Bytes]) -> Bytes:
    width = max(row.shape[1] for row in rows)
    return np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows])


def _grey(shadow: Floats) -> Bytes:
    return np.repeat(to_srgb(1 - shadow)[..., None], 3, axis=2)


def _cell(figures: Any, name: str, form: str) -> str:
    return cell(figures and getattr(figures, name), form)
