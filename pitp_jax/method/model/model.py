"""The model: a differential equation of order n whose coefficients depend on the state (paper, eqs. 2-7).

    F = sigma_off + sum_{i=0}^{n} sigma_i x^(i),   F = map(V),  V = drive(u)
    sigma = tokens(S, m),   S = [x, x', ..., x^(n-1)]

In scaled coordinates X_i = x^(i) / scale_i and force / force_scale everything is of order one; a token is the
nominal coefficient times a positive factor, so a zero encoder is exactly the identified linear model.
"""

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from itertools import pairwise
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...common.errors import BadInput
from .constants import Constants, number, numbers
from .domain import Domain
from .dominant import dominant_frequency
from .drive import AbstractDrive, DirectDrive
from .encoder import AbstractEncoder, ConstantEncoder
from .input_map import AbstractInputMap, SquareInput
from .memory import AbstractMemory, NoMemory
from .own_encoder import as_encoder, own_module
from .positive import positive_factor
from .rows import Rows
from .sections import product, sections_of
from .substeps import substeps as substeps_of

Hold = Literal["foh", "zoh", "bandlimited"]


class Output(Constants):
    """The sensor's offset and direction: x = polarity (y - offset), y as measured (base unit).

    `offset`: the reading y at rest, base unit. `polarity`: 1, or -1 if y decreases as the actuator extends.
    Its numbers are `constants`: exact on the host, and no parameters of the model.
    """

    offset: float = eqx.field(converter=number, default=0.0)
    polarity: float = eqx.field(converter=number, default=1.0)

    def to_model(self, y):
        """Convert sensor readings y (base unit) to displacements x from the rest position, same unit and shape."""
        return self.polarity * (y - self.offset)

    def to_rig(self, x):
        """Convert displacements x from the rest position (base unit) to sensor readings y, same unit and shape."""
        return self.polarity * x + self.offset


class Scales(Constants):
    """Units of the scaled coordinates: m/s^i for each derivative x^(i), and V^2 (or V) for the force.

    `sections` (order 3 and up): the nominal polynomial's factors (`sections_of`), the units of its variable tokens.
    Its numbers are `constants`: exact on the host, and no parameters of the model. Cast them to a program's precision.
    """

    state: tuple[float, ...] = eqx.field(converter=numbers)
    force: float = eqx.field(converter=number)
    sections: tuple[float, ...] = eqx.field(converter=numbers, default=())

    @property
    def rates(self) -> list:
        """Return the factors r_i (1/s) in dX_i/dt = r_i X_{i+1} of the scaled derivatives X_i."""
        return [upper / lower for lower, upper in pairwise(self.state)]


class Model(eqx.Module):
    """An actuator's equation of motion of order n, whose coefficients depend on its state (paper, eqs. 2 to 7).

        F(t) = sigma_off(S, m) + sum_{i=0}^{n} sigma_i(S, m) x^(i)(t)
        F = V^2 (or V),   V: the input u behind the drive,   S = [x, ..., x^(n-1)],   m: lags of x
        sigma_i = a_i g(encoder(S, m))_i,   g(0) = 1          a_i: the nominal (linear) model

    All parts work in scaled coordinates X_i = x^(i) / scales.state_i and F / scales.force, which are of order one.

    Attributes:
        coefficients: nominal tokens in scaled coordinates, shape (n + 1,): a_i scales.state_i / scales.force;
            `physical_coefficients` holds a_i in V^2 s^i / m.
        encoder: g's argument, the logits from the scaled S and m; constant for a linear model. Any other Equinox
            module is wrapped (`OwnEncoder`).
        memory: the lags m of x.
        input_map: F of the voltage, squared or linear.
        drive: the lag of the electrode between u and V.
        output: the sensor's offset and direction.
        scales: m / s^i of every derivative, V^2 (or V) of the force.
        effects: further parts of the catalogue, each at its place between input and sensor.
        hold: the voltage between samples: "foh" (linear), "zoh" (constant) or "bandlimited".
        substeps: RK4 steps per sample.
        domain: range of its training data: sampling, voltages, region.
    """

    coefficients: Float[Array, " tokens"]
    input_map: AbstractInputMap
    encoder: AbstractEncoder = eqx.field(converter=as_encoder)
    memory: AbstractMemory
    output: Output
    scales: Scales
    hold: Hold = eqx.field(static=True, default="foh")
    substeps: int = eqx.field(static=True, default=1)
    domain: Domain = Domain(1.0)
    drive: AbstractDrive = DirectDrive()
    effects: tuple = ()

    def __repr__(self) -> str:
        """Return two lines of text: the kind of model, and its coefficients."""
        part = own_module(self.encoder) or self.encoder
        kind = "identified" if isinstance(part, ConstantEncoder) else f"trained ({type(part).__name__})"
        parts = [f"{self.memory.size} memory states"] if self.memory.size else []
        parts += [effect.name for effect in self.effects]
        head = f"Model: {kind}, order {self.order}, input map {self.input_map.name}"
        try:
            numbers = ", ".join(f"a{i} {a:.4g}" for i, a in enumerate(self.physical_coefficients))
            hertz = f"; {self.natural_frequency / (2 * np.pi):.4g} Hz"
        except Exception:  # under a transformation the coefficients are not numbers
            numbers, hertz = "traced coefficients", ""
        return f"{head}{''.join(f', {p}' for p in parts)}\n  {numbers}{hertz}"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"

    @property
    def order(self) -> int:
        """Return the order n of the differential equation."""
        return len(self.scales.state) - 1

    @property
    def physical_coefficients(self) -> np.ndarray:
        """Return the nominal coefficients a_0 ... a_n of sum a_i x^(i) = F in V^2 s^i / m (or V s^i / m)."""
        return np.asarray(self.coefficients, np.float64) * self.scales.force / self.scales.state

    @property
    def natural_frequency(self) -> float:
        """Return the resonance frequency (`dominant_frequency`), rad/s; at order 2 it is sqrt(k / m).

        A pure integrator has none; then the frequency of its identification records is returned.
        """
        # the scale of x' over that of x
        return dominant_frequency(self.physical_coefficients) or float(self.scales.rates[0])

    @property
    def dt(self) -> float:
        """Return the sampling interval of the model's training records, s."""
        return float(self.domain.dt)

    def tokens(
        self, features: Float[Array, " features"], *, key=None
    ) -> tuple[Float[Array, " tokens"], Float[Array, ""]]:
        """Compute the coefficients sigma_0 ... sigma_n, shape (n + 1,), and sigma_off from the features of one instant.

        All are in scaled units (`scales`); `features` are the scaled state, then the memories. `key` turns dropout on.
        """
        tokens, offset = self.tokens_from(self.encoder(features, key=key))
        return jnp.stack(tokens), offset

    def tokens_from(self, logits: Rows | Float[Array, " logits"]) -> tuple[list[Array], Array]:
        """Compute the coefficients (tokens) and the offset token from an encoder's logits, one array per token.

        Their polynomial is stable (`sections`): from order 3 on the factors act on the nominal's sections, and the
        coefficients follow in proportion.
        """
        if len(logits) != self.order + 2:
            raise BadInput(f"the encoder returns {len(logits)} logits; order {self.order} needs {self.order + 2}")
        *factor, offset = [*map(positive_factor, logits[:-1]), logits[-1]]
        if self.order >= 3:  # up to order 2 positive tokens are stable by themselves (Routh-Hurwitz)
            (*sections, last), nominal = factor, list(jnp.asarray(self.scales.sections, offset.dtype))
            moved = product([f * s for f, s in zip(sections, nominal, strict=True)])
            # ratios to the nominal's own product, so that rounding of the sections cancels
            factor = [last * a * (1 / b) for a, b in zip(moved, product(nominal), strict=True)]
        return [self.coefficients[i] * f for i, f in enumerate(factor)], offset

    def sampled(self, dt: float, hold: Hold) -> "Model":
        """Return the model for another sampling interval (s) and another `hold`, with the same coefficients."""
        domain = replace(self.domain, dt=dt)
        count = substeps_of(self.physical_coefficients, dt)
        return replace(self, substeps=count, hold=hold, domain=domain)

    def changed(self, factors: np.ndarray) -> "Model":
        """Return the model with its nominal coefficients multiplied by these factors, shape (n + 1,)."""
        coefficients = np.asarray(self.coefficients, np.float64) * factors  # rounded once, at the end
        return replace(self, coefficients=jnp.asarray(coefficients, self.coefficients.dtype))


def linear_model(
    coefficients: np.ndarray | Sequence[float],
    *,
    dt: float | None = None,
    domain: Domain | None = None,
    input_map: AbstractInputMap | None = None,
    hold: Hold = "foh",
    substeps: int | None = None,
    output: Output | None = None,
    state_scale: np.ndarray | None = None,
    force_scale: float | None = None,
) -> Model:
    """Build a linear model sum a_i x^(i) = F from its coefficients a_0 ... a_n (V^2 s^i / m).

    Set other parts by `dataclasses.replace(model, encoder=..., memory=..., drive=...)`.

    Args:
        coefficients: a_0 ... a_n of stable roots, shape (n + 1,); V^2 s^i / m, for a linear input V s^i / m.
        dt: sampling interval, s.
        domain: sampling interval and limits, instead of `dt`.
        input_map: `SquareInput()` (default) or `LinearInput()`.
        hold: how the voltage runs between samples: "foh" (linear), "zoh" (constant) or "bandlimited".
        substeps: Runge-Kutta steps a sample; None: from the poles.
        output: offset and direction of the sensor; default 0 and +1.
        state_scale: unit of every derivative, m / s^i, shape (n + 1,); None: the motion under a unit force at the
            natural frequency.
        force_scale: unit of the force, V^2 or V; None: the force of the highest voltage, or of 1 kV (1 V for a linear
            input) without a limit.

    Returns:
        the model.

    Raises:
        BadInput: neither `dt` nor `domain`.

    Examples:
        >>> model = pitp.linear_model([1e9, 6.4e6, 1e6], dt=1e-3)
        >>> round(model.natural_frequency / (2 * np.pi), 2)
        5.03
    """
    if domain is None and dt is None:
        raise BadInput("linear_model needs dt, the sampling interval in s")
    domain = Domain(number(dt)) if domain is None else domain
    coefficients, input_map = np.asarray(coefficients, np.float64), input_map or SquareInput()
    if force_scale is None:
        highest = np.abs(domain.voltage_range).max()
        usual = 1e3 if input_map.one_sided else 1.0
        known = highest if np.isfinite(highest) and highest > 0 else usual
        force_scale = float(input_map.force(np.asarray(known, float)))
    if state_scale is None:
        powers = (dominant_frequency(coefficients) or 1 / domain.dt) ** np.arange(len(coefficients))
        state_scale = force_scale / np.abs(coefficients * powers).max() * powers
    scaled = coefficients * np.asarray(state_scale) / force_scale
    return Model(
        coefficients=jnp.asarray(scaled, jnp.float32),
        input_map=input_map,
        encoder=ConstantEncoder(len(coefficients) + 1),
        memory=NoMemory(),
        output=output or Output(),
        scales=Scales(state_scale, force_scale, sections_of(coefficients) if len(coefficients) > 3 else ()),
        hold=hold,
        substeps=substeps_of(coefficients, domain.dt) if substeps is None else substeps,
        domain=domain,
    )
