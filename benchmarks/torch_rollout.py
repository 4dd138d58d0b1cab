"""Rollouts in PyTorch: a loop of the decoder's own RK4 steps, and torchdiffeq on the continuous-token ODE.

A loop in Python costs the same per step however many there are, so it is timed on a part of the record. One thread: the
arrays are small, and two would wait for each other.
"""

import torch
from torchdiffeq import odeint

from pitp_jax.method.model.model import Model

from .ode import EQUAL, LOOSE, error
from .torch_model import DEVICE, Step, finished, tensor


def loop(model: Model, film, start, dt: float):
    """Fn() -> displacement (records, steps + 1), scaled: one RK4 step a sample, all records at once."""
    step, volts, state0 = Step(model, dt).eval(), tensor(film), tensor(start).T.contiguous()
    scale = float(model.scales.force)

    def run():
        torch.set_num_threads(1)
        with torch.inference_mode():
            state, out = state0, [state0[0]]
            for k in range(volts.shape[1] - 1):
                now, later = volts[:, k], volts[:, k + 1]
                forces = (v * v / scale for v in (now, (now + later) / 2, later))
                state = step(state, *forces)
                out.append(state[0])
            return finished(torch.stack(out, 1))

    return run


def solver(model: Model, film, start, dt: float, **options):
    """Fn() -> displacement (records, time), scaled: torchdiffeq, one step size for all records."""
    step, volts, state0 = Step(model, dt).eval(), tensor(film), tensor(start).T.contiguous()
    scale, last = float(model.scales.force), volts.shape[1] - 1
    times = torch.arange(last + 1, device=DEVICE) * dt

    def slope(t, state):
        place = (t / dt).clamp(0, last)
        k = int(min(place, last - 1))
        volt = volts[:, k] * (1 - (place - k)) + volts[:, k + 1] * (place - k)
        return step.ode(state, volt * volt / scale)

    def run():
        torch.set_num_threads(1)
        with torch.inference_mode():
            return finished(odeint(slope, state0, times, **options)[:, 0].T)

    return run


def torchdiffeq_ways(model: Model, film, start, truth, dt: float) -> tuple[dict, dict]:
    """RK4 at a constant step and dopri5, the loosest of each within the loose limit; the errors of all tried."""
    constant = {
        f"torchdiffeq rk4, step {k} samples": {"method": "rk4", "options": {"step_size": k * dt}} for k in (10, 5, 1)
    }
    adaptive = {
        f"torchdiffeq dopri5, rtol {r:g}": {"method": "dopri5", "rtol": r, "atol": r} for r in (1e-5, 1e-6, 1e-7)
    }
    ways, errors = {}, {}
    for kind in (constant, adaptive):
        for name, options in kind.items():
            run = solver(model, film, start, dt, **options)
            errors[name] = error(run().cpu()[: len(truth), :, None], truth)
            if errors[name] <= LOOSE:
                ways[name] = run
                if errors[name] <= EQUAL:
                    break
    return ways, errors
