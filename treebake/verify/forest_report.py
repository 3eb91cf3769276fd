"""What was found on the way through a forest, for people and for machines."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from treebake.files import atomic
from treebake.images import encode_png, to_srgb
from treebake.verify.approach import Change
from treebake.verify.tables import aligned, cell, rounded
from treebake.verify.walk import Walk

_SUMS = ("speed_up_worst", "speed_up_mean", "worst", "mean", "flip_ratio")
_COLUMNS = (  # heading, figure, format
    ("trees", "trees", "d"),
    ("ms", "milliseconds", ".1f"),
    ("source ms", "source_milliseconds", ".1f"),
    ("/floor", "flip_ratio", ".3f"),
    ("triangles", "triangles", ",d"),
    ("draws", "draw_calls", "d"),
    ("overdraw", "overdraw", ".2f"),
)


def forest_facts(found: Walk, changes: Mapping[str, Sequence[Change]]) -> dict[str, Any]:
    """Everything as plain values for JSON. changes: of each species' ladder."""
    return {
        "renderer": found.renderer,
        **rounded({name: getattr(found, name) for name in _SUMS}),
        "gpu_bytes": found.gpu_bytes,
        "frames": [rounded(asdict(frame)) for frame in found.frames],
        "changes": {name: [rounded(asdict(change)) for change in each] for name, each in changes.items()},
    }


def format_forest(found: Walk, changes: Mapping[str, Sequence[Change]]) -> str:
    """Lay the frames out for a terminal, the sums and the changes of rungs below."""
    rows = [["frame", *(heading for heading, _, _ in _COLUMNS)]]
    rows += [
        [str(number), *(cell(getattr(frame, figure), form) for _, figure, form in _COLUMNS)]
        for number, frame in enumerate(found.frames)
    ]
    lines = aligned(rows)
    lines += ["", f"worst frame {found.worst:.1f} ms, mean {found.mean:.1f} ms ({found.renderer})"]
    if found.speed_up_worst and found.speed_up_mean:
        lines += [
            f"times as fast as the source: worst frame {found.speed_up_worst:.1f}, mean {found.speed_up_mean:.1f}",
            f"FLIP / floor(1 px), mean of the compared frames: {found.flip_ratio or 0:.3f}",
        ]
    lines += [f"bytes on the graphics card, all rungs of all species: {found.gpu_bytes:,}"]
    for name, each in changes.items():
        lines += [
            f"{name}, {change.nearer} to {change.farther} at {change.height} px: largest step {change.step:.2f} times "
            "the source's own"
            for change in each
        ]
    return "\n".join(lines)


def write_forest_report(found: Walk, changes: Mapping[str, Sequence[Change]], folder: Path) -> None:
    """Write forest.json, and forest.png: the two compared frames that differ most, source and ours side by side.

    Raises WorkspaceError where the folder cannot be written.
    """
    if found.samples:
        rows = [np.concatenate([to_srgb(picture) for picture in pair], axis=1) for pair in found.samples]
        with atomic(folder / "forest.png") as file:
            file.write(encode_png(np.concatenate(rows)))
    with atomic(folder / "forest.json") as file:
        file.write((json.dumps(forest_facts(found, changes), indent=2) + "\n").encode())
