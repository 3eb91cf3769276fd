"""Measure the rows, print them as a table and write build/bench.json: python -m tests.bench [--only E1,E5]."""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tests.bench import (  # noqa: F401 - they register their rows
    forest_rows,
    indirect_rows,
    level_rows,
    light_rows,
    picture_rows,
    trunk_rows,
)
from tests.bench.rows import ROWS, Measured, NotMeasured
from tests.bench.runner import Runner

BUILD = Path("build")


def main() -> int:
    """Return 1 where a measured row misses its bound, or a row that was asked for could not be measured."""
    parser = argparse.ArgumentParser(prog="make bench")
    parser.add_argument("--only", default="", help="row ids, separated by commas; all of them by default")
    asked = parser.parse_args().only
    only = asked.split(",") if asked else list(ROWS)
    if unknown := [name for name in only if name not in ROWS]:
        parser.error(f"there is no row {', '.join(unknown)}; known are {', '.join(ROWS)}")

    runner = Runner(BUILD / "bench")
    results = {}
    for name, row in ROWS.items():
        if name not in only:
            results[name] = Measured(None, False, "not measured: this run was asked for other rows only")
            continue
        print(f"{name} ...", file=sys.stderr, flush=True)
        try:
            results[name] = row.measure(runner)
        except NotMeasured as reason:
            results[name] = Measured(None, False, f"not measured: {reason}")
        _print_row(name, results[name])

    rows = [{"id": name, "bound": row.bound, "unit": row.unit, **asdict(results[name])} for name, row in ROWS.items()]
    BUILD.mkdir(exist_ok=True)
    (BUILD / "bench.json").write_text(json.dumps(rows, indent=2) + "\n")
    print(f"\nwritten: {BUILD / 'bench.json'}")
    return 0 if all(results[name].holds for name in only) else 1


def _print_row(name: str, result: Measured) -> None:
    row = ROWS[name]
    verdict = "?" if result.value is None else "holds" if result.holds else "MISSED"
    print(
        f"{name:<3} {verdict:<7} {_figure(result.value):<34} bound {row.bound}  [{row.unit}]  {result.note}", flush=True
    )


def _figure(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_figure, value))
    return f"{value:.3f}" if isinstance(value, float) else "-" if value is None else str(value)


if __name__ == "__main__":
    sys.exit(main())
