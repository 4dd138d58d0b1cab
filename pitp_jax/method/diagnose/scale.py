"""The units of initial guesses: ranges of the measured motion, time constants of the base model."""

import numpy as np

from ..model.units import base_units, units_of
from .data import Case, excited_hz
from .fit import Fit
from .library import CORE, Scale, rates_of


def scale_of(case: Case, base: Fit) -> Scale:
    """Return the units of initial guesses: ranges of the measured motion, time constants of the base model."""
    x = np.concatenate([s.output[s.counts] for s in case.series])
    moves = [_smooth(s.output) for s in case.series]
    v = np.concatenate([np.gradient(m, d.dt) for m, d in zip(moves, case.simulator.drives, strict=True)])
    a = np.concatenate(
        [np.gradient(np.gradient(m, d.dt), d.dt) for m, d in zip(moves, case.simulator.drives, strict=True)]
    )
    a0, a1, a2 = (base.value(k) for k in CORE)
    drives = case.simulator.drives
    longest = max(len(d.voltage) * d.dt for d in drives)
    # of the natural period or the slowest pole of the base; a spring that takes longer than the records is none
    if a2 > 0:
        tau = np.sqrt(a2 / a0) if a0 * longest > a1 else a2 / a1
    else:
        tau = a1 / a0 if a0 > 0 else 10 * case.dt
    tau = float(np.clip(tau, case.dt, longest))
    volts = np.concatenate([d.voltage for d in drives])
    force = case.model.input_map.force(volts) / case.simulator.force_scale
    # of the input's integral, the unit of a loop around a speed command
    area = float(max(np.std(np.cumsum(d.voltage - d.voltage.mean()) * d.dt) for d in drives)) + 1e-12
    ages = [d.age for d in drives]
    band = 2 * np.pi * np.array(excited_hz(case))
    # quantiles instead of extremes, so that single outliers do not set the starts
    return Scale(
        tau=tau, dt=case.dt, duration=longest, session=max(ages) - min(ages) + longest if max(ages) > 0 else 0.0,
        reach=float(np.quantile(np.abs(x), 0.98)), top=float(np.quantile(x, 0.98)), bottom=float(np.quantile(x, 0.02)),
        speed=float(np.quantile(np.abs(v), 0.9)) + 1e-12, acceleration=float(np.quantile(np.abs(a), 0.98) * (a2 > 0)),
        fall=float(max(-np.quantile(a, 0.04), 1e-12)), voltage=float(np.abs(volts).max()),
        slew=float(np.quantile(np.abs(np.concatenate([np.diff(d.voltage) / d.dt for d in drives])), 0.99)) + 1e-12,
        area=area, a0=a0, a1=a1, a2=a2, force=float(np.abs(force).max()),
        fastest=float(np.quantile(np.abs(v), 0.995)), low=band[0], high=band[1], rates=rates_of(case.model),
        radian=float(case.model.scales.state[0]) if base_units(units_of(case.model)).output.unit == "rad" else 0.0,
    )  # fmt: skip


def _smooth(x: np.ndarray) -> np.ndarray:
    filled = np.interp(np.arange(len(x)), np.flatnonzero(np.isfinite(x)), x[np.isfinite(x)])
    # five samples: enough that a difference of a thinned record is not noise
    return np.convolve(np.pad(filled, 2, mode="edge"), np.ones(5) / 5, "valid")
