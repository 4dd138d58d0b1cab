"""Run a command once per robot joint in a log, and print its JSON result on standard output."""

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path


def once_per_joint(arguments: dict) -> Iterator[dict]:
    """Yield the arguments of a command once, or once per robot joint with its columns and output paths.

    Joints come from `--each NAME=INPUT,OUTPUT`, otherwise from `each` in the `pitp.toml` of a folder. An output folder
    gets a subfolder NAME per joint with links to the pages; an output file becomes `stem.NAME.suffix`.

    Args:
        arguments: of the command; `each` is removed.

    Raises:
        BadInput: an `--each` of another form, or two of one name.
    """
    read_as = _joints(arguments)
    if not read_as:
        yield arguments
        return
    joints, before = arguments.get("joint") or [], None
    for k, (name, columns) in enumerate(read_as.items()):
        own = {**arguments, "reading": {**arguments["reading"], **columns}}
        for key in ("out", "report", "json_file"):
            if own.get(key):
                own[key] = own_place(own[key], name)
        if len(joints) == len(read_as):  # of a simulator's file, which finally holds all of them
            own["joint"], own["mjcf"] = [joints[k]], before or arguments["mjcf"]
        print(f"== {name}")
        yield own
        if len(joints) == len(read_as) and own.get("out"):
            from ...files.mjcf.write import identified_name  # already loaded by the command that has just run

            made = Path(own["out"]) / identified_name(own["mjcf"])
            before = str(made) if made.is_file() else before
    for place in (arguments.get("out"), arguments.get("report")):
        if place is not None and Path(place).is_dir():
            from .outputs import write_index  # imported here, because it loads NumPy, which a usage error does not need

            write_index(Path(place), Path(place))


def _joints(arguments: dict) -> dict[str, dict]:
    """Remove `each` from the arguments; return reading options by robot joint, if it or `pitp.toml` names joints."""
    if "each" not in arguments:
        return {}
    said = arguments.pop("each")
    # the folders of these arguments do not determine joints
    no_records = "out", "report", "json_file", "model", "nominal"
    read_from = [v if isinstance(v, list) else [v] for key, v in arguments.items() if key not in no_records]
    paths = [Path(p) for v in read_from for p in v if isinstance(p, str)]
    folders = {p if p.is_dir() else p.parent for p in paths if p.exists()}
    if not said and not any((folder / "pitp.toml").is_file() for folder in folders):
        return {}
    # imported here, because the table reader loads NumPy, which a usage error does not need
    from ...files.containers.options import joints_in, joints_of

    if said:
        return {name: {"input_column": i, "output_column": o} for name, (i, o) in joints_of(said).items()}
    if any(arguments["reading"].get(f"{stem}_column") for stem in ("input", "output")):
        return {}
    return {name: {"joint": name} for path in paths if path.exists() for name in joints_in(path)}


def own_place(path: str, name: str) -> str:
    """Return the output path for one robot joint: `stem.NAME.suffix` for a file, a subfolder for a folder."""
    given = Path(path)
    return str(given.with_name(f"{given.stem}.{name}{given.suffix}") if given.suffix else given / name)


@contextmanager
def json_to_standard_output(arguments: dict) -> Iterator[None]:
    """If the user gives `--json -`, print the JSON result on standard output and all messages on standard error."""
    if arguments.get("json_file") not in ("-", "/dev/stdout"):
        yield
        return
    with tempfile.TemporaryDirectory() as folder:
        arguments["json_file"] = str(Path(folder) / "result.json")
        try:
            with redirect_stdout(sys.stderr):
                yield
        finally:  # a command fails after writing if all its records diverged
            for file in sorted(Path(folder).glob("*.json")):
                sys.stdout.write(file.read_text(encoding="utf-8"))
