"""A command run once per joint of a log, and its result for machines on standard output."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from .._errors import BadInput


def once_per_joint(arguments: dict) -> Iterator[dict]:
    """The arguments of a command, once, or for every `--each NAME=INPUT,OUTPUT` with its columns and its outputs.

    A folder gets a folder NAME for each and links to their pages, a file the name `stem.NAME.suffix`.

    Args:
        arguments: of the command; `each` is taken out.

    Raises:
        BadInput: an `--each` of another form, or two of one name.
    """
    joints = arguments.pop("each", None)
    if not joints:
        yield arguments
        return
    parts = [joint.partition("=")[::2] for joint in joints]
    for name, ports in parts:
        if not name or "/" in name or name.startswith(".") or ports.count(",") != 1 or not all(ports.split(",")):
            raise BadInput(f"--each {name}={ports}: give NAME=INPUT,OUTPUT, the exact headers of one joint")
    if len({name for name, _ in parts}) < len(parts):
        raise BadInput("--each: two joints have one name; name each once")
    for name, ports in parts:
        input_column, output_column = ports.split(",")
        own = {
            **arguments,
            "reading": {**arguments["reading"], "input_column": input_column, "output_column": output_column},
        }
        for key in ("out", "report", "json_file"):
            if own.get(key):
                own[key] = _own_place(own[key], name)
        print(f"== {name}")
        yield own
    for place in (arguments.get("out"), arguments.get("report")):
        if place is not None and Path(place).is_dir():
            from .outputs import write_index  # with it comes NumPy: a mistyped option is answered without

            write_index(Path(place), Path(place))


def _own_place(path: str, name: str) -> str:
    """Where one joint is written: a file beside, or a folder below."""
    given = Path(path)
    return str(given.with_name(f"{given.stem}.{name}{given.suffix}") if given.suffix else given / name)


@contextmanager
def json_to_standard_output(arguments: dict) -> Iterator[None]:
    """With `--json -` the result for machines is standard output, and what is said to people goes to standard error."""
    if arguments.get("json_file") not in ("-", "/dev/stdout"):
        yield
        return
    with tempfile.TemporaryDirectory() as folder:
        arguments["json_file"] = str(Path(folder) / "result.json")
        try:
            with redirect_stdout(sys.stderr):
                yield
        finally:  # a command whose records all diverged fails after it has written
            for file in sorted(Path(folder).glob("*.json")):
                sys.stdout.write(file.read_text(encoding="utf-8"))
