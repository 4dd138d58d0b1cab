"""`pitp predict`: simulates a model under the input of every record and reports the errors."""

import math
import statistics
from collections.abc import Sequence

import numpy as np

from ...common.errors import ComputationFailed
from ...common.metrics import e_rms_percent, nrmse_percent, rmse
from ...common.numbers import finite
from ...common.quantity import Quantity, Units
from ...common.units import from_base
from ...files.recordings.writing import write_signals, write_text_atomic
from ...method.model.expected_error import Expected, expected_error
from ...method.signal.initial_state import Beginning
from ...method.signal.record import Record
from ...method.simulate.prediction import Prediction
from ...method.simulate.prediction import predict as run_predict
from ..pages.tables import scores as scores_table
from .console import number, print_table
from .outputs import REPORT, check_outputs, csv_names, staged
from .recordings import open_both
from .reports import listed, print_sensors


def predict(model, records, out, json_file, reading) -> None:
    """Simulate every record, write the requested files, and print the errors.

    Args:
        model: model file.
        records: files and folders.
        out: folder for one CSV per record and a page, or None.
        json_file: where to write the scores as JSON, or None.
        reading: keyword arguments of `pitp.read`: columns, units, scales, rate.

    Raises:
        BadInput: with nothing written.
        ComputationFailed: every record diverged; the results are written.
    """
    loaded, read_in = open_both(model, records, reading)
    files = csv_names(read_in)
    check_outputs(json_file, folder=out, names=[*files, REPORT], inputs=[model, *records])
    predictions = run_predict(loaded, read_in)
    scores = scored(read_in, predictions)
    result = {"records": scores, "median_e_rms_percent": median_e_rms(list(scores.values()))}
    with staged(folder=out, json_file=json_file, value=result) as stage:
        if out is not None:
            from ..pages.fit_page import fit_page  # imported here, because matplotlib takes half a second

            for record, prediction, file in zip(read_in, predictions, files, strict=True):
                unit = record.displacement_unit
                write_signals(
                    stage / file, record.time, {f"predicted_{unit}": from_base(prediction.displacement, unit)},
                    voltage=(record.voltage, record.voltage_unit), displacement=(record.displacement, unit),
                )  # fmt: skip
            write_text_atomic(stage / REPORT, fit_page(loaded, read_in, predictions, scores, model).html())
    _print_scores(result, predictions, [expected_error(loaded, p.displacement, read_in[0].dt) for p in predictions])
    # a probability from 0.9 on is taken for certain
    if open_ones := [p.name for p in predictions if p.start_certainty < 0.9]:
        print(
            f"uncertain how the recording starts (at rest, settled or in motion): {listed(open_ones)}. The "
            "error may come from this; record a second of rest at 0 V first"
        )
    units = Units(Quantity(read_in[0].voltage_unit), Quantity(read_in[0].displacement_unit), loaded.input_map.one_sided)
    print_sensors(_sensors(read_in, predictions), units)
    if all(row["diverged"] for row in scores.values()):
        raise ComputationFailed(
            f"{model} diverged on every recording; check units and columns, or train on more recordings of this kind"
        )


def scored(records: Sequence[Record], runs: Sequence[Prediction]) -> dict[str, dict]:
    """Return the errors and counts of records, by name."""
    return {r.name: score(r, p) for r, p in zip(records, runs, strict=True)}


def score(record: Record, prediction: Prediction) -> dict:
    """Return the errors and counts of one record; the errors are None if the simulation diverged.

    `samples` counts the whole record, `missing` those without a measurement; the figures leave out those and
    the ones the initial state was estimated from. `rmse` is in the record's own unit.
    """
    measured, scored = record.displacement, prediction.scored
    error, unit = np.where(scored, prediction.displacement - measured, np.nan), record.displacement_unit
    offset = np.nanmean(error) if np.isfinite(error).any() else 0.0
    metrics = {
        "e_rms_percent": e_rms_percent(prediction.displacement, measured, scored),
        "zero_fitted_e_rms_percent": e_rms_percent(prediction.displacement - offset, measured, scored),
        "nrmse_percent": nrmse_percent(prediction.displacement, measured, scored),
        "rmse": from_base(rmse(prediction.displacement, measured, scored), unit),
    }
    return {
        **{name: None if prediction.diverged else finite(value) for name, value in metrics.items()},
        "rmse_unit": unit,
        "begins": prediction.begins,
        "zero": {
            "value": from_base(prediction.zero, unit),
            "stderr": finite(from_base(prediction.zero_stderr, unit)),
            "unit": unit,
        },
        "direction": int(prediction.direction),
        "samples": record.samples,
        "missing": record.missing,
        "initial_samples": int((~prediction.scored).sum()),
        "diverged": bool(prediction.diverged),
        "outside_training_share": float(prediction.outside_training_share),
    }


def median_e_rms(rows: Sequence[dict]) -> float | None:
    """Return the median error over records, % of range; None if it is infinite or there is no error."""
    values = [math.inf if row["diverged"] else row["e_rms_percent"] for row in rows]
    values = [value for value in values if value is not None]
    return finite(statistics.median(values)) if values else None


def _sensors(records: Sequence[Record], predictions: Sequence[Prediction]) -> dict[str, Beginning]:
    """Return initial states in which records with an unusual sensor offset form a second group.

    The tolerance is 4 standard errors and 0.2 % of the record's range; an unknown offset is ignored.
    """
    known = [p.zero for p in predictions if math.isfinite(p.zero_stderr)]
    middle, begun = float(np.median(known or [0.0])), {}
    for record, p in zip(records, predictions, strict=True):
        may = 4 * p.zero_stderr + 0.002 * record.span
        apart = math.isfinite(may) and abs(p.zero - middle) > may
        begun[p.name] = Beginning(p.begins, p.direction, p.zero, p.zero_stderr, int(apart))
    return begun


def _shown(expected: Expected | None, prediction: Prediction) -> str:
    """Write the error to expect for a record, or `unknown` where the model was not trained with such an input."""
    if prediction.not_excited:
        return "unknown"
    return "" if expected is None else number(expected.percent, 2)


def _print_scores(result: dict, predictions: Sequence[Prediction], expected: Sequence[Expected | None]) -> None:
    shown = {p.name: _shown(e, p) for e, p in zip(expected, predictions, strict=True)}
    print_table(scores_table(shown, result["records"], shown), 3)
    median = result["median_e_rms_percent"]
    infinite = any(row["diverged"] for row in result["records"].values())
    print(f"median e_rms: {'infinite' if median is None and infinite else number(median, 3)} %")
    if sources := dict.fromkeys(e.source for e in expected if e is not None):
        print(f"expected: e_rms of a recording that was not used for training ({'; '.join(sources)})")
    for p in predictions:
        if p.outside_training:
            print(f"{p.name}: outside the trained region: {p.outside_training}")
        if p.not_excited:
            print(f"{p.name}: {p.not_excited} No figure is known for its error.")
        if p.estimated_start:
            used = int((~p.scored).sum())
            print(
                f"{p.name}: starts moving; its initial state was estimated from the first {used} samples, which are "
                "not scored"
            )
