"""`pitp demo`: runs the paper's experiments on a virtual actuator, or simulates a robot's joint and its simulator."""

from dataclasses import asdict
from pathlib import Path

from ...common.errors import BadInput
from ..compare.description import fallback_line
from ..demo import files, joint
from ..demo.protocol import run, tables
from .console import ProgressLine, Table, print_table, say
from .outputs import check_outputs, staged


def demo(plant, out, quick, json_file=None) -> None:
    """Run the demo for one virtual actuator, write its files, and print its tables.

    Args:
        plant: name of the virtual actuator, or "joint".
        out: folder to write to, created if missing.
        quick: fewer and shorter records.
        json_file: where to write the tables as JSON, or None.

    Raises:
        BadInput, ComputationFailed: with nothing written.
    """
    if plant == "joint":
        _joint(out, quick, json_file)
        return
    check_outputs(json_file, folder=out, names=files.FILES)
    _check_recordings(Path(out), files.recordings(plant, quick))
    played = run(plant, quick=quick, say=say, progress=ProgressLine().train)
    made = tables(played)
    fallback = fallback_line(played.training.notes)
    value = {"tables": [{"title": t.note, "header": t.header, "rows": t.rows} for t in made], "fallback": fallback}
    with staged(folder=out, json_file=json_file, value=value) as stage:
        files.write(played, stage)
    if fallback:
        print(f'{fallback} The column "this model" shows that model.\n')
    for table in made:
        print(table.note)
        print_table(table, 3)
        print()
    print(f"recordings, model, tables and figures are in {out}; the other commands run on them:")
    print(f"  pitp predict {out}/model.pitp {out}/held_out")


def _joint(out: str, quick: bool, json_file: str | None) -> None:
    """Write recordings of a robot's joint and of its simulator, and print how the two differ."""
    check_outputs(json_file, folder=out, names=joint.recordings())
    _check_recordings(Path(out), joint.recordings())
    ideal, real = asdict(joint.IDEAL), asdict(joint.REAL)
    with staged(folder=out, json_file=json_file, value={"simulator": ideal, "robot": real}) as stage:
        joint.write(stage, quick=quick)
    units = {"friction": "N m", "delay": "s", "backlash": "rad"}
    rows = [(name, ideal[name], real[name], unit) for name, unit in units.items()]
    print_table(Table(("what differs", "simulator", "robot", "unit"), rows))
    print(f"{out}/{joint.SIMULATED} and {out}/{joint.ROBOT} hold the same position commands. To find these parameters:")
    print(
        f"  pitp diagnose {out}/{joint.ROBOT} --against {out}/{joint.SIMULATED} --position-gain {joint.POSITION_GAIN:g}"
    )
    print(f"{out}/{joint.SIMULATOR_FILE} is the simulator as a MuJoCo file (pitp diagnose --mjcf, pitp verify)")


def _check_recordings(out: Path, names: set[str]) -> None:
    """Refuse a folder that holds recordings of another demo: recordings in one folder must be of one actuator."""
    for home in sorted({name.split("/")[0] for name in names}):
        if (out / home).is_dir():
            others = sorted(p.name for p in (out / home).iterdir() if f"{home}/{p.name}" not in names)
            if others:
                raise BadInput(f"{out / home}: {others[0]} is from another demo; choose another folder with --out")
