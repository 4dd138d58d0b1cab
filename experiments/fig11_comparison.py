"""Fig. 11: other models on the same records, roll at 110 Hz.

Claim: existing wide-band models fail at high frequency, the token model does not. The paper compares with two models
of other authors; here stand, fitted to the same records, the identified linear model, the paper's own preset, and
the default preset with one part taken away or exchanged. The trajectory at 110 Hz is in-sample, as in the paper.
"""

import sys
from dataclasses import replace

import _paper_figures as paper_figures
import numpy as np
from _paper import PRESETS, Bench, errors
from _show import arguments, axes_grid, finish, overlay, panel, show

import pitp_jax as pitp
from pitp_jax.application.pages.drawing import ERROR

FREQUENCY = {"roll": 110.0, "cone": 8.0}  # Hz
DEFAULT = PRESETS["default"]
VARIANTS = {
    "default preset": DEFAULT,
    "paper preset": PRESETS["paper"],
    "default, raw time for memory": replace(DEFAULT, memory="elapsed"),
    "default, no memory": replace(DEFAULT, memory="none"),
    "default, no offset token": replace(DEFAULT, offset=False),
    "default, equation error only": replace(DEFAULT, refine_steps=0),
}


def main(smoke: bool = False, argv=()):
    """Fit every variant; print its errors; draw the trajectories."""
    options = arguments(__doc__, argv, smoke, ("roll",))
    for name in options.plants:
        bench = Bench(name, options)
        frequency = FREQUENCY[bench.kind]
        record = bench.grid(frequency)
        fits = {"identified linear model": (bench.identify().model, None)}
        for label, settings in VARIANTS.items():
            try:
                found = bench.fit(settings)
                fits[label] = found.model, found.seconds
            except pitp.ComputationFailed as trouble:
                print(f"{label}: {trouble}")
        in_sample, held_out = [], []
        for label, (model, seconds) in fits.items():
            inside, outside = errors(model, bench.train), errors(model, bench.test)
            values = np.array(list(inside.values()))
            in_sample.append((label, None, inside[record.name], float(np.median(values)), float(values.max()), seconds))
            values = np.array(list(outside.values()))
            held_out.append((label, None, float(np.median(values)), float(values.max()), *outside.values()))
        columns = ("cell", "paper (%)", f"ours, {frequency:g} Hz (%)", "all sines, median (%)", "worst (%)", "fit (s)")
        show(f"Fig. 11, in-sample, {name}", columns, in_sample)
        columns = ("cell", "paper (%)", "ours, median (%)", "worst (%)", *outside)
        show(f"held-out, {name}", columns, held_out)
        titles = [f"{label}: e_rms {here:.2f} %" for label, _, here, *_ in in_sample]
        _draw(options, name, record, frequency, dict(zip(titles, (m for m, _ in fits.values()), strict=True)))


def _draw(options, name, record, frequency, models):
    """The last periods of the trajectory and what is left of them, a row per model (title: model)."""
    figure, axes = axes_grid(len(models), 2, (9.0, 0.3 + 1.2 * len(models)))
    part = slice(max(0, record.samples - round(5 / (frequency * record.dt))), None)
    low, high = 1e3 * record.displacement[part].min(), 1e3 * record.displacement[part].max()
    time, errors_um = record.time[part], []
    for ax, model in zip(axes[:, 0], models.values(), strict=True):
        run = pitp.predict(model, [record])[0].displacement[part]
        overlay(ax, time, record.displacement[part], run)
        ax.set_ylim(low - 0.3 * (high - low), high + 0.3 * (high - low))
        errors_um.append(1e6 * (run - record.displacement[part]))
    for ax, error in zip(axes[:, 1], errors_um, strict=True):
        ax.plot(time, error, color=ERROR, lw=0.8)
        ax.set_ylim(-1.05 * np.abs(errors_um).max(), 1.05 * np.abs(errors_um).max())
    for column, label in ((0, "x (mm)"), (1, "error (µm)")):
        paper_figures.finish(axes[:, column], "time (s)", [label] * len(models))
    for ax, title in zip(axes[:, 0], models, strict=True):
        panel(ax, title)
    finish(figure, options, f"fig11_comparison_{name}.png", axes[0, 0])


if __name__ == "__main__":
    main(argv=sys.argv[1:])
