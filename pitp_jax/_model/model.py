"""The model: an ODE of order n whose coefficients are read off the current state (paper, eqs. 2-7).

    F = sigma_off + sum_{i=0}^{n} sigma_i x^(i),   F = map(V),  V = drive(u)
    sigma = tokens(S, m),   S = [x, x', ..., x^(n-1)]

In scaled coordinates X_i = x^(i) / scale_i and force / force_scale everything is of order one; a token is the
nominal coefficient times a positive factor, so a zero encoder is exactly the identified linear model.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Literal, NoReturn

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._errors import BadInput
from .._record.long_record import LongRecord
from .._record.record import Record
from .._record.sets import ABSOLUTE
from .dominant import dominant_frequency
from .drive import AbstractDrive, DirectDrive
from .encoder import AbstractEncoder, ConstantEncoder
from .input_map import AbstractInputMap
from .memory import AbstractMemory, NoMemory
from .positive import positive_factor
from .rows import Rows
from .sections import product, sections_of

Hold = Literal["foh", "zoh", "bandlimited"]


@dataclass(frozen=True)
class Provenance:
    """What a model was made from: read on the host alone, and no part of what compiles (`programs`).

    Attributes:
        dt: sampling interval of the training records, s.
        displacement_unit, voltage_unit: units the user's files had.
        voltage_range: lowest and highest drive voltage seen, V.
        slew: highest voltage slew seen, V/s.
        region: per feature (S then memory, scaled) lowest and highest value trained on.
        notes: JSON text, the identification and training summary `pitp info` prints.
        covariance: of ln a_0 ... ln a_n as identified, n + 1 rows; empty where it is not known, or no longer holds.
        misfit: what the nominal left of the records it was identified on, over their noise (rms); infinite likewise.
        long_record: the longest record the nominal was identified on, which training holds creep to.
        clock: what the records' clock showed when their session began, s; 0 unless it shows absolute time.
    """

    dt: float
    displacement_unit: str = "m"
    voltage_unit: str = "V"
    voltage_range: tuple[float, float] = (0.0, float("inf"))
    slew: float = float("inf")
    region: tuple[tuple[float, float], ...] = ()
    notes: str = "{}"
    covariance: tuple[tuple[float, ...], ...] = ()
    misfit: float = float("inf")
    long_record: LongRecord | None = None
    clock: float = 0.0

    def with_(self, **changes) -> "Provenance":
        """Copy it with some fields replaced."""
        return replace(self, **changes)

    def age(self, time: float) -> float:
        """Compute how long the session had lasted when a clock showed this time, s; 0 by a clock of another kind."""
        # a record that counts from its own start says nothing about a session dated by the calendar
        age = float(time) - self.clock
        return age if abs(age) < ABSOLUTE else 0.0

    def driven_by(self, records: Sequence[Record]) -> "Provenance":
        """Widen range and slew of the voltage to those of these records."""
        low, high = self.voltage_range  # never narrower: what an earlier session has shown is still known
        return self.with_(
            voltage_range=(
                min(low, *(float(r.voltage.min()) for r in records)),
                max(high, *(float(r.voltage.max()) for r in records)),
            ),
            slew=max(self.slew, *(float(np.abs(np.diff(r.voltage)).max()) / r.dt for r in records)),
        )


class Removed:
    """Stands where a model's provenance was: nothing of it can be read."""

    def __getattr__(self, name: str) -> NoReturn:
        """Fail with advice, but for names that Python itself asks about."""
        if name.startswith("__"):
            raise AttributeError(name)
        raise RuntimeError(
            f"provenance.{name} is not there under jit, where models of any origin share one program: "
            "read it before, or put it back with replace(model, provenance=...)"
        )


REMOVED = Removed()


def _numbers(values) -> np.ndarray:
    return np.asarray(values, np.float64)


class Output(eqx.Module):
    """The sensor's zero and direction: x = polarity (y - offset), y in the rig's coordinates (m or V).

    NumPy's float64, exact on the host; under jit they are arguments of the program.
    """

    offset: float = eqx.field(converter=np.float64, default=0.0)
    polarity: float = eqx.field(converter=np.float64, default=1.0)

    def to_model(self, y):
        """Convert measured output to displacement from rest."""
        return self.polarity * (y - self.offset)

    def to_rig(self, x):
        """Convert displacement from rest to what the sensor would read."""
        return self.polarity * x + self.offset


class Scales(eqx.Module):
    """Units of the scaled coordinates: x^(i) in m/s^i (n + 1 of them) and force in V^2 (or V).

    `sections` (order 3 and up): the nominal polynomial's factors (`sections_of`), the units of its variable tokens.
    NumPy's float64, exact on the host; under jit they are arguments of the program: cast them to its precision.
    """

    state: Float[np.ndarray, " tokens"] = eqx.field(converter=_numbers)
    force: float = eqx.field(converter=np.float64)
    sections: Float[np.ndarray, " sections"] = eqx.field(converter=_numbers, default=())

    @property
    def rates(self) -> Float[np.ndarray | Array, " order"]:
        """dX_i/dt = rates_i X_{i+1}, in 1/s."""
        return self.state[1:] / self.state[:-1]


class Model(eqx.Module):
    """Input map, encoder, memory and effects around one nominal coefficient vector.

    Attributes:
        coefficients: nominal tokens in scaled coordinates, shape (n + 1,): a_i scale_i / force_scale.
        encoder, memory, input_map, output, scales, drive, effects: the parts; `effects` act on the force side.
        hold: how the voltage runs between samples: "foh" (linear), "zoh" (constant) or "bandlimited".
        substeps: RK4 steps per sample.
        provenance: what it was made from.
    """

    coefficients: Float[Array, " tokens"]
    input_map: AbstractInputMap
    encoder: AbstractEncoder
    memory: AbstractMemory
    output: Output
    scales: Scales
    hold: Hold = eqx.field(static=True, default="foh")
    substeps: int = eqx.field(static=True, default=1)
    provenance: Provenance | Removed = eqx.field(static=True, default=Provenance(1.0))
    drive: AbstractDrive = DirectDrive()
    effects: tuple = ()

    def __repr__(self) -> str:
        """Describe it in two lines: what it is, and its coefficients."""
        kind = "identified" if isinstance(self.encoder, ConstantEncoder) else f"trained ({type(self.encoder).__name__})"
        parts = [f"{self.memory.size} memory states"] if self.memory.size else []
        parts += [effect.name for effect in self.effects]
        head = f"Model: {kind}, order {self.order}, input map {self.input_map.name}"
        try:
            numbers = ", ".join(f"a{i} {a:.4g}" for i, a in enumerate(self.physical_coefficients))
            hertz = f"; {self.natural_frequency / (2 * np.pi):.4g} Hz"
        except Exception:  # under a transformation the coefficients are no numbers
            numbers, hertz = "traced coefficients", ""
        return f"{head}{''.join(f', {p}' for p in parts)}\n  {numbers}{hertz}"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"

    @property
    def order(self) -> int:
        """ODE order n."""
        return len(self.scales.state) - 1

    @property
    def physical_coefficients(self) -> np.ndarray:
        """Nominal a_0 ... a_n in V^2 s^i / m (or V s^i / m), shape (n + 1,)."""
        return np.asarray(self.coefficients, np.float64) * self.scales.force / self.scales.state

    @property
    def natural_frequency(self) -> float:
        """Frequency of the mode that is meant by the resonance, rad/s (`dominant_frequency`): sqrt(k / m) at order 2.

        A bare integrator has none: there it is that of the motion it was identified on.
        """
        # the scale of x' over that of x
        return dominant_frequency(self.physical_coefficients) or float(self.scales.rates[0])

    def tokens(
        self, features: Float[Array, " features"], *, key=None
    ) -> tuple[Float[Array, " tokens"], Float[Array, ""]]:
        """Compute the scaled tokens sigma_0 ... sigma_n and the offset token at one instant (S then memory, scaled)."""
        tokens, offset = self.tokens_from(self.encoder(features, key=key))
        return jnp.stack(tokens), offset

    def tokens_from(self, logits: Rows | Float[Array, " logits"]) -> tuple[list[Array], Array]:
        """Compute tokens and offset token, row by row, from an encoder's logits.

        Their polynomial is stable (`sections`): from order 3 on the factors act on the nominal's sections, and the
        coefficients follow in proportion.
        """
        *factor, offset = [*map(positive_factor, logits[:-1]), logits[-1]]
        if self.order >= 3:  # up to order 2 positive tokens are stable by themselves (Routh-Hurwitz)
            (*sections, last), nominal = factor, list(jnp.asarray(self.scales.sections, offset.dtype))
            moved = product([f * s for f, s in zip(sections, nominal, strict=True)])
            # ratios to the nominal's own product: what rounding did to the sections cancels
            factor = [last * a * (1 / b) for a, b in zip(moved, product(nominal), strict=True)]
        return [self.coefficients[i] * f for i, f in enumerate(factor)], offset

    def changed(self, factors: np.ndarray) -> "Model":
        """Multiply the nominal coefficients by these factors, shape (n + 1,)."""
        coefficients = np.asarray(self.coefficients, np.float64) * factors  # rounded once, at the end
        return replace(self, coefficients=jnp.asarray(coefficients, self.coefficients.dtype))


def check_model(model: object) -> None:
    """Refuse what is no model, and say where one is.

    Raises:
        BadInput: saying what was given, and what to give.
    """
    if not isinstance(model, Model):
        inside = isinstance(getattr(model, "model", None), Model)
        kind = type(model).__name__
        remedy = f"give its .model (the {kind} holds one)" if inside else "give pitp.load(FILE) or identify(...).model"
        raise BadInput(f"a {kind} is no model: {remedy}")


def linear_model(
    coefficients: np.ndarray,
    *,
    input_map: AbstractInputMap,
    state_scale: np.ndarray,
    force_scale: float,
    output: Output,
    hold: Hold,
    substeps: int,
    provenance: Provenance,
) -> Model:
    """Build a model with constant tokens from coefficients a_0 ... a_n (V^2 s^i / m), no memory, no effects."""
    coefficients = np.asarray(coefficients, np.float64)
    scaled = coefficients * np.asarray(state_scale) / force_scale
    return Model(
        coefficients=jnp.asarray(scaled, jnp.float32),
        input_map=input_map,
        encoder=ConstantEncoder(len(coefficients) + 1),
        memory=NoMemory(),
        output=output,
        scales=Scales(state_scale, force_scale, sections_of(coefficients) if len(coefficients) > 3 else ()),
        hold=hold,
        substeps=substeps,
        provenance=provenance,
    )
