"""The public `inverse` of 120,000 samples, and its part that the paper measures: network and inverse.

    V = sqrt(max(sigma_off(S, m) + sum_i sigma_i(S, m) x^(i), 0))

`inverse` takes a displacement; it also computes derivatives, memories, the electrode's lag and the mask. The paper's
part takes known derivatives and memories, as PyTorch does: the ratio is that of this part (`network_ms`). The floor
counts the multiply-adds of the networks at this machine's matrix rate and the arrays read and written at its bandwidth,
both measured in the same run.
"""

import jax
import jax.numpy as jnp
import numpy as np

from pitp_jax import inverse
from pitp_jax.method.invert.equation import force_along, scaled_equation
from pitp_jax.method.model.equation import equation_force
from pitp_jax.method.model.model import Model
from pitp_jax.method.model.programs import jit
from pitp_jax.method.numerics.spline_derivative import fast_derivatives

from .clock import row, take_turns
from .machine import floor
from .subjects import DT, target

PUBLIC, FAST, PLAIN = "pitp_jax", "pitp_jax, network and inverse", "pitp_jax, network and inverse, vmapped"


@jit
def fast(model: Model, equation, memory):
    """Rows."""
    return model.input_map.voltage(force_along(model, equation, memory) * model.scales.force)


@jit
def plain(model: Model, equation, memory):
    """One instant, vmapped."""
    features = jnp.concatenate([equation[:, :-1], memory], 1)
    force = jax.vmap(lambda f, x: equation_force(model, model.encoder(f), x)[0])(features, equation)
    return model.input_map.voltage(force * model.scales.force)


def inputs(model: Model):
    """Scaled [x, ..., x^(n)] and memories along the target."""
    equation = scaled_equation(model, fast_derivatives(target(), DT, model.order))
    return equation, model.memory.trajectory(equation[:, 0], DT, model.memory.initial(jnp.zeros(())))


def torch_ways(model: Model, equation, memory, truth) -> tuple[dict, str]:
    """PyTorch eager, compiled, on one thread (on shared cores two wait), in blocks; or none, and why."""
    try:
        import torch

        from .torch_model import Inverse, finished, tensor
    except ImportError as error:
        return {}, f"{error.name} is not installed"
    network = Inverse(model).eval()
    features, rows = tensor(jnp.concatenate([equation[:, :-1], memory], 1).T), tensor(equation.T)
    compiled = torch.compile(network, dynamic=False)
    with torch.inference_mode():
        found = network(features, rows).cpu().numpy()
    np.testing.assert_allclose(found, truth, rtol=0, atol=2e-3 * np.abs(truth).max())  # the same network

    def with_threads(count, run):
        def call():
            torch.set_num_threads(count)
            with torch.inference_mode():
                return finished(run())

        return call

    def in_blocks():
        pairs = zip(features.split(4000, 1), rows.split(4000, 1), strict=True)
        return torch.cat([compiled(f, r) for f, r in pairs])

    all_of_them = torch.get_num_threads()
    ways = {
        "PyTorch eager": with_threads(all_of_them, lambda: network(features, rows)),
        "PyTorch compiled": with_threads(all_of_them, lambda: compiled(features, rows)),
        "PyTorch compiled, one thread": with_threads(1, lambda: compiled(features, rows)),
        "PyTorch compiled, one thread, blocks": with_threads(1, in_blocks),
    }
    return ways, ""


def best(found: dict, prefix: str) -> str | None:
    """The fastest way whose name begins so."""
    names = [name for name in found if name.startswith(prefix)]
    return min(names, key=lambda name: found[name]["median_ms"]) if names else None


def network_and_inverse(model: Model, multiply_adds: float, seconds: float) -> dict:
    """One row for one model; `multiply_adds` of its networks per instant."""
    equation, memory = inputs(model)
    truth = np.asarray(plain(model, equation, memory))
    wanted = jnp.asarray(target(), model.coefficients.dtype)
    ways = {PUBLIC: lambda: inverse(model, wanted), FAST: lambda: fast(model, equation, memory)}
    ways[PLAIN] = lambda: plain(model, equation, memory)
    others, why = torch_ways(model, equation, memory, truth)
    found = take_turns(ways | others, seconds)
    error = float(np.abs(np.asarray(ways[FAST]()) - truth).max() / truth.max())
    read, peer = equation.nbytes + memory.nbytes + truth.nbytes, best(found, "PyTorch compiled")
    part = found[FAST]["median_ms"]
    out = row(found, PUBLIC, peer, samples=len(equation), network_ms=part, error_against_vmapped=error,
              peer_skipped=why, **floor(2 * multiply_adds * len(equation), read))  # fmt: skip
    return out if peer is None else out | {"ratio": out["peer_median_ms"] / part}
