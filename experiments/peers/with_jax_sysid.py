"""Train a neural state-space model with jax-sysid (Bemporad) by the settings of its README, and print its test errors.

    x+ = A x + B u + W3 s(W1 x + W2 u + b1) + b2,    y = C x + W5 s(W4 x + b3) + b4,    s: sigmoid, 5 neurons each

1000 steps of Adam and 1000 of L-BFGS, one random start; the README leaves the number of states open: 4.

It runs in an environment of its own, because jax-sysid needs an older JAX:
    python with_jax_sysid.py TRAIN.csv.gz ... --test TEST.csv.gz ... --start SAMPLES

Errors are rms over the samples after the first `--start` ones, which give the initial state; in the file's unit.
"""

import argparse
import contextlib
import json
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax_sysid.models import Model  # pyright: ignore[reportMissingImports]
from jax_sysid.utils import standard_scale, unscale  # pyright: ignore[reportMissingImports]

STATES, NEURONS, ADAM, LBFGS, PRIOR = 4, 5, 1000, 1000, 1e-4


def sigmoid(x):
    """Return the logistic function."""
    return 1.0 / (1.0 + jnp.exp(-x))


@jax.jit
def next_state(x, u, params):
    """Return the next state of the README's example."""
    a, b, _, w1, w2, w3, b1, b2, *_ = params
    return a @ x + b @ u + w3 @ sigmoid(w1 @ x + w2 @ u + b1) + b2


@jax.jit
def output(x, u, params):
    """Return the output of the README's example."""
    c, (w4, w5, b3, b4) = params[2], params[8:]
    return c @ x + w5 @ sigmoid(w4 @ x + b3) + b4


def columns(path: str) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output of a file, shapes (T, 1)."""
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    return table[:, 1:2], table[:, 2:3]


def initial_parameters(rng: np.random.Generator) -> list[np.ndarray]:
    """Return the README's random parameters."""
    n, k = STATES, NEURONS
    state = [0.5 * np.eye(n), 0.1 * rng.standard_normal((n, 1)), 0.1 * rng.standard_normal((1, n))]
    state += [f * rng.standard_normal(s) for f, s in ((0.1, (k, n)), (0.5, (k, 1)), (0.5, (n, k)))]
    read = [0.5 * rng.standard_normal(s) for s in ((k, n), (1, k))]
    return [*state, np.zeros(k), np.zeros(n), *read, np.zeros(k), np.zeros(1)]


def main():
    """Train, simulate the test recordings, and print the errors as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("train", nargs="+")
    parser.add_argument("--test", nargs="+", required=True)
    parser.add_argument("--start", type=int, default=50)
    options = parser.parse_args()
    pairs = [columns(f) for f in options.train]
    _, mean_y, gain_y = standard_scale(np.concatenate([y for _, y in pairs]))
    _, mean_u, gain_u = standard_scale(np.concatenate([u for u, _ in pairs]))
    inputs, outputs = ([(v - m) * g for v in values] for values, m, g in (
        ([u for u, _ in pairs], mean_u, gain_u), ([y for _, y in pairs], mean_y, gain_y)))  # fmt: skip
    model = Model(STATES, 1, 1, state_fcn=next_state, output_fcn=output)
    model.init(params=initial_parameters(np.random.default_rng(0)))
    model.loss(rho_x0=PRIOR, rho_th=PRIOR)
    model.optimization(adam_epochs=ADAM, lbfgs_epochs=LBFGS)
    errors = {}
    with contextlib.redirect_stdout(sys.stderr):
        model.fit(*((outputs, inputs) if len(pairs) > 1 else (outputs[0], inputs[0])))
        for path in options.test:
            u, y = columns(path)
            us, ys = (u - mean_u) * gain_u, (y - mean_y) * gain_y
            start = model.learn_x0(us[: options.start], ys[: options.start])
            run = unscale(np.asarray(model.predict(start, us)[0]), mean_y, gain_y).ravel()
            error = (run - y.ravel())[options.start :]
            rms = float(np.sqrt(np.mean(error**2)))
            errors[Path(path).name.removesuffix(".csv.gz")] = {
                "rmse": rms, "nrmse": 100 * rms / float(y[options.start :].std()), "scored": len(error)
            }  # fmt: skip
    print(json.dumps({"errors": errors, "cpu_s": round(time.process_time(), 1)}))


if __name__ == "__main__":
    main()
