"""Run the command line: turn arguments into commands, and errors into one line and an exit code.

    0 done      2 bad input or usage      3 the computation failed      130 interrupted

Results go to standard output, progress, warnings and errors to standard error. JAX is imported by the commands that
compute, so `pitp --help` and a mistyped option respond at once.
"""

import argparse
import io
import os
import re
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import Any, ClassVar

from ... import __version__
from ...common.errors import BadInput, ComputationFailed, cleaned
from .arguments import COMMANDS, EVERYWHERE, READING, Either, Group
from .cache import keep_programs
from .console import say
from .each import json_to_standard_output, once_per_joint
from .examples import ending
from .ours import allow_overwriting


class _Once(argparse.Action):
    """An option with one value; a second value is a usage error."""

    given = False
    advice: ClassVar = {
        f"{READING}input_column": "a recording has one input; fit a model to each input, or a column computed from "
        "both",
        f"{READING}output_column": "a recording has one output; --each NAME=INPUT,OUTPUT runs the command once per "
        "output",
    }

    def __call__(self, parser, namespace, values, option_string=None):
        if self.given and option_string is not None:
            raise argparse.ArgumentError(self, f"is given twice; {self.advice.get(self.dest, 'give it once')}")
        self.given = True
        setattr(namespace, self.dest, values)


class _Parser(argparse.ArgumentParser):
    """A parser whose usage errors are one line with exit code 2; options that are not lists are given once."""

    def __init__(self, **named):
        super().__init__(**named)
        for action in (None, "store"):
            self.register("action", action, _Once)

    def error(self, message):
        raise BadInput(f"{' '.join(message.split())}; see {self.prog} --help")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one `pitp` command; return its exit code.

    Args:
        argv: arguments after the program's name; None takes the process's own.

    Returns:
        exit code: 0 done, 2 bad input or usage, 3 the computation failed, 130 interrupted.
    """
    _say_anything()
    given = list(sys.argv[1:] if argv is None else argv)
    try:
        arguments = vars(_parser().parse_args(_joined(given)))
        module, function = arguments.pop("runs"), arguments.pop("command")
        if not arguments.pop("no_cache", True):
            # the other commands compile hundreds of programs, and keep only slow compilations
            keep_programs(0.0 if module in ("predict", "invert", "check", "simulate", "adapt") else 0.1)
        allow_overwriting(arguments.pop("force", False))
        of_reading = [name for name in arguments if name.startswith(READING)]
        if of_reading:
            arguments["reading"] = {name.removeprefix(READING): arguments.pop(name) for name in of_reading}
        code = 0
        with json_to_standard_output(arguments):
            for each in once_per_joint(arguments):  # the last nonzero code: after a failed joint the others continue
                code = getattr(import_module(f".{module}", __package__), function)(**each) or code
        sys.stdout.flush()
        return code
    except SystemExit as stop:  # argparse, after --help and --version
        return int(stop.code or 0)
    except BrokenPipeError:  # the reader of our output has closed it
        sys.stdout = open(os.devnull, "w")  # not the pipe: the interpreter flushes it at exit
        return 0
    except KeyboardInterrupt as stop:
        say("; ".join(["interrupted", *map(str, stop.args)]))
        return 130
    except Exception as error:
        if os.environ.get("PITP_TRACEBACK"):
            traceback.print_exc()
        code, line = _explain(error, given)
        say(f"error: {line}")
        return code


def _joined(argv: Sequence[str]) -> list[str]:
    """Join negative numbers to their options, because argparse takes `-2e-3` for an option."""
    words: list[str] = []
    for word in argv:
        number = re.fullmatch(r"-(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?([^\W\d].*)?", word)
        if number and words and words[-1].startswith("--") and "=" not in words[-1]:
            words[-1] += f"={word}"
        else:
            words.append(word)
    return words


def _say_anything() -> None:
    """Make output streams escape characters that the terminal lacks, such as a superscript minus."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _explain(error: Exception, argv: Sequence[str]) -> tuple[int, str]:
    """Turn an error that ended a command into an exit code and one line of text."""
    if isinstance(error, BadInput) and (options := getattr(error, "options", ())):
        refused: Any = error  # its class is loaded only by commands that read files
        # options of a command suit one set of files, all of one kind; its --rate may not be that of the files
        whole = refused.alone and argv[0] != "compare" and "--against" not in argv
        own_rate = argv[0] in ("invert", "plan") and "--rate" in options
        error = BadInput(refused.in_command(argv) if whole and not own_rate else refused.in_folder())
    text = cleaned(" ".join(str(error).splitlines()))  # blanks stay, because headers may hold several
    if isinstance(error, BadInput):
        return 2, text
    if isinstance(error, ComputationFailed):
        return 3, text
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return 2, f"{where}{error.strerror or text}; check the path, its access rights and the free disk space"
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in text:
        return 3, "out of memory; give fewer or shorter records"
    kind = type(error).__name__
    return 3, f"unexpected {kind}: {text[:200]}; run again with PITP_TRACEBACK=1 to see where, and report it"


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="pitp", description="Model, invert and diagnose dielectric elastomer actuators.", allow_abbrev=False,
        epilog="`pitp COMMAND --help` ends with examples. To begin: docs/start.md.",
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"pitp {__version__}", help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    for name, (text, *rows) in COMMANDS.items():
        made = commands.add_parser(
            name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=ending(name), allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        made.set_defaults(runs=name)
        _add(made, [*EVERYWHERE, *rows])
    return parser


def _add(parser, rows: Sequence) -> None:
    """Add arguments to a parser, from rows of `arguments`."""
    for row in rows:
        if isinstance(row, Group):
            _add(parser.add_argument_group(row.title, row.text), row.rows)
        elif isinstance(row, Either):
            _add(parser.add_mutually_exclusive_group(required=row.required), row.rows)
        else:
            names, shown, text, *more = row
            kinds = {tuple: {"choices": shown}, str: {"metavar": shown}, type(None): {"action": "store_true"}}
            parser.add_argument(*names.split(), help=text, **(kinds[type(shown)] | dict(*more)))
