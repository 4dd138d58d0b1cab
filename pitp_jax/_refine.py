"""Rollout refinement: what the equation error cannot see, by multiple shooting.

    minimise  mean over windows of  mean_t ( (x_rollout(t) - x_measured(t)) / range_record )^2

Each window starts from the filtered state and the memory at its first sample and runs freely through the decoder that
predictions use. The error of a window is weighted by its record's range, as the metric (eq. 15) is.
"""

import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

from ._decode import step
from ._errors import ComputationFailed


def refine(model, data, records, settings, key, report):
    """Yield (best model, history entry) about ten times over the refinement steps."""
    dt = records[0].dt
    a = model.physical_coefficients
    period = 2 * np.pi / (a[0] / a[-1]) ** (1 / model.order)
    length = int(np.clip(settings.window_periods * period / dt, 64, min(r.samples for r in records) - 2))
    bank = _Windows(model, data, records, length)
    rng = np.random.default_rng(np.asarray(jax.random.key_data(key)))
    schedule = optax.cosine_onecycle_schedule(settings.refine_steps, settings.refine_rate, 0.1, 10.0, 100.0)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    spec = jax.tree.map(lambda _: False, model)
    spec = eqx.tree_at(lambda m: m.encoder, spec, jax.tree.map(eqx.is_inexact_array, model.encoder))
    params, static = eqx.partition(model, spec)
    state = optimiser.init(params)

    @eqx.filter_jit
    def update(p, s, batch):
        value, grads = eqx.filter_value_and_grad(lambda q: _window_loss(eqx.combine(q, static), batch, dt))(p)
        updates, s = optimiser.update(grads, s, p)
        return eqx.apply_updates(p, updates), s, value

    held = bank.sample(np.random.default_rng(0), 2 * settings.windows)
    score = eqx.filter_jit(lambda p: _window_loss(eqx.combine(p, static), held, dt))
    first = best = float(score(params))
    best_params, began, block = params, time.monotonic(), max(settings.refine_steps // 10, 1)
    for k in range(settings.refine_steps):
        params, state, value = update(params, state, bank.sample(rng, settings.windows))
        if (k + 1) % block == 0:
            now = float(score(params))
            if not np.isfinite(now):
                raise ComputationFailed(
                    "the rollout diverged during refinement; use fewer refinement steps or a lower rate"
                )
            if now < best:
                best, best_params = now, params
            left = (time.monotonic() - began) / (k + 1) * (settings.refine_steps - k - 1)
            report("rollouts", k + 1, settings.refine_steps, float(value), best, left)
            yield (
                eqx.combine(best_params, static),
                {"stage": "rollouts", "step": k + 1, "before": first, "rollout": best},
            )


class _Windows:
    """All places a window may start, and the arrays to cut it from."""

    def __init__(self, model, data, records, length):
        self.length, self.features = length, data.features
        self.voltage = [r.voltage.astype(np.float32) for r in records]
        self.target, self.weight = [], []
        for r in records:
            x = model.output.to_model(r.displacement) / model.scales.state[0]
            seen = np.isfinite(x)
            self.target.append(np.where(seen, x, 0.0).astype(np.float32))
            self.weight.append((seen / (np.nanmax(x) - np.nanmin(x)) ** 2).astype(np.float32))
        self.starts, self.chance = [], []
        for valid, rarity in zip(data.valid, data.rarity, strict=True):
            places = np.flatnonzero(valid)
            total = np.cumsum(np.append(0.0, rarity))  # a window is worth what it sees
            end = np.searchsorted(places, np.minimum(places + length, len(valid)))
            worth = (total[end] - total[:-1])[places + length < len(valid)]
            self.starts.append(places[places + length < len(valid)])
            self.chance.append(np.cumsum(worth) / max(worth.sum(), 1e-12))
        self.records = [k for k, s in enumerate(self.starts) if len(s)]

    def sample(self, rng, count):
        """Windows from every record equally: (start states, voltages, targets, weights)."""
        picks = rng.choice(self.records, count)
        places = [
            (k, self.starts[k][min(np.searchsorted(self.chance[k], rng.random()), len(self.starts[k]) - 1)])
            for k in picks
        ]
        cut = lambda arrays: jnp.asarray(np.stack([arrays[k][s : s + self.length] for k, s in places]))  # noqa: E731
        start = jnp.asarray(np.stack([self.features[k][s] for k, s in places]))
        return start, cut(self.voltage), cut(self.target), cut(self.weight)


def _window_loss(model, batch, dt):
    """Range-relative mean square of the free run, in units of (1 %)^2.

    A window that runs away is stopped at ten times the largest start so that its gradient stays finite; predictions
    are never clamped.
    """
    start, voltage, target, weight = batch
    far = 10 * jnp.max(jnp.abs(start), axis=0) + 1.0

    def advance(state, pair):
        following = jax.vmap(lambda s, u, v: step(model, s, u, v, dt))(state, *pair)
        return jnp.clip(following, -far, far), state[:, 0]

    pairs = (voltage.T, jnp.concatenate([voltage[:, 1:], voltage[:, -1:]], 1).T)
    x = jax.lax.scan(advance, start, pairs)[1].T
    return jnp.mean(weight * (x - target) ** 2) * 1e4
