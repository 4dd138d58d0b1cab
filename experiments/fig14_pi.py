"""Fig. 14: a PI controller on top of the feedforward, cone with 100 g.

Claim: PI (P = 0.1, I = 0.3, here kV per mm and kV per mm and second) takes off the offset that the feedforward leaves.
The paper blames that offset on a drift of the actuator, so the loop is closed around the plant of the training records
and around one whose membrane has become 3 % softer; the mean error is taken over the last second.
"""

import sys
from dataclasses import replace

import _paper_figures as paper_figures
import jax
import jax.numpy as jnp
import numpy as np
from _paper import TABLE_2, Bench
from _show import arguments, axes_grid, finish, panel, show

import pitp_jax as pitp

SECONDS = {"roll": 2.0, "cone": 20.0}
SOFTER = 0.97
HELD_OUT = {"roll": 48.0, "cone": 5.5}  # Hz


def main(smoke: bool = False, argv=()):
    """Close the loop at every frequency of Table II; print errors with and without PI; draw one of them."""
    options = arguments(__doc__, argv, smoke, ("cone100",))
    for name in options.plants:
        bench = Bench(name, options)
        model = bench.fit().model
        drifted = replace(bench.actuator, spring=SOFTER * bench.actuator.spring)
        plants = {"same plant": bench.actuator, "3 % softer": drifted}
        rows, drawn = [], None
        for f in (*TABLE_2[name], HELD_OUT[bench.kind]):
            track = bench.play(model, bench.sine(f, SECONDS[bench.kind]), f)
            for label, actuator in plants.items():
                pair = [closed_loop(actuator, track, on) for on in (False, True)]
                rows.append((f"{name}, {f:g} Hz, {label}", None, *(v for x, _ in pair for v in scores(track, x))))
            drawn = drawn or (track, pair)
        header = ("cell", "paper", "ours: e_rms alone (%)", "mean (%)", "e_rms with PI (%)", "mean (%)")
        count = len(plants)
        show("Fig. 14, frequencies in-sample, in percent of the target's range", header, rows[:-count])
        show("frequency held-out", header, rows[-count:])
        _draw(options, name, *drawn)


def closed_loop(actuator, track, on: bool):
    """Displacement (m) and voltage (V) on a plant under the track's feedforward, PI on or off."""
    gains = {} if on else {"p": 0.0, "i": 0.0}
    with jax.enable_x64(True):
        step, state = pitp.stepper(actuator)
        signals = jnp.asarray(track.voltage, jnp.float64), jnp.asarray(track.target, jnp.float64)
        limits = (0.0, actuator.max_voltage)
        x, u = _loop(step, state, *signals, 1 / actuator.rate_hz, limits, gains)
    return np.asarray(x), np.asarray(u)


def _loop(step, state, voltage, target, dt, limits, gains):
    return jax.jit(lambda v, w: pitp.pi_trim(step, state, v, w, dt, limits=limits, **gains))(voltage, target)


def scores(track, x):
    """e_rms over all, and the mean error over the last second, in percent of the target's range."""
    last = track.time >= track.time[-1] - min(1.0, track.time[-1] / 2)
    return pitp.e_rms_percent(x, track.target), float(100 * np.mean((x - track.target)[last]) / np.ptp(track.target))


def _draw(options, name, track, pair):
    """The drifted plant at the first frequency, without and with PI."""
    figure, axes = axes_grid(3, 2, (8.0, 4.2), (2, 1, 1.2))
    for column, (x, u), label in zip(axes.T, pair, ("feedforward alone", "with PI"), strict=True):
        paper_figures.tracking(track.time, track.target, x, u, column)
        panel(column[0], f"{name}, 3 % softer, {track.frequency:g} Hz: {label}")
    for row in axes:
        row[0].sharey(row[1])
    figure.align_ylabels(axes[:, 0])
    finish(figure, options, f"fig14_pi_{name}.png", axes[0, 0])


if __name__ == "__main__":
    main(argv=sys.argv[1:])
