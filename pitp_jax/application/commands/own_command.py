"""Rewrite the command that a refusal proposes (`pitp check`) as the command that the user ran.

...; try: pitp check FILE --option VALUE        ->  try: pitp identify FILE --out M --option VALUE
for two sets of files                            ->  write into FOLDER/pitp.toml: "*" = {option = "VALUE"}
"""

import json
import os
import shlex
from collections.abc import Sequence

from ...common.errors import by_option, cleaned

_MARK = "; try: pitp check "
_LONGEST = 585  # of a refusal, before the program's name
_OWN_RATE = ("invert", "plan")  # their --rate is not that of the files


def own_command(text: str, argv: Sequence[str]) -> str:
    """Return a refusal with the proposed command rewritten for `argv`; unchanged if that would be too long."""
    head, mark, command = text.rpartition(_MARK)
    if not mark or not argv or argv[0] == "check":
        return text
    words = shlex.split(command)
    first = next((k for k, word in enumerate(words) if word.startswith("--")), len(words))
    paths, options = words[:first], words[first:]
    if not options or not paths or (argv[0] in _OWN_RATE and "--rate" in options):
        return text
    if argv[0] == "compare" or "--against" in argv:
        folder = paths[0] if os.path.isdir(paths[0]) else os.path.dirname(paths[0])
        keys = ", ".join(f"{option[2:]} = {_value(option, values)}" for option, *values in by_option(options))
        whole = f'{head}; write into {os.path.join(folder, "pitp.toml")}: "*" = {{{keys}}}'
    else:
        # A name with control characters is printed cleaned, so its command must be typed anew.
        words = ["pitp", *_without(argv, [group[0] for group in by_option(options)]), *options]
        whole = f"{head}; try: {shlex.join(map(cleaned, words))}"
    return whole if len(whole) <= _LONGEST else text


def _without(argv: Sequence[str], names: Sequence[str]) -> list[str]:
    """Remove options and their values from arguments, because a repeated option is refused."""
    words, k = [], 0
    while k < len(argv):
        if argv[k] in names:
            several = argv[k] == "--join"
            k += 2
            while several and k < len(argv) and not argv[k].startswith("--"):
                k += 1
        else:
            words += [] if argv[k].partition("=")[0] in names else [argv[k]]
            k += 1
    return words


def _value(option: str, values: Sequence[str]) -> str:
    """Write the value of an option as TOML; joined files are named without their folder."""
    if option == "--join":
        return json.dumps([os.path.basename(value) for value in values], ensure_ascii=False)
    return json.dumps(values[0], ensure_ascii=False)
