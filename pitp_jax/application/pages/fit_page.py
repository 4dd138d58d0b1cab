"""Write the page of a trained model: simulations over their records, errors, coefficients and spectra.

e_rms by input frequency and stroke,   tokens sigma_i(x) / a_i at standstill over the stroke,
time constants of the memory,   spectrum of predicted - measured beside the measured one
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from ...common.numbers import figure, shown_unit
from ...common.page import Card, Page, Section
from ...common.picture import Picture, figure_of, finish, new_axes
from ...common.units import from_base
from ...method.model.fitted import Fitted
from ...method.model.memory import FadingMemory, RingingMemory
from ...method.model.model import Model
from ...method.model.units import units_of
from ...method.signal.excitation_kind import kind, loudest
from ...method.signal.record import Record
from ...method.simulate.prediction import Prediction, predict
from ..compare.description import fallback_line
from .drawing import CYCLE, DRAWN, ERROR, MEASURED, PREDICTED, beside
from .tables import scores as scores_table


def fit_page(
    model: Fitted, records: Sequence[Record], predictions: Sequence[Prediction], scores: dict, name: str
) -> Page:
    """Return the page that compares simulations of a trained model with records.

    Args:
        model: the fitted model.
        records: compared with its free runs.
        predictions: its free runs, one a record.
        scores: rows of `pitp predict`, by the record's name.
        name: of the model file.
    """
    errors = [_error(scores[r.name]) for r in records]
    runs = sorted(zip(errors, records, predictions, strict=True), key=lambda run: -run[0])
    complete = [(r, p) for error, r, p in runs if not p.diverged and np.isfinite(error)]
    pictures = [_map(records, errors)]  # the others need a finite error, or a trained range
    if complete:
        pictures.append(_spectra(complete))
    if len(model.domain.region):
        pictures.append(_tokens(model))
    shown = [run for run in runs[:DRAWN] if not run[2].diverged]
    return Page(
        f"Off by {figure(float(np.median(errors)), 2)} % of range, at most {figure(max(errors), 2)} %",
        f"Free runs of {name} beside {len(records)} recordings",
        [fallback_line(model.origin.training) or "", _cards(model, records, predictions, scores), pictures],
        [
            Section("Recordings, the worst first", [
                scores_table((r.name for _, r, _ in runs), scores, {}),
                [_run(f"run{k}", *run) for k, run in enumerate(shown)],
            ])
        ],
    )  # fmt: skip


def _error(row: dict) -> float:
    return float("inf") if row["diverged"] else row["e_rms_percent"] or 0.0


def _cards(model: Fitted, records, predictions, scores) -> list[Card]:
    outside = 100 * float(np.mean([p.outside_training_share for p in predictions]))
    farthest = max(predictions, key=lambda p: p.outside_training_share)
    where = f", most in {farthest.name}: {farthest.outside_training}" if farthest.outside_training else ""
    lines = [f"{figure(outside, 2)} % lie outside the trained region{where}."]
    lines += [f"{p.name}: {p.not_excited}" for p in predictions if p.not_excited][:3]
    nrmse = [row["nrmse_percent"] for row in scores.values() if row["nrmse_percent"] is not None]
    big = f"{figure(float(np.median(nrmse)), 2)} % of std" if nrmse else "–"
    fading = memory_times(model, records, predictions)
    memory = list(fading)
    if isinstance(model.memory, RingingMemory):
        memory.append(f"and a second mass at {figure(float(model.memory.ring[0]) / (2 * np.pi))} Hz")
    if fading:
        memory.append("The past motion fades within them (creep of the film). The network can compensate for changes.")
    hertz = figure(model.natural_frequency / (2 * np.pi))
    return [
        Card("Error", big, lines),
        Card("Model", f"order {model.order}, {hertz} Hz", [e.name for e in model.effects]),
        Card("Memory", "Memory times" if fading else "none", memory),
    ]


def memory_times(model: Model | Fitted, records: Sequence[Record], predictions: Sequence[Prediction]) -> list[str]:
    """Write the model's memory time constants as text, with a mark for those that the records do not determine.

    J_k = dx / d ln tau_k,   covariance of ln tau = s^2 (J'J)^-1 (samples / independent ones)

    The error is coloured: with its lag-1 correlation r, only (1 - r) / (1 + r) of the samples are independent. The
    network is held fixed, although it can compensate for a changed time constant: such errors are too small to be
    shown.
    """
    memory, step = model.memory, 0.05
    if not isinstance(memory, FadingMemory | RingingMemory):
        return []
    whole = [(r, p) for r, p in zip(records, predictions, strict=True) if not p.diverged]
    if not whole:
        return [f"{figure(float(t), 2)} s" for t in np.sort(np.exp(memory.log_tau))]
    records, predictions = zip(*whole, strict=True)
    counted = [p.scored & r.observed for r, p in whole]
    columns = []
    for k in range(len(memory.log_tau)):
        changed = replace(model, memory=replace(memory, log_tau=memory.log_tau.at[k].add(step)))
        runs = zip(predict(changed, records), predictions, counted, strict=True)
        columns.append(np.concatenate([(run.displacement - p.displacement)[use] / step for run, p, use in runs]))
    errors = [(p.displacement - r.displacement)[use] for (r, p), use in zip(whole, counted, strict=True)]
    error, jacobian = np.concatenate(errors), np.stack(columns, -1)
    correlation = sum(float(e[1:] @ e[:-1]) for e in errors) / (error @ error)
    independent = max((1 - correlation) / (1 + correlation), 1 / len(error))
    scatter = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * np.mean(error**2) / independent
    times = sorted(zip(np.exp(np.asarray(memory.log_tau, float)), np.sqrt(np.diag(scatter)), strict=True))
    longest, lines = max(r.samples * r.dt for r in records), []
    for tau, stderr in times:
        mark = ""
        if stderr >= 0.5:  # of ln tau
            mark = ", not determined"
        elif tau > longest:
            mark = ", longer than the recordings"
        lines.append(f"{figure(tau, 2)} s{mark}")
    return lines


def _run(name: str, error: float, record: Record, run: Prediction) -> Picture:
    measured, predicted = ("measured", record.displacement), ("predicted", run.displacement, PREDICTED)
    drawn = beside(record.time, measured, [predicted], record.displacement_unit)
    return Picture(name, drawn, f"{record.name}: {figure(error, 2)} % of range.")


def _map(records: Sequence[Record], errors: Sequence[float]) -> Picture:
    """Draw one dot per record by frequency and stroke, coloured by the kind of input, with the error as text."""
    (ax,) = axes = new_axes(1, 3.0)
    unit, kinds = records[0].displacement_unit, [kind(r) for r in records]
    colors = dict(zip(dict.fromkeys(kinds), CYCLE * len(kinds), strict=False))
    for k, (record, name) in enumerate(zip(records, kinds, strict=True)):
        place = loudest(record), float(from_base(record.span, unit))
        label = name if kinds.index(name) == k else f"_{name}"  # one entry in the legend
        ax.plot(*place, "o", ms=4, color=colors[name], label=label)
        ax.annotate(figure(errors[k], 2), place, (3, 3), textcoords="offset points", fontsize=7)
    ax.set_xscale("log")
    finish(axes, "strongest frequency of the input (Hz)", [f"stroke ({shown_unit(unit)})"])
    return Picture("map", figure_of(ax), "Error, % of range, by the input's strongest frequency and by the stroke.")


def _spectra(pairs: Sequence[tuple[Record, Prediction]]) -> Picture:
    """Draw the spectra of output and error, as medians over records of one sampling rate."""
    (ax,) = axes = new_axes(1, 3.0)
    unit, size = pairs[0][0].displacement_unit, min(4096, *(r.samples for r, _ in pairs))

    def density(values: np.ndarray, dt: float):
        return scipy.signal.welch(from_base(np.nan_to_num(values), unit), 1 / dt, nperseg=size)

    outputs = [density(r.displacement - np.nanmean(r.displacement), r.dt) for r, _ in pairs]
    errors = [density(p.displacement - r.displacement, r.dt) for r, p in pairs]
    for color, label, rows in ((MEASURED, "measured", outputs), (ERROR, "error of the free runs", errors)):
        root = np.sqrt(np.median([power[1:] for _, power in rows], axis=0))
        ax.loglog(rows[0][0][1:], root, color=color, lw=1.1, label=label)
    finish(axes, "frequency (Hz)", [f"density ({shown_unit(unit)}/√Hz)"])
    caption = (
        "Spectra of the measured output and of the error of the free runs. A flat error spectrum is noise; a peak at "
        "the input's frequency or at the resonance shows that the model lacks something."
    )
    return Picture("spectra", figure_of(ax), caption)


def _tokens(model: Fitted) -> Picture:
    """Draw the factor on each nominal coefficient at standstill over the trained displacements."""
    (ax,) = axes = new_axes(1, 3.0)
    low, high = model.domain.region[0]
    x = jnp.linspace(low, high, 60)

    def settled(at):
        still = jnp.zeros(model.order, at.dtype).at[0].set(at)
        return model.tokens(jnp.concatenate([still, model.memory.initial(at)]))[0] / model.coefficients

    factors, unit = np.asarray(jax.vmap(settled)(x)), model.origin.displacement_unit
    across = from_base(np.asarray(x, np.float64) * float(model.scales.state[0]), unit)
    for k, color in zip(range(model.order + 1), CYCLE, strict=False):
        ax.plot(across, factors[:, k], color=color, lw=1.2, label=f"of a{k}")
    finish(axes, f"{units_of(model).output_word} ({shown_unit(unit)})", ["factor"])
    caption = "Factors on the nominal model's coefficients at standstill, settled, over the trained stroke."
    return Picture("tokens", figure_of(ax), caption)
