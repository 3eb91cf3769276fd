"""Bounds on a report's figures, as they are written in TOML."""

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields

from treebake.errors import SettingsError
from treebake.verify.figures import Figures

Thresholds = Mapping[str, float | Mapping[str, float]]
CLOSE = "close"  # stands where a height does for the views of close up
_FIGURES = tuple(field.name for field in fields(Figures))


def failures(measured: Iterable[tuple[int | str, Figures]], thresholds: Thresholds) -> tuple[str, ...]:
    """Say which thresholds are missed, one line each, e.g. "flip_ratio at 256 px is 1.310, above 1.0".

    measured: the figures at each height, and CLOSE up. thresholds: a figure's name, with _min or _max (without: _max),
    to a bound for all heights or to one per height, {"512": 1.1, "close": 1.0}; a height that was not measured is not
    judged. A figure that could not be measured misses every bound. Raises SettingsError for an unknown figure or a
    height that is no number.
    """
    bounds = parse(thresholds)
    return tuple(
        _line(name, height, value, least, bound)
        for height, figures in measured
        for name, least, heights, bound in bounds
        if height == heights or (heights is None and height != CLOSE)
        for value in [asdict(figures)[name]]
        if value is None or (value < bound if least else value > bound)
    )


def parse(thresholds: Thresholds) -> list[tuple[str, bool, int | str | None, float]]:
    """Take thresholds apart: the figure, whether the bound is the least, the height (None: all, CLOSE), the bound.

    Raises SettingsError as `failures` does.
    """
    bounds: list[tuple[str, bool, int | str | None, float]] = []
    for key, value in thresholds.items():
        name = key.removesuffix("_min").removesuffix("_max")
        if name not in _FIGURES:
            near = difflib.get_close_matches(name, _FIGURES, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(_FIGURES)}, with _min or _max"
            raise SettingsError(f"verify.thresholds: there is no figure {name}; {hint}")
        per_height = value if isinstance(value, Mapping) else {None: value}
        for height, bound in per_height.items():
            if height not in (None, CLOSE) and not height.isdecimal():
                hint = f"give pixels, e.g. 512 = {bound}, or {CLOSE}"
                raise SettingsError(f"verify.thresholds.{key}: {height} is no height; {hint}")
            where = height if height in (None, CLOSE) else int(height)
            bounds.append((name, key.endswith("_min"), where, float(bound)))
    return bounds


def _line(name: str, height: int | str, value: float | None, least: bool, bound: float) -> str:
    where = "close up" if height == CLOSE else f"at {height} px"
    if value is None:
        return f"{name} {where} could not be measured, and is asked for"
    shown = f"{value:.3f}" if isinstance(value, float) else f"{value:,}"
    return f"{name} {where} is {shown}, {'below' if least else 'above'} {bound:g}"
