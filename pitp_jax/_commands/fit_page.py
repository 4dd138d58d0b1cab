"""The page of a fit: what a colleague looks at first, free runs beside their records.

e_rms by drive frequency and stroke,   tokens sigma_i(x) / a_i at standstill over the stroke,
time constants of the memory,   spectrum of predicted - measured beside the measured one
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .._model.memory import FadingMemory, RingingMemory
from .._model.model import Model
from .._record.excitation_kind import kind, loudest
from .._record.record import Record
from .._report import html
from .._report.html import tag
from .._report.lines import CYCLE, ERROR, MEASURED, PREDICTED, finish, own_axes
from .._report.numbers import figure, shown_unit
from .._report.paper_figures import prediction as beside
from .._simulate.prediction import Prediction
from .._table.units import base_unit, from_base

_SHOWN = 12  # records drawn, the worst first


def fit_page(
    model: Model, records: Sequence[Record], predictions: Sequence[Prediction], scores: dict, name: str
) -> str:
    """A self-contained HTML page.

    Args:
        model: what was fitted.
        records: it was run beside.
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
        f'<div class="cards">{"".join(_cards(model, records, predictions, scores))}</div>',
        '<div class="figures">',
        html.picture("map", _map(records, errors), "Error by the drive's strongest frequency and by the stroke."),
        html.picture("colour", _colour([(records[k], predictions[k]) for k in kept]), _COLOUR) if kept else "",
        html.picture("tokens", _tokens(model), _TOKENS) if model.provenance.region else "",
        "</div>",
        tag("h2", "Recordings, the worst first"),
        _table([records[k] for k in order], scores),
        f'<div class="figures">{"".join(runs)}</div>',
    ]
    return html.page(title, parts)


_COLOUR = (
    "Spectra of what was measured and of what the free runs leave: flat is noise, a peak under the drive or at the "
    "resonance is something the model lacks."
)
_TOKENS = (
    "What the nominal's coefficients are multiplied by at standstill, everything settled, over the trained stroke."
)


def _error(row: dict) -> float:
    return float("inf") if row["diverged"] else row["e_rms_percent"] if row["e_rms_percent"] is not None else 0.0


def _cards(model: Model, records, predictions, scores) -> list[str]:
    outside = 100 * float(np.mean([p.outside_training_share for p in predictions]))
    moved = [p.name for p in predictions if p.begins != "rest"]
    lines = [f"{figure(outside, 2)} % of the samples lie outside the trained region."]
    lines += [f"{len(moved)} of {len(predictions)} do not begin at rest."] if moved else []
    lost = sum(p.diverged for p in predictions)
    nrmse = [row["nrmse_percent"] for row in scores.values() if row["nrmse_percent"] is not None]
    big = f"{figure(float(np.median(nrmse)), 2)} % of std" if nrmse else "–"
    memory = model.memory
    taus = np.exp(np.asarray(memory.log_tau)) if isinstance(memory, FadingMemory | RingingMemory) else ()
    told = ", ".join(f"{figure(float(t), 2)} s" for t in np.sort(taus)) or "none"
    hertz = float(memory.ring[0]) / (2 * np.pi) if isinstance(memory, RingingMemory) else None
    mass = [f"and a second mass at {figure(hertz)} Hz"] if hertz else []
    return [
        html.card("Error", big, html.bullets([*lines, *([f"{lost} diverged."] if lost else [])])),
        html.card("Model", f"order {model.order}, {figure(model.natural_frequency / (2 * np.pi))} Hz",
                  html.bullets([e.name for e in model.effects])),
        html.card("Memory", told, html.bullets(mass)),
    ]  # fmt: skip


def _run(record: Record, run: Prediction) -> Figure:
    unit = base_unit(record.displacement_unit)
    axes = beside(record.time - record.time[0], record.displacement, run.displacement, unit=unit)
    return axes[0].figure


def _map(records: Sequence[Record], errors: Sequence[float]) -> Figure:
    """A dot a record, its colour the kind of drive, its error written beside it."""
    ax: Axes = own_axes(None, 1, (5.0, 3.0))[0]
    unit = records[0].displacement_unit
    kinds = [kind(r) for r in records]
    for color, name in zip(CYCLE, dict.fromkeys(kinds), strict=False):
        for k in (k for k, other in enumerate(kinds) if other == name):
            x = records[k].displacement
            stroke = float(from_base(np.nanmax(x) - np.nanmin(x), unit, "displacement"))
            label = name if kinds.index(name) == k else f"_{name}"  # one entry in the legend
            ax.plot(loudest(records[k]), stroke, "o", ms=4, color=color, label=label)
            ax.annotate(
                figure(errors[k], 2), (loudest(records[k]), stroke), (3, 3), textcoords="offset points", fontsize=7
            )
    ax.set_xscale("log")
    finish(np.array([ax]), "strongest frequency of the drive (Hz)", [f"stroke ({shown_unit(unit)})"], 4)
    return ax.figure  # pyright: ignore[reportReturnType]


def _colour(pairs: Sequence[tuple[Record, Prediction]]) -> Figure:
    """Median densities over records of one sampling rate."""
    ax: Axes = own_axes(None, 1, (5.0, 3.0))[0]
    unit, size = pairs[0][0].displacement_unit, min(4096, *(r.samples for r, _ in pairs))
    for color, label, signal in (
        (MEASURED, "measured", lambda r, p: r.displacement - np.nanmean(r.displacement)),
        (ERROR, "left by the free runs", lambda r, p: p.displacement - r.displacement),
    ):
        rows = [
            scipy.signal.welch(from_base(np.nan_to_num(signal(r, p)), unit, "displacement"), 1 / r.dt, nperseg=size)
            for r, p in pairs
        ]
        ax.loglog(
            rows[0][0][1:], np.sqrt(np.median([row[1][1:] for row in rows], axis=0)), color=color, lw=1.1, label=label
        )
    finish(np.array([ax]), "frequency (Hz)", [f"density ({shown_unit(unit)}/√Hz)"])
    return ax.figure  # pyright: ignore[reportReturnType]


def _tokens(model: Model) -> Figure:
    """Factors of all tokens over the trained displacements."""
    ax: Axes = own_axes(None, 1, (5.0, 3.0))[0]
    low, high = model.provenance.region[0]
    x = jnp.linspace(low, high, 60)

    def settled(at):
        still = jnp.zeros(model.order, at.dtype).at[0].set(at)
        return model.tokens(jnp.concatenate([still, model.memory.initial(at)]))[0] / model.coefficients

    factors, unit = np.asarray(jax.vmap(settled)(x)), model.provenance.displacement_unit
    across = from_base(np.asarray(x, np.float64) * float(model.scales.state[0]), unit, "displacement")
    for k, color in zip(range(model.order + 1), (PREDICTED, *CYCLE[1:]), strict=False):
        ax.plot(across, factors[:, k], color=color, lw=1.2, label=f"of a{k}")
    finish(np.array([ax]), f"displacement ({shown_unit(unit)})", ["factor"], 4)
    return ax.figure  # pyright: ignore[reportReturnType]


def _table(records: Sequence[Record], scores: dict) -> str:
    header = ("recording", "begins", "error, % of range", "% of std", "rmse", "with its zero fitted, %", "outside, %")
    rows = []
    for r in records:
        s = scores[r.name]
        cells = s["e_rms_percent"], s["nrmse_percent"], s["rmse"], s["zero_fitted_e_rms_percent"]
        share = 100 * s["outside_training_share"]
        rows.append(
            ("", (r.name, s["begins"], *("diverged" if s["diverged"] else figure(c) for c in cells), figure(share, 2)))
        )
    return html.table(header, rows, {1: "left"})
