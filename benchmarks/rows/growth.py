"""How times grow: inversion over samples, order and width; rollout over records; identification is a row of its own.

The row itself is the inversion of 10^6 samples beside ten times that of 10^5: linear where the ratio is one.
"""

from pitp_jax import rest_state
from pitp_jax.method.invert.equation import invert_path, scaled_equation
from pitp_jax.method.numerics.spline_derivative import fast_derivatives
from pitp_jax.method.simulate.batched_rollout import fast_rollout

from ..clock import row, take_turns
from ..sizes import size
from ..subjects import DT, default, target, voltages

_SAMPLES = size((1000, 10_000, 100_000, 1_000_000), (100, 1000))
_ORDERS, _WIDTHS = size(((2, 3, 4), (4, 8, 16, 32, 64)), ((2,), (4,)))
_RECORDS = size((1, 8, 64, 512), (1,))


def inversion(samples: int, order: int = 2, width: int = 8):
    """Fn() of eq. 13 with memories, along known derivatives."""
    model = default(order, width)
    equation = scaled_equation(model, fast_derivatives(target(samples), DT, order))
    return lambda: invert_path(model, equation, DT)[1]


def rollout(records: int):
    """Fn() of 1,000 steps."""
    import jax.numpy as jnp

    model = default()
    volts, start = jnp.asarray(voltages(records, 1000)), jnp.tile(rest_state(model), (records, 1))
    return lambda: fast_rollout(model, volts, DT, start)


def measure(seconds: float) -> dict:
    """Every curve as {x: ms}."""
    small, big = _SAMPLES[-2:]
    curves = {
        "inversion over samples": {n: inversion(n) for n in _SAMPLES},
        "inversion of 10^5 over order": {n: inversion(small, order=n) for n in _ORDERS},
        "inversion of 10^5 over width": {n: inversion(small, width=n) for n in _WIDTHS},
        "rollout of 1,000 steps over records": {n: rollout(n) for n in _RECORDS},
    }
    ways = {f"{name}: {x}": run for name, points in curves.items() for x, run in points.items()}
    found = take_turns(ways, seconds)
    table = {name: {str(x): found[f"{name}: {x}"]["median_ms"] for x in points} for name, points in curves.items()}
    ours, tenth = (f"inversion over samples: {n}" for n in (big, small))
    made = row(found, ours, tenth, {tenth: 10.0}, curves=table)
    return made | {"peer": "ten times 10^5", "others": {}}
