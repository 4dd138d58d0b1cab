"""Simulate virtual actuators modelled on the paper's four (section III), for demo, tests and experiments.

    u(t) between samples ──▶ equations of `physics` ──▶ x(t_i) ──▶ + noise, read in 16 bit

Integrated in float64 whatever the session's precision: by Runge-Kutta steps of fixed length that end on every sample,
or by diffrax's adaptive Dopri8 (`method="adaptive"`), the reference for its tests. `cone100`, `cone122` and `cone150`
are one membrane under three masses: one mode, at 7.4 Hz with 100 g (excited by an input at 3.7 Hz through u^2), and
some 10 % of creep; `roll` has one mode at 142 Hz and little creep.
"""

import zlib
from collections.abc import Collection
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ...common.errors import ComputationFailed
from ...method.signal.record import Record, sampling_interval
from .integration import adaptive, advance, fixed, rest, substeps
from .physics import ConeGeometry, Plant, RollGeometry

_CONE = Plant(
    name="cone100",
    rate_hz=1e3,
    mass=0.100,
    max_voltage=6e3,
    noise_std=4e-6,
    sensor_range=20e-3,
    scale=1e-3,
    geometry=ConeGeometry(width=20e-3),
    prestretch=3.0,
    spring=4.66158e-3,
    limit=40.0,
    branches=((2.4e-2, 0.1), (3.0e-2, 1.2), (4.2e-2, 12.0)),
    membrane_damping=1.5e-3,
    friction=0.45,
    capacitance=0.35e-9,
)
_PLANTS = {
    "cone100": _CONE,
    "cone122": replace(_CONE, name="cone122", mass=0.122),
    "cone150": replace(_CONE, name="cone150", mass=0.150),
    "roll": Plant(
        name="roll",
        rate_hz=5e3,
        mass=0.012,
        max_voltage=1.4e3,
        noise_std=0.5e-6,
        sensor_range=1e-3,
        scale=0.1e-3,
        geometry=RollGeometry(width=8e-3),
        prestretch=1.0,
        spring=0.143573,
        limit=2.0,
        branches=((6e-3, 0.1), (6e-3, 1.0), (8e-3, 8.0)),
        membrane_damping=2.5e-5,
        friction=0.5,
        capacitance=2.5e-9,
    ),
}

_HOLDS = ("foh", "zoh")


def plant(name: str) -> Plant:
    """Return the parameters of a virtual actuator by its name.

    Args:
        name: `cone100`, `cone122`, `cone150` (acrylic, under 100, 122, 150 g) or `roll` (silicone).

    Returns:
        its parameters.

    Raises:
        ValueError: no such plant; the message lists all plants.

    Examples:
        >>> pitp.plant("roll").rate_hz
        5000.0
    """
    _one_of("virtual actuator", name, _PLANTS)
    return _PLANTS[name]


def simulate(plant: Plant, time, voltage, *, hold: str = "foh", method: str = "fixed") -> np.ndarray:
    """Simulate the displacement (m) of a virtual actuator under a sampled voltage, from rest and without noise.

    Args:
        plant: the virtual actuator.
        time: uniform sample times in s, shape (T,).
        voltage: input voltage in V, shape (..., T); records of one length share one integration.
        hold: the voltage between samples: "foh" linear, "zoh" held from each sample to the next.
        method: "fixed" Runge-Kutta steps between samples, or "adaptive" (Dopri8, slower, the reference).

    Returns:
        Displacement in m at the sample times, the shape of `voltage`.

    Raises:
        ValueError: shapes that do not fit, non-uniform time, unknown hold or method.
        ComputationFailed: the motion left the range of the spring.

    Examples:
        >>> time = np.arange(100) / 1000
        >>> bool(pitp.simulate(pitp.plant("cone100"), time, np.zeros(100)).max() < 1e-9)
        True
    """
    time, voltage = np.asarray(time, dtype=np.float64), np.asarray(voltage, dtype=np.float64)
    dt = _interval(time, voltage)
    _one_of("hold", hold, _HOLDS)
    _one_of("method", method, ("fixed", "adaptive"))
    rows = voltage.reshape(-1, len(time))
    # in float32, rounding would exceed the error of the steps, 1e-7 of the range
    with jax.enable_x64(True):
        if method == "fixed":
            x = fixed(plant, rows, dt, substeps(plant, dt), hold)
        else:
            x = jnp.stack([adaptive(plant, row, dt, hold) for row in rows])
        x = np.asarray(x)
    # beyond it the Gent spring would change its sign and the motion would be meaningless; nan fails too
    if not (plant.rest_position + x < plant.last_position).all():
        raise ComputationFailed(
            f"{plant.name} moved beyond the range of its spring; keep the voltage below {plant.max_voltage:g} V"
        )
    return x.reshape(voltage.shape)


def record(
    plant: Plant, excitation_name: str, time, voltage, *, seed: int, noise: bool = True, hold: str = "foh"
) -> Record:
    """Simulate a recording of a virtual actuator with sensor noise.

    Args:
        plant: the virtual actuator.
        excitation_name: the record's name; it also separates the noise of records that share a seed.
        time: uniform sample times in s, shape (T,).
        voltage: drive voltage in V, shape (T,).
        seed: of the sensor noise.
        noise: False leaves out the noise and the 16-bit reading.
        hold: as for `simulate`.

    Returns:
        The record, in V and m.

    Raises:
        ValueError, ComputationFailed: as `simulate`.

    Examples:
        >>> time = np.arange(100) / 1000
        >>> pitp.record(pitp.plant("cone100"), "step", time, 2000 * (time > 0), seed=0).samples
        100
    """
    displacement = simulate(plant, time, voltage, hold=hold)
    if noise:
        # a checksum, because Python's `hash` of a text differs from session to session
        rng = np.random.default_rng([seed, zlib.crc32(f"{plant.name}/{excitation_name}".encode())])
        digit = 2.0 * plant.sensor_range / 2**16  # noise first, then rounding and clipping, as a converter reads
        noisy = displacement + plant.noise_std * rng.standard_normal(displacement.shape)
        displacement = np.clip(np.round(noisy / digit), -(2**15), 2**15 - 1) * digit
    return Record(excitation_name, time, voltage, displacement, source=f"virtual actuator {plant.name}")


def stepper(plant: Plant, *, hold: str = "foh"):
    """Build a function that simulates a virtual actuator by one sample, for experiments that close a loop around it.

    Args:
        plant: the virtual actuator; a sample lasts 1 / `plant.rate_hz`.
        hold: as for `simulate`; with "zoh" the second voltage is not used.

    Returns:
        `(step, state)`: the pure function `step(state, u0, u1) -> (state, x)`, which advances one sample from
        the voltage u0 to u1 (V) and gives the displacement x (m) at its end, and the state at rest. `step`
        may be jitted, scanned and vmapped; it works in the precision of the state.

    Raises:
        ValueError: unknown hold.

    Examples:
        >>> step, state = pitp.stepper(pitp.plant("cone100"))
        >>> state, x = step(state, 0.0, 100.0)
    """
    _one_of("hold", hold, _HOLDS)
    dt = 1.0 / plant.rate_hz
    step = partial(advance, plant, dt=dt, count=substeps(plant, dt), hold=hold)
    return step, rest(plant)


def _interval(time, voltage) -> float:
    """Return the sampling interval (s); refuse sample times that are not uniform or do not fit the voltage."""
    if time.ndim != 1 or len(time) < 2 or voltage.shape[-1:] != time.shape:
        raise ValueError(f"time must be (T,) and voltage (..., T), T > 1; got {time.shape} and {voltage.shape}")
    dt = sampling_interval(time)
    # the scan has one dt: a jitter of a hundredth is that of a logged clock, more is not uniform
    if dt <= 0.0 or np.abs(np.diff(time) - dt).max() > 0.01 * dt:
        raise ValueError("time must increase uniformly, to 1 % of a sample")
    return dt


def _one_of(what: str, value: str, known: Collection[str]) -> None:
    """Refuse the value of an option that is not one of the known ones."""
    if value not in known:
        raise ValueError(f"unknown {what} {value!r}; use one of {', '.join(known)}")
