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
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...common.numbers import figure, shown_unit
from ...common.units import from_base
from ...method.model.fitted import Fitted
from ...method.model.memory import FadingMemory, RingingMemory
from ...method.model.model import Model
from ...method.model.units import units_of
from ...method.signal.excitation_kind import kind, loudest
from ...method.signal.record import Record
from ...method.simulate.prediction import Prediction, predict
from . import html
from .description import fallback_line
from .html import tag
from .lines import CYCLE, ERROR, MEASURED, PREDICTED, finish, line, over, own_axes

_KNOWN = 0.5  # standard error of ln tau above which a time constant counts as unknown
_SHOWN = 12  # records drawn, the worst first


def fit_page(
    model: Fitted, records: Sequence[Record], predictions: Sequence[Prediction], scores: dict, name: str
) -> str:
    """Write an HTML page that compares simulations of a trained model with records.

    Args:
        model: the fitted model.
        records: compared with its free runs.
        predictions: its free runs, one a record.
        scores: rows of `pitp predict`, by the record's name.
        name: of the model file.
    """
    order = sorted(range(len(records)), key=lambda k: -_error(scores[records[k].name]))
    errors = [_error(scores[r.name]) for r in records]
    title = f"Off by {figure(float(np.median(errors)), 2)} % of range, at most {figure(max(errors), 2)} %"
    runs = [
        html.picture(
            f"run{k}", _run(records[k], predictions[k]), f"{records[k].name}: {figure(errors[k], 2)} % of range."
        )
        for k in order[:_SHOWN]
        if not predictions[k].diverged
    ]
    kept = [k for k in range(len(records)) if not predictions[k].diverged and np.isfinite(errors[k])]
    parts = [
        tag("p", f"Free runs of {name} beside {len(records)} recordings", "soft"),
        tag("h1", title),
        *([tag("p", line)] if (line := fallback_line(model.origin.training)) else []),
        f'<div class="cards">{"".join(_cards(model, records, predictions, scores))}</div>',
        '<div class="figures">',
        html.picture("map", _map(records, errors), "Error by the input's strongest frequency and by the stroke."),
        html.picture("colour", _colour([(records[k], predictions[k]) for k in kept]), _COLOUR) if kept else "",
        html.picture("tokens", _tokens(model), _TOKENS) if len(model.domain.region) else "",
        "</div>",
        tag("h2", "Recordings, the worst first"),
        _table([records[k] for k in order], scores),
        f'<div class="figures">{"".join(runs)}</div>',
    ]
    return html.page(title, parts)


_COLOUR = (
    "Spectra of the measured output and of the error of the free runs. A flat error spectrum is noise; a peak at the "
    "input's frequency or at the resonance shows that the model lacks something."
)
_TOKENS = "Factors on the nominal model's coefficients at standstill, settled, over the trained stroke."


def _error(row: dict) -> float:
    return float("inf") if row["diverged"] else row["e_rms_percent"] or 0.0


def _cards(model: Fitted, records, predictions, scores) -> list[str]:
    outside = 100 * float(np.mean([p.outside_training_share for p in predictions]))
    moved = [p.name for p in predictions if p.begins != "rest"]
    farthest = max(predictions, key=lambda p: p.outside_training_share)
    where = f", most in {farthest.name}: {farthest.outside_training}" if farthest.outside_training else ""
    lines = [f"{figure(outside, 2)} % lie outside the trained region{where}."]
    lines += [f"{p.name}: {p.not_excited}" for p in predictions if p.not_excited][:3]
    lines += [f"{len(moved)} of {len(predictions)} do not start at rest."] if moved else []
    lost = sum(p.diverged for p in predictions)
    nrmse = [row["nrmse_percent"] for row in scores.values() if row["nrmse_percent"] is not None]
    big = f"{figure(float(np.median(nrmse)), 2)} % of std" if nrmse else "–"
    memory = model.memory
    fading = memory_times(model, records, predictions)
    hertz = float(memory.ring[0]) / (2 * np.pi) if isinstance(memory, RingingMemory) else None
    mass = [f"and a second mass at {figure(hertz)} Hz"] if hertz else []
    what = (
        [
            tag(
                "p",
                "Memory times: the past motion fades within them (creep of the film). The network can compensate "
                "for changes.",
            )
        ]
        if fading
        else []
    )
    return [
        html.card("Error", big, html.bullets([*lines, *([f"{lost} diverged."] if lost else [])])),
        html.card("Model", f"order {model.order}, {figure(model.natural_frequency / (2 * np.pi))} Hz",
                  html.bullets([e.name for e in model.effects])),
        html.card("Memory", "" if fading else "none", *what, html.bullets([*fading, *mass])),
    ]  # fmt: skip


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
    counted = [p.scored & np.isfinite(r.displacement) for r, p in zip(records, predictions, strict=True)]
    columns = []
    for k in range(len(memory.log_tau)):
        moved = replace(model, memory=replace(memory, log_tau=memory.log_tau.at[k].add(step)))
        runs = predict(moved, records)
        change = [(run.displacement - p.displacement) / step for run, p in zip(runs, predictions, strict=True)]
        columns.append(np.concatenate([c[use] for c, use in zip(change, counted, strict=True)]))
    errors = [(p.displacement - r.displacement)[use] for r, p, use in zip(records, predictions, counted, strict=True)]
    error, jacobian = np.concatenate(errors), np.stack(columns, -1)
    pairs = sum(float(e[1:] @ e[:-1]) for e in errors)
    kept = max((1 - pairs / (error @ error)) / (1 + pairs / (error @ error)), 1 / len(error))
    scatter = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * np.mean(error**2) / kept
    times = sorted(zip(np.exp(np.asarray(memory.log_tau, float)), np.sqrt(np.diag(scatter)), strict=True))
    longest, lines = max(r.samples * r.dt for r in records), []
    for tau, error in times:
        beyond = ", longer than the recordings" if tau > longest else ""
        lines.append(f"{figure(tau, 2)} s{', not determined' if error >= _KNOWN else beyond}")
    return lines


def _run(record: Record, run: Prediction) -> Figure:
    unit, time = record.displacement_unit, record.time - record.time[0]
    measured, predicted = (from_base(x, unit) for x in (record.displacement, run.displacement))
    upper, lower = own_axes(None, 2, (5.0, 3.2), (2.4, 1.0))
    line(upper, time, measured, color=MEASURED, lw=2.4, label="measured")
    line(upper, time, predicted, color=PREDICTED, lw=1.0, label="predicted", **over(predicted))
    line(lower, time, predicted - measured, color=ERROR, lw=0.8)
    finish(np.array([upper, lower]), "time (s)", [f"output ({shown_unit(unit)})", "error"])
    return upper.figure


def _map(records: Sequence[Record], errors: Sequence[float]) -> Figure:
    """Draw one dot per record by frequency and stroke, coloured by the kind of input, with the error as text."""
    ax: Axes = own_axes(None, 1, (5.0, 3.0))[0]
    unit = records[0].displacement_unit
    kinds = [kind(r) for r in records]
    for color, name in zip(CYCLE, dict.fromkeys(kinds), strict=False):
        for k in (k for k, other in enumerate(kinds) if other == name):
            x = records[k].displacement
            stroke = float(from_base(np.nanmax(x) - np.nanmin(x), unit))
            label = name if kinds.index(name) == k else f"_{name}"  # one entry in the legend
            ax.plot(loudest(records[k]), stroke, "o", ms=4, color=color, label=label)
            ax.annotate(
                figure(errors[k], 2), (loudest(records[k]), stroke), (3, 3), textcoords="offset points", fontsize=7
            )
    ax.set_xscale("log")
    finish(np.array([ax]), "strongest frequency of the input (Hz)", [f"stroke ({shown_unit(unit)})"], 4)
    return ax.figure  # pyright: ignore[reportReturnType]


def _colour(pairs: Sequence[tuple[Record, Prediction]]) -> Figure:
    """Draw the spectra of output and error, as medians over records of one sampling rate."""
    ax: Axes = own_axes(None, 1, (5.0, 3.0))[0]
    unit, size = pairs[0][0].displacement_unit, min(4096, *(r.samples for r, _ in pairs))
    for color, label, signal in (
        (MEASURED, "measured", lambda r, p: r.displacement - np.nanmean(r.displacement)),
        (ERROR, "error of the free runs", lambda r, p: p.displacement - r.displacement),
    ):
        rows = [
            scipy.signal.welch(from_base(np.nan_to_num(signal(r, p)), unit), 1 / r.dt, nperseg=size) for r, p in pairs
        ]
        ax.loglog(
            rows[0][0][1:], np.sqrt(np.median([row[1][1:] for row in rows], axis=0)), color=color, lw=1.1, label=label
        )
    finish(np.array([ax]), "frequency (Hz)", [f"density ({shown_unit(unit)}/√Hz)"])
    return ax.figure  # pyright: ignore[reportReturnType]


def _tokens(model: Fitted) -> Figure:
    """Draw the factor on each nominal coefficient at standstill over the trained displacements."""
    ax: Axes = own_axes(None, 1, (5.0, 3.0))[0]
    low, high = model.domain.region[0]
    x = jnp.linspace(low, high, 60)

    def settled(at):
        still = jnp.zeros(model.order, at.dtype).at[0].set(at)
        return model.tokens(jnp.concatenate([still, model.memory.initial(at)]))[0] / model.coefficients

    factors, unit = np.asarray(jax.vmap(settled)(x)), model.origin.displacement_unit
    across = from_base(np.asarray(x, np.float64) * float(model.scales.state[0]), unit)
    for k, color in zip(range(model.order + 1), (PREDICTED, *CYCLE[1:]), strict=False):
        ax.plot(across, factors[:, k], color=color, lw=1.2, label=f"of a{k}")
    finish(np.array([ax]), f"{units_of(model).output_word} ({shown_unit(unit)})", ["factor"], 4)
    return ax.figure  # pyright: ignore[reportReturnType]


def _table(records: Sequence[Record], scores: dict) -> str:
    header = (
        "recording",
        "begins",
        "error, % of range",
        "% of std",
        "rmse",
        "with fitted sensor offset, %",
        "outside, %",
    )
    rows = []
    for r in records:
        s = scores[r.name]
        cells = s["e_rms_percent"], s["nrmse_percent"], s["rmse"], s["zero_fitted_e_rms_percent"]
        share = 100 * s["outside_training_share"]
        rows.append(
            ("", (r.name, s["begins"], *("diverged" if s["diverged"] else figure(c) for c in cells), figure(share, 2)))
        )
    return html.table(header, rows, {1: "left"})
