"""Determine a record's initial state, sensor offset and sensor direction with a model, from its first samples.

    rest     x(0) = 0, uncharged                         offset: the level of the first samples
    held     tokens(x) x + offset = F(u(0)), memories settled there       offset: mean of y - d x
    moving   state estimated from at most 50 samples     offset and direction: the model's

A still record (`initial_state`) is at rest or settled, whichever simulation has the smaller residual before the input
moves, or in the first 50 samples. If neither fits, the record is at a turning point and starts in motion. The direction
is the one with the smaller residual once the motion exceeds the noise. The direction opposite to the model's is taken
only if it explains that motion with at most a fifth of the model's residual, because a delay of half a period also
inverts a motion.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._model.model import Model
from .._model.programs import jit, on_device
from .._record.initial_state import (
    INITIAL_SAMPLES,
    Beginning,
    Begins,
    beginning_of,
    first_states,
    is_still,
    noise_std,
    rest_level,
    settled_samples,
    standing_drive,
    starts_at_rest,
)
from .._record.record import Record
from . import ports
from .decoder import rest_state, rollout_batch, step, still_state

_AHEAD = 2048  # samples from which initial state and direction are determined
_GRID, _ROUNDS, _FAR = 64, 4, 10.0  # grid points, refinements and range (scaled displacement) of an equilibrium search
_PLAIN = 20.0  # noise floors that a motion must exceed to show a direction
_HALF = 0.5  # of the residual at rest: below it a record that starts at the 0 V offset started under a held voltage
_EXPLAINED = 0.2  # fraction of the first samples' motion that a model may miss and still explain the initial state


@jit
def held_states(
    model: Model, voltage: Float[Array, " records"], dt: float, age: Float[Array, " records"]
) -> Float[Array, "records state"]:
    """Solve for the states in equilibrium at these voltages; nan if none lies within ten scaled displacements.

    At an equilibrium, one decoder step from (x, 0, ...) does not change x^(n-1), and the sign of the change reverses
    there.
    """

    def one(volts, age):
        stages = jnp.full((2 * model.substeps + 1,), volts)

        def state(x):
            return still_state(model, x, volts, age)

        def change(x):
            return (step(model, state(x), stages, dt) - state(x))[model.order - 1]

        low, high = jnp.asarray(-_FAR, voltage.dtype), jnp.asarray(_FAR, voltage.dtype)
        exists = jnp.asarray(True)
        # Nested grids instead of Newton: a snapping film has several equilibria, and the one nearest to 0 is found.
        for _ in range(_ROUNDS):
            grid = jnp.linspace(low, high, _GRID)
            up = jax.vmap(change)(grid) > 0
            turns = up[:-1] & ~up[1:]  # accelerated up below it and down above it: stable
            place = jnp.argmin(jnp.where(turns, jnp.abs(grid[:-1]), jnp.inf))
            exists = exists & turns.any()
            low, high = grid[place], grid[place + 1]
        return jnp.where(exists, state((low + high) / 2), jnp.nan)

    return jax.vmap(one)(voltage, age)


@jit
def _first_runs(model: Model, voltage: Float[Array, "records time"], dt: float, age: Float[Array, " records"]):
    """Simulate every record from rest and from the equilibrium at u(0); return (states, readings) of both."""
    starts = jax.vmap(lambda a: rest_state(model, a))(age), held_states(model, voltage[:, 0], dt, age)
    return [(s, jax.vmap(lambda r: ports.readings(model, r))(rollout_batch(model, voltage, dt, s))) for s in starts]


def beginnings(
    model: Model, records: Sequence[Record], ages: Sequence[float]
) -> tuple[list[Beginning], list[Float[np.ndarray, " state"] | None]]:
    """Return how each record starts, and its initial state if it starts at rest or in equilibrium."""
    dtype, size = model.coefficients.dtype, min(_AHEAD, max(r.samples for r in records))
    records = [beginning_of(r, _AHEAD, _span(model, r)) for r in records]
    # Nothing changes while input and reading are constant, so a run from the end of that stretch equals the whole run.
    settled = [settled_samples(r, model.natural_frequency) for r in records]
    first = [
        max(count - INITIAL_SAMPLES, 0) if count < r.samples else 0 for count, r in zip(settled, records, strict=True)
    ]
    ends = [r.voltage[k : k + size] for r, k in zip(records, first, strict=True)]
    voltage = np.stack([np.pad(v, (0, size - len(v)), mode="edge") for v in ends])
    kinds: tuple[Begins, ...] = ("rest", "held")
    runs = _first_runs(model, on_device(voltage, dtype), records[0].dt, on_device(ages, dtype))
    states = {kind: np.asarray(state) for kind, (state, _) in zip(kinds, runs, strict=True)}
    x = [np.asarray(run, np.float64) * model.scales.state[0] for _, run in runs]
    begun = [
        _beginning(model, r, dict(zip(kinds, rows, strict=True)), k, stands > 0)
        for r, k, stands, *rows in zip(records, first, settled, *x, strict=True)
    ]
    return begun, [None if b.begins == "moving" else states[b.begins][k] for k, b in enumerate(begun)]


def _span(model: Model, record: Record) -> float:
    """Return the voltage range of the model's training records, V; if unknown, the range of this record."""
    low, high = model.domain.voltage_range
    return high - low if np.isfinite(high - low) and high > low else float(np.ptp(record.voltage))


def _beginning(model: Model, record: Record, runs: dict[Begins, np.ndarray], begin: int, settled: bool) -> Beginning:
    """Choose the initial state whose simulation fits the first samples best, with sensor offset and direction.

    Args:
        model: used for the runs.
        record: in base units.
        runs: displacement from rest and from a settled start, m, shapes (time,), from sample `begin` on.
        begin: first sample of the runs; nothing moves before it.
        settled: whether the data show an initially still record, which a misfit of the model cannot make a moving one.
    """
    zero, polarity = float(model.output.offset), float(model.output.polarity)
    y, omega = record.displacement[begin : begin + _AHEAD], model.natural_frequency
    noise, span = noise_std(record.displacement), record.span
    if not (settled or is_still(record, omega)):
        return Beginning("moving", polarity, zero, float("inf"))
    moved = np.abs(record.voltage[begin : begin + _AHEAD] - record.voltage[0]) > 1e-3 * np.ptp(record.voltage)
    first = max(int(np.argmax(moved)) if moved.any() else len(y), min(INITIAL_SAMPLES, len(y)))
    # the median of a few samples, so that one outlier is not a level; 2 % of the range, so that hum is not a motion
    plain = np.abs(y - np.nanmedian(y[:8])) > max(_PLAIN * noise, 0.02 * span)
    seen = min(max(int(np.argmax(plain)) + INITIAL_SAMPLES if plain.any() else len(y), first), len(y))

    def unexplained(begins: Begins, direction: float) -> float:
        error = y[:seen] - direction * runs[begins][:seen]
        # the deviation, because the record's own offset is not known yet
        return float(np.nanstd(error)) if np.isfinite(runs[begins][:seen]).all() else np.inf

    driven = standing_drive(record)[1] != 0
    kinds: tuple[Begins, ...] = ("rest", "held") if driven else ("rest",)  # held at 0 V is rest
    if settled and driven and np.isfinite(runs["held"]).all():
        kinds = ("held",)  # from rest it would move
    scores = {(b, d): unexplained(b, d) for b in kinds for d in (polarity, -polarity)}
    begins, direction = min((k for k in scores if k[1] == polarity), key=lambda k: scores[k])
    turned = min((k for k in scores if k[1] != polarity), key=lambda k: scores[k])
    explained = scores[turned] < _EXPLAINED * min(float(np.nanstd(y[:seen])), scores[begins, direction])
    if plain.any() and explained:
        begins, direction = turned
    at_zero = starts_at_rest(record, zero, omega)
    if at_zero and not settled and begins == "held" and scores["held", direction] > _HALF * scores["rest", direction]:
        begins = "rest"
    enough = max(3 * noise, 0.002 * span, _EXPLAINED * float(np.nanstd(y[:seen])))
    if not (at_zero or settled) and scores[begins, direction] > enough:
        return Beginning("moving", polarity, zero, float("inf"))
    if begins == "rest":
        level, stderr = rest_level(record)
        return Beginning("rest", direction, zero if at_zero else level, 1.5 * stderr)
    before = record.displacement[:begin] - direction * runs["held"][0]
    error = np.concatenate([before, y[:first] - direction * runs["held"][:first]])
    known = int(np.isfinite(error).sum())
    return Beginning("held", direction, float(np.nanmean(error)), float(np.nanstd(error)) / np.sqrt(max(known, 1)))


def with_zero_at_rest(records: Sequence[Record], begun: Sequence[Beginning]) -> list[Beginning]:
    """Give records that start at a held voltage the sensor offset of records at rest, if it is plausible.

    x(0) = d (y(0) - zero)        beside the model's own equilibrium of u(0), within a factor of two

    Otherwise a held record would only repeat the model's static curve, because the model's equilibrium gave the offset.
    A sensor that was zeroed under the held input reads no displacement there, which exceeds the factor of two.
    """
    known = sorted((b.zero, b.stderr) for b in begun if b.begins == "rest")
    if not known:
        return [replace(b, free=True) for b in begun]
    zero, stderr = known[len(known) // 2]
    zeroed = []
    for record, b in zip(records, begun, strict=True):
        level = first_level(record)
        same = b.begins == "held" and 0.5 < (level - zero) / ((level - b.zero) or np.inf) < 2.0
        zeroed.append(replace(b, zero=zero, stderr=stderr) if same else replace(b, free=b.begins != "rest"))
    return zeroed


def first_level(record: Record) -> float:
    """Return the first reading y(0), estimated in the window with the smallest standard error."""
    values, errors = first_states(record)
    return float(values[np.argmin(errors[:, 0]), 0])
