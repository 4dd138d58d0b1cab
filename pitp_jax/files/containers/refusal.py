"""Refuse files: the problem, and the options that would solve it, as data.

<file>: <problem> (columns here: ...); try: --option VALUE ...        at most 585 characters

Readers say only what is wrong; `about` puts the file in front. The command line puts its own command before the
options, so that the line is the complete command to try.
"""

import json
import os
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...common.errors import BadInput, cleaned

LONGEST = 585  # characters of a refusal; with `pitp: error: ` before it 600
FOLDER_FILE = "pitp.toml"


class Refused(BadInput):
    """Error: files cannot be read as they are; it holds the options that would solve the problem.

    Attributes:
        why: the problem, without the file.
        options: values of the options that solve it, to be added to those given; empty if none does.
        aside: text that may be omitted: the columns of the file.
        source: the file, or the first of several; empty until `about` adds it.
        named: the files as the message names them.
        alone: whether every file of the call is refused for this reason, so that the options suit the whole call.
    """

    def __init__(
        self, why: str, options: Mapping[str, str] | None = None, aside="", source="", named="", alone: bool = True
    ):
        """Write the message; the arguments are the attributes."""
        self.why, self.options, self.aside, self.source = why, dict(options or {}), aside, source
        # the proposed command holds the whole path
        self.named, self.alone = named or (os.path.basename(source) if options else source), alone
        self.words = [word for option in self.options.items() for word in option]
        super().__init__(self.ending(f"; try: {shlex.join(self.words)}" if options else ""))

    def ending(self, remedy: str) -> str:
        """Write the refusal in one line that ends with a remedy; the problem is shortened before it."""
        room = LONGEST - len(remedy) - len(self.named) - 2
        why = self.why if len(self.why) <= room else self.why[: max(room - 3, 40)].rstrip() + "..."
        aside = f" ({self.aside})" if self.aside and len(why) + len(self.aside) + 3 <= room else ""
        return f"{self.named}: {why}{aside}{remedy}"

    def in_command(self, argv: Sequence[str]) -> str:
        """Write the refusal with the complete command to try: the one given, with the options added.

        Args:
            argv: the arguments of the command.
        """
        # a check is tried without its files: the line stays short; nothing was written that --force must replace
        names = (*self.options, *(("--out", "--json") if argv[0] == "check" else ()))
        kept = [word for word in _without(argv, names) if word != "--force"]
        # a name with control characters is shown cleaned, so its command must be typed anew
        words = ["pitp", *map(cleaned, kept), *self.words]
        return self.ending(f"; try: {shlex.join(words)}") if self.options else str(self)

    def in_folder(self) -> str:
        """Write the refusal with the entry of `pitp.toml` that suits this file and no other of the call."""
        keys = ", ".join(f"{key[2:]} = {json.dumps(value, ensure_ascii=False)}" for key, value in self.options.items())
        folder, name = os.path.split(self.source)
        pattern = json.dumps("*" if self.alone else name, ensure_ascii=False)
        file = os.path.join(folder, FOLDER_FILE)
        return self.ending(f"; write into {file}: {pattern} = {{{keys}}}") if self.options else str(self)


def _without(argv: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return arguments without these options and their values, because a repeated option is refused."""
    words, skip = [], False
    for word in argv:
        if not skip and word.partition("=")[0] not in names:
            words.append(word)
        skip = not skip and word in names
    return words


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Put the file in front of a problem that is raised within, unless a file is named there already.

    Raises:
        Refused: the problem with the file.
    """
    source = cleaned(path)
    try:
        yield
    except BadInput as error:
        one = error if isinstance(error, Refused) else Refused(str(error).removeprefix(f"{source}: "))
        raise Refused(one.why, one.options, one.aside, one.source or source) from None


def unrefused(make: Callable[[Any], Any], tried: Iterable) -> Iterator[Any]:
    """Yield what `make` returns for each one tried that it does not refuse.

    Raises:
        BadInput: it refuses all: the first refusal with options, otherwise the first.
    """
    refusals, good = [], False
    for one in tried:
        try:
            made = make(one)
        except BadInput as error:
            refusals.append(error)
            continue
        good = True
        yield made
    if refusals and not good:
        raise max(refusals, key=lambda error: isinstance(error, Refused) and bool(error.options))


def together(refused: Mapping[str, Refused], files: int) -> Refused:
    """Return one error for all refusals: equal ones once, with the options of the first kind that has some.

    Args:
        refused: of single files, by name.
        files: number of files tried.
    """
    refusals = list(refused.values())
    if len(refusals) == 1 and (files == 1 or not refusals[0].options):
        return refusals[0]
    # files of one kind are refused for one reason, reported once
    kinds: dict[tuple, list[str]] = {}
    for one in refusals:
        kinds.setdefault((one.why, tuple(one.options.items()), one.aside), []).append(one.source)
    (why, options, aside), sources = next(((k, s) for k, s in kinds.items() if k[1]), next(iter(kinds.items())))
    several = [f"{os.path.basename(s[0])}{_more(s, 1)}: {k[0]}" for k, s in kinds.items() if s is not sources]
    named = ", ".join(map(os.path.basename, sources[:3])) + _more(sources, 3)
    if len(refusals) > 1:
        named = f"{len(refusals)} of {files} files are refused: {named}"
    alone = len(kinds) == 1 and len(refusals) == files
    return Refused(" | ".join([why, *several]), dict(options), aside if not several else "", sources[0], named, alone)


def shortened(text: str, most: int) -> str:
    """Return the first `most` characters of a text, with dots if there are more."""
    return text if len(text) <= most else text[:most] + "..."


def _more(sources: Sequence[str], shown: int) -> str:
    return f" and {len(sources) - shown} more" if len(sources) > shown else ""
