"""`pitp verify`: compares a robot with its MuJoCo model, before and after the file was changed."""

from ...common.errors import ComputationFailed, refuse_if
from ...common.units import from_base
from ...files.mjcf.verify import verify_mjcf
from ...files.recordings.writing import write_csv
from ..pages.drawing import write_page
from ..pages.mjcf import page, table
from .console import print_table
from .outputs import REPORT, check_outputs, csv_names, staged
from .recordings import read_records


def verify(records, mjcf, before, joint, actuator, held_out, out, json_file, reading) -> None:
    """Simulate the recorded commands in MuJoCo, write the requested files, and print the errors.

    Args:
        records: files and folders: recordings that the diagnosis used.
        mjcf: the changed file.
        before: the file as it was, or None.
        joint: list with its name.
        actuator: its name, if several act on the joint.
        held_out: files and folders of recordings that the diagnosis did not use.
        out: folder for a page, and one CSV and one figure per record, or None.
        json_file: where to write the gaps for machines, or None.
        reading: keyword arguments of `pitp.read`.

    Raises:
        BadInput: with nothing written.
        ComputationFailed: the changed file is not better beyond the noise; the results are written.
    """
    used, others = (read_records(paths, reading, input_map="linear") for paths in (records, held_out))
    files = csv_names((*used, *others))
    same = len(set(files)) < len(files)
    refuse_if((same, "a held-out recording has the same name as another recording; rename one of them"))
    check_outputs(json_file, folder=out, names=[*files, REPORT], inputs=[mjcf, before, *records, *held_out])
    result = verify_mjcf(used, mjcf, one_joint(joint), before=before, held_out=others, actuator=actuator)
    with staged(folder=out, json_file=json_file, value=result.as_json()) as stage:
        if out is not None:
            for played, file in zip(result.played, files, strict=True):
                columns = {"time_s": played.record.time}
                unit = played.record.displacement_unit
                series = {"measured": played.record.displacement, "before": played.before, "after": played.after}
                columns |= {f"{n}_{unit}": from_base(v, unit) for n, v in series.items() if v is not None}
                write_csv(stage / file, columns)
            write_page(stage / REPORT, page(result))
    print_table(table(result), 3)
    for line in result.lines():
        print(line)
    if result.better is False:
        raise ComputationFailed(f"{mjcf} is not significantly better than {before}; keep the old file")


def one_joint(joint: list[str] | None) -> str:
    """Return the name of the joint if exactly one is given.

    Raises:
        BadInput: none or several.
    """
    names = joint or []
    refuse_if(
        (not names, "--mjcf needs --joint NAME, the joint whose motion was recorded"),
        (len(names) > 1, "several --joint need --each NAME=INPUT,OUTPUT once per joint, in the same order"),
    )
    return names[0]
