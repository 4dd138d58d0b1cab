"""Simulate linear ODEs that are stable by construction, exactly for a sampled input.

    P(s) = prod (s^2 + e^p s + e^q) [(s + e^r)] = prod (s - p_i):  every stable polynomial is reached
    P(0) / P(s) = sum_i r_i / (s - p_i),    r_i = P(0) / prod_{j != i} (p_i - p_j)            (partial fractions)
    without a spring (a pole at 0, the logarithm -inf) P'(0) stands for P(0): the response to a unit rate
    m_i(t+1) = e^z m_i(t) + f_1 F_t + f_2 (F_{t+1} - F_t) + f_3 (u_{t+1} - u_t)^2,    x = sum_i r_i m_i,    z = p_i h
    f_1 = phi_1(z),   f_2 = phi_2(z),   f_3 = 2 phi_3(z) - phi_2(z),    phi_k(z) = sum_j z^j / (j + k)!

Exact for a voltage linear (foh) or constant (zoh) between samples, squared or not, and for any delay; f_3 adds the
difference between the square of a line and the line between squares, or half the second difference of a force that is
cubic between samples. A mode is one first-order filter, ten times faster than the chained state space. Its derivative
is another:

    m'(t+1) = e^z m'(t) + e^z m(t) + sum_k f_k'(z) ...,    phi_k' = phi_k - k phi_{k+1}
    (2 p + e^a) dp = -e^a p da - e^b db       of a pole p of  s^2 + e^a s + e^b
"""

from functools import reduce
from math import factorial

import numpy as np
from jaxtyping import Complex, Float
from scipy.signal import lfilter

from ..model.sections import factored
from ..numerics.intersample import between

_FINER = 4
_APART = 1e-5  # of a pole: two nearer ones are separated, which changes a response by less than 1e-9


def _factors(logs: np.ndarray) -> list[np.ndarray]:
    """Return the ascending coefficients of the quadratic factors, then of the linear ones: s + e^r, and s of -inf."""
    if len(logs) and logs[-1] == -np.inf:
        return [*_factors(logs[:-1]), np.array([0.0, 1.0])]
    sizes = np.exp(logs)
    pairs = [np.array([sizes[k + 1], sizes[k], 1.0]) for k in range(0, len(logs) - 1, 2)]
    return pairs + [np.array([size, 1.0]) for size in sizes[2 * len(pairs) :]]


def _product(factors) -> np.ndarray:
    return reduce(np.convolve, factors, np.ones(1))


def polynomial(logs: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n+1"]:
    """Return ascending coefficients c_0 ... c_{n-1}, 1 from the logarithms of the coefficients of the factors."""
    return _product(_factors(logs))


def polynomial_slopes(logs: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n+1 n"]:
    """Return the derivatives of the polynomial's coefficients by the logarithms of the factors', shape (n + 1, n)."""
    factors, slopes, column = _factors(logs), np.zeros((len(logs) + 1, len(logs))), 0
    for k, factor in enumerate(factors):
        others = _product(factors[:k] + factors[k + 1 :])
        for power in range(len(factor) - 2, -1, -1):  # powers ascend, but logs hold the highest power first
            slopes[power : power + len(others), column] = factor[power] * others
            column += 1
    return slopes


def logs_from_roots(roots: np.ndarray) -> np.ndarray:
    """Return the logarithms of the factors' coefficients for these roots, reflected into the stable half plane."""
    roots = np.asarray(roots, complex)
    size = np.maximum(np.abs(roots), 1e-4)
    roots = np.asarray(-np.maximum(np.abs(np.real(roots)), 1e-3 * size) + 1j * np.imag(roots))
    pairs, rest = factored(roots)
    return np.log([*(v for q, p in pairs for v in (p, q)), *rest])


def poles(logs: Float[np.ndarray, " n"]) -> Complex[np.ndarray, " n"]:
    """Return the poles in rad per unit of time; equal poles are separated slightly."""
    roots: list[complex] = []
    for factor in _factors(logs):
        if len(factor) == 2:
            roots.append(complex(-factor[0]))
            continue
        half = np.sqrt(complex(factor[1] ** 2 / 4 - factor[0]))  # p = -b/2 +- sqrt(b^2 / 4 - c)
        half = half if abs(half) > _APART * factor[1] else complex(_APART * factor[1])
        far = -factor[1] / 2 - half  # the larger one, free of cancellation
        roots += [far, factor[0] / far if half.imag == 0 else far.conjugate()]
    for k, pole in enumerate(roots):
        if any(abs(pole - other) < _APART * abs(pole) for other in roots[:k]):
            roots[k] = pole * (1 + 3 * _APART * (k + 1))
    return np.array(roots)


def bounded(logs: Float[np.ndarray, " n"], slowest: float, fastest: float) -> Float[np.ndarray, " n"]:
    """Move poles to within these sizes; return the logarithms of the polynomial factors' coefficients.

    Clipping the coefficients instead would move all poles.
    """
    known = poles(logs)
    factor = np.clip(np.abs(known), slowest, fastest) / np.abs(known)
    return logs if (factor == 1).all() else logs_from_roots(known * factor)


def _phi(z: complex, k: int) -> complex:
    """Compute phi_k(z), by a power series near zero, where the closed form cancels."""
    if abs(z) < 1:
        term = total = 1 / factorial(k)
        for j in range(1, 24):
            term *= z / (j + k)
            total += term
        return total
    closed = np.exp(z)  # phi_0; phi_{k+1} = (phi_k - 1 / k!) / z
    for j in range(k):
        closed = (closed - 1 / factorial(j)) / z
    return closed


def pole_slopes(logs: Float[np.ndarray, " n"]) -> Complex[np.ndarray, "n n"]:
    """Return the derivatives of the poles by the logarithms of the polynomial factors' coefficients, shape (n, n)."""
    known, slopes, i = poles(logs), np.zeros((len(logs), len(logs)), complex), 0
    for factor in _factors(logs):
        if len(factor) == 2:
            slopes[i, i] = known[i]
        else:
            b, two = factor[1], slice(i, i + 2)
            slopes[two, two] = [-np.array([b * p, factor[0]]) / (2 * p + b) for p in known[two]]
        i += len(factor) - 1
    return slopes


def respond(logs: Float[np.ndarray, " n"], drive: Float[np.ndarray, " time"], **how) -> Float[np.ndarray, " time"]:
    """Simulate the response with unit static gain to the input voltage^2 (or voltage), shape (time,).

    Args:
        logs: of the pole coefficients, in rad per unit of time.
        drive: voltage at the samples of one record, or of several, one after another.
        how: `step`, duration of one sample in the unit of time of the poles;
            `square`, whether the force is the square of the voltage;
            `hold`, "foh", "zoh", "bandlimited" (foh on the voltage read four times a sample) or "cubic" (a smooth
            force);
            `settled`, start from the equilibrium of the first sample, not from rest; one for all records or one each;
            `late`, delay in samples; exact between them;
            `heads`, index of every record's first sample.
    """
    return _simulated(logs, drive, False, **how)[0]


def respond_with_slopes(
    logs: Float[np.ndarray, " n"], drive: Float[np.ndarray, " time"], **how
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, "n time"], Float[np.ndarray, " time"]]:
    """Simulate as `respond` does; return the response, its derivatives by the logarithms, and its time derivative."""
    runs = _simulated(logs, drive, True, **how)
    return runs[0], runs[1:-1], runs[-1]


def _simulated(
    logs, drive, slopes: bool, *, step: float, square: bool, hold: str, settled=False, late=0.0, heads=(0,)
) -> Float[np.ndarray, "rows time"]:
    """Return the response; with `slopes` its derivatives by the logarithms and by time in the rows below it."""
    heads = np.asarray(heads)
    if hold == "bandlimited":
        fractions = np.arange(_FINER) / _FINER
        fine = [between(part, "bandlimited", fractions, np).reshape(-1) for part in np.split(drive, heads[1:])]
        return _simulated(logs, np.concatenate(fine), slopes, step=step / _FINER, square=square, hold="foh",
                          settled=settled, late=_FINER * late, heads=_FINER * heads)[:, ::_FINER]  # fmt: skip
    rows, level = _inputs(drive, square, hold, settled, heads)
    z, moves = poles(logs) * step, pole_slopes(logs) * step
    # u(t - late): the mode at the sample before t - late, advanced by a part of a sample, which the exact step allows
    whole = min(int(late), len(drive) - 1)
    part = 1 - min(late - whole, 1.0)
    ahead = _later(rows, whole, heads) if whole else rows
    terms, sizes = [], []
    for i in np.flatnonzero(np.imag(z) >= 0):
        pole, others = _real_if_real(z[i]), np.delete(z, i)
        weights = _weights(pole)[:, : len(rows)]
        modes = [_filtered(weights[0] @ rows, pole, heads)]
        if slopes:  # m'(t+1) at the head of the file
            pushed = weights[1] @ rows
            pushed[1:] += np.exp(pole) * modes[0][:-1]
            pushed[heads] = 0.0
            modes.append(_filtered(pushed, pole, heads))
        if late:
            weights, (mode, *slope) = _weights(pole, part)[:, : len(rows)], [_later(m, whole + 1, heads) for m in modes]
            before = [mode, *(s + part * mode for s in slope)]
            modes = [np.exp(part * pole) * m + w @ ahead for m, w in zip(before, weights, strict=False)]
        # d log(r_i) / dz_j = 1 / z_j + 1 / (z_i - z_j);  for z_i itself minus their sum; a pole at 0 does not move
        relative = 1 / np.where(z, z, 1)
        relative[np.arange(len(z)) != i] += 1 / (pole - others)
        relative[i] -= (1 / (pole - others)).sum()
        factors = [[1.0, *(relative @ moves), pole / step], [0.0, *moves[i], 0.0]]
        for mode, row in zip(modes, factors, strict=False):
            size = _count(pole) * _residue(pole, z, step) * np.array(row)
            terms += [np.real(mode), np.imag(mode)]
            sizes += [np.real(size), -np.imag(size)]
    runs = np.transpose(sizes)[: len(logs) + 2 if slopes else 1] @ np.stack(terms)
    if slopes and len(z) == 1:  # for order 1 the force itself acts on the rate
        runs[-1] += _residue(z[0], z, step).real / step * (np.array([1.0, part, part**2 - part])[: len(rows)] @ ahead)
    runs[0] += level
    return runs


def bounded_response(
    poles: Complex[np.ndarray, " n"], force: Float[np.ndarray, " time"]
) -> tuple[Float[np.ndarray, " time"], Float[np.ndarray, "time n"]]:
    """Simulate stable and unstable poles (rad a sample) without divergence; return the response and the free responses.

    The force is linear between samples.

    Re p < 0: m(t+1) = e^p m(t) + ..., from the first sample on;  Re p > 0: m(t) = e^-p m(t+1) - ..., from the last one
    back. A solution of m' = p m + F either way; what it begins or ends with is in the free ones.
    """
    response, free = np.zeros(len(force)), []
    for pole in poles[np.imag(poles) >= 0]:
        way = -1 if pole.real > 0 else 1  # of time
        decay = powers(way * pole, len(force))[::way]
        driven = _residue(pole, poles, 1.0) * mode(way * pole, way * force[::way], "foh")[::way]
        response += _count(pole) * np.real(driven)
        free += [np.real(decay), np.imag(decay)][: _count(pole)]
    return response, np.stack(free, 1)


def mode(pole: complex, force: Float[np.ndarray, " time"], hold: str) -> np.ndarray:
    """Simulate m' = p m + F from rest, p in rad a sample, F held ("zoh") or linear between samples; shape (time,)."""
    heads, pole = np.zeros(1, int), _real_if_real(pole)
    rows, _ = _inputs(force, False, hold, False, heads)
    return _filtered(_weights(pole)[0, : len(rows)] @ rows, pole, heads)


def _residue(pole: complex, z: np.ndarray, step: float) -> complex:
    return complex(np.prod(np.where(z, -z, step)) / np.prod(pole - z[z != pole]))


def _real_if_real(pole: complex) -> complex | float:
    """Return a real pole as a float, because real arithmetic is three times as fast."""
    return pole if pole.imag else pole.real


def _count(pole: complex | float) -> int:
    """Return the number of poles for which this one stands: 2 for one of a pair, otherwise 1."""
    return 1 + bool(pole.imag > 0)


def _inputs(drive: np.ndarray, square: bool, hold: str, settled, heads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the terms that f_1, f_2, f_3 multiply, shape (1 to 3, T), and the input's level of every equilibrium.

    A column holds the input from the sample before; a record's first column is 0.
    """
    force = drive**2 if square else drive
    level = np.repeat(np.where(settled, force[heads], 0.0), np.diff(heads, append=len(drive)))
    terms = [force[:-1] - level[:-1]]
    if hold != "zoh":
        terms.append(np.diff(force))
    if hold == "cubic":
        # half of F'' within the sample (h = 1): the mean of the second differences at its two ends
        bend, tails = np.pad(np.diff(force, 2), 1), np.append(heads[1:], len(drive)) - 1
        bend[heads], bend[tails] = bend[heads + 1], bend[tails - 1]
        terms.append((bend[:-1] + bend[1:]) / 4)
    elif hold == "foh" and square:
        terms.append(np.diff(drive) ** 2)
    rows = np.zeros((len(terms), len(drive)))
    rows[:, 1:] = terms
    rows[:, heads] = 0.0
    return rows, level


def _weights(z: complex, part: float = 1.0) -> np.ndarray:
    """Return the weights f_1, f_2, f_3 for a fraction of a sample, and their derivatives by z, shape (2, 3)."""
    s = part
    one, two, three, four = (_phi(z * s, k) * s**k for k in (1, 2, 3, 4))
    return np.array([[one, two, 2 * three - two],
                     [s * one - two, s * two - 2 * three, 2 * s * three - 6 * four - s * two + 2 * three]])  # fmt: skip


def _later(series: np.ndarray, samples: int, heads: np.ndarray) -> np.ndarray:
    """Delay every record by whole samples; it starts with zeros."""
    later = np.roll(series, samples, axis=-1)
    for head in heads:
        later[..., head : head + samples] = 0.0
    return later


def _filtered(pushed: np.ndarray, z: complex, heads: np.ndarray) -> np.ndarray:
    """Simulate a mode of every record under the input `pushed`."""
    taps = np.array([1.0]), np.array([1.0, -np.exp(z)])
    return np.concatenate([np.asarray(lfilter(*taps, part)) for part in np.split(pushed, heads[1:])])


def coast(
    logs: Float[np.ndarray, " n"], samples: int, *, step: float
) -> tuple[Float[np.ndarray, "time n"], np.ndarray]:
    """Return the free responses of every mode, of amplitude 1 at the start, and which of them oscillate."""
    columns, rings = [], []
    for pole in poles(logs) * step:
        if pole.imag < 0:
            continue
        mode = powers(pole, samples)
        columns += [np.real(mode), np.imag(mode)][: _count(pole)]
        rings += [pole.imag > 0] * _count(pole)
    return np.array(columns).reshape(len(rings), samples).T, np.array(rings, bool)


def powers(z: complex, samples: int) -> Complex[np.ndarray, " time"]:
    """Compute e^(z t), t = 0 ... samples - 1, as e^(z B i) e^(z j): a product costs a tenth of an exponential."""
    size = int(np.ceil(np.sqrt(samples)))
    coarse, fine = np.exp(z * size * np.arange(size)), np.exp(z * np.arange(size))
    return (coarse[:, None] * fine).reshape(-1)[:samples]
