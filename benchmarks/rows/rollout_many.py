"""The public `free_run`, vmapped over 1,024 records of 1,000 steps, beside the plain vmapped rollout."""

import equinox as eqx
import jax
import jax.numpy as jnp

from pitp_jax import free_run, rest_state
from pitp_jax.method.simulate.batched_rollout import fast_rollout
from pitp_jax.method.simulate.decoder import rollout_batch

from ..clock import row, take_turns
from ..ode import rollout_floor
from ..sizes import size
from ..subjects import DT, default, voltages

RECORDS, STEPS = size((1024, 1000), (8, 100))


@eqx.filter_jit
def many(model, volts):
    """The public free run, batched by the caller."""
    return jax.vmap(free_run, (None, 0))(model, volts)


def measure(seconds: float) -> dict:
    """Ours and plain."""
    model, volts = default(), jnp.asarray(voltages(RECORDS, STEPS))
    start = jnp.tile(rest_state(model), (RECORDS, 1))
    ways = {"pitp_jax": lambda: many(model, volts), "pitp_jax, rows": lambda: fast_rollout(model, volts, DT, start)}
    ways["pitp_jax, vmapped"] = lambda: rollout_batch(model, volts, DT, start)
    return row(take_turns(ways, seconds), "pitp_jax", "pitp_jax, vmapped", records=RECORDS, steps=STEPS,
               **rollout_floor(model, RECORDS, STEPS))  # fmt: skip
