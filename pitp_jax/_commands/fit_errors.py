"""What a training leaves of every record: under the nominal, the trained model, and models of the other records."""

from collections.abc import Sequence
from statistics import median

from .._train.cross_validation import HeldOut
from .._train.errors import RecordError
from .console import number, print_table


def print_errors(errors: Sequence[RecordError], held_out: Sequence[HeldOut]) -> None:
    """Every training record under the nominal, the trained model and, where there is one, a model of the others."""
    rows: list[tuple[str, ...]] = [(e.name, number(e.nominal, 3), number(e.trained, 3)) for e in errors]
    header = ("record, e_rms in % of range", "nominal", "trained")
    if held_out:
        header = (*header, "left out")
        rows = [(*row, number(h.predicted, 3)) for row, h in zip(rows, held_out, strict=True)]
        columns = ([e.nominal for e in errors], [e.trained for e in errors], [h.predicted for h in held_out])
        rows.append(("median", *(number(median(column), 3) for column in columns)))
    print_table(header, rows)


def suspects(held_out: Sequence[HeldOut]) -> list[str]:
    """A line for every record that models of the others do not predict."""
    return [
        f"{h.name}: {h.problem or f'predicted {h.predicted / h.fitted:.0f} times worse than fitted'}"
        "; it holds what no other record does: take another like it"
        for h in held_out
        if h.suspect
    ]


def errors_json(errors: Sequence[RecordError], held_out: Sequence[HeldOut]) -> dict:
    """The same for machines."""
    predicted = {h.name: {"left_out_e_rms_percent": h.predicted, "problem": h.problem or None} for h in held_out}
    rows = {
        e.name: {"nominal_e_rms_percent": e.nominal, "trained_e_rms_percent": e.trained, **predicted.get(e.name, {})}
        for e in errors
    }
    return {"records": rows, "worse_than_nominal": [e.name for e in errors if e.worse],
            "warnings": suspects(held_out)}  # fmt: skip
