"""Does any bounded voltage make a fitted model run away? 1,000 random excitations and 20 found by gradient ascent.

    random:   noise held for 1 to 300 samples, square waves, multisines, all within the training range of u
    ascent:   maximise the mean of |x|^4 over the voltage (Adam, projected on the range), from random starts

    python experiments/worst_case.py [MODEL ...] [--random 1000] [--ascent 20] [--smoke]

A run counts as diverged when it is not finite or leaves 100 times the trained range; no state is ever clamped.
Without a model file a virtual cone is fitted first. The largest response, in trained ranges (peak to peak), says how
far from trouble it stays.
"""

import argparse
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

import pitp_jax as pitp
from pitp_jax.application.demo.protocol import excitations, measure, run
from pitp_jax.method.simulate.decoder import rollout, rollout_batch


def random_voltages(rng, count: int, samples: int, low: float, high: float) -> np.ndarray:
    """Bounded excitations, shape (count, samples): held noise, square waves, multisines clipped to the range."""
    rows, t = [], np.arange(samples)
    for k in range(count):
        if k % 3 == 0:
            hold = int(np.exp(rng.uniform(0, np.log(300))))
            row = np.repeat(rng.uniform(low, high, samples // hold + 1), hold)[:samples]
        elif k % 3 == 1:
            period = np.exp(rng.uniform(np.log(4), np.log(samples / 2)))
            row = np.where(np.sin(2 * np.pi * t / period + rng.uniform(0, 7)) > rng.uniform(-0.8, 0.8), high, low)
        else:
            waves = np.exp(rng.uniform(np.log(4), np.log(samples / 2), 5))
            row = sum(np.sin(2 * np.pi * t / w + rng.uniform(0, 7)) for w in waves) / 3
            row = np.clip((low + high) / 2 + (high - low) / 2 * row, low, high)
        rows.append(row)
    return np.stack(rows)


def ascend(model, voltage: np.ndarray, dt: float, steps: int, low: float, high: float) -> np.ndarray:
    """Voltages moved uphill in mean |x|^4, each row on its own."""
    start = pitp.rest_state(model)

    def loudness(u):
        return jnp.log(jnp.mean(rollout(model, u, dt, start)[:, 0] ** 4) + 1e-12)

    optimiser = optax.adam(0.05 * (high - low))

    @eqx.filter_jit
    def climb(u):
        def move(carry, _):
            u, state = carry
            grads = jax.vmap(jax.grad(loudness))(u)
            updates, state = optimiser.update(jax.tree.map(jnp.negative, jnp.nan_to_num(grads)), state)
            return (jnp.clip(u + updates, low, high), state), None

        return jax.lax.scan(move, (u, optimiser.init(u)), None, length=steps)[0][0]

    return np.asarray(climb(jnp.asarray(voltage, jnp.float32)))


def worst(model, voltage: np.ndarray, dt: float, span: float) -> tuple[int, float]:
    """How many runs diverge, and the largest |x| in trained ranges."""
    start = jnp.tile(pitp.rest_state(model), (len(voltage), 1))
    states = rollout_batch(model, jnp.asarray(voltage, jnp.float32), dt, start)
    x = np.abs(np.asarray(states[..., 0])) / span
    bad = ~np.isfinite(np.asarray(states)).all((1, 2)) | (np.nan_to_num(x, nan=np.inf).max(1) > 100)
    return int(bad.sum()), float(np.nan_to_num(x, nan=np.inf).max())


def check(name: str, model, randoms: int, ascents: int, samples: int, steps: int) -> dict:
    """Print and return one model's figures."""
    dt, (low, high) = model.dt, model.domain.voltage_range
    low = max(low, 0.0) if model.input_map.infeasible(jnp.asarray(-1.0)) else low
    first = model.domain.region[0] if len(model.domain.region) else (0.0, 1.0)
    span = first[1] - first[0]
    rng = np.random.default_rng(0)
    some = worst(model, random_voltages(rng, randoms, samples, low, high), dt, span)
    climbed = worst(
        model, ascend(model, random_voltages(rng, ascents, samples, low, high), dt, steps, low, high), dt, span
    )
    print(f"{name:24s} random {some[0]}/{randoms} diverged, at most {some[1]:.2f} ranges; "
          f"ascent {climbed[0]}/{ascents}, at most {climbed[1]:.2f}")  # fmt: skip
    return {"random": some, "ascent": climbed}


def main(smoke: bool = False, argv=None):
    """Check the models on the command line, or a freshly fitted virtual cone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("models", nargs="*", type=Path)
    parser.add_argument("--random", type=int, default=1000)
    parser.add_argument("--ascent", type=int, default=20)
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args([] if smoke else argv)
    smoke = smoke or options.smoke
    models = {p.name: pitp.load(p) for p in options.models} or {"virtual cone100": virtual(smoke)}
    for name, model in models.items():
        count = (60, 4, 600, 10) if smoke else (options.random, options.ascent, 4000, 60)
        check(name, model, *count)


def virtual(smoke: bool):
    """A quick model of the built-in cone, in smoke a linear one."""
    if smoke:
        return pitp.identify(list(measure(pitp.plant("cone100"), excitations("cone100", "sweep", True)))).model
    return run("cone100", quick=True).training.model


if __name__ == "__main__":
    main()
