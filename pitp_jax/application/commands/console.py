"""Print the output of a command: messages and progress on standard error, tables on standard output."""

import shutil
import sys
import time
from typing import Any

from ...common.numbers import number as number
from ...common.page import Table as Table


def say(line: str) -> None:
    """Print one line on standard error, in place of a progress bar on a terminal."""
    clear = "\r\x1b[K" if sys.stderr.isatty() else ""
    print(f"{clear}pitp: {line}", file=sys.stderr, flush=True)


def print_table(table: Table, digits: int = 4) -> None:
    """Print a table on standard output, without columns that hold nothing; `*` marks the rows that a page has in bold.

    Args:
        table: its first column is left-aligned, the others are right-aligned.
        digits: of the numbers.
    """
    rows = table.cells(lambda value: number(value, digits))
    marks = [" *" if bold else "" for bold in table.bold] or [""] * len(rows)
    rows = [(first + mark, *others) for (first, *others), mark in zip(rows, marks, strict=True)]
    columns = zip(table.header, *rows, strict=True)
    shown = [column for column in columns if set(column[1:]) - set(table.omitted)]
    widths = [max(map(len, column)) for column in shown]
    for first, *others in zip(*shown, strict=True):
        cells = [first.ljust(widths[0]), *(c.rjust(w) for c, w in zip(others, widths[1:], strict=True))]
        print("  ".join(cells).rstrip())


class ProgressLine:
    """A line of progress: redrawn in place on a terminal, a line every few seconds otherwise."""

    def __init__(self):
        self._tty, self._last, self._stage = sys.stderr.isatty(), -1e9, ""

    def update(self, line: str, ends: bool = False) -> None:
        """Show a line `stage: step ...`; the first of a stage, and one that `ends` it, are always shown.

        A line without a colon is an event, and stays.
        """
        stage, colon, _ = line.partition(":")
        if not colon:
            say(line)
            return
        now = time.monotonic()
        pause = 0.1 if self._tty else 5.0  # s; a terminal redraws the line in place
        if stage == self._stage and not ends and now - self._last < pause:
            return
        self._last, self._stage = now, stage
        if self._tty:
            text = line[: shutil.get_terminal_size().columns - 1]
            print(f"\r\x1b[K{text}", end="\n" if ends else "", file=sys.stderr, flush=True)
        else:
            say(line)

    def train(self, progress: Any) -> None:
        """Show the state of the training, a `training.Progress`."""
        box = "" if progress.box is None else f"  box {progress.box:.3g}"
        text = f"{progress.stage}: {progress.step}/{progress.steps}{box}  loss {progress.loss:.3g}"
        self.update(f"{text}  best {progress.best:.3g}", progress.step >= progress.steps)

    def close(self) -> None:
        """Clear the progress line on a terminal."""
        if self._tty:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
