"""Prepare an export: the model in float64 at a sampling rate, its programs, limits and a test vector.

Every language writes the same `Plan`. The test vector is the beginning of the longest identification record. If the
model has none, or that beginning covers less than a quarter of the stroke, it is a sum of sines over the voltage range.
It lasts at least three periods of the resonance at any rate.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from math import comb
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

from ...common.errors import BadInput
from ...common.metrics import e_rms_percent
from ...common.quantity import Units
from ...method.effects.kernels import total_delay
from ...method.invert import steps
from ...method.invert.limits import Limits, limit_slew
from ...method.model.coordinate import from_model
from ...method.model.fitted import Fitted, Origin, fitted_of
from ...method.model.model import Model
from ...method.model.programs import in_double
from ...method.model.units import units_of
from ...method.numerics.scalar.jaxpr import program
from ...method.numerics.scalar.scalars import Program
from ...method.numerics.spline_derivative import derivatives
from .differentiator import ALLOWED, Differentiator, differentiator
from .equilibria import stroke
from .pi_gains import PIGains, pi_gains, slew_of

SAMPLES = 1000  # of the test vector that is exported with the code
_NONE = 1e30  # no limit, in float as in double


@dataclass(frozen=True)
class Precision:
    """A type of numbers in the exported code.

    Attributes:
        real: its name in C.
        kind: the same type of NumPy.
        predicted, planned: bounds of the errors of displacement and force in the test vector, relative to their ranges.
    """

    real: str
    kind: type
    predicted: float
    planned: float


PRECISIONS = {
    "double": Precision("double", np.float64, 1e-9, 1e-9), "single": Precision("float", np.float32, 1e-4, 1e-3)
}  # fmt: skip


@dataclass(frozen=True)
class Written:
    """A one-sample step as a scalar program, and the program of its initial state, fn(y0, u0) -> state."""

    run: Program
    start: Program
    states: int


@dataclass(frozen=True)
class Plan:
    """A model to be exported, with the settings of the export.

    Attributes:
        model: in float64.
        origin: its longest record is the test vector.
        dt: s between two steps.
        name: of files and functions, an identifier.
        precision: "double" or "single".
        held: the voltage is held over a step (`steps.predict`).
        time_constant: of the closed loop, s; None: the default of `pi_gains`; inf: no controller.
    """

    model: Model
    origin: Origin
    dt: float
    name: str
    precision: str = "double"
    held: bool = False
    time_constant: float | None = None

    @property
    def numbers(self) -> Precision:
        """Return the type of the code's numbers."""
        return PRECISIONS[self.precision]

    @property
    def single(self) -> bool:
        """Return whether the code computes in float."""
        return self.precision == "single"

    @property
    def units(self) -> Units:
        """Return the units of the exported code: V and m, or those of the model's records."""
        return units_of(Fitted(self.model, self.origin))

    def predict_step(self, *, held: bool = False) -> steps.Step:
        """Build the step from a voltage to the displacement one sample later, in the exported units."""
        return steps.in_units(steps.predict(self.model, self.dt, held=held), self.units, inverse=False)

    @property
    def inverse_step(self) -> steps.Step:
        """Build the step of the inverse model (voltage for a wanted motion, eq. 13), in the exported units."""
        return steps.in_units(steps.inverse(self.model, self.dt), self.units, inverse=True)

    @cached_property
    def predict(self) -> Written:
        """Return the step from a voltage to the displacement as a scalar program."""
        return _written(self.predict_step(held=self.held))

    @cached_property
    def inverse(self) -> Written:
        """Return the inverse step (voltage for a wanted motion) as a scalar program.

        Its outputs are the voltage, and whether no voltage gives this motion.
        """
        return _written(self.inverse_step)

    @property
    def late(self) -> float:
        """Return the total delay of the model's input, s."""
        return total_delay(self.model.effects)

    @property
    def voltages(self) -> tuple[float, float, float]:
        """Return the lowest and highest voltage and the largest slew (`slew_of`), in the exported units."""
        low, high = map(self.units.input.shown, self.model.domain.voltage_range)
        if self.model.input_map.one_sided:
            low, high = 0.0, max(high, -low)
        slew = float(self.units.input.shown(slew_of(self.model)))
        return min(float(low), 0.0), min(max(float(high), 0.0), _NONE), min(slew, _NONE)

    @property
    def displacements(self) -> tuple[float, float]:
        """Return the trained range of displacement, widened by 5 % on each side; without one, no limit."""
        if not len(self.model.domain.region):
            return -_NONE, _NONE
        low, high = self.model.domain.region[0]
        wide = 0.05 * (high - low)
        scale = self.model.scales.state[0]
        ends = [float(self.units.si.shown(from_model(self.model, v * scale))) for v in (low - wide, high + wide)]
        return min(ends), max(ends)

    @property
    def stroke(self) -> float:
        """Return the largest displacement of the training records, in the exported unit."""
        return float(self.units.si.shown(stroke(self.model)))

    @property
    def silent(self) -> int:
        """Return the number of calls without a target after which the voltage ramps to 0 V."""
        return max(int(np.ceil(0.02 / self.dt)), 1)

    @cached_property
    def differentiator(self) -> Differentiator:
        """Return the window of weights by which the exported code differentiates a target.

        Raises:
            BadInput: single precision is too coarse for it.
        """
        model, full = self.model, stroke(self.model)
        # the smallest motion that single precision has to follow: a fiftieth of the stroke, or 20 um
        smallest = min(full, max(full / 50, 20e-6))
        rounding = float(np.spacing(self.numbers.kind(full))) / np.sqrt(12) / (smallest / 2)
        window, error = differentiator(
            model.physical_coefficients, self.dt, model.natural_frequency, rounding, self.late
        )
        if self.single and error > ALLOWED:
            raise BadInput(
                f"--precision single: at {1 / self.dt:g} Hz a target of {self.units.output.text(smallest, 3)} within "
                f"{self.units.output.text(full, 3)} would have an error of {100 * error:.2g} % of the force; give "
                "--precision double, or another --rate"
            )
        return window

    @cached_property
    def gains(self) -> PIGains:
        """Return the gains of the exported PI controller."""
        return pi_gains(self.model, self.dt, self.time_constant)

    @property
    def reference_time(self) -> float:
        """Return the time constant T of the lags that smooth a target without derivatives, s."""
        return max(1 / self.model.natural_frequency, self.dt)

    def reference(self) -> np.ndarray:
        """Return the matrix that advances the smoothed target [r, T r', ..., T^n r^(n)] by one call.

        r = target / (1 + s T)^(n + 1)
        """
        n = self.model.order
        # n + 1 equal lags: as many as the equation has derivatives, so that x^(n) has no jump
        chain = np.eye(n + 1, k=1)
        chain[n] = [-comb(n + 1, i) for i in range(n + 1)]
        moved = expm(chain * self.dt / self.reference_time) - np.eye(n + 1)
        moved[:, 0] *= -1  # it rests at the target
        return moved

    @cached_property
    def test(self) -> "Vector":
        """Return the test vector that all languages use."""
        return _vector(self)


@dataclass(frozen=True)
class Vector:
    """Test data in exported units: voltage, displacement, motion [y, ..., y^(n)], and limited voltage for it.

    `every`: steps from one number of a file to the next; voltage and motion are linear in between.
    """

    what: str
    every: int
    voltage: np.ndarray
    displacement: np.ndarray
    motion: np.ndarray
    planned: np.ndarray


def plan(
    model: object, name: str, rate: float | None, precision: str, time_constant: float | None = None, *, held=False
) -> Plan:
    """Prepare an export, or refuse the request with the reason.

    Raises:
        BadInput: no single model, a name that is not an identifier, or an invalid rate or precision.
    """
    if not isinstance(model, Model | Fitted):
        raise BadInput(f"{type(model).__name__}: only a single model can be exported; export one of its members")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,39}", name):
        raise BadInput(
            f"--name {name[:60]!r}: is not an identifier; use letters, digits and _, a letter first, at most 40"
        )
    if precision not in PRECISIONS:
        raise BadInput(f"--precision {precision!r}: is not single or double")
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise BadInput(f"--rate {rate!r}: must be a positive number of Hz")
    fitted = fitted_of(model)
    own = fitted.dt
    with jax.enable_x64(True):
        double = in_double(fitted.model)
    made = Plan(double, fitted.origin, 1 / rate if rate else own, name, precision, held, time_constant)
    if not made.dt <= 100 * own:
        raise BadInput(f"--rate {rate:g}: too low; give at least a hundredth of the model's {1 / own:g} Hz")
    return made


def _written(step: steps.Step) -> Written:
    with jax.enable_x64(True):
        zero = jnp.zeros(())
        carry = step.start(zero, zero)
        states = sum(int(np.size(leaf)) for leaf in jax.tree.leaves(carry))
        return Written(program(step.run, carry, jnp.zeros(step.inputs)), program(step.start, zero, zero), states)


def played(step: steps.Step, values: np.ndarray, y0: float, u0: float = 0.0) -> tuple[np.ndarray, ...]:
    """Simulate a one-sample step along its inputs, by JAX in float64, from an actuator held at y0 under u0."""
    with jax.enable_x64(True):
        rows = jnp.asarray(values, jnp.float64).reshape(len(values), -1)
        start = step.start(jnp.asarray(y0, jnp.float64), jnp.asarray(u0, jnp.float64))
        return tuple(np.asarray(a) for a in jax.jit(lambda s, r: jax.lax.scan(step.run, s, r)[1])(start, rows))


def within(plan: Plan, wanted: np.ndarray) -> np.ndarray:
    """Limit a voltage to range and slew, as the exported code does."""
    return limit_slew(np.append(0.0, wanted), Limits(*plan.voltages), plan.dt)[0][1:]


def _vector(plan: Plan) -> Vector:
    # at a high rate the numbers of a file are several samples apart, so that the actuator moves within them
    resonance = 2 * np.pi / plan.model.natural_frequency
    every = max(int(np.ceil(3 * resonance / (SAMPLES * plan.dt))), 1)
    low, high, _ = plan.voltages
    stored, what = plan.origin.long_record, "a record the model was identified on"
    u, y = np.zeros(0), np.zeros(1)
    if stored is not None and stored.seconds > 2 * SAMPLES * every * plan.dt:
        record = stored.record()
        first, voltage = 0 if stored.rest else np.argmin(np.abs(record.voltage)), plan.units.input.shown(record.voltage)
        u = np.interp(np.arange(1, SAMPLES + 1) * every * plan.dt, record.time - record.time[first], voltage)
        u, y = _answered(plan, u, every)
    # a test vector covers three periods of the resonance and a quarter of the stroke
    if np.ptp(y) < 0.25 * plan.stroke:
        what, t = "a sum of sines", np.arange(SAMPLES) * every * plan.dt * plan.model.natural_frequency
        widest = float(plan.model.input_map.voltage(jnp.asarray(plan.model.scales.force)))
        top = high if high < _NONE else float(plan.units.input.shown(widest))
        swell = np.sin(np.pi / 2 * np.arange(SAMPLES) / SAMPLES) ** 2
        u, y = _answered(plan, np.clip(0.75 * top * swell * (1 + 0.3 * np.sin(0.71 * t)), low, high), every)
    # sin^4 starts and ends with three zero derivatives, so the target is at rest there
    smooth = y[np.argmax(np.abs(y))] * 0.4 * np.sin(np.pi * np.arange(len(y)) / len(y)) ** 4
    motion = _between(derivatives(smooth, plan.dt, plan.model.order)[every - 1 :: every], every)
    planned = within(plan, played(plan.inverse_step, motion, 0.0)[0])
    return Vector(what, every, u, y, motion, planned)


def _answered(plan: Plan, coarse: np.ndarray, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate a coarse voltage to every sample; return it with the model's displacement."""
    low, high, _ = plan.voltages
    u = np.clip(coarse, low, high)
    if plan.single:  # the controller reads the vector in float, so the reference must start with the same numbers
        u = u.astype(np.float32).astype(np.float64)
    u = _between(u, every)
    return u, played(plan.predict_step(), u, 0.0)[0]


def _between(coarse: np.ndarray, every: int) -> np.ndarray:
    """Interpolate rows linearly to `every` samples each; before the first row the value is constant."""
    before = np.concatenate([coarse[:1], coarse[:-1]])
    part = (np.arange(1, every + 1) / every).reshape(every, *[1] * (coarse.ndim - 1))
    rows = before[:, None] + part * (coarse - before)[:, None]
    rows[:, -1] = coarse  # not rounded
    return rows.reshape(-1, *coarse.shape[1:])


def half_step(plan: Plan) -> float:
    """Return the largest change of the test displacement in half a sample, divided by the stroke."""
    y = plan.test.displacement
    return float(np.abs(np.diff(y)).max()) / 2 / max(float(np.ptp(y)), plan.stroke)


def rate_error(plan: Plan) -> float | None:
    """Return the error of another rate than the model's, e_rms (%) over its test voltage; None at its own rate.

    The voltage is the same for every rate, so the figures of several rates can be compared.
    """
    own = plan.model.dt
    if abs(plan.dt / own - 1) < 1e-9:
        return None
    known = replace(plan, dt=own).test
    fine = np.arange(len(known.voltage)) * own
    t = np.arange(0, fine[-1], plan.dt)
    (y,) = played(plan.predict_step(), np.interp(t, fine, known.voltage), 0.0)
    late, own_late = (steps.predict(plan.model, d).late * d for d in (plan.dt, own))
    return e_rms_percent(y, np.interp(t - late, fine - own_late, known.displacement))


@contextmanager
def whole_folder(folder: str | Path) -> Iterator[Path]:
    """Create a new folder that appears with all its files or not at all.

    Raises:
        BadInput: it exists, or cannot be made.
    """
    target = Path(folder).resolve()
    if target.exists():
        raise BadInput(f"{folder}: exists already and is not overwritten; give a folder that does not exist yet")
    if not target.parent.is_dir():
        raise BadInput(f"{folder}: there is no folder {target.parent}; create it first")
    try:
        stage = Path(mkdtemp(prefix=".pitp-", dir=target.parent))
    except OSError as error:
        raise BadInput(
            f"{folder}: no permission to write in {target.parent} ({error.strerror}); choose another place"
        ) from None
    try:
        yield stage
        stage.chmod(0o755)
        stage.rename(target)
    finally:
        rmtree(stage, ignore_errors=True)
