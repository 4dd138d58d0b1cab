"""Compare the responses of two models to the same inputs within their common training range.

    U_k = U_low + f_k (U_high - U_low)                              operating points f = 0.25, 0.6, 0.95
    x_k: settled displacement at U_k,      dF/dx: static stiffness there, from x(U_k +- dU)
    s_{t+1} = A s_t + B dV,  dx = C s      the decoder step, linearised at the settled state
    z = eig(A),  p = ln(z) / dt            resonance |p| and damping -Re p / |p| of the mode with the largest residue

Each model has an error e on its own recordings (rms, % of range). Changing a coefficient by the fraction h changes the
free run by d(h) % of range, so a coefficient is known to e h / d(h) at best. The two models differ where their
difference exceeds 1.96 times both of these combined. Two free runs of one sweep differ where their rms difference
exceeds both e.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.signal import chirp

from ...common.metrics import rms
from ...common.numbers import finite, number
from ...common.quantity import Units
from ...common.units import base_unit
from ...method.model.fitted import Fitted
from ...method.model.model import Model
from ...method.model.programs import jit, on_device
from ...method.model.units import units_of
from ...method.simulate.beginnings import settled_states
from ...method.simulate.decoder import step
from ...method.simulate.voltage_only import rollout
from .result import Difference, measured


@dataclass(frozen=True)
class Behaviour:
    """The responses of one model to the inputs that both models know, with standard errors (nan: unknown).

    Attributes:
        run: displacement in the sweep from its first sample on, m.
        own: rms error on the model's own recordings, m; nan if unknown.
        quantities: by words and unit: values and standard errors at the operating points; nan if unknown. The settled
            displacement, the stiffness dF/dx, and resonance and damping of the mode that moves the displacement most.
    """

    run: Float[np.ndarray, " time"]
    own: float
    quantities: dict[tuple[str, str], Float[np.ndarray, "2 points"]]


def compare_behaviour(a: Fitted, b: Fitted) -> tuple[list[Difference], list[str]]:
    """Compare displacement, stiffness, resonance and damping of two models at three inputs, and one simulated sweep.

    Returns:
        rows, and remarks: the reason if there are no rows.
    """
    if why := _apart(a, b):
        return [], [why]
    low, high = _common_range(a, b)
    points = low + np.array([0.25, 0.6, 0.95]) * (high - low)
    drive, dt = _sweep(a, b, low, high)
    units = units_of(a)
    # a hundredth of the range is half the step of the static stiffness
    one, two = (_behaviour(m, points, 0.01 * (high - low), drive, dt, units) for m in (a, b))
    rows = [_free_run_row(one, two)]
    for k, level in enumerate(points):
        for (what, unit), known in one.quantities.items():
            both = np.stack([known[:, k], two.quantities[what, unit][:, k]], 1).tolist()
            (a_value, b_value), errors = (list(map(finite, pair)) for pair in both)
            if (a_value, b_value) != (None, None):
                rows.append(measured(f"{what} at {units.input.text(level)}", a_value, b_value, unit, errors))
    return rows, []


def _apart(a: Fitted, b: Fitted) -> str | None:
    if a.input_map.name != b.input_map.name:
        return "The models have different input maps, so their responses were not compared."
    units = [(base_unit(m.origin.voltage_unit), base_unit(m.origin.displacement_unit)) for m in (a, b)]
    if units[0] != units[1]:
        return "The models have inputs or outputs of different kinds, so their responses were not compared."
    low, high = _common_range(a, b)
    if not (np.isfinite([low, high]).all() and high > low):
        return "The models have no known common input range, so their responses were not compared."
    return None


def _common_range(a: Fitted, b: Fitted) -> tuple[float, float]:
    ranges = np.stack([m.domain.voltage_range for m in (a, b)])
    low = ranges[:, 0].max()
    return float(max(low, 0.0) if a.input_map.one_sided else low), float(ranges[:, 1].min())


def _sweep(a: Fitted, b: Fitted, low: float, high: float) -> tuple[np.ndarray, float]:
    """Return a sweep of the input up to twice the higher resonance of two models, and its sampling interval (s)."""
    hertz = max(m.natural_frequency for m in (a, b)) / (2 * np.pi)
    # 60 periods of the faster model, with at most 20,000 samples
    duration = 60 / hertz
    dt = max(min(a.dt, b.dt), duration / 20_000)
    t = dt * np.arange(round(duration / dt))
    wave = chirp(t, hertz / 20, duration, min(2 * hertz, 0.2 / dt), method="logarithmic")
    return low + 0.48 * (high - low) * (1 - wave), dt


def _behaviour(
    fitted: Fitted, points: np.ndarray, small: float, drive: np.ndarray, dt: float, units: Units
) -> Behaviour:  # fmt: skip
    model = fitted.model
    run = _run(model, drive, dt)
    own = own_error(fitted) * float(np.ptp(run)) / 100
    levels = np.stack([points - small, points, points + small])
    states = settled_states(model, levels.ravel(), model.dt, np.zeros(levels.size)).reshape(*levels.shape, -1)
    state, level = (on_device(a[1], model.coefficients.dtype) for a in (states, levels))
    by_state, by_input = map(np.asarray, _linearised(model, state, level, model.dt))
    below, at, above = states[..., 0] * float(model.scales.state[0])
    forces = np.asarray(model.input_map.force(levels))
    resonance, damping = np.array([_mode(*pair, model.dt) for pair in zip(by_state, by_input, strict=True)]).T
    factor, unit = units.coefficient(0)
    settled = np.stack([at, np.full(len(at), own)])
    quantities = {(f"settled {units.output_word}", units.output.unit): units.output.shown(settled)}
    for name, values, k in (
        (("stiffness dF/dx", unit), factor * (forces[2] - forces[0]) / (above - below), None),
        (("resonance", "Hz"), resonance, 2),
        (("damping ratio", ""), damping, 1),
    ):
        quantities[name] = np.stack([values, _error_of(model, k, run, own, drive, dt) * values])
    return Behaviour(run, own, quantities)


def own_error(fitted: Fitted) -> float:
    """Return the model's rms error on its training recordings, % of range; nan or infinite if unknown."""
    training = fitted.origin.training or {}
    errors = [pair[1] for pair in training.get("errors", {}).values()]
    if errors:
        return rms(errors)
    return float(fitted.origin.level)


def _run(model: Model, drive: np.ndarray, dt: float) -> np.ndarray:
    """Simulate the sweep; return the displacement relative to the first sample, m, without the sensor's direction."""
    run = rollout(model, drive, dt, begins="rest")
    return float(model.output.polarity) * (run - run[0])


def _error_of(model: Model, k: int | None, run: np.ndarray, own: float, drive, dt: float) -> float:
    """Return the standard error of the logarithm of a stiffness, resonance or damping: the change that errors hide."""
    if k is not None and k > model.order:
        return np.nan
    step = 0.05  # relative change of the coefficient
    factors = np.where((np.arange(model.order + 1) == k) | (k is None), 1 + step, 1.0)
    moved = _run(model.changed(factors), drive, dt)
    change = rms(moved - run) or np.nan
    return own * step / change * (0.5 if k == 2 else 1.0)  # the resonance is proportional to the root of the inertia


@jit
def _linearised(model: Model, states: Float[Array, "points state"], volts: Float[Array, " points"], dt: float):
    """Return A and B of one time step about states under constant inputs."""

    def after(state, volts):
        return step(model, state, jnp.full((2 * model.substeps + 1,), volts), dt)

    return jax.vmap(jax.jacfwd(after, (0, 1)))(states, volts)


def _mode(by_state: np.ndarray, by_input: np.ndarray, dt: float) -> tuple[float, float]:
    """Return frequency (Hz) and damping ratio of the oscillation that moves the displacement most; nan without one."""
    if not np.isfinite(by_state).all():
        return np.nan, np.nan
    z, vectors = np.linalg.eig(by_state.astype(np.float64))
    part = vectors[0] * np.linalg.lstsq(vectors, by_input.astype(complex), rcond=None)[0]
    poles = np.log(np.where(np.abs(z) > 1e-9, z, 1e-9).astype(complex)) / dt
    rings = poles.imag > 0.05 * np.abs(poles)
    if not rings.any():
        return np.nan, np.nan
    p = poles[np.argmax(np.where(rings, np.abs(part), -1.0))]
    return float(abs(p) / (2 * np.pi)), float(-p.real / abs(p))


def _free_run_row(one: Behaviour, two: Behaviour) -> Difference:
    """Compare the two simulated sweeps: rms difference, and both models' own errors, % of the range."""
    span = max(float(np.ptp(one.run)), float(np.ptp(two.run)))
    percent = 100 / span
    apart = percent * rms(one.run - two.run)
    what = "free runs of one sweep: rms difference"
    known = percent * float(np.hypot(one.own, two.own))
    differs = None if apart else False
    if known < np.inf:
        what += f" (own errors {number(percent * one.own, 2)} and {number(percent * two.own, 2)} %)"
        differs = apart > known
    return Difference(what, "reference", apart, "% of range", None, differs)
