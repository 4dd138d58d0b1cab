"""Draw the figures of a diagnosis, in the units of the user's files.

`Diagnosis.as_json` and the tables of the page hold every number of the figures.
"""

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ....common.numbers import figure as digits
from ....common.numbers import percent, shown_unit
from ....common.picture import Picture, figure_of, finish, new_axes
from ....common.quantity import Quantity
from ....method.diagnose.diagnosis import Diagnosis
from ....method.diagnose.result import Ranked
from ....method.diagnose.traces import Trace
from ....method.diagnose.words import worst
from ....method.model.units import units_of
from ..drawing import DRIVE, ERROR, MEASURED, PREDICTED, beside, signals, volts

FIGURES = ("gap", "where", "shares", "force", "ranking", "next_experiment")
_SMALL = 8.0  # points: text beside bars


def figures(d: Diagnosis) -> dict[str, Picture]:
    """Draw all figures for which the diagnosis has data; return them by file name.

    A figure that cannot be drawn shows the reason instead, and does not affect the others.
    """
    makers = {"gap": gap}
    if d.verdict != "no_gap":
        makers |= {"where": where_map, "shares": shares, "force": force, "ranking": ranking}
    if d.next_experiment is not None:
        makers["next_experiment"] = excitation
    made = {}
    for name, make in makers.items():
        try:
            drawn, caption = make(d)
            drawn.draw_without_rendering()  # layout and text fail only here
        except Exception as error:
            drawn, reason = Figure(figsize=(5.0, 1.0)), " ".join(str(error).split())[:80]
            caption = f"not drawn: {type(error).__name__}: {reason}"
            drawn.text(0.02, 0.5, caption.encode("ascii", "replace").decode(), fontsize=_SMALL, parse_math=False)
        made[name] = Picture(name, drawn, caption)
    return made


def gap(d: Diagnosis) -> tuple[Figure, str]:
    """Draw measured, nominal and returned output of the worst record, with both errors below."""
    units, trace = units_of(d.model), worst(d)
    runs = [("model as given", trace.nominal, ERROR)]
    if d.handed_back:
        runs.append(("model handed back", trace.augmented, PREDICTED))
    words, measured = (units.output_word, "error"), ("measured", trace.measured)
    drawn = beside(trace.time, measured, runs, units.output.unit, words, telling(trace))
    return drawn, f"{trace.name}, the part with the largest error. Below: model minus measurement."


def telling(trace: Trace) -> slice:
    """Return the slice of about six oscillations in which the nominal model's error is largest."""
    e = np.where(np.isfinite(trace.measured), trace.nominal - trace.measured, 0.0)
    turns = np.flatnonzero(np.diff(np.signbit(trace.nominal - np.mean(trace.nominal))))
    total = len(e)
    width = max(total // 8, min(total, 64))
    peak = _loudest(e, width)
    near = np.count_nonzero((turns >= peak) & (turns < peak + width)) / 2
    # about six oscillations
    width = int(np.clip(6 * width / max(near, 1e-9), min(total, 64), total))
    first = _loudest(e, width)
    return slice(first, first + width)


def _loudest(e: np.ndarray, width: int) -> int:
    energy = np.concatenate([[0.0], np.cumsum(e**2)])
    return int(np.argmax(energy[width:] - energy[:-width]))


def where_map(d: Diagnosis) -> tuple[Figure, str]:
    """Draw the fraction of the missing force by input frequency and amplitude, one square a visited cell."""
    (ax,) = axes = new_axes(1, 3.2)
    cells, (scale, unit) = d.where["cells"], scaling(units_of(d.model).output)
    bands = sorted({(*c["band_hz"],) for c in cells})
    sizes = sorted({(*c["amplitude"],) for c in cells})
    largest = max([c["share"] for c in cells], default=0.0) or 1.0
    heat = LinearSegmentedColormap.from_list("gap", ["#f3f6f9", "#e69f00", "#c03a00"])
    for cell in cells:
        i, j = bands.index((*cell["band_hz"],)), sizes.index((*cell["amplitude"],))
        ax.add_patch(Rectangle((i, j), 1, 1, color=heat(cell["share"] / largest), lw=0))
        if cell["flagged"]:
            ax.add_patch(Rectangle((i + 0.05, j + 0.06), 0.9, 0.88, fill=False, edgecolor="#1a1a1a", lw=1.4))
        if cell["share"] >= 0.01:
            text = percent(cell["share"])
            ax.text(i + 0.5, j + 0.5, text, ha="center", va="center", fontsize=7.5, color="#1a1a1a")
    ax.set(xlim=(0, max(len(bands), 1)), ylim=(0, max(len(sizes), 1)))
    finish(axes, "frequency of the input (Hz)", [f"amplitude ({unit})"])
    ax.grid(visible=False)
    ax.set_xticks(*_edges(bands, 1.0))
    ax.set_yticks(*_edges(sizes, scale))
    return figure_of(ax), (
        "Fraction of the missing force by the input's frequency and the motion's amplitude. Outlined: above the noise."
    )


def _edges(pairs: Sequence[tuple[float, float]], scale: float) -> tuple[range, list[str]]:
    """Return places and labels of the edges of cells; where cells are missing in between, a label shows both edges."""
    lows, highs = [low for low, _ in pairs], [high for _, high in pairs]
    edges = zip([*lows[:1], *highs], [*lows, *highs[-1:]], strict=True)
    texts = ["|".join(dict.fromkeys(digits(scale * v, 2) for v in pair)) for pair in edges]
    return range(len(texts)), texts


def ranking(d: Diagnosis) -> tuple[Figure, str]:
    """Draw the fraction of the held-out gap that each effect closes, with its interval, the largest first."""
    rows = [("model handed back", d.gap)] if has_several(d) and d.gap.closed_fraction is not None else []
    best = {r.effect: r for r in reversed(d.ranking) if r.closed_fraction is not None}  # of a name its best form
    # at most 12 effects fit into the figure
    rows += [(r.effect, r) for r in by_closed_fraction([*best.values()])][: 12 - len(rows)]
    (ax,) = axes = new_axes(1, 0.7 + 0.24 * max(len(rows), 2))
    for k, (name, r) in enumerate(rows):
        color, tied = MEASURED, ""
        if name in d.equivalent:
            color, tied = "#e69f00", " (tied)"
        if name in d.effects or r is d.gap:
            color = PREDICTED
        ax.barh(k, np.clip(r.closed_fraction or 0.0, 0, 1), color=color, height=0.68)
        if r.ci95 is not None:
            ax.plot(np.clip(r.ci95, 0, 1), [k, k], color="#000000", lw=1.0, marker="|", ms=5)
        ax.text(1.03, k, fraction_closed(r.closed_fraction) + tied, va="center", fontsize=_SMALL)
    if not rows:
        ax.text(0.5, 0.5, "no gap to close", ha="center", va="center", fontsize=_SMALL + 1)
    finish(axes, "fraction of the gap closed", [""])
    ax.set_yticks(range(len(rows)), [name for name, _ in rows])
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    ax.set(xlim=(0, 1.02), ylim=(max(len(rows), 1) - 0.4, -0.6))
    ax.grid(visible=False, axis="y")
    return figure_of(ax), (
        "Fraction of the gap that each effect closes by itself, with its 95 % interval, the largest first. At 100 % "
        "only the model's own error remains. Blue: reported; orange: tied."
    )


def by_closed_fraction(ranking: Sequence[Ranked]) -> list[Ranked]:
    """Return the candidates by the fraction of the gap that they close, the largest first; unknown ones follow."""
    return sorted(ranking, key=lambda r: np.inf if r.closed_fraction is None else -r.closed_fraction)


def fraction_closed(value: float | None) -> str:
    """Return a closed fraction as text."""
    return "nothing" if value is None or value < 0.005 else percent(value)


def shares(d: Diagnosis) -> tuple[Figure, str]:
    """Draw the fractions of the error by its frequency and by part of a recording."""
    panels = [
        ("frequency", "band_hz", 1.0, "frequency of the error (Hz)"),
        ("time", "part", 100.0, "part of a recording (%)"),
    ]
    return _bars(d, panels, ERROR), "Fraction of the model's error by its frequency and by part of a recording."


def force(d: Diagnosis) -> tuple[Figure, str]:
    """Draw the fractions of the missing force by output, velocity and input."""
    units = units_of(d.model)
    scale, unit = scaling(units.output)
    factor, command = scaling(units.input)
    panels = [
        ("displacement", "range", scale, f"{units.output_word} ({unit})"),
        ("velocity", "range", scale, f"{units.velocity_word} ({shown_unit(units.output.rate)})"),
        ("voltage", "range", factor, f"{units.input_word} ({command})"),
    ]
    return _bars(d, panels, DRIVE), (
        "Fraction of the missing force (the equation's residual along the measured motion) by "
        f"{units.output_word}, {units.velocity_word} and {units.input_word}."
    )


def _bars(d: Diagnosis, panels: Sequence[tuple[str, str, float, str]], color: str) -> Figure:
    """Draw the fractions along some axes of `Diagnosis.where` as bars, with the edges of the bins under them."""
    drawn = Figure(figsize=(5.0, 0.3 + 1.45 * len(panels)), layout="constrained")
    for ax, (name, key, scale, label) in zip(drawn.subplots(len(panels), 1), panels, strict=True):
        rows = d.where[name]
        edges = scale * np.array([*(row[key][0] for row in rows), *(row[key][1] for row in rows[-1:])])
        ax.bar(range(len(rows)), [100 * row["share"] for row in rows], color=color, width=0.75)
        finish(np.array([ax]), label, ["fraction (%)"])
        step = float(np.ptp(edges)) / max(len(rows), 1) if rows else 0.0
        # rounding residues of 0 are 0; every second label if they would touch
        texts = [digits(0.0 if abs(edge) < 0.02 * step else edge, 2) for edge in edges]
        texts = [text if k % 2 == 0 or sum(map(len, texts)) < 26 else "" for k, text in enumerate(texts)]
        ax.set_xticks(np.arange(len(edges)) - 0.5, texts, fontsize=7.5)
        ax.grid(visible=False, axis="x")
    return drawn


def excitation(d: Diagnosis) -> tuple[Figure, str]:
    """Draw the voltage (V or kV) of the proposed next experiment over time (s)."""
    e = d.next_experiment
    assert e is not None  # otherwise this figure is not asked for
    voltage, label = volts(e.voltage, d.model.origin.voltage_unit)
    return signals(e.time, [(label, voltage, DRIVE)]), f"To play: {e.excitation}."


def scaling(quantity: Quantity) -> tuple[float, str]:
    """Return the factor from the base unit of a quantity to its shown unit, and the displayed name of this unit."""
    return 1 / quantity.factor, shown_unit(quantity.unit)


def has_several(d: Diagnosis) -> bool:
    """Return whether the model handed back has several parts beside changed coefficients."""
    return len({*d.handed_back} - {"parameters"}) > 1
