"""Fig. 18: complex trajectories by feedforward alone, cone with 100 g and roll.

Claim: trained on sines alone, the feedforward tracks waveforms, frequencies and ranges it has never seen. Everything
here is held out: a curve of changing range and speed, a triangle with rounded corners, and smooth steps.
"""

import sys

import _paper_figures as paper_figures
import numpy as np
from _paper import Bench
from _show import arguments, axes_grid, finish, panel, show
from scipy.ndimage import gaussian_filter1d

from pitp_jax import excitation

BAND = {"roll": (20.0, 1.0), "cone": (1.5, 10.0)}  # slowest frequency (Hz) and length (s)


def main(smoke: bool = False, argv=()):
    """Track three shapes on every actuator; print e_rms; draw them."""
    options = arguments(__doc__, argv, smoke, ("cone100", "roll"))
    figure, axes = axes_grid(6, len(options.plants), (4.2 * len(options.plants), 9.0), (2, 1) * 3)
    rows = []
    for column, name in zip(axes.T, options.plants, strict=True):
        bench = Bench(name, options)
        model = bench.fit().model
        for k, (shape, target) in enumerate(targets(bench).items()):
            track = bench.play(model, target)
            rows.append((f"{name}, {shape}", None, track.e_rms, track.self_check))
            pair = column[2 * k : 2 * k + 2]
            paper_figures.prediction(track.time, track.target, track.achieved, pair)
            panel(pair[0], f"{name}, {shape}")
    figure.align_ylabels(axes[:, 0])
    show("Fig. 18, held-out", ("cell", "paper (%)", "ours (%)", "model's own check (%)"), rows)
    finish(figure, options, "fig18_complex.png", axes[0, 0], ("target", "achieved"))


def targets(bench):
    """Three shapes from rest, (time, displacement in m) each."""
    frequency, seconds = BAND[bench.kind]
    seconds = seconds / 5 if bench.options.smoke else seconds
    rate, rise = bench.actuator.rate_hz, bench.scale.rise_s / (5 if bench.options.smoke else 1)
    swing, mean = bench.swing(2 * frequency)
    shape = (seconds, rate, swing, mean)
    clock, corners = excitation.triangle(frequency, *shape, rise=rise)
    hold = seconds / 5
    levels = mean + swing * np.array([-0.6, 0.3, 0.9, -0.2, 0.5])
    return {
        "complex": excitation.complex_trajectory(frequency, *shape, seed=18, rise=rise),
        "triangle": (clock, gaussian_filter1d(corners, 0.03 * rate / frequency)),
        "steps": excitation.steps(levels, hold, rate, rise=min(1.0 / frequency, hold / 2)),
    }


if __name__ == "__main__":
    main(argv=sys.argv[1:])
