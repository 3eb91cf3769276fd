"""What `verify` found, for people and for machines: a table, report.json, contact sheets."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from treebake.files import atomic
from treebake.images import encode_png, to_srgb
from treebake.model import Bytes, Floats
from treebake.verify.figures import Figures
from treebake.verify.morph import Morphing
from treebake.verify.protocol import Level, Report, Sample
from treebake.verify.tables import aligned, cell, rounded
from treebake.verify.turn import Turn

# Dark to light through purple, evenly spaced for the eye: matplotlib's "magma" at quarter steps.
_RAMP = np.array([[0, 0, 4], [81, 18, 124], [183, 55, 121], [252, 137, 97], [252, 253, 191]], np.float64)
_COLUMNS = (  # heading, figure, format
    ("FLIP", "flip", ".4f"),
    ("worst", "flip_worst", ".4f"),
    ("/floor", "flip_ratio", ".3f"),
    ("SSIM", "ssim", ".3f"),
    ("IoU", "iou", ".3f"),
    ("coverage", "coverage", ".3f"),
    ("foliage", "foliage_coverage", ".3f"),
    ("depth cm", "depth_cm", ".1f"),
    ("overdraw", "overdraw", ".2f"),
    ("triangles", "triangles", ",d"),
    ("draws", "draw_calls", "d"),
    ("GPU bytes", "gpu_bytes", ",d"),
)


def as_dict(report: Report) -> dict[str, Any]:
    """The whole report as plain values for JSON, rounded to 5 decimals; a candidate's figures lie at the top."""
    return {
        "renderer": report.renderer,
        "views": report.views,
        "misses": list(report.misses),
        "heights": [_level(level) for level in report.levels],
        "close_up": _level(report.close_up) if report.close_up else None,
        "turn": rounded(asdict(report.turn)) if report.turn else None,
        "morphs": [rounded(asdict(each)) for each in report.morphs],
    }


def _level(level: Level) -> dict[str, Any]:
    return {
        "height": level.height,
        "invisible": level.invisible,
        **rounded(asdict(level.candidate)),
        "scale": {name: rounded(asdict(figures)) for name, figures in _scale(level).items()},
    }


def write_report(reports: Mapping[str, Report], folder: Path) -> None:
    """Write report.json, a table per representation, and its contact sheets, e.g. cloud_512px.png, cloud_close.png.

    A sheet shows source, candidate and FLIP map; its rows are each elevation's worst view, pixel for pixel. The map
    runs from black (no difference) to light yellow (1). The same reports give the same bytes. Raises WorkspaceError
    where the folder cannot be written.
    """
    for sheet in folder.glob("*_*.png"):  # of an earlier run, which report.json will not tell of
        if sheet.stem.endswith(("px", "_close")):
            sheet.unlink(missing_ok=True)
    for name, report in reports.items():
        for label, level in _labelled(report):
            with atomic(folder / f"{name}_{label}.png") as file:
                file.write(encode_png(np.concatenate([_row(sample) for sample in level.samples])))
    facts = {name: as_dict(report) for name, report in reports.items()}
    with atomic(folder / "report.json") as file:
        file.write((json.dumps(facts, indent=2, sort_keys=True) + "\n").encode())


def format_table(reports: Mapping[str, Report]) -> str:
    """Lay the figures out for a terminal: per height, and close up, every candidate, the floors and the empty scene."""
    lines = [["", "", *(heading for heading, _, _ in _COLUMNS)]]
    columns = {name: _labelled(report) for name, report in reports.items()}
    for index, (label, level) in enumerate(next(iter(columns.values()))):
        candidates = {name: column[index][1] for name, column in columns.items()}
        rows = {name: each.candidate for name, each in candidates.items()} | _scale(level)
        for row, (name, figures) in enumerate(rows.items()):
            mark = " =" if name in candidates and candidates[name].invisible else ""
            cells = [cell(getattr(figures, figure), form) for _, figure, form in _COLUMNS]
            lines.append(["" if row else label, name.replace("_", " ") + mark, *cells])
    moved = [line for name, each in reports.items() for line in (*_turned(name, each.turn), *_morphed(each.morphs))]
    return "\n".join(aligned(lines, left=1) + moved)


def _morphed(morphs: tuple[Morphing, ...]) -> list[str]:
    return [
        f"level {each.level} into {each.level + 1} at {each.height} px, FLIP over floor: largest of {each.steps} steps "
        f"{each.step:.3f}, last one to the next level {each.last:.3f}, without a morph {each.jump:.3f}"
        for each in morphs
    ]


def _turned(name: str, turn: Turn | None) -> list[str]:
    if turn is None:
        return []
    return [
        f"once round at {turn.height} px, {name.replace('_', ' ')}: brightness {turn.brightness:.3f} of the source's, "
        f"at worst {turn.brightness_worst:.3f}; largest step {turn.step:.2f} times the source's"
    ]


def _labelled(report: Report) -> list[tuple[str, Level]]:
    levels = [(f"{level.height}px", level) for level in report.levels]
    return [*levels, ("close", report.close_up)] if report.close_up else levels


def _scale(level: Level) -> dict[str, Figures]:
    return {"floor_0.5px": level.floor_half, "floor_1px": level.floor_one, "empty": level.empty}


def _row(sample: Sample) -> Bytes:
    return np.concatenate([to_srgb(sample.source), to_srgb(sample.candidate), _ramp(sample.flip)], axis=1)


def _ramp(values: Floats) -> Bytes:
    stops = np.linspace(0, 1, len(_RAMP))
    channels = [np.interp(values, stops, _RAMP[:, channel]) for channel in range(3)]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
