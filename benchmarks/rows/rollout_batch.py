"""The public `free_run`, vmapped over 32 records of 10,000 steps, beside PyTorch, deepSI, diffrax and torchdiffeq.

General solvers run at the decoder's own error (`ode`); PyTorch ones on the first tenth of the record, their time
counted tenfold.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from pitp_jax import free_run, rest_state
from pitp_jax.method.simulate.batched_rollout import fast_rollout
from pitp_jax.method.simulate.decoder import rollout_batch

from ..clock import row, take_turns
from ..ode import EQUAL, diffrax_ways, error, films, reference, rollout_floor
from ..sizes import size
from ..subjects import DT, default, voltages

RECORDS, STEPS, CHECKED, PART = size((32, 10_000, 4, 10), (2, 100, 2, 2))


@eqx.filter_jit
def many(model, volts):
    """The public free run, batched by the caller."""
    return jax.vmap(free_run, (None, 0))(model, volts)


def torch_ways(model, film, start, truth) -> tuple[dict, dict, str]:
    """PyTorch's ways on a part of the record and their errors, or why there are none."""
    try:
        from ..torch_rollout import loop, torchdiffeq_ways
    except ImportError as missing:
        return {}, {}, f"{missing.name} is not installed"
    part, known = np.asarray(film[:, : STEPS // PART + 1]), truth[:, : STEPS // PART + 1]
    run = loop(model, part, start, DT)
    ways, errors = torchdiffeq_ways(model, part, start, known, DT)
    ways, errors = (
        {"PyTorch loop": run} | ways,
        {"PyTorch loop": error(run().cpu()[: len(known), :, None], known)} | errors,
    )
    try:
        from ..deepsi_rollout import subnet
    except ImportError as missing:
        return ways, errors, f"{missing.name} is not installed"
    return ways | {"deepSI SUBNET loop": subnet(part)}, errors, ""


def measure(seconds: float) -> dict:
    """Ours, plain, and the peers; the ratio is to the fastest general solver at equal error."""
    model = default()
    volts = jnp.asarray(voltages(RECORDS, STEPS + 1))
    start = jnp.tile(rest_state(model), (RECORDS, 1))
    film = films(model, volts, DT)
    truth = reference(model, film[:CHECKED], start[:CHECKED], DT)
    ours = error(fast_rollout(model, volts[:CHECKED], DT, start[:CHECKED]), truth)
    ways = {"pitp_jax": lambda: many(model, volts), "pitp_jax, rows": lambda: fast_rollout(model, volts, DT, start)}
    ways["pitp_jax, vmapped"] = lambda: rollout_batch(model, volts, DT, start)
    solvers, errors = diffrax_ways(model, film, start, truth, DT)
    torched, torch_errors, why = torch_ways(model, film, start, truth)
    found, errors = take_turns(ways | solvers | torched, seconds), errors | torch_errors
    scale = dict.fromkeys(torched, float(PART))
    ratios = {n: scale.get(n, 1.0) * f["median_ms"] / found["pitp_jax"]["median_ms"] for n, f in found.items()}
    equal = [n for n in ratios if n in errors and "loop" not in n and errors[n] <= max(ours, EQUAL)]
    peer = min(equal, key=lambda n: ratios[n], default=None)
    return row(found, "pitp_jax", peer, scale, records=RECORDS, steps=STEPS, error=ours, errors=errors,
               ratios=ratios, peer_skipped=why, **rollout_floor(model, RECORDS, STEPS))  # fmt: skip
