"""Estimate how records start, with sensor offset and direction, beside the simulations of a model.

    rest     x(0) = 0, uncharged
    held     tokens(x) x + offset = F(u(0)), memories settled there
    moving   the state is estimated from the first samples (`moving_start`)

`method.signal.start` decides with the simulations from these three states.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..model.model import Model
from ..signal.initial_state import Beginning, aligned
from ..signal.record import Record
from ..signal.start import Response, estimate_start, first_part
from .model_runs import Models, evaluate, model_runs, models_of, padded, runs_of, sample
from .moving_start import moving_states, still

_GRID, _ROUNDS, _FAR = 64, 4, 10.0  # grid points, refinements and range (scaled displacement) of an equilibrium search


def settled_states(
    model: Model | Models, volts: Float[np.ndarray, " records"], dt: float, ages: Float[np.ndarray, " records"]
) -> Float[np.ndarray, "records state"]:
    """Solve for the states in equilibrium at these voltages; nan if none lies within ten scaled displacements.

    At an equilibrium, one decoder step from (x, 0, ...) does not change x^(n-1), and the sign of the change reverses
    there.
    """
    models, low, high = models_of(model), np.full(len(volts), -_FAR), np.full(len(volts), _FAR)
    exists, first = np.full(len(volts), True), models[0]
    runs = np.repeat(np.arange(len(volts)), _GRID)
    many, by_grid = (volts[runs], ages[runs]), models.of_runs(runs)
    stages = np.broadcast_to(many[0][:, None, None], (len(many[0]), 2, 2 * first.substeps + 1))
    # Nested grids instead of Newton: a snapping film has several equilibria, and the one nearest to 0 is found.
    for _ in range(_ROUNDS):
        grid = np.linspace(low, high, _GRID, axis=1)
        begun = evaluate(still, by_grid, grid.ravel(), *many)
        start, after = runs_of(sample, by_grid, begun, stages, dt).swapaxes(0, 1)
        up = (after - start)[:, first.order - 1].reshape(grid.shape) > 0
        turns = up[:, :-1] & ~up[:, 1:]  # accelerated up below it and down above it: stable
        place = np.argmin(np.where(turns, np.abs(grid[:, :-1]), np.inf), axis=1)
        exists &= turns.any(1)
        low, high = (np.take_along_axis(grid, place[:, None] + k, 1)[:, 0] for k in (0, 1))
    return np.where(exists[:, None], evaluate(still, models, (low + high) / 2, volts, ages), np.nan)


def beginnings(
    model: Model, records: Sequence[Record], ages: Sequence[float]
) -> tuple[list[Beginning], Float[np.ndarray, "records state"]]:
    """Return how each record starts, and its initial state."""
    omega, dt, clock = model.natural_frequency, records[0].dt, np.asarray(ages, float)
    low, high = model.domain.voltage_range
    span = float(high - low) if np.isfinite(high - low) and high > low else None
    parts = [first_part(r, omega, span) for r in records]
    lengths = [p.samples for p in parts]
    voltage = padded([p.voltage for p in parts])
    states = {
        "rest": evaluate(still, model, 0.0, 0.0, clock),
        "held": settled_states(model, voltage[:, 0], dt, clock),
        "moving": moving_states(model, records, clock),
    }
    start = np.concatenate(list(states.values()))
    readings = model.scales.state[0] * model_runs(model, np.tile(voltage, (3, 1)), dt, start)[1]
    poles = np.roots(np.nan_to_num(model.physical_coefficients[::-1]))
    known = poles, omega, (float(model.output.offset),), float(model.output.polarity)
    begun = [
        estimate_start(
            p, Response(rest[:n], held[:n], *known, moving[:n], 1 + any(e.port == "IN" for e in model.effects))
        )
        for p, n, rest, held, moving in zip(parts, lengths, *np.split(readings, 3), strict=True)
    ]
    moving = [k for k, b in enumerate(begun) if b.begins == "moving"]
    if moving:  # with the sensor offset and direction that were decided
        turned = [aligned(records[k], begun[k], model.output) for k in moving]
        states["moving"][moving] = moving_states(model, turned, clock[moving])
    return begun, np.stack([states[b.begins][k] for k, b in enumerate(begun)])


def with_zero_at_rest(begun: Sequence[Beginning]) -> list[Beginning]:
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
    for b in begun:
        same = b.begins == "held" and 0.5 < (b.level - zero) / ((b.level - b.zero) or np.inf) < 2.0
        zeroed.append(replace(b, zero=zero, stderr=stderr) if same else replace(b, free=b.begins != "rest"))
    return zeroed
