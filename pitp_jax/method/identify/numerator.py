"""Check whether the plant has zeros, which the identified model lacks: fit one or two as well.

    y = (b_0 + ... + b_m s^m) / a(s) e^{-s tau} F + offset      a, tau: from a fit of the frequency response

b by least squares on the recordings themselves. Zeros are reported where they leave less than half the error of the
identified model, and of as many poles without zeros. Zeros at 0 Hz are those of a derivative: the output is a velocity
or an acceleration. A pair on the imaginary axis is an antiresonance: the output is measured at the
driven one of two masses.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from ..numerics.coloured_noise import project
from .frequency_response import FrequencyResponse
from .heldout import Candidate
from .linear_ode import coast, logs_from_roots, mode, poles
from .output_error import Problem
from .rational_fit import PEAK, Rational, fit_rational

_LESS = 0.5  # of the error: what a model with zeros must leave
_SMALL = 0.02  # of the output's deviation: an error that needs no reason


@dataclass(frozen=True)
class Numerator:
    """A model with zeros: poles and zeros (rad/s), its error and that of the identified model, of the deviation."""

    poles: np.ndarray
    zeros: np.ndarray
    error: float
    without: float

    @property
    def derivative(self) -> int:
        """Return the number of zeros at 0 Hz."""
        return int((self.zeros == 0).sum())

    def __str__(self) -> str:
        """Write which zeros the plant has, and what to do."""
        origin = ([], ["a zero at 0 Hz (a velocity)"], ["two zeros at 0 Hz (an acceleration)"])[self.derivative]
        others = [_words(z) for z in self.zeros if z != 0 and z.imag >= 0]
        modes = [f"{abs(p) / (2 * np.pi):.3g} Hz" for p in self.poles if p.imag > 0 and -p.real < PEAK * abs(p)]
        mode = f" and a mode at {' and '.join(modes)}" if modes else ""
        do = ("Train", "Integrate the output once, or train", "Integrate the output twice, or train")[self.derivative]
        return (
            f"The output has {' and '.join(origin + others)}: with these{mode} {100 * self.error:.2g} % of its "
            f"deviation remains unexplained, with the model below, which has poles only, {100 * self.without:.2g} %. "
            f"The coefficients are not those of the plant. {do} with `pitp fit`, whose memory describes zeros"
        )


def _words(zero: complex) -> str:
    hz = abs(zero) / (2 * np.pi)
    if not zero.imag:
        return f"a zero at {hz:.3g} Hz ({1 / abs(zero):.3g} s{'' if zero.real < 0 else ', to the wrong side first'})"
    deep = " (an antiresonance)" if abs(zero.real) < PEAK * abs(zero) else ""
    return f"a pair of zeros at {hz:.3g} Hz{deep}"


def needed_zeros(chosen: Candidate, problem: Problem, response: FrequencyResponse) -> Numerator | None:
    """Return the model with the fewest poles and zeros that leaves less than half the error; None if none does."""
    moved = sum(float(w @ (y - w @ y / w.sum()) ** 2) for y, w in zip(problem.output, problem.weight, strict=True))
    deviation, hold = np.sqrt(moved), chosen.structure.hold
    without = float(np.sqrt(chosen.cost * problem.samples)) / deviation
    if without < _SMALL or not response.rich:
        return None
    for order in (1, 2, 3, 4):
        plain = fit_rational(response, problem.fine, order)
        most = _LESS * min(
            without, np.linalg.norm(_left(plain.poles, plain.delay, slice(1), problem, hold)[0]) / deviation
        )
        for zeros in (1, 2)[:order]:
            found = fit_rational(response, problem.fine, order, zeros)
            rest, _ = _left(found.poles, found.delay, slice(zeros + 1), problem, hold)
            if np.linalg.norm(rest) < most * deviation:
                fitted = _fitted(found, zeros, problem, deviation, without)
                plain = _fitted(plain, 0, problem, deviation, without)
                needed = fitted.error < _LESS * plain.error and (np.abs(fitted.zeros) * problem.dt < np.pi).all()
                return fitted if needed and not _creeps(fitted) else None
    return None


def _creeps(fitted: Numerator) -> bool:
    """Return whether every zero has a real pole beside it: a lag added to the motion, which is creep."""
    real = np.abs(fitted.poles[np.imag(fitted.poles) == 0])
    # with a zero twice as fast as its pole, a lag adds the whole of the motion
    return all(z != 0 and ((real < abs(z)) & (abs(z) < 2 * real)).any() for z in fitted.zeros)


def _fitted(found: Rational, zeros: int, problem: Problem, deviation: float, without: float) -> Numerator:
    """Fit poles, delay and numerator to the recordings under either hold, with as many zeros at 0 Hz as fit as well."""
    start, fits = np.append(logs_from_roots(found.poles), found.delay / problem.dt), []
    within = start - 20, start + 20  # a pole that wanders without changing the residual must not overflow
    for hold, lowest in product(("foh", "zoh"), range(zeros + 1)):

        def left(p, hold=hold, lowest=lowest):
            return _left(poles(p[:-1]), p[-1] * problem.dt, slice(lowest, zeros + 1), problem, hold)

        fit = least_squares(lambda p, left=left: left(p)[0], start, x_scale=0.1, max_nfev=15, bounds=within)
        factors = np.append(np.zeros(lowest), left(fit.x)[1])
        error = float(np.sqrt(2 * fit.cost)) / deviation
        fits.append(Numerator(poles(fit.x[:-1]), np.roots(factors[::-1]), error, without))
    most = max(min(f.error for f in fits) / _LESS, _SMALL)
    return max((f for f in fits if f.error <= most), key=lambda f: (f.derivative, -f.error))


def _left(roots: np.ndarray, delay: float, powers: slice, problem: Problem, hold: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the residual of all records with these poles (rad/s) and delay (s), and the numerator's coefficients."""
    z, k = roots * problem.dt, np.arange(len(roots) + 1)[powers]
    # s^k / a(s) = sum_i r_i p_i^k / (s - p_i), and 1 more for k = n
    residues = z[:, None] ** k / np.prod(z[:, None] - z + np.eye(len(z)), axis=1, keepdims=True)
    rows, target = [], []
    for force, output, weight, b in zip(
        problem.forces, problem.output, problem.weight, problem.beginnings, strict=True
    ):
        time = np.arange(len(force)) * problem.dt
        late = np.interp(time - delay, time, force) - (b.begins != "rest") * force[0]
        columns = np.real(np.stack([mode(p, late, hold) for p in z], 1) @ residues) + late[:, None] * (k == len(z))
        own = [np.ones(len(time))]
        if b.begins == "moving":
            own += list(coast(logs_from_roots(roots), len(time), step=problem.dt)[0].T)
        own = weight[:, None] * np.column_stack(own)
        rows.append(project(weight[:, None] * columns, own)[1])
        target.append(project(weight * output, own)[1])
    factors, rest = project(np.concatenate(target), np.concatenate(rows))
    return rest, factors * problem.dt**k
