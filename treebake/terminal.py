"""What a command says: progress and warnings on stderr, its result on stdout as text or as JSON."""

import json
import logging
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

Advance = Callable[[int, int], None]  # called with the steps done and to do


class Terminal:
    """The screen of one command."""

    def __init__(self, *, quiet: bool = False, verbose: bool = False, as_json: bool = False) -> None:
        """quiet: warnings and errors only. verbose: the stages' details too. as_json: the result as one JSON object."""
        self.quiet = quiet
        self.as_json = as_json
        logger = logging.getLogger("treebake")
        logger.handlers = [_Lines()]
        logger.setLevel(logging.WARNING if quiet else logging.DEBUG if verbose else logging.INFO)
        logger.propagate = False

    @contextmanager
    def announce(self, stage: str, *, skipped: bool = False) -> Iterator[Advance]:
        """Show a stage while it runs (a bar, on a terminal only), then one line that says how it went."""
        start = time.perf_counter()
        with self._bar(stage) as advance:
            yield advance
        if not self.quiet:
            say(f"{stage:<10} {'up to date' if skipped else f'{time.perf_counter() - start:.1f} s'}")

    def show(self, facts: dict[str, Any], text: str | None = None) -> None:
        """Print a command's result: as JSON, as the given text, or else each fact by its name."""
        if self.as_json:
            print(json.dumps(facts, indent=2))
        elif not self.quiet:
            print(text or "\n".join(_text(facts)))

    @contextmanager
    def _bar(self, stage: str) -> Iterator[Advance]:
        if self.quiet or not sys.stderr.isatty():
            yield lambda _done, _total: None
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (SpinnerColumn(), TextColumn("{task.description:<10}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
            task = progress.add_task(stage, total=None)
            yield lambda done, total: progress.update(task, completed=done, total=total)


class _Lines(logging.Handler):
    """Warnings and notes, one line each and each only once."""

    def __init__(self) -> None:
        super().__init__()
        self.said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        kind = "warning" if record.levelno >= logging.WARNING else "note"
        line = f"treebake: {kind}: {record.getMessage()}"
        if line not in self.said:
            self.said.add(line)
            say(line)


def say(line: str) -> None:
    """Print one line on stderr."""
    print(line, file=sys.stderr, flush=True)


def _text(facts: dict[str, Any]) -> Iterator[str]:
    width = max(map(len, facts), default=0)
    for key, value in facts.items():
        name = key.replace("_", " ")
        if isinstance(value, dict):
            yield f"{name}:"
            yield from (f"  {line}" for line in _text(value))
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            yield f"{name}:"
            yield from (f"  {line}" for line in _table(value))
        elif value not in (None, []):
            yield f"{name:<{width}}  {_cell(value)}"


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Rows of equal keys, numbers to the right."""
    names = list(rows[0])
    cells = [[name.replace("_", " ") for name in names], *([_cell(row[name]) for name in names] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(names))]
    right = [all(isinstance(row[name], (int, float)) for row in rows) for name in names]
    for row in cells:
        padded = (f"{cell:>{w}}" if r else f"{cell:<{w}}" for cell, w, r in zip(row, widths, right, strict=True))
        yield "  ".join(padded).rstrip()


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{round(value, 4):g}"
    if isinstance(value, list):
        return ", ".join(map(_cell, value))
    return str(value)
