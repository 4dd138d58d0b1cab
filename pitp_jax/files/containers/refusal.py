"""Refuse files with the problem, the content of the file, and the complete command to try.

<file>: <problems> (columns here: ...); try: pitp check FILE --option VALUE ...        at most 600 characters
"""

import os
import shlex
from collections.abc import Sequence

from ...common.errors import BadInput, cleaned

_LONGEST, _PROGRAM = 600, len("pitp: error: ") + 2


class Refused(BadInput):
    """Error: a file cannot be read as it is; it holds the options that would solve the problem.

    Attributes:
        source: the file.
        why: the problem, without the file.
        options: words of a command line that solve it; empty if none does.
        aside: text that may be shortened: the columns of the file.
    """

    def __init__(self, source: str, why: str, options: Sequence[str] = (), aside: str = ""):
        """Write the message; the arguments are the attributes."""
        super().__init__(composed([source], why, options, aside, [source]))
        self.source, self.why, self.options, self.aside = source, why, tuple(options), aside


def composed(
    sources: Sequence[str], why: str, options: Sequence[str], aside: str, paths: Sequence[str], before: str = ""
) -> str:
    """Write a refusal in one line of at most 600 characters; the problem is shortened before the command.

    Args:
        sources: the files concerned.
        why: the problem.
        options: that solve it.
        aside: added if there is room.
        paths: for the command.
        before: text before the first file.
    """
    short = [os.path.basename(source) for source in sources] if options else sources  # the command has the whole path
    named = ", ".join(short[:3]) + (f" and {len(short) - 3} more" if len(short) > 3 else "")
    command = "; try: " + shlex.join(["pitp", "check", *paths, *options]) if options else ""
    room = _LONGEST - _PROGRAM - len(command) - len(before) - len(named) - 2
    # the command must be complete to run
    if len(why) > room:
        why = why[: max(room - 3, 40)].rstrip() + "..."
    text = f"{why} ({aside})" if aside and len(why) + len(aside) + 3 <= room else why
    return f"{before}{named}: {text}{command}"


def together(refusals: Sequence[BadInput], files: int, paths: Sequence[object]) -> str:
    """Write all refusals in one line: equal ones once, with one command for the first kind that has one.

    Args:
        refusals: of single files.
        files: number of files tried.
        paths: as the user gave them, for the command.
    """
    if len(refusals) == 1:
        return str(refusals[0])
    kinds: dict[tuple, list[str]] = {}
    for refusal in refusals:
        source, _, why = str(refusal).partition(": ")
        curable = isinstance(refusal, Refused)
        # files of one kind are refused for one reason, reported once
        key = (refusal.why, refusal.options, refusal.aside) if curable else (why, (), "")
        kinds.setdefault(key, []).append(refusal.source if curable else source)
    before = f"{len(refusals)} of {files} files are refused: "
    (why, options, aside), sources = next(((k, s) for k, s in kinds.items() if k[1]), next(iter(kinds.items())))
    others = []
    for key, some in kinds.items():
        if some is not sources:
            more = f" and {len(some) - 1} more" if len(some) > 1 else ""
            others.append(f" | {os.path.basename(some[0])}{more}: {key[0]}")
    given = [cleaned(path) for path in paths] if len(kinds) == 1 else sources
    given = given if len(given) <= 3 else given[:3]
    bare = composed(sources, why, options, "", given, before)
    room = _LONGEST - _PROGRAM - len(bare)
    said = ""
    for other in others:
        each = max(room // len(others), 0)
        said += other if len(other) <= each else other[: max(each - 3, 0)] + "..." * (each > 20)
    head, mark, command = bare.rpartition("; try: ") if options else (bare, "", "")
    return f"{head}{said}{mark}{command}" if others else composed(sources, why, options, aside, given, before)
