"""Change a model by the few parameters in which an actuator differs from itself on another day.

    stiffness on sigma_0 and the restoring sigma_off,   damping on sigma_1,   inertia on sigma_2,   a3, ... on the rest
    creep on m - x (lags that the recording outlasts),  tau_electrode and T_delay plus their increase

z holds the logarithms of the factors, then the increases of the times in units of 0.1 / omega_0 (a lag that did not
exist has no factor). For a trained encoder two slopes over its stroke follow; only the mean is reported. All factors
are relative to the force of the input, which is unknown; so `gain` is no coordinate of its own but the direction (-1,
..., -1, 0, 0, 0) in which all coefficients change alike.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.drive import DirectDrive, ElectrodeLag
from ..model.encoder import AdaptedEncoder, ConstantEncoder, plain
from ..model.memory import FadingMemory, RingingMemory
from ..model.model import Model

_UNIT = 0.1  # of an increase of a time, in 1 / omega_0
_SHORTEST = 1e-9  # of a lag, in samples: counts as none
_COEFFICIENT, _OTHER = 0.3, 0.5  # prior standard deviations of logarithms: coefficients, creep
_TILT = 0.05  # of the two tilts of a trained encoder, per scale of x
_TIME = 2.0  # and of increases of times, in units
_FIRST = ("stiffness", "damping", "inertia")
TIMES = ("electrode_tau", "delay")
TILTS = ("gain over the stroke", "stiffness over the stroke")


class Factors(NamedTuple):
    """The coordinates z in which one model may change, with their priors.

    Attributes:
        names: of the coordinates; `tokens` of them are of coefficients, first.
        prior: standard deviation of each before any recording.
        outlasted: 1 for every lag among the memories that the recording outlasts.
        reach: scaled displacement: lowest trained on, mean of the recording, highest trained on.
        unit: of the lengthened times, s.
        tau, delay: the model's own lag and delay, s (0: none).
    """

    names: tuple[str, ...]
    tokens: int
    prior: Float[np.ndarray, " numbers"]
    outlasted: Float[np.ndarray, " lags"]
    reach: Float[np.ndarray, " three"]
    unit: float
    tau: float
    delay: float

    def direction(self, name: str) -> np.ndarray:
        """Return the direction of a named parameter in the coordinates z, shape (numbers,)."""
        if name == "gain":
            return np.where(np.arange(len(self.names)) < self.tokens, -1.0, 0.0)
        return np.eye(len(self.names))[self.names.index(name)]

    def lowest(self) -> np.ndarray:
        """Return the lower bounds of z: a time constant or delay is not negative; logarithms have no bound."""
        times = {"electrode_tau": -self.tau / self.unit, "delay": -self.delay / self.unit}
        return np.array([times.get(n, -np.inf) for n in self.names])

    def own(self, name: str) -> float:
        """Return the model's own electrode time constant or delay, s."""
        return float(self.tau if name == "electrode_tau" else self.delay)

    def factor(self, name: str, q: float) -> float:
        """Return the factor on a named parameter for a change q; nan if the model's own value is almost zero."""
        if name not in TIMES:
            with np.errstate(over="ignore"):  # an unknown factor may be infinite
                return float(np.exp(q))
        own = self.own(name)
        return max(own + float(self.unit) * q, 0.0) / own if own > self.unit else float("nan")


def factors_of(model: Model, seconds: float, middle: float) -> Factors:
    """Return the coordinates that may change.

    `seconds`: duration of the recording; `middle`: its mean scaled displacement.
    """
    n = model.order
    names = [*_FIRST[: n + 1], *(f"a{i}" for i in range(3, n + 1))]
    prior = [_COEFFICIENT] * (n + 1)
    # a lag that has not settled twice looks like a stiffness, so it is left unchanged
    outlasted = np.asarray(jnp.exp(_lags(model)) < seconds / 2, np.float64)
    if outlasted.any() or any(e.name == "creep" and float(e.tau) < seconds / 2 for e in model.effects):
        names, prior = [*names, "creep"], [*prior, _OTHER]
    tau = 0.0
    if model.input_map.one_sided:  # a lag before a linear input is one of the force, which is part of the order
        names, prior = [*names, "electrode_tau"], [*prior, _TIME]
        tau = next((float(e.tau) for e in model.effects if e.name == "electrode_rc"), 0.0)
        tau = float(jnp.exp(model.drive.log_tau)) if isinstance(model.drive, ElectrodeLag) else tau
    delay = next((float(e.time) for e in model.effects if e.delays), 0.0)
    if delay:
        names, prior = [*names, "delay"], [*prior, _TIME]
    if not isinstance(plain(model.encoder), ConstantEncoder):
        names, prior = [*names, *TILTS], [*prior, _TILT, _TILT]
    unit = _UNIT / model.natural_frequency
    own = (np.float64(v) for v in (unit, tau, delay))  # NumPy scalars are arguments of programs, not parts of them
    low, high = model.domain.region[0] if len(model.domain.region) else (middle - 1.0, middle + 1.0)
    reach = np.array((low, middle, high))
    return Factors(tuple(names), n + 1, np.array(prior), outlasted, reach, *own)


def _lags(model: Model) -> Array:
    """Return the logarithms of the time constants (s) of the memories that an encoder sees."""
    memory = model.memory
    if isinstance(plain(model.encoder), ConstantEncoder) or not isinstance(memory, FadingMemory | RingingMemory):
        return jnp.zeros((0,))
    return memory.log_tau


def moved(model: Model, factors: Factors, z: Float[np.ndarray | Array, " numbers"], dt: float) -> Model:
    """Return the model changed by z; `dt`: sampling interval of the records, s."""
    z = jnp.asarray(z, model.coefficients.dtype)
    by = dict(zip(factors.names, z, strict=True))
    model = eqx.tree_at(lambda m: m.coefficients, model, model.coefficients * jnp.exp(z[: factors.tokens]))
    creep = by.get("creep", jnp.zeros_like(by["stiffness"]))
    if not isinstance(plain(model.encoder), ConstantEncoder):
        model = eqx.tree_at(lambda m: m.encoder, model, _encoder(model, factors, by, creep))
    if "electrode_tau" in by:
        model = _later(model, factors, by["electrode_tau"], dt)

    def effect(e):
        if e.name == "creep":
            return eqx.tree_at(lambda e: e.kappa, e, e.kappa * jnp.exp(creep))
        if e.delays and "delay" in by:
            return eqx.tree_at(lambda e: e.time, e, jnp.maximum(e.time + factors.unit * by["delay"], 0.0))
        return e

    return eqx.tree_at(lambda m: m.effects, model, tuple(map(effect, model.effects))) if model.effects else model


def _encoder(model: Model, factors: Factors, by: dict[str, Array], creep: Array) -> AdaptedEncoder:
    """Wrap the encoder for an adaptation; an encoder that is already adapted is adapted further."""
    lags = jnp.exp(jnp.asarray(factors.outlasted, creep.dtype) * creep)
    offset, tilt = jnp.exp(by["stiffness"]), jnp.stack([by[n] for n in TILTS])
    own, reach = model.encoder, factors.reach
    if isinstance(own, AdaptedEncoder):
        offset, lags, tilt, reach = own.offset * offset, own.creep * lags, own.tilt + tilt, own.reach
    return AdaptedEncoder(plain(own), offset, lags, tilt, reach)


def _later(model: Model, factors: Factors, z: Array, dt: float) -> Model:
    """Return the model with a longer electrode time constant, in its drive or in an effect."""
    tau = factors.tau + factors.unit * z
    if isinstance(model.drive, DirectDrive) and any(e.name == "electrode_rc" for e in model.effects):
        place = next(k for k, e in enumerate(model.effects) if e.name == "electrode_rc")
        return eqx.tree_at(lambda m: m.effects[place].tau, model, jnp.maximum(tau, 0.0))
    log_tau = jnp.log(jnp.maximum(tau, _SHORTEST * dt)).astype(model.coefficients.dtype)
    drive = eqx.tree_at(lambda d: d.log_tau, ElectrodeLag(jnp.zeros(())), log_tau)  # it may have rows
    return eqx.tree_at(lambda m: m.drive, model, drive, is_leaf=lambda part: part is model.drive)


def adapted(model: Model, factors: Factors, z: np.ndarray, dt: float) -> Model:
    """Return the model changed by z as it is stored; unchanged parts are the old objects."""
    by = dict(zip(factors.names, z, strict=True))
    new = moved(model, factors, z, dt)
    if not by.get("electrode_tau"):
        new = replace(new, drive=model.drive)
    if not any(by.get(name) for name in ("stiffness", "creep", *TILTS)):
        new = replace(new, encoder=model.encoder)
    return new
