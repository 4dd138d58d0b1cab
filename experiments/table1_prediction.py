"""Table I, Figs. 8-10: free runs of the trained model, in-sample cells of the paper and held-out records apart.

Claim: from the voltage alone the model predicts every actuator over its whole band, at several amplitudes, hysteresis
included. Every cell of Table I lies on the training grid; the held-out records are ours.
"""

import sys

import _paper_figures as paper_figures
import numpy as np
from _paper import ACTUATORS, TABLE_1, Bench, errors
from _show import arguments, axes_grid, finish, overlay, panel, show

import pitp_jax as pitp

FIG_8 = {"roll": (20, 130), "cone": (2, 10)}  # Hz
FIG_9_HZ, FIG_10_HZ = {"roll": 100, "cone": 8}, {"roll": (10, 50, 100), "cone": (1, 4, 8)}


def main(smoke: bool = False, argv=()):
    """Fit every actuator; print Table I and the held-out records; draw Figs. 8, 9 and 10."""
    options = arguments(__doc__, argv, smoke, ACTUATORS)
    figure, axes = axes_grid(6, len(options.plants), (3.0 * len(options.plants), 9.5), (2, 1, 2, 1, 2, 3))
    header = ("cell", "paper (%)", "ours (%)", "linear model (%)", "sensor noise (%)")
    for column, name in zip(axes.T, options.plants, strict=True):
        bench = Bench(name, options)
        fit = bench.fit()
        linear = bench.identify().model
        ours, plain = (errors(m, (*bench.train, *bench.test)) for m in (fit.model, linear))
        records = [bench.grid(f) for f in TABLE_1[name]]
        cells = [
            (f"{name}, {f} Hz", paper, ours[r.name], plain[r.name], _floor(bench, r))
            for (f, paper), r in zip(TABLE_1[name].items(), records, strict=True)
        ]
        show(f"Table I, in-sample, {name} ({fit.seconds:.0f} s of training)", header, cells)
        for title, part in (("all training sines, in-sample", bench.train), ("held-out", bench.test)):
            rows = [(r.name, None, ours[r.name], plain[r.name], _floor(bench, r)) for r in part]
            summary = [(how.__name__, None, *(float(how([x[k] for x in rows])) for k in (2, 3, 4))) for how in _HOWS]
            show(f"{name}, {title}", header, summary + (rows if part is bench.test else []))
        _draw(column, bench, fit.model)
    figure.align_ylabels(axes[:, 0])
    finish(figure, options, "table1_prediction.png", axes[0, 0])


_HOWS = (np.median, np.max)


def _floor(bench, record) -> float:
    """e_rms (%) that the sensor's noise alone leaves."""
    return 100.0 * bench.actuator.noise_std / float(np.ptp(record.displacement))


def _last(record, frequency: float, periods: int) -> slice:
    """The last periods of a record."""
    return slice(max(0, record.samples - round(periods / (frequency * record.dt))), None)


def _draw(column, bench, model):
    """Fig. 8 at two frequencies, Fig. 9 at three amplitudes, Fig. 10 at three frequencies, in one column of axes."""
    for k, f in enumerate(FIG_8[bench.kind]):
        record = bench.grid(f)
        run, part = pitp.predict(model, [record])[0].displacement, _last(record, f, 4)
        paper_figures.prediction(record.time[part], record.displacement[part], run[part], column[2 * k : 2 * k + 2])
        panel(column[2 * k], f"{bench.name}, {f} Hz")
    f = FIG_9_HZ[bench.kind]
    records = [r for r in bench.train if r.name.startswith(f"sine_{f:03d}Hz")]
    for record, run in zip(records, pitp.predict(model, records), strict=True):
        part = _last(record, f, 3)
        clock = record.time[part] - record.time[part][0]
        overlay(column[4], clock, record.displacement[part], run.displacement[part])
    paper_figures.finish(column[4:5], "time (s)", ["displacement (mm)"])
    panel(column[4], f"{bench.name}, {f} Hz, {len(records)} amplitudes")
    for f in FIG_10_HZ[bench.kind]:
        record = bench.grid(f)
        run, part = pitp.predict(model, [record])[0].displacement, _last(record, f, 1)
        signals = record.voltage[part], record.displacement[part], run[part]
        paper_figures.hysteresis_loops(*signals, column[5], label=f"{f} Hz")
    solid = [loop for loop in column[5].lines if loop.get_label().endswith("Hz")]
    style = {"loc": "lower left", "bbox_to_anchor": (0, 1), "frameon": False, "fontsize": 8}
    column[5].legend(handles=solid, ncols=len(solid), handlelength=1, columnspacing=1, borderpad=0, **style)


if __name__ == "__main__":
    main(argv=sys.argv[1:])
