"""Print the output of a command: messages and progress on standard error, tables on standard output."""

import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from typing import Any

from ...common.numbers import number as number

_EVERY_S = 5.0  # between lines of progress if standard error is not a terminal
_REDRAW_S = 0.1  # on a terminal, where a line is redrawn in place


def say(line: str) -> None:
    """Print one line on standard error, in place of a progress bar on a terminal."""
    clear = "\r\x1b[K" if sys.stderr.isatty() else ""
    print(f"{clear}pitp: {line}", file=sys.stderr, flush=True)


def print_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table on standard output, the first column left-aligned, the others right-aligned."""
    lines = [list(header), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = [line[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(line[1:], widths[1:], strict=True))]
        print("  ".join(cells).rstrip())


class ProgressBar:
    """A progress bar for training: redrawn in place on a terminal, a line every few seconds otherwise."""

    def __init__(self):
        self._tty, self._last, self._stage = sys.stderr.isatty(), -1e9, None

    def update(self, progress: Any) -> None:
        """Show the state of the training, a `training.Progress`."""
        now, ends = time.monotonic(), progress.step >= progress.steps
        fresh = progress.stage != self._stage
        if not (fresh or ends or now - self._last >= (_REDRAW_S if self._tty else _EVERY_S)):
            return
        self._last, self._stage = now, progress.stage
        box = "" if progress.box is None else f"  box {progress.box:.3g}"
        text = f"{progress.stage}: {progress.step}/{progress.steps}{box}  loss {progress.loss:.3g}"
        text += f"  best {progress.best:.3g}"
        if not self._tty:
            say(text)
            return
        done = round(20 * min(progress.step / max(progress.steps, 1), 1.0))
        bar = f"[{'#' * done}{'.' * (20 - done)}] {text}"
        bar = bar[: shutil.get_terminal_size().columns - 1]
        print(f"\r\x1b[K{bar}", end="\n" if ends else "", file=sys.stderr, flush=True)


class StatusLine:
    """A progress line for work of unknown length: redrawn in place on a terminal, regular lines otherwise.

    A line `stage: step ...` is a step of its stage; any other line is an event, and always shown.
    """

    def __init__(self):
        self._tty, self._last, self._stage = sys.stderr.isatty(), -1e9, None

    def update(self, line: str) -> None:
        """Show one line of progress."""
        stage, colon, _ = line.partition(":")
        if not colon:
            say(line)
            return
        now = time.monotonic()
        if stage == self._stage and now - self._last < (_REDRAW_S if self._tty else _EVERY_S):
            return
        self._last, self._stage = now, stage
        if self._tty:
            text = line[: shutil.get_terminal_size().columns - 1]
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
        else:
            say(line)

    def close(self) -> None:
        """Clear the progress line on a terminal."""
        if self._tty:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
