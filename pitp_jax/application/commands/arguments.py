"""State the arguments of every command in one table, from which the parser and its help are made.

A row: names, what the help shows for the value, help, and further keywords of argparse. A tuple in place of the shown
value lists the values to choose from; None marks a switch.
"""

import math
from argparse import SUPPRESS, ArgumentTypeError
from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple

from ...files.containers.options import ReadOptions, option_of

if TYPE_CHECKING:
    from .amounts import Amount

READING = "reading:"  # before names of reading options: invert has its own --rate and --input-scale


class Group(NamedTuple):
    """Rows below a heading of their own in the help."""

    title: str
    text: str
    rows: list


class Either(NamedTuple):
    """Rows of which one at most may be given; if `required`, exactly one."""

    required: bool
    rows: list


def _refusing(what: str, convert: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return `convert` with a usage error where it returns None: the text is not `what`."""

    def converted(text: str):
        value = convert(text)
        if value is None:
            raise ArgumentTypeError(f"{text!r} is not {what}")
        return value

    return converted


def _finite(text: str, accepts: Callable[[float], bool] = lambda value: True) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    # "nan" and "inf" are numbers in Python, but not valid settings
    return value if math.isfinite(value) and accepts(value) else None


def _above_zero(text: str) -> float | None:
    return _finite(text, lambda value: value > 0)


def _whole(text: str, low: int, high: int) -> int | None:
    return int(text) if text.isdecimal() and low <= int(text) <= high else None


def _amount(text: str) -> "Amount | None":
    from .amounts import amount  # imported here, because it loads NumPy

    return amount(text)


_amount_of = _refusing("a number, or a number with a unit such as 3kV or 20deg", _amount)


def _limit(text: str) -> "Amount | None":
    given = _amount_of(text)
    return given if given.value > 0 else None


_POSITIVE = {"type": _refusing("a positive number", _above_zero)}
_SECONDS = {"type": _refusing("a number of seconds", lambda text: _finite(text, lambda value: value >= 0))}
_ORDER = {"type": _refusing("1 to 6 or auto", lambda text: text if text == "auto" else _whole(text, 1, 6))}
_SEED = {
    "type": _refusing(f"a whole number from 0 to {2**32 - 1}", lambda text: _whole(text, 0, 2**32 - 1)),
    "default": 0,
}
_LIMIT = {"type": _refusing("positive", _limit)}
_LIST, _REPEATED, _REQUIRED = {"nargs": "+", "action": "extend"}, {"action": "append"}, {"required": True}


def _columns(*without: str) -> Group:
    """Return the options of reading, as in `pitp.read`; not those whose first word is in `without`."""
    kinds = {  # of a field of `ReadOptions`
        "factor": {"type": _refusing("a number other than 0", lambda text: _finite(text, bool))},
        "number": {"type": _refusing("a finite number", _finite)},
        "positive": _POSITIVE,
        "whole": {"type": int},
        "seconds": _SECONDS,
        "files": _LIST,
    }
    rows = [
        (f"--{option_of(f.name)}", f.metadata["placeholder"], f.metadata["help"],
         {"dest": READING + f.name} | kinds.get(f.metadata["kind"], {}))
        for f in fields(ReadOptions) if f.metadata["kind"]
    ]  # fmt: skip
    rows.append(("--each", "NAME=INPUT,OUTPUT", "read one joint of a log; give it once per joint", _REPEATED))
    kept = [row for row in rows if row[0].split("-")[2] not in without]
    return Group("columns of the files", "by default, chosen by the names and units in the headers", kept)


def _zero(what: str) -> tuple:
    text = f"zero of the {what}: rest = at 0 V (default), sensor = the sensor's zero, VALUE = reading at 0 V"
    converted = _refusing(
        "rest, sensor or a number in the target's unit",
        lambda text: text if text in ("rest", "sensor") else _finite(text),
    )
    return "--zero", "rest|sensor|VALUE", text, {"type": converted, "default": "rest"}


_RECORDS = (
    "records",
    "RECORDS",
    "recordings: files (text, .xlsx, .mat, .npz, .h5, .tdms, .parquet, .mcap, rosbag2) and folders of them",
    {"nargs": "+"},
)
_MODEL = ("model", "MODEL", "identified or trained model, with any effects")
_INPUT_MAP = (
    "--input-map",
    ("square", "linear"),
    "F = u^2 or u (default: square for a voltage with a length, otherwise linear)",
)
_JOINT = ("--joint", "NAME", "joint whose motion was recorded; with --each once per joint", _REPEATED)
_ACTUATOR = ("--actuator", "NAME", "actuator that was commanded, if several drive the joint")
_LIMITS = Group(
    "limits",
    "Voltages in V, lengths in mm, other quantities in the unit of the model's recordings; or with a unit: 3kV, 20deg.",
    [
        ("--max-voltage --max-input", "U", "largest input (default: the largest in the model's recordings)", _LIMIT),
        (
            "--max-slew --max-input-rate",
            "U/s",
            "fastest change of the input (default: as in the model's recordings)",
            _LIMIT,
        ),
        (
            "--max-displacement --max-output",
            "Y",
            "largest distance from the position at zero input, in both directions (default: no limit)",
            _LIMIT,
        ),
    ],
)
EVERYWHERE = (
    ("--json", "FILE", "also write the result as JSON; - writes it to standard output", {"dest": "json_file"}),
    ("--force", None, "overwrite existing files that pitp did not write"),
    ("--no-cache", None, "do not read or store compiled programs"),
)
COMMANDS = {
    "demo": (
        "identify, train and invert a virtual actuator: tables, figures, model",
        (
            "--plant",
            ("cone100", "cone122", "cone150", "roll", "joint"),
            "virtual actuator (default cone100), or joint: a robot's joint and its simulator",
            {"default": "cone100"},
        ),
        ("--out", "DIR", "folder to write to (default ./demo)", {"default": "demo"}),
        ("--quick", None, "fewer and shorter recordings: takes a minute or two"),
    ),
    "plan": (
        "propose recordings to take: a first session, or the next ones for a model",
        (
            "paths",
            "[MODEL] RECORDS",
            "a model, or a model and the recordings it was fitted on (optional)",
            {"nargs": "*"},
        ),
        ("--out", "DIR", "folder for the inputs to play, a page and plan.json", _REQUIRED),
        _LIMITS,
        (
            "--band",
            "HZ",
            "lowest and highest frequency of the input, Hz",
            {"nargs": 2, "metavar": ("LO", "HI")} | _POSITIVE,
        ),
        ("--duration", "S", "total duration of all recordings", _POSITIVE),
        (
            "--rest",
            "S",
            "rest at zero input between recordings (default: until the actuator is at rest again)",
            _SECONDS,
        ),
        ("--rate", "HZ", "samples per second of the inputs", _POSITIVE),
        ("--alternate", None, "make every second input negative (bipolar amplifier)"),
        ("--seed", "N", "seed of the space-filling set (default 0)", _SEED),
        _columns("rate"),
    ),
    "check": (
        "show what was read and how each recording starts, and judge whether the set is sufficient",
        _RECORDS,
        ("--out", "DIR", "folder for a page and one CSV per recording as it was read"),
        _columns(),
    ),
    "identify": (
        "fit a linear model to recordings; the data choose its order",
        _RECORDS,
        ("--out", "NOMINAL", "model file to write", _REQUIRED),
        ("--order", "N|auto", "1 to 6, or auto (default)", {"default": "auto"} | _ORDER),
        _INPUT_MAP,
        Either(
            False,
            [
                (
                    "--learn",
                    ("delay",),
                    "always fit a pure delay between input and output",
                    {"default": []} | _REPEATED,
                ),
                (
                    "--no-delay",
                    None,
                    "fit no delay (default: fit one if it predicts left-out blocks better)",
                    {"action": "store_const", "const": ("delay",), "default": (), "dest": "leave_out"},
                ),
            ],
        ),
        ("--validate", "RECORDS", "also score the model on these, without fitting them", {"default": []} | _LIST),
        ("--report", "DIR", "folder for a page with the Bode diagram"),
        _columns(),
    ),
    "fit": (
        "train a model on recordings, starting from an identified one",
        _RECORDS,
        ("--out", "MODEL", "model file to write", _REQUIRED),
        ("--nominal", "NOMINAL", "start from this model instead of identifying one"),
        ("--order", "N|auto", "1 to 6, or auto (default)", _ORDER),
        ("--preset", ("default", "paper"), "training settings", {"default": "default"}),
        (
            "--learn",
            ("delay", "sensor_lag"),
            "also learn a delay or a sensor_lag between amplifier and recording (may be given twice)",
            {"default": [], "metavar": "PART"} | _REPEATED,
        ),
        _INPUT_MAP,
        ("--seed", "N", "seed of the random start (default 0)", _SEED),
        ("--report", "DIR", "folder for a page of free runs beside the recordings"),
        (
            "--cross-validate",
            None,
            "also leave out each recording in turn, train on the others and predict the one left out",
        ),
        _columns(),
    ),
    "predict": (
        "simulate a model under the recorded input and compare it with the recorded output",
        _MODEL,
        _RECORDS,
        ("--out", "DIR", "folder for a page and one CSV per recording"),
        _columns(),
    ),
    "simulate": (
        "simulate a model under inputs without a measurement",
        _MODEL,
        ("voltages", "VOLTAGE", "files of time and voltage, and folders of them", {"nargs": "+"}),
        ("--out", "DIR", "folder for one CSV per input"),
        _zero("displacement"),
        _columns("output", "each"),
    ),
    "invert": (
        "compute the voltage for a wanted motion",
        _MODEL,
        ("target", "TARGET", "file with a time and a displacement"),
        ("--out", "VOLTAGE.csv", "voltage file to write", _REQUIRED),
        _LIMITS,
        _zero("target"),
        (
            "--start-input",
            "U",
            "input before and after the target, such as a holding torque (default 0)",
            {"type": _amount_of},
        ),
        ("--rate", "HZ", "samples per second of the voltage (default: those of the target)", _POSITIVE),
        ("--unit", "UNIT", "unit of the written input (default V, or that of the recordings)"),
        (
            "--input-scale",
            "S",
            "gain of the amplifier: the file holds the input divided by S (default 1)",
            {"default": 1.0} | _POSITIVE,
        ),
        _columns("input", "rate", "each"),
    ),
    "diagnose": (
        "find where a model and recordings disagree, and which missing effect causes it",
        _RECORDS,
        Either(
            True,
            [
                ("--nominal", "MODEL", "identified or trained model"),
                ("--against", "SIMULATED", "compare with a simulator's recordings instead of a model", _LIST),
            ],
        ),
        (
            "--position-gain",
            "KP",
            "gain of the simulator's position controller: gives parameters in N m instead of ratios",
            _POSITIVE,
        ),
        (
            "--refit-nominal",
            None,
            "also fit the nominal model's coefficients (use it if the model was identified on these recordings)",
        ),
        ("--seconds", "S", "stop after S seconds and report the best result so far", _POSITIVE),
        ("--out", "DIR", "folder for the model with the effects, a page and figures"),
        Group(
            "MuJoCo file",
            "with --against, if the simulator's recordings were made with this file",
            [
                ("--mjcf", "XML", "write a copy with the robot's parameters into the folder --out"),
                _JOINT,
                _ACTUATOR,
            ],
        ),
        _columns(),
    ),
    "verify": (
        "compare MuJoCo with a robot's recordings, before and after its file was changed",
        _RECORDS,
        ("--mjcf", "XML", "MuJoCo file with the robot's parameters", _REQUIRED),
        ("--before", "XML", "original file, to compare with"),
        _JOINT,
        _ACTUATOR,
        ("--held-out", "RECORDS", "recordings that the diagnosis did not use", {"default": []} | _LIST),
        ("--out", "DIR", "folder for a page and one CSV per recording"),
        _columns(),
    ),
    "adapt": (
        "update a model to the same actuator on another day, from one short recording",
        _MODEL,
        _RECORDS,
        ("--out", "MODEL", "model file to write (an unchanged copy if nothing has changed)", _REQUIRED),
        _columns(),
    ),
    "export": (
        "write a model and its inverse as C, as an FMU or as MATLAB functions, for the rig",
        _MODEL,
        ("--to", ("c", "fmu", "matlab"), "target language", _REQUIRED),
        ("--out", "DIR", "folder to create; it must not exist yet", _REQUIRED),
        ("--rate", "HZ", "steps per second (default: the model's)", {"dest": "steps"} | _POSITIVE),
        ("--precision", ("single", "double"), "arithmetic of C and FMU (default double)"),
        (
            "--time-constant",
            "S",
            "closed-loop time constant of the PI controller in C (default: from the model; inf: no controller)",
            {
                "type": _refusing(
                    "a positive number", lambda text: math.inf if text.strip().lower() == "inf" else _above_zero(text)
                )
            },
        ),
        ("--fmi", (2, 3), "version of the FMI standard (default 2)", {"type": int}),
        ("--name", "NAME", "name of files and functions: pitp_NAME (default model)", {"default": "model"}),
    ),
    "info": (
        "show what a model file holds",
        _MODEL,
        ("others", "MODEL", SUPPRESS, {"nargs": "*"}),  # two are compared by `compare`
    ),
    "compare": (
        "show the differences between two models or two sets of recordings",
        ("a", "A", "model file, folder of a diagnosis, or recordings"),
        ("b", "B", "what A is compared with, of the same kind"),
        ("--out", "DIR", "folder for a page and its figures"),
        _columns(),
    ),
}
