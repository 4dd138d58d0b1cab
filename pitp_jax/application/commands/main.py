"""Run the command line: turn arguments into commands, and errors into one line and an exit code.

    0 done      2 bad input or usage      3 the computation failed      130 interrupted

Results go to standard output, progress, warnings and errors to standard error. JAX is imported by the commands that
compute, so `pitp --help` and a mistyped option respond at once.
"""

import argparse
import io
import math
import os
import re
import sys
import traceback
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ... import __version__
from ...common.errors import BadInput, ComputationFailed
from ...files.containers.options import ReadOptions, option_of
from .cache import keep_programs
from .console import say
from .each import json_to_standard_output, once_per_joint
from .examples import ending
from .ours import allow_overwriting

if TYPE_CHECKING:
    from .amounts import Amount

_RECORDS = "recordings: files (text, .xlsx, .mat, .npz, .h5, .tdms, .parquet, .mcap, rosbag2) and folders of them"
_READING = "reading:"  # before names of reading options: invert has its own --rate and --input-scale
# In names from files, control characters could move the cursor, and direction marks reverse a line.
_UNSAFE = re.compile(r"[\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ud800-\udfff]")
# Commands that keep every compiled program; the others, which have hundreds, keep only slow compilations.
_QUICK = ("predict", "invert", "check", "simulate", "adapt")
_INPUT_MAP = "F = u^2 or u (default: square for a voltage with a length, otherwise linear)"
_OWN_RATE = ("invert", "plan")  # their --rate is not that of the files
# advice for an option given twice
_SINGLE = {
    f"{_READING}input_column": "a recording has one input; fit a model to each input, or a column computed from both",
    f"{_READING}output_column": "a recording has one output; --each NAME=INPUT,OUTPUT runs the command once per output",
}
_PLANTS = ("cone100", "cone122", "cone150", "roll", "joint")


class _Once(argparse.Action):
    """An option with one value; a second value is a usage error."""

    given = False

    def __call__(self, parser, namespace, values, option_string=None):
        if self.given and option_string is not None:
            raise argparse.ArgumentError(self, f"is given twice; {_SINGLE.get(self.dest, 'give it once')}")
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
    try:
        arguments = vars(_parser().parse_args(_joined(sys.argv[1:] if argv is None else argv)))
        module, function = arguments.pop("runs"), arguments.pop("command")
        if not arguments.pop("no_cache", True):
            keep_programs(0.0 if module in _QUICK else 0.1)
        allow_overwriting(arguments.pop("force", False))
        of_reading = [name for name in arguments if name.startswith(_READING)]
        if of_reading:
            arguments["reading"] = {name.removeprefix(_READING): arguments.pop(name) for name in of_reading}
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
        say(f"interrupted{f'; {stop}' if str(stop) else ''}")
        return 130
    except Exception as error:
        if os.environ.get("PITP_TRACEBACK"):
            traceback.print_exc()
        code, line = _explain(error, list(sys.argv[1:] if argv is None else argv))
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
        own_rate = argv[0] in _OWN_RATE and "--rate" in options
        error = BadInput(refused.in_command(argv) if whole and not own_rate else refused.in_folder())
    text = _UNSAFE.sub("_", " ".join(str(error).splitlines()))  # blanks stay, because headers may hold several
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


def _order(text: str) -> int | str:
    if text == "auto":
        return text
    if text.isdecimal() and 1 <= int(text) <= 6:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not 1 to 6 or auto")


def _seed(text: str) -> int:
    if text.isdecimal() and int(text) < 2**32:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 to {2**32 - 1}")


def _finite(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None  # "nan" and "inf" are numbers in Python, but not valid settings


def _zero(text: str) -> str | float:
    value = text if text in ("rest", "sensor") else _finite(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not rest, sensor or a number in the target's unit")
    return value


def _positive(text: str) -> float:
    value = _finite(text)
    if value is None or value <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _seconds(text: str) -> float:
    value = _finite(text)
    if value is None or value < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds")
    return value


def _time_constant(text: str) -> float:
    return float("inf") if text.strip().lower() == "inf" else _positive(text)


def _amount(text: str) -> "Amount":
    from .amounts import amount  # imported here, because it loads NumPy

    given = amount(text)
    if given is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number, or a number with a unit such as 3kV or 20deg")
    return given


def _limit(text: str) -> "Amount":
    given = _amount(text)
    if not given.value > 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not positive")
    return given


def _number(text: str) -> float:
    value = _finite(text)
    if not value:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number other than 0")
    return value


def _any_number(text: str) -> float:
    value = _finite(text)
    if value is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="pitp", description="Model, invert and diagnose dielectric elastomer actuators.", allow_abbrev=False,
        epilog="`pitp COMMAND --help` ends with examples. To begin: docs/start.md.",
    )  # fmt: skip
    parser.add_argument("--version", action="version", version=f"pitp {__version__}", help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)

    def command(name: str, text: str) -> argparse.ArgumentParser:
        made = commands.add_parser(
            name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=ending(name), allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )  # fmt: skip
        made.set_defaults(runs=name)
        made.add_argument(
            "--json",
            dest="json_file",
            metavar="FILE",
            help="also write the result as JSON; - writes it to standard output",
        )
        made.add_argument("--force", action="store_true", help="overwrite existing files that pitp did not write")
        made.add_argument("--no-cache", action="store_true", help="do not read or store compiled programs")
        return made

    demo = command("demo", "identify, train and invert a virtual actuator: tables, figures, model")
    demo.add_argument(
        "--plant",
        choices=_PLANTS,
        default="cone100",
        help="virtual actuator (default cone100), or joint: a robot's joint and its simulator",
    )
    demo.add_argument("--out", default="demo", metavar="DIR", help="folder to write to (default ./demo)")
    demo.add_argument("--quick", action="store_true", help="fewer and shorter recordings: takes a minute or two")
    _plan_arguments(command("plan", "propose recordings to take: a first session, or the next ones for a model"))
    _check_arguments(
        command("check", "show what was read and how each recording starts, and judge whether the set is sufficient")
    )
    _identify_arguments(command("identify", "fit a linear model to recordings; the data choose its order"))
    _fit_arguments(command("fit", "train a model on recordings, starting from an identified one"))
    _predict_arguments(
        command("predict", "simulate a model under the recorded input and compare it with the recorded output")
    )
    _simulate_arguments(command("simulate", "simulate a model under inputs without a measurement"))
    _invert_arguments(command("invert", "compute the voltage for a wanted motion"))
    _diagnose_arguments(
        command("diagnose", "find where a model and recordings disagree, and which missing effect causes it")
    )
    _verify_arguments(
        command("verify", "compare MuJoCo with a robot's recordings, before and after its file was changed")
    )
    _adapt_arguments(command("adapt", "update a model to the same actuator on another day, from one short recording"))
    _export_arguments(
        command("export", "write a model and its inverse as C, as an FMU or as MATLAB functions, for the rig")
    )
    info = command("info", "show what a model file holds")
    info.add_argument("model", metavar="MODEL", help="identified or trained model")
    info.add_argument("others", nargs="*", help=argparse.SUPPRESS)  # two are compared by `compare`
    _compare_arguments(command("compare", "show the differences between two models or two sets of recordings"))
    return parser


def _columns(parser: argparse.ArgumentParser, *, target: bool = False, drive: bool = False, rate: bool = True) -> None:
    """Add the options that choose the columns of files, as in `pitp.read`, `read_target` or `read_voltage`."""
    group = parser.add_argument_group(
        "columns of the files", "by default, chosen by the names and units in the headers"
    )
    kinds = {"factor": _number, "number": _any_number, "positive": _positive, "whole": int, "seconds": _seconds}
    for one in fields(ReadOptions):
        option, kind = option_of(one.name), one.metadata["kind"]
        stem = option.partition("-")[0]
        if (stem == "input" and target) or (stem == "output" and drive) or (stem == "rate" and (target or not rate)):
            continue
        said = {"dest": f"{_READING}{one.name}", "metavar": one.metadata["placeholder"], "help": one.metadata["help"]}
        if kind == "files":
            group.add_argument(f"--{option}", nargs="+", action="extend", **said)
        elif kind:
            group.add_argument(f"--{option}", type=kinds.get(kind, str), **said)
    if not target and not drive:
        group.add_argument(
            "--each",
            action="append",
            metavar="NAME=INPUT,OUTPUT",
            help="read one joint of a log; give it once per joint",
        )


def _check_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    parser.add_argument("--out", metavar="DIR", help="folder for a page and one CSV per recording as it was read")
    _columns(parser)


def _compare_arguments(parser: argparse.ArgumentParser) -> None:
    kinds = "model file, folder of a diagnosis, or recordings"
    parser.add_argument("a", metavar="A", help=kinds)
    parser.add_argument("b", metavar="B", help="what A is compared with, of the same kind")
    parser.add_argument("--out", metavar="DIR", help="folder for a page and its figures")
    _columns(parser)


def _simulate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="identified or trained model")
    parser.add_argument("voltages", nargs="+", metavar="VOLTAGE", help="files of time and voltage, and folders of them")
    parser.add_argument("--out", metavar="DIR", help="folder for one CSV per input")
    _zero_argument(parser, "displacement")
    _columns(parser, drive=True)


def _limit_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "limits", "Voltages in V, lengths in mm, other quantities in the unit of the model's recordings; or with a "
        "unit: 3kV, 20deg.",
    )  # fmt: skip
    for names, placeholder, text in (
        (("--max-voltage", "--max-input"), "U", "largest input (default: the largest in the model's recordings)"),
        (
            ("--max-slew", "--max-input-rate"),
            "U/s",
            "fastest change of the input (default: as in the model's recordings)",
        ),
        (
            ("--max-displacement", "--max-output"),
            "Y",
            "largest distance from the position at zero input, in both directions (default: no limit)",
        ),
    ):
        group.add_argument(*names, type=_limit, metavar=placeholder, help=text)


def _zero_argument(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument(
        "--zero", type=_zero, default="rest", metavar="rest|sensor|VALUE",
        help=f"zero of the {what}: rest = at 0 V (default), sensor = the sensor's zero, VALUE = reading at 0 V",
    )  # fmt: skip


def _plan_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "paths",
        nargs="*",
        metavar="[MODEL] RECORDS",
        help="a model, or a model and the recordings it was fitted on (optional)",
    )
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="folder for the inputs to play, a page and plan.json"
    )
    _limit_arguments(parser)
    parser.add_argument(
        "--band", type=_positive, nargs=2, metavar=("LO", "HI"), help="lowest and highest frequency of the input, Hz"
    )
    parser.add_argument("--duration", type=_positive, metavar="S", help="total duration of all recordings")
    parser.add_argument(
        "--rest", type=_seconds, metavar="S",
        help="rest at zero input between recordings (default: until the actuator is at rest again)",
    )  # fmt: skip
    parser.add_argument("--rate", type=_positive, metavar="HZ", help="samples per second of the inputs")
    parser.add_argument("--alternate", action="store_true", help="make every second input negative (bipolar amplifier)")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of the space-filling set (default 0)")
    _columns(parser, rate=False)


def _identify_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    parser.add_argument("--out", required=True, metavar="NOMINAL", help="model file to write")
    parser.add_argument("--order", type=_order, default="auto", metavar="N|auto", help="1 to 6, or auto (default)")
    parser.add_argument("--input-map", choices=("square", "linear"), help=_INPUT_MAP)
    delay = parser.add_mutually_exclusive_group()
    delay.add_argument(
        "--learn",
        action="append",
        default=[],
        choices=("delay",),
        help="always fit a pure delay between input and output",
    )
    delay.add_argument(
        "--no-delay", action="store_const", const=("delay",), default=(), dest="leave_out",
        help="fit no delay (default: fit one if it predicts left-out blocks better)",
    )  # fmt: skip
    parser.add_argument(
        "--validate",
        nargs="+",
        action="extend",
        default=[],
        metavar="RECORDS",
        help="also score the model on these, without fitting them",
    )
    parser.add_argument("--report", metavar="DIR", help="folder for a page with the Bode diagram")
    _columns(parser)


def _fit_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    parser.add_argument("--out", required=True, metavar="MODEL", help="model file to write")
    parser.add_argument("--nominal", metavar="NOMINAL", help="start from this model instead of identifying one")
    parser.add_argument("--order", type=_order, metavar="N|auto", help="1 to 6, or auto (default)")
    parser.add_argument("--preset", choices=("default", "paper"), default="default", help="training settings")
    parser.add_argument(
        "--learn", action="append", default=[], choices=("delay", "sensor_lag"), metavar="PART",
        help="also learn a delay or a sensor_lag between amplifier and recording (may be given twice)",
    )  # fmt: skip
    parser.add_argument("--input-map", choices=("square", "linear"), help=_INPUT_MAP)
    parser.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of the random start (default 0)")
    parser.add_argument("--report", metavar="DIR", help="folder for a page of free runs beside the recordings")
    parser.add_argument(
        "--cross-validate",
        action="store_true",
        help="also leave out each recording in turn, train on the others and predict the one left out",
    )
    _columns(parser)


def _predict_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="identified or trained model")
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    parser.add_argument("--out", metavar="DIR", help="folder for a page and one CSV per recording")
    _columns(parser)


def _invert_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="identified or trained model")
    parser.add_argument("target", metavar="TARGET", help="file with a time and a displacement")
    parser.add_argument("--out", required=True, metavar="VOLTAGE.csv", help="voltage file to write")
    _limit_arguments(parser)
    _zero_argument(parser, "target")
    parser.add_argument(
        "--start-input",
        type=_amount,
        metavar="U",
        help="input before and after the target, such as a holding torque (default 0)",
    )
    parser.add_argument(
        "--rate", type=_positive, metavar="HZ", help="samples per second of the voltage (default: those of the target)"
    )
    parser.add_argument(
        "--unit", metavar="UNIT", help="unit of the written input (default V, or that of the recordings)"
    )
    parser.add_argument(
        "--input-scale",
        type=_positive,
        default=1.0,
        metavar="S",
        help="gain of the amplifier: the file holds the input divided by S (default 1)",
    )
    _columns(parser, target=True)


def _diagnose_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    beside = parser.add_mutually_exclusive_group(required=True)
    beside.add_argument("--nominal", metavar="MODEL", help="identified or trained model")
    beside.add_argument(
        "--against",
        nargs="+",
        action="extend",
        metavar="SIMULATED",
        help="compare with a simulator's recordings instead of a model",
    )
    parser.add_argument(
        "--position-gain",
        type=_positive,
        metavar="KP",
        help="gain of the simulator's position controller: gives parameters in N m instead of ratios",
    )
    parser.add_argument(
        "--refit-nominal",
        action="store_true",
        help="also fit the nominal model's coefficients (use it if the model was identified on these recordings)",
    )
    parser.add_argument(
        "--seconds", type=_positive, metavar="S", help="stop after S seconds and report the best result so far"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for the model with the effects, a page and figures")
    group = parser.add_argument_group(
        "MuJoCo file", "with --against, if the simulator's recordings were made with this file"
    )
    group.add_argument("--mjcf", metavar="XML", help="write a copy with the robot's parameters into the folder --out")
    _joint_arguments(group)
    _columns(parser)


def _joint_arguments(parser) -> None:
    parser.add_argument(
        "--joint", action="append", metavar="NAME", help="joint whose motion was recorded; with --each once per joint"
    )
    parser.add_argument("--actuator", metavar="NAME", help="actuator that was commanded, if several drive the joint")


def _verify_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    parser.add_argument("--mjcf", required=True, metavar="XML", help="MuJoCo file with the robot's parameters")
    parser.add_argument("--before", metavar="XML", help="original file, to compare with")
    _joint_arguments(parser)
    parser.add_argument(
        "--held-out",
        nargs="+",
        action="extend",
        default=[],
        metavar="RECORDS",
        help="recordings that the diagnosis did not use",
    )
    parser.add_argument("--out", metavar="DIR", help="folder for a page and one CSV per recording")
    _columns(parser)


def _adapt_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="identified or trained model")
    parser.add_argument("records", nargs="+", metavar="RECORDS", help=_RECORDS)
    parser.add_argument(
        "--out", required=True, metavar="MODEL", help="model file to write (an unchanged copy if nothing has changed)"
    )
    _columns(parser)


def _export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL", help="identified or trained model, with any effects")
    parser.add_argument("--to", required=True, choices=("c", "fmu", "matlab"), help="target language")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder to create; it must not exist yet")
    parser.add_argument(
        "--rate", dest="steps", type=_positive, metavar="HZ", help="steps per second (default: the model's)"
    )
    parser.add_argument("--precision", choices=("single", "double"), help="arithmetic of C and FMU (default double)")
    parser.add_argument(
        "--time-constant",
        type=_time_constant,
        metavar="S",
        help="closed-loop time constant of the PI controller in C (default: from the model; inf: no controller)",
    )
    parser.add_argument("--fmi", type=int, choices=(2, 3), help="version of the FMI standard (default 2)")
    parser.add_argument(
        "--name", metavar="NAME", default="model", help="name of files and functions: pitp_NAME (default model)"
    )
