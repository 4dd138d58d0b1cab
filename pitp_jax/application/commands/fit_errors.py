"""Report the error of every record: of the nominal model, the trained model, and models trained without that record."""

from collections.abc import Sequence
from statistics import median

import numpy as np

from ...method.identify.explained import CHECK, LITTLE, NOTHING
from ...method.identify.identification import Identification
from ...method.signal.record import Record
from ...method.train.cross_validation import HeldOut
from ...method.train.errors import RecordError
from .console import Table, print_table


def explained(
    errors: Sequence[RecordError], records: Sequence[Record], first: Identification | None
) -> tuple[bool, str | None]:
    """Return whether a trained model explains its training records at all, and a warning if it explains little.

    Args:
        errors: of the trained model.
        records: it was trained on.
        first: the identification that it started from, or None if a nominal was given.
    """
    own, missed, moved = {r.name: r for r in records}, 0.0, 0.0
    for e in errors:
        y = own[e.name].displacement[own[e.name].observed]
        missed += len(y) * (e.trained / 100 * own[e.name].span) ** 2
        moved += len(y) * float(np.var(y))
    residual = float(np.sqrt(missed / max(moved, 1e-300)))
    # training may explain effects that a linear model cannot, and then has less than half of its residual
    if first is not None and not first.explains and residual > 0.5 * first.chosen.heldout / 100:
        return False, first.warning
    text = f"{100 * residual:.0f} % of the output's rms remains unexplained on the training recordings"
    if residual >= NOTHING:
        return False, f"The model explains nothing: {text}. {CHECK}"
    if residual >= LITTLE:
        return True, f"{text}: the model explains only a part. {CHECK}"
    return True, None


def print_errors(errors: Sequence[RecordError], held_out: Sequence[HeldOut]) -> None:
    """Print the error of every record: of the nominal model, the trained one and, if known, one trained without it."""
    rows: list[tuple] = [(e.name, e.nominal, e.trained) for e in errors]
    header = ("record, e_rms in % of range", "nominal", "trained")
    if held_out:
        header = (*header, "left out")
        rows = [(*row, h.predicted) for row, h in zip(rows, held_out, strict=True)]
        _, *columns = zip(*rows, strict=True)
        rows.append(("median", *map(median, columns)))
    print_table(Table(header, rows), 3)


def suspects(held_out: Sequence[HeldOut]) -> list[str]:
    """Write a line for every record that a model trained without it does not predict."""
    lines = []
    for h in held_out:
        if h.suspect:
            why = h.problem or f"predicted {h.predicted / h.fitted:.0f} times worse if left out of the training"
            lines.append(f"{h.name}: {why}; no other recording covers this motion: record another one like it")
    return lines


def errors_json(errors: Sequence[RecordError], held_out: Sequence[HeldOut]) -> dict:
    """Return the errors of every record as a dict for JSON."""
    predicted = {h.name: {"left_out_e_rms_percent": h.predicted, "problem": h.problem or None} for h in held_out}
    rows = {
        e.name: {"nominal_e_rms_percent": e.nominal, "trained_e_rms_percent": e.trained, **predicted.get(e.name, {})}
        for e in errors
    }
    return {"records": rows, "worse_than_nominal": [e.name for e in errors if e.worse],
            "warnings": suspects(held_out)}  # fmt: skip
