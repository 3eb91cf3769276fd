"""Figures as text and as JSON: what all reports lay out alike."""

from collections.abc import Mapping, Sequence
from typing import Any

_DECIMALS = 5


def rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values for JSON, numbers that are no integers rounded to 5 decimals."""
    return {name: round(value, _DECIMALS) if isinstance(value, float) else value for name, value in values.items()}


def cell(value: Any, form: str) -> str:
    """A figure in a format, or a dash where there was nothing to measure."""
    return "-" if value is None else format(value, form)


def aligned(lines: Sequence[Sequence[str]], left: int | None = None) -> list[str]:
    """Lines of as many cells each as text, all columns aligned to the right but for the one numbered `left`."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return [
        "  ".join(
            each.ljust(width) if index == left else each.rjust(width)
            for index, (each, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    ]
