"""Initial guesses for all effects of a search, and conversion between models and parameter vectors.

A form is one way to start an effect: a catalogue row with its parameters in the model's scaled coordinates. An effect
may have several forms. `slots` are the core's three coefficients, then the parameters of every row.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from ..effects import CATALOGUE, lookup
from ..effects.effect import Effect
from ..effects.found_term import TERM
from ..effects.physical import in_scales
from ..effects.spec import EffectSpec, Parameter
from ..model.drive import DirectDrive
from ..model.encoder import ConstantEncoder
from ..model.fitted import Fitted, fitted_of
from ..model.model import Model, linear_model

FREE = "term"  # a force without a name
# faults of the records: they are removed from them and are not parts of a model
SHIFT = EffectSpec(
    "clock_shift", "early output", (Parameter("time", "s", off=0.0),),
    "The output column is early beside the input column.", "y(t) = x(t + T), T = time", "record", "IN",
    law=lambda p, u, z: u,
)  # fmt: skip
LAGGED = EffectSpec(
    "clock_shift", "lagging input",
    (Parameter("tau", "s", off=0.0), Parameter("time", "s", positive=False, off=0.0)),
    "The input column is the voltage behind a low pass of its own channel, and may be early or late.",
    "V(t) = (u + tau u')(t + T), T = time", "record", "IN",
    law=lambda p, u, z: u,
)  # fmt: skip
FAULTS = SHIFT, LAGGED
CHANGED = "parameter_change"  # the label of coefficients that have changed
_SIDES = 1.2  # the excited band extends beyond a resonance by at least this factor on both sides
# names that share a law in one of their forms: a hypothesis holds at most one form of each
_GROUPS = {
    "stiffening": "spring", "softening": "spring", "creep": "viscoelastic", "relaxation": "viscoelastic",
    "charge_leak": "charge", "charge_retention": "charge", "electrode_rc": "electrode", "bleeder": "electrode",
    TERM.name: FREE,
}  # fmt: skip


@dataclass(frozen=True)
class Form:
    """An effect with initial guesses of its parameters; an effect may have several such forms.

    Attributes:
        name: effect in the search, which takes at most one form of an effect.
        spec: the row; None: the coefficients of the nominal.
        start: values of its parameters, by their slots.
    """

    name: str
    spec: EffectSpec | None
    start: dict[str, float]

    @property
    def free(self) -> tuple[str, ...]:
        """Return the names of the parameters to fit, without those whose initial guess has no influence."""
        moved = (k for k, v in self.start.items() if v != OFF[INDEX[k]] or SHAPE[INDEX[k]])
        return tuple(k for k in moved if not FIXED[INDEX[k]])

    @property
    def stiffness(self) -> float:
        """Return the stiffness that the effect adds, relative to the stiffness of the linear core."""
        return next(iter(self.start.values())) if self.spec and self.spec.stiffens else 0.0


@dataclass(frozen=True)
class Scale:
    """Units of the initial guesses, from the nominal model and the records (`scale_of`): scaled x, s, scaled force."""

    tau: float
    dt: float
    duration: float
    session: float
    reach: float
    top: float
    bottom: float
    speed: float
    acceleration: float
    fall: float
    voltage: float
    slew: float
    area: float
    a0: float
    a1: float
    a2: float
    force: float
    radian: float = 0.0  # 1 / rad in scaled coordinates; 0: the output is not an angle
    fastest: float = np.inf  # scaled speed that 0.5 % of the samples exceed
    low: float = 0.0  # rad/s, lower and upper end of the excited band
    high: float = np.inf
    rates: tuple[float, float] = (1.0, 1.0)  # 1/s, from these units of x' and x'' to the model's scaled ones

    def stored(self, p: Parameter) -> float:
        """Return the factor from a parameter in these units to the model's scaled ones."""
        return float(self.rates[0] ** -(p.speed + p.acceleration) * self.rates[1] ** -p.acceleration)


def forms(s: Scale) -> list[Form]:
    """Return the effects that can be fitted to these records, with their initial guesses."""
    made, within = [], bounds(s)
    for key, *starts in _starts(s):
        spec = _BY_KEY[key]
        ends = [within.get(k, (-np.inf, np.inf)) for k in slots_of_row(spec)]
        if all(low < high for low, high in ends):
            units = [s.stored(p) for p in spec.parameters]
            begun = [[float(np.clip(v * u, *e)) for v, u, e in zip(n, units, ends, strict=True)] for n in starts]
            made += [Form(group(spec.name), spec, dict(zip(slots_of_row(spec), n, strict=True))) for n in begun]
    # a changed mass: heavier and lighter; without a mass, a small and a large one relative to the damping
    masses = (1.2 * s.a2, 0.85 * s.a2) if s.a2 > 0 else (0.05 * s.tau * _damping(s), 0.5 * s.tau * _damping(s))
    mass = lookup("added_mass")
    return made + [Form(mass.name, mass, {"a2": a2}) for a2 in masses]


def bounds(s: Scale) -> dict[str, tuple[float, float]]:
    """Return the bounds of parameters that the records determine only within their own range, by name.

    If a force changes over a speed or a distance beyond all recorded ones, this parameter only scales the force.
    """
    # a lagging input may be late by a sample of its own; more would be a delay, which a machine can have
    span, limits = s.top - s.bottom, {AHEAD: (-s.dt, np.inf)}
    for name, p in zip(NAMES[3:], _NUMBERS, strict=True):
        if p.unit == "s" and p.off is None:  # a memory slower than ten sessions is an integral
            # one of the input faster than the plant is a filter of it, not a charge
            limits[name] = s.tau * p.slow, 10 * max(s.duration, s.session)
        elif p.resonance:  # outside the band it is equivalent to a lag or a stiffness
            limits[name] = _SIDES * s.low, s.high / _SIDES
        elif p.off is None and (p.speed == 1 or p.length == 1):
            limits[name] = 0.0, s.fastest if p.speed else span
    return limits


def group(name: str) -> str:
    """Return the name under which a search tries an effect; effects with a common law share one."""
    return _GROUPS.get(name, name)


def slots_of_row(spec: EffectSpec) -> tuple[str, ...]:
    """Return the names of an effect's parameters in the parameter vector."""
    return tuple(f"{spec.key}, {p.name}" for p in spec.parameters)


def _damping(s: Scale) -> float:
    # a plant without its own damping still needs a unit of damping
    return max(s.a1, 0.1 * s.tau * max(s.a0, s.force / s.reach))


def _starts(s: Scale) -> Iterator[tuple]:
    """Yield the key of every catalogue form with the initial guesses of its parameters."""
    x, pull, tau, volts, damping = s.reach, s.force, s.tau, s.voltage, _damping(s)
    span, middle = s.top - s.bottom, (s.top + s.bottom) / 2
    terms = (0, -0.1, 0), (0.2, 0, 0), (0.05, 0.1, 0), (0, 0.1, 0.1)
    curve = (0.05, 0), (-0.05, 0), (0, 0.03), (0.03, 0.03)
    branches = (0.2, 3.0), (1.0, 3.0), (0.2, 20.0), (1.0, 20.0), (0.3, 100.0)
    modes = [(f / tau, 0.05) for f in (0.6, 1.6, 3.5)]
    yield "stiffening: cubic", (0.1 / x**2,), (0.5 / x**2,)
    yield "stiffening: polynomial", *((c2 / x, c3 / x**2, c5 / x**4) for c2, c3, c5 in terms)
    yield "stiffening: limited chain", *((f / x,) for f in (0.3, 0.6, 0.85))
    yield "softening: quadratic", (0.2 / x,)
    yield "softening: saturating", (0.6 / x,)
    yield "softening: exponential", (0.5 / x,)
    yield "softening: gravity", *((f / x,) for f in (0.5, 1.2, 2.5))
    if s.radian:
        yield "softening: weight on an arm", (0.1, s.radian), (-0.1, s.radian)
    yield "softening: root", (1 / x,)
    # a law that begins at a level starts at several within the data: between two of them its cost has other minima
    ends = [(k, f) for k in (2.0, 20.0) for f in (0.6, 0.75, 0.9, 0.97)]
    yield "end_stop: above", *((k, s.bottom + f * span) for k, f in ends)
    yield "end_stop: below", *((k, f * span - s.top) for k, f in ends)
    yield "end_stop: each side", *((k, middle + 0.375 * span, 0.375 * span - middle) for k in (2.0, 20.0))
    sides = [(middle + f * span, f * span - middle) for f in (0.4, 0.47)]
    yield "end_stop: each side, damped", *((k, *ends, tau) for k in (3.0, 20.0) for ends in sides)
    if s.acceleration > 0:
        yield "force_limit: inside the loop", *((f / (s.a2 * s.acceleration),) for f in (0.5, 0.7, 1.0, 1.4, 2.0))
        yield "slack: free fall", *((f / s.fall,) for f in np.geomspace(0.45, 2.2, 8))
    yield "creep: one branch", *((k, f * tau) for k, f in branches)
    yield "hysteresis: Dahl", (5.0, 0.01 * x), (0.3, 0.1 * x), (0.3, 0.5 * x)
    yield "hysteresis: Bouc-Wen, either sign", *((0.5, w * x, g) for w, g in ((0.1, -0.5), (0.5, -0.5), (0.5, 0.5)))
    yield "hysteresis: plays", (0.4, 0.06 * x), (0.4, 0.3 * x)
    yield "hysteresis: Dahl at four widths", (0.3, 0.3 * x, 0.5, 2.0)
    yield (
        "hysteresis: Dahl of the command's integral",
        *((c * volts, f * s.area) for c in (0.5, -0.5) for f in (0.1, 0.5)),
    )
    yield "hysteresis: plays of the drive", *((*4 * (0.1,), f * volts) for f in (0.5, 1.5))
    yield "coulomb_friction: Coulomb", *((f * pull,) for f in (0.01, 0.02, 0.05, 0.1, 0.2))
    yield "coulomb_friction: Stribeck", (0.04 * pull, 0.5, 0.1 * s.speed)
    yield "coulomb_friction: smooth", (0.05 * pull, 0.05 * s.speed)
    yield (
        "coulomb_friction: loaded by the spring",
        *((f * pull, mu) for f, mu in ((0.02, 0.1), (0.1, 0.3), (0.003, 0.05))),
    )
    yield "coulomb_friction: loaded by spring and mass", (0.02 * pull, 0.1), (0.1 * pull, 0.3)
    yield "coulomb_friction: bristles under load", (0.1, 0.03, 0.02 * x), (0.3, 0.1, 0.1 * x)
    yield "drag: quadratic", *((f * damping / s.speed,) for f in (0.3, 2.0))
    yield "drag: three powers", *(tuple(f * damping / s.speed**n for n in (0.5, 1, 2)) for f in (0.1, 0.7))
    yield "electrode_rc: one lag", (0.2 * tau,), (tau,)
    yield "electrode_rc: far part", (0.2 * tau, 0.8), (tau, 0.8)
    yield "bleeder: one lag each way", (0.05 * tau, 0.5 * tau), (0.5 * tau, 0.05 * tau), (0.3 * tau, 2 * tau)
    yield "force_lag: one lag", (0.2 * tau,), (tau,)
    yield "slew_limit: rate limit", *((1 / (f * s.slew),) for f in (0.1, 0.2, 0.4, 0.6, 0.8))
    yield "voltage_clip: hard", *((1 / (f * volts),) for f in (0.4, 0.55, 0.7, 0.8, 0.87, 0.93, 0.97))
    yield "voltage_offset: constant", (-0.05 * volts,), (0.05 * volts,)
    yield "dead_zone: symmetric", *((f * volts,) for f in (0.02, 0.05, 0.1, 0.2, 0.35))
    yield "delay: pure", (s.dt,), (0.1 * tau,), (0.5 * tau,)
    yield SHIFT.key, (0.5 * s.dt,), (0.1 * tau,)
    yield LAGGED.key, (s.dt, -0.5 * s.dt), (0.2 * tau, -0.5 * s.dt)
    yield "charge_leak: one trap", (0.15, 5 * tau), (0.15, 50 * tau)
    yield "charge_retention: one store", (0.15, 5 * tau), (0.15, 50 * tau)
    yield "stretch_coupling: linear", (0.1 / x,), (-0.1 / x,)
    yield "stretch_coupling: exponential", (-1 / x,)
    yield "dielectric_saturation: rational", (0.1 / pull,), (0.6 / pull,)
    yield "dielectric_saturation: sharp", (0.5 / pull,), (1.5 / pull,)
    yield "second_mode: between film and sensor", *((0.3, *m) for m in modes)
    yield "second_mode: hung on", *((0.2, *m) for m in modes)
    if s.session > 1.5 * s.duration:
        yield "stiffness_drift: settling", (0.1, 0.3 * s.session), (-0.1, 0.3 * s.session)
    yield "sensor_lag: one lag", (0.2 * tau,), (tau,)
    yield "sensor_nonlinearity: quadratic and cubic", *((c2 / x, c3 / x**2) for c2, c3 in curve)
    yield "sensor_nonlinearity: saturating", (0.5 / x,)
    yield "sensor_nonlinearity: folded", (0.0,)
    yield "backlash: play", *((f * x,) for f in (0.02, 0.04, 0.1, 0.2, 0.5))
    yield "backlash: coasting", (0.1 * x, 0.05 / tau), (0.1 * x, 0.5 / tau)
    yield "mullins: exponential", (0.15, 0.5 * x)
    yield "sensor_gain: share", (0.2,), (-0.2,)
    yield "feedthrough: of the force", (0.05 * x / volts**2,), (-0.05 * x / volts**2,)
    yield "feedthrough: of the input", (0.05 * x / volts,), (-0.05 * x / volts,)
    by_place = [(f * damping / x, 0, 0) for f in (-0.3, 0.5)] + [(0, f * damping / x**2, 0) for f in (0.3, 2.0)]
    yield TERM.key, *by_place, *((0, 0, f * damping / pull) for f in (-0.3, 0.5))


_BY_KEY = {spec.key: spec for spec in (*CATALOGUE, TERM, *FAULTS)}
# only the names of these starts are used, not their sizes
_ONES: dict[str, Any] = dict.fromkeys(Scale.__dataclass_fields__, 1.0)
_UNIT = Scale(**_ONES | {"session": 9.0, "rates": (1.0, 1.0)})
_STARTED = {_BY_KEY[key] for key, *_ in _starts(_UNIT)}
_BESIDE = {lookup(*spec.second) for spec in _STARTED if spec.second}
# the rows that a hypothesis may hold, in the order in which they act: those with a start, and a part of linear models
ROWS = tuple(r for r in (*CATALOGUE, TERM, *FAULTS) if r in _STARTED | _BESIDE or r.key == "sensor_lag: second order")
CORE = ("a0", "a1", "a2")
_NUMBERS = tuple(p for spec in ROWS for p in spec.parameters)
NAMES = (*CORE, *(name for spec in ROWS for name in slots_of_row(spec)))
INDEX = {name: k for k, name in enumerate(NAMES)}
# of every slot: a0, a1 and a2 come first, then the effects
OFF = np.array([0.0] * 3 + [off for spec in ROWS for off in spec.off])
LOGARITHM = np.array([True] * 3 + [p.positive for p in _NUMBERS])
LEAST = np.array([-np.inf] * 3 + [p.least for p in _NUMBERS])
MOST = np.array([np.inf] * 3 + [p.most for p in _NUMBERS])
# parameters without influence while their effect's strength is off
SHAPE = np.array([False] * 3 + [p.off is None for p in _NUMBERS])
FIXED = np.array([False] * 3 + [p.fixed for p in _NUMBERS])
_ENDS = np.cumsum([3, *(len(r.parameters) for r in ROWS)])
PLACES = {spec: slice(int(a), int(b)) for spec, a, b in zip(ROWS, _ENDS, _ENDS[1:], strict=False)}
(OFFSET,) = slots_of_row(_BY_KEY["voltage_offset: constant"])
# effects behind the core of a linear model
(DELAY,), (LAG,), (FILTER, FILTER_ZETA) = (
    slots_of_row(_BY_KEY[key]) for key in ("delay: pure", "sensor_lag: one lag", "sensor_lag: second order")
)
(EARLY,), (MONITOR, AHEAD) = map(slots_of_row, FAULTS)
# times by which rows let the output follow the input later
LATE = tuple(
    slot for r in ROWS if r not in FAULTS for p, slot in zip(r.parameters, slots_of_row(r), strict=True)
    if p.unit == "s" and p.off == 0.0
)  # fmt: skip
# parameters of a memory, and of the same law once more, by the name of the search
DOUBLED = {group(r.name): (slots_of_row(r), slots_of_row(lookup(*r.second))) for r in ROWS if r.second}
# names that are one parameter of the linear model, and those that recordings cannot separate
LONE = {spec.name for spec in CATALOGUE if spec.moves}
TWINS = {spec.name: (spec.twin,) for spec in CATALOGUE if spec.twin}
# effects that the search does not add, by the one that it adds instead
HIDDEN = {spec.twin: spec for spec in CATALOGUE if spec.only_given and spec.twin}
COMMUTING = {spec.name for spec in CATALOGUE if spec.commutes}
_MOST_POLES = 4  # of a model whose poles are all in its core, its lag and its filter (`sections`)
_IN_POLES = {3: (LAG,), 4: (FILTER, FILTER_ZETA)}  # the slots that the coefficients of a model of this order hold


def named(name: str, slots: np.ndarray, scale: Scale) -> str:
    """Return the catalogue name of a fitted effect; sign and time constant decide between similar effects."""
    return next(iter(names_of(name, slots, scale)), name)


def names_of(name: str, slots: np.ndarray, scale: Scale, least: float = 0.0) -> tuple[str, ...]:
    """Return the catalogue names of a fitted effect's rows, the strongest first; two only if it has two memories.

    A row counts if its first parameter is at least `least` of the strongest row's.
    """
    mine = [spec for spec in ROWS if group(spec.name) == name != FREE and is_on(spec, slots)]
    sizes = {spec.key: abs(float(slots[PLACES[spec]][0])) for spec in mine}
    mine = sorted((s for s in mine if sizes[s.key] >= least * max(sizes.values())), key=lambda s: -sizes[s.key])
    return tuple(dict.fromkeys(_reported(spec, slots, scale)[0] for spec in mine))


def family(name: str) -> str:
    """Return the family of an effect, by its catalogue name."""
    return next((c.family for c in CATALOGUE if c.name == name), "parametric" if name != FREE else "found")


def is_on(spec: EffectSpec, slots: np.ndarray) -> bool:
    """Return whether an effect has any influence with these parameters."""
    pairs = zip(spec.parameters, slots[PLACES[spec]], strict=True)
    return any(p.off is not None and v != p.off for p, v in pairs)


def effects_of(slots: np.ndarray, scale: Scale, only: str = "") -> list[tuple[Effect, tuple[str, ...]]]:
    """Return the effects with an influence in a parameter vector, each with the names of its parameters.

    `only`: those of this effect.
    """
    effects = []
    for spec in ROWS:
        if is_on(spec, slots) and only in ("", group(spec.name)):
            name, form, numbers = _reported(spec, slots, scale)
            # the row stays if only the name changes
            row = _BY_KEY.get(f"{name}: {form}", spec)
            effects.append((row(*numbers), slots_of_row(spec)))
    return effects


def _reported(spec: EffectSpec, slots: np.ndarray, scale: Scale) -> tuple[str, str, tuple]:
    values = slots[PLACES[spec]]
    if spec.reported is None:
        return spec.name, spec.form, tuple(values)
    p = SimpleNamespace(**{q.name: v for q, v in zip(spec.parameters, values, strict=True)})
    return spec.reported(p, slots[0], scale)


def slots_of(model: Model) -> tuple[np.ndarray, Model | None]:
    """Return the nominal model as a parameter vector, and a model of its parts that no slot holds, if there are any.

    The electrode's lag is neither: it filters the voltage of the records.
    """
    slots, others = OFF.copy(), []
    core, lag, filtered = sections(model.physical_coefficients)
    slots[: min(len(core), 3)] = (core * model.scales.state[0] / model.scales.force)[:3]
    slots[INDEX[LAG]] = lag
    if filtered:
        slots[INDEX[FILTER]], slots[INDEX[FILTER_ZETA]] = filtered
    if model.hold == "zoh":
        slots[INDEX[DELAY]] += model.dt / 2
    for e in model.effects:
        place = PLACES.get(e.spec)
        if place is None or (is_on(e.spec, slots) and not e.delays):
            others.append(e)
            continue
        # delays add up
        slots[place] = np.array([float(v) for _, v in e.numbers()]) + (slots[place] if e.delays else 0.0)
    plain = isinstance(model.encoder, ConstantEncoder) and not others
    return slots, None if plain else replace(model, effects=tuple(others), drive=DirectDrive())


def model_of(nominal: np.ndarray, slots: np.ndarray, model: Model, scale: Scale) -> tuple[Model, list[tuple]]:
    """Build the model with these fitted parameters; return it and the added effects with parameter names.

    A model of order 3 or 4 contains its lag or filter in its coefficients, which are changed. With an effect behind the
    input its core has order two, as in the search, and the lag or filter follows: they do not commute. A model with
    parts that no slot holds keeps its order, and its coefficients if a fit adds a mass that its core lacks.
    """
    slots, order, whole = slots.copy(), model.order, slots_of(model)[1] is not None
    for k in (DELAY, LAG, FILTER):  # a value fitted to almost zero counts as absent
        slots[INDEX[k]] *= slots[INDEX[k]] > 0.01 * model.dt
    slots[:3] = _no_faster(slots[:3], 2 / model.dt)
    same = bool(((slots[:3] > 0) == (nominal[:3] > 0)).all())
    behind = any(r.port != "IN" and not {LAG, FILTER} & {*slots_of_row(r)} and is_on(r, slots) for r in ROWS)
    if order <= _MOST_POLES and (whole or (same and (order < 3 or not behind))):
        inside = within_coefficients(nominal, order)
        slots[inside] = np.maximum(slots[inside], model.dt / 2)
        if not same:
            slots[:3] = nominal[:3]
        before, after = (coefficients_of(s, order) for s in (nominal, slots))
        factors = np.where(before != 0, after / np.where(before != 0, before, 1), 1)
        moved = slots != nominal
        moved[inside] = False
        changed = {r for r in ROWS if moved[PLACES[r]].any()}
        change = OFF.copy()
        change[:3] = slots[:3]
        for r in changed:
            change[PLACES[r]] = slots[PLACES[r]]
        if model.hold == "zoh" and moved[INDEX[DELAY]]:  # half a sample belongs to the hold
            if slots[INDEX[DELAY]] < model.dt / 2:  # with less the input runs linearly between samples, as in the fit
                model = replace(model, hold="foh")
            else:
                change[INDEX[DELAY]] -= model.dt / 2
        # the nominal keeps its own parts; changed ones are rebuilt
        own = tuple(e for e in model.effects if e.spec not in changed)
        added = effects_of(change, scale)
        return replace(model.changed(factors), effects=(*own, *(e for e, _ in added))), added
    size, force, rates = np.asarray(model.scales.state, float), float(model.scales.force), rates_of(model)
    a = slots[:3] * force / size[0]
    a = a if a[2] > 0 else a[:2]
    state = size[: len(a)] if len(size) >= len(a) else size[0] / scale.tau ** np.arange(len(a))
    plain = linear_model(
        a, input_map=model.input_map, state_scale=state, force_scale=force, output=model.output,
        hold="bandlimited" if model.hold == "bandlimited" else "foh", substeps=model.substeps, domain=model.domain,
    )  # fmt: skip
    simulated = tuple(size[0] * np.cumprod([1.0, *rates])), force
    added = [(in_scales(e, simulated, (state, force)), names) for e, names in effects_of(slots, scale)]
    made = replace(plain, effects=tuple(e for e, _ in added))
    return cast(Model, Fitted(made, fitted_of(model).origin.of_other_coefficients())), added


def within_coefficients(nominal: np.ndarray, order: int) -> list[int]:
    """Return the places of the nominal's lag or filter, which the coefficients of order 3 or 4 contain."""
    return [INDEX[k] for k in _IN_POLES.get(order, ()) if nominal[INDEX[k]] > 0]


def coefficients_of(slots: np.ndarray, order: int) -> np.ndarray:
    """Return the scaled a_0 ... a_n of the linear core, multiplied by the lag (order 3) or the filter (order 4)."""
    poles = np.polynomial.Polynomial(slots[: min(order, 2) + 1])
    if order == 3:
        poles *= np.polynomial.Polynomial([1.0, slots[INDEX[LAG]]])
    if order == 4:
        tau, zeta = slots[INDEX[FILTER]], slots[INDEX[FILTER_ZETA]]
        poles *= np.polynomial.Polynomial([1.0, 2 * zeta * tau, tau**2])
    return np.pad(poles.coef, (0, order + 1 - len(poles.coef)))


def rates_of(model: Model) -> tuple[float, float]:
    """Return the ratios of the scales of x' and x, and of x'' and x' (1/s), for a model of any order."""
    rates = np.asarray(model.scales.rates, float)
    return float(rates[0]), float(rates[min(1, len(rates) - 1)])


def sections(a: np.ndarray) -> tuple[np.ndarray, float, tuple[float, float] | None]:
    """Split the polynomial a_0 ... a_n into a core of order two at most, a lag (s) and a filter (s, damping).

    The core has the dominant pair: the slowest oscillating one, otherwise the slowest two poles. Poles beyond order
    four are combined with the lag.
    """
    a = np.asarray(a, float)
    if len(a) <= 3:
        return a, 0.0, None
    roots = sorted(np.roots(a[::-1]), key=abs)
    pairs = [k for k, p in enumerate(roots) if p.imag > 0]
    if pairs:
        first = roots[pairs[0]]
        core = [first, np.conj(first)]
        rest = [p for k, p in enumerate(roots) if k != pairs[0] and not np.isclose(p, np.conj(first))]
    else:
        core, rest = roots[:2], roots[2:]
    poly = np.real(np.poly(core))[::-1]  # c_0, c_1, 1
    core_a = poly / (poly[0] if abs(poly[0]) > 1e-12 else 1.0)
    core_a = core_a * (a[0] if abs(poly[0]) > 1e-12 else a[1] / core_a[1])
    lag, filtered = 0.0, None
    if len(rest) >= 2:
        p, q = rest[0], rest[1]
        w = np.sqrt(abs(p * q))
        filtered, rest = (float(1 / w), float(-(p + q).real / (2 * w))), rest[2:]
    lag = float(sum(1 / abs(p) for p in rest))
    return core_a, lag, filtered


def _no_faster(a: np.ndarray, most: float) -> np.ndarray:
    """Limit the poles of the coefficients a_0 ... a_n to `most` (1/s), with an unchanged slow response.

    The search steps a linear plant exactly for any poles; the rollout does not, and samples do not show such fast
    poles. For example, a damper with a fitted lag of almost zero diverged in the rollout.
    """
    order = int(np.flatnonzero(a)[-1])
    poles = np.roots(a[order::-1])
    if order == 0 or np.abs(poles).max() <= most:
        return a
    slower = np.poly(poles * np.minimum(1.0, most / np.maximum(np.abs(poles), 1e-300))).real[::-1]
    slowest = int(np.flatnonzero(a)[0])
    moved = np.zeros_like(a)
    moved[: order + 1] = slower * a[slowest] / slower[slowest]
    return moved
