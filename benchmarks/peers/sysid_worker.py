"""Worker of `sysid`: s+ = A s + B v + W1 tanh(W2 (s, v) + b),  x = C s + W3 tanh(W4 s), full free runs from s = 0.

All records are one experiment of the library: their states side by side under shared parameters, so that one scan
does the work of thirty and every output can be weighted by its record's range.
"""

import sys
import time

import jax.numpy as jnp
import numpy as np

LATENT, WIDTH = 6, 24


def start(generator):
    """Near-integrating linear part, quiet nets."""

    def draw(*shape, scale):
        return scale * generator.standard_normal(shape)

    return [
        0.95 * np.eye(LATENT) + draw(LATENT, LATENT, scale=0.02), draw(LATENT, 4, scale=0.1),
        draw(LATENT, WIDTH, scale=0.02), draw(WIDTH, LATENT + 4, scale=0.4), np.zeros(WIDTH),
        draw(1, LATENT, scale=0.3), draw(1, WIDTH, scale=0.05), draw(WIDTH, LATENT, scale=0.4),
    ]  # fmt: skip


def step(s, v, p, np_=jnp):
    """Next states (R, LATENT) under inputs (R, 4)."""
    both = np_.concatenate([s, v], -1)
    return s @ p[0].T + v @ p[1].T + np_.tanh(both @ p[3].T + p[4]) @ p[2].T


def read(s, p, np_=jnp):
    """Outputs (R,)."""
    return (s @ p[5].T + np_.tanh(s @ p[7].T) @ p[6].T)[:, 0]


def fit(path, place, seconds):
    """Time a few epochs, then share the time between Adam and L-BFGS."""
    from jax_sysid.models import Model

    began, data = time.monotonic(), np.load(path)
    inputs, targets, weights = data["inputs"], data["targets"][:, :-1], data["weights"]
    count = len(inputs)
    U, Y = inputs.swapaxes(0, 1).reshape(inputs.shape[1], -1), targets.T
    model = Model(
        LATENT * count, count, 4 * count,
        state_fcn=lambda x, u, p: step(x.reshape(count, LATENT), u.reshape(count, 4), p).ravel(),
        output_fcn=lambda x, u, p: read(x.reshape(count, LATENT), p),
    )  # fmt: skip
    scale = jnp.asarray(weights**2 / count)
    model.loss(lambda out, y: jnp.mean(((out - y) ** 2) @ scale), rho_th=1e-7, train_x0=False)
    model.init(params=start(np.random.default_rng(0)))

    def go(adam, lbfgs):
        tick = time.monotonic()
        model.optimization(adam_eta=3e-3, adam_epochs=adam, lbfgs_epochs=lbfgs, memory=20)
        model.fit(Y.copy(), U.copy())
        np.savez(place, *[np.asarray(p) for p in model.params])
        return time.monotonic() - tick

    few = go(3, 0)
    each = max((go(23, 0) - few) / 20, 1e-4)
    left = seconds - (time.monotonic() - began) - 2 * few
    go(max(int(0.4 * left / each), 5), max(int(0.5 * left / each), 5))


def run(place, source, target):
    """Free run of one record from rest, with NumPy."""
    stored, inputs = np.load(place + ".npz"), np.load(source)["inputs"].astype(np.float64)
    p, s, x = [stored[name] for name in stored.files], np.zeros((1, LATENT)), []
    for v in inputs:
        x.append(read(s, p, np)[0])
        s = np.clip(step(s, v[None], p, np), -1000, 1000)
    np.savez(target, x=np.array([*x, read(s, p, np)[0]]))


if __name__ == "__main__":
    if sys.argv[1] == "fit":
        fit(*sys.argv[2:4], float(sys.argv[4]))
    else:
        run(*sys.argv[2:5])
