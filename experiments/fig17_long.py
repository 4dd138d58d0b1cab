"""Fig. 17: 50 s of a 0.5 Hz sine by feedforward alone, cone with 100 g.

Claim: five times longer than any training record, the error neither drifts nor grows. Printed: the error of every
second in percent of the target's range, and whether the last second is no worse than the fifth. All of it is held out
(0.5 Hz lies below the training grid, 50 s beyond its records). In-sample there is no such record.
"""

import sys

import _paper_figures as paper_figures
import numpy as np
from _paper import PRESETS, Bench
from _show import arguments, axes_grid, finish, panel, show

import pitp_jax as pitp
from pitp_jax.application.pages.drawing import CYCLE

SECONDS, FREQUENCY = 50.0, 0.5


def main(smoke: bool = False, argv=()):
    """Track 50 s with the default and the paper preset; print the error of every second; draw both."""
    options = arguments(__doc__, argv, smoke, ("cone100",))
    for name in options.plants:
        bench = Bench(name, options)
        figure, axes = axes_grid(4, 1, (6.5, 6.0), (2, 1, 1, 1.4))
        seconds = {}
        for label, color in zip(("default", "paper"), CYCLE, strict=False):
            try:
                track = bench.play(bench.fit(PRESETS[label]).model, bench.sine(FREQUENCY, SECONDS), FREQUENCY)
            except pitp.ComputationFailed as trouble:
                print(f"{label}: {trouble}")
                continue
            seconds[label] = per_second(track)
            _report(label, track, seconds[label])
            if label == "default":
                paper_figures.tracking(track.time, track.target, track.achieved, track.voltage, axes[:3, 0])
                panel(axes[0, 0], f"{name}, {label} preset")
            clock = np.arange(len(seconds[label])) + 0.5
            axes[3, 0].plot(clock, seconds[label], marker=".", lw=0.8, color=color, label=f"{label} preset")
        paper_figures.finish(axes[3:, 0], "time (s)", ["error of each\nsecond (%)"])
        axes[3, 0].set_ylim(bottom=0)
        figure.align_ylabels(axes[:, 0])
        rows = [
            (f"second {k + 1}", None, *(s[k] for s in seconds.values()))
            for k in range(len(next(iter(seconds.values()))))
        ]
        show(f"Fig. 17, held-out, {name}", ("cell", "paper (%)", *(f"ours, {k} (%)" for k in seconds)), rows)
        finish(figure, options, f"fig17_long_{name}.png", axes[0, 0])


def per_second(track) -> np.ndarray:
    """Root mean square error of every second, in percent of the whole target's range."""
    rate = round(1 / (track.time[1] - track.time[0]))
    error = (track.achieved - track.target)[: len(track.time) // rate * rate].reshape(-1, rate)
    return 100 * np.sqrt(np.mean(error**2, axis=1)) / np.ptp(track.target)


def _report(label, track, seconds):
    """One line per preset."""
    fifth, last = seconds[min(4, len(seconds) - 1)], seconds[-1]
    verdict = "no worse" if last <= fifth else "worse"
    print(f"{label} preset, whole {track.time[-1]:.0f} s: {track.e_rms:.2f} %; ", end="")
    print(f"last second {last:.2f} % is {verdict} than the fifth {fifth:.2f} %")


if __name__ == "__main__":
    main(argv=sys.argv[1:])
