"""The library: forms of every effect as slots with starts, and as the catalogue's rows once their numbers are fitted.

One form has one mechanism; a name may have several. `slots` are what a fit moves, each with a start, in the model's
scaled coordinates (x over its scale, time in s, force over its scale, voltages in V). Twins by algebra share a tie.
"""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from .._effects import CATALOGUE, lookup
from .._effects.found_term import term_row
from .._model.encoder import ConstantEncoder
from .._model.fitted import Fitted, fitted_of
from .._model.model import Model, linear_model
from .simulator import INDEX, NAMES, OFF

BORDER = 15.0  # tau omega: creep above, relaxation below
GIVE = 0.05  # of the stroke: contacts that give less before they slide are dry friction, others a hysteresis
FREE = "term"  # a force without a name
# names that one linear plant, or one sensor, cannot tell apart whatever is played
TWINS = (
    {"sensor_gain", "parameter_change"},
    {"delay", "sensor_lag"},
)


@dataclass(frozen=True)
class Form:
    """One way to write an effect: its name in the search, and start values of the slots it moves."""

    name: str
    start: dict[str, float]
    second: bool = False  # needs a mass


@dataclass(frozen=True)
class Scale:
    """What starts are multiples of, from the nominal and the records (`starts_of`)."""

    tau: float
    dt: float
    duration: float
    session: float
    reach: float
    top: float
    bottom: float
    speed: float
    acceleration: float
    voltage: float
    slew: float
    area: float
    a0: float
    a1: float
    a2: float
    force: float


def forms(s: Scale) -> list[Form]:
    """Every form with its starts."""
    x, pull = s.reach, s.force
    # a plant without damping of its own still gets one to measure others by
    damping = max(s.a1, 0.1 * s.tau * max(s.a0, s.force / x))
    all_forms = []

    def add(name: str, *starts: dict[str, float], second: bool = False):
        all_forms.extend(Form(name, start, second) for start in starts)

    add("spring", *({"k3": c / x**2} for c in (0.1, 0.5, -0.1)), *({"k2": c / x} for c in (-0.2, 0.2)))
    add(
        "spring",
        {"k2": 0.05 / x, "k3": 0.1 / x**2},
        {"k3": 0.1 / x**2, "k5": 0.1 / x**4},
        {"gent": 0.3 / x},
        {"gent": 0.6 / x},
        {"gent": 0.85 / x},
    )
    add(
        "spring",
        {"tanh": 0.6 / x},
        {"expo": 0.5 / x},
        *({"sine": c / x} for c in (0.5, 1.2, 2.5)),
        {"root": 0.5, "reach": x},
    )
    for hard in (2.0, 20.0):
        for far in (0.6, 0.9):
            add("end_stop", {"stop": hard, "stop_at": s.bottom + far * (s.top - s.bottom)})
        add("end_stop", {"low_stop": hard, "low_stop_at": s.top - 0.85 * (s.top - s.bottom)})
        middle, half = (s.top + s.bottom) / 2, (s.top - s.bottom) / 2
        add(
            "end_stop",
            {"stop": hard, "stop_at": middle + 0.75 * half, "low_stop": hard, "low_stop_at": middle - 0.75 * half},
        )
    if s.acceleration > 0:
        add("slack", *({"slack": f / s.acceleration} for f in (1.3, 3.0)), second=True)
    for strength, times in ((0.2, 3.0), (1.0, 3.0), (0.2, 20.0), (1.0, 20.0), (0.3, 100.0)):
        add("viscoelastic", {"branch": strength, "branch_tau": times * s.tau})
    add("viscoelastic", {"branch": 0.3, "branch_tau": 2 * s.tau, "branch2": 0.3, "branch2_tau": 30 * s.tau})
    add("hysteresis", {"bouc": 5.0, "yield": 0.01 * x})
    for width in (0.1, 0.5):
        add("hysteresis", {"bouc": 0.3, "yield": width * x}, {"bouc": 0.5, "yield": width * x, "gamma": -0.5})
        add("hysteresis", {"plays": 0.4, "plays_width": 0.6 * width * x})
    add(
        "hysteresis",
        *({"drive_bouc": c * s.voltage, "drive_yield": f * s.area} for c in (0.5, -0.5) for f in (0.1, 0.5)),
    )
    add("hysteresis", {"bouc": 0.5, "yield": 0.5 * x, "gamma": 0.5})
    add(
        "hysteresis",
        *({"play1": 0.1, "play2": 0.1, "play3": 0.1, "play4": 0.1, "play_range": f * s.voltage} for f in (0.5, 1.5)),
    )
    add(
        "coulomb_friction",
        *({"dry": f * pull} for f in (0.01, 0.05, 0.2)),
        {"dry": 0.04 * pull, "rise": 0.5, "rise_speed": 0.1 * s.speed},
        {"dry": 0.05 * pull, "dry_speed": 0.05 * s.speed},
    )
    add(
        "coulomb_friction",
        {"dry": 0.02 * pull, "dry_load": 0.1},
        {"dry": 0.1 * pull, "dry_load": 0.3},
        {"dry": 0.003 * pull, "dry_load": 0.05},
    )
    add("drag", *({"drag": f * damping / s.speed} for f in (0.3, 2.0)))
    add("electrode_rc", *({"rc": f * s.tau} for f in (0.2, 1.0)))
    add("slew_limit", *({"slew": f * s.slew} for f in (0.1, 0.4, 0.8)))
    add("voltage_clip", *({"clip": f * s.voltage} for f in (0.55, 0.8, 0.93)))
    add("voltage_offset", *({"offset": f * s.voltage} for f in (-0.05, 0.05)))
    add("dead_zone", *({"dead": f * s.voltage} for f in (0.05, 0.2)))
    add("delay", *({"delay": f} for f in (s.dt, 0.1 * s.tau, 0.5 * s.tau)))
    add("charge", *({"charge": c, "charge_tau": f * s.tau} for c in (-0.15, 0.15) for f in (5.0, 50.0)))
    add("stretch_coupling", *({"stretch": c / x} for c in (0.1, -0.1)), {"stretch_exp": -1 / x})
    add("dielectric_saturation", *({"saturation": f / pull} for f in (0.1, 0.6)))
    add("second_mode", *({"mode_gain": 0.3, "mode_w": f / s.tau, "mode_zeta": 0.05} for f in (0.6, 1.6, 3.5)))
    # a second mass hangs on a first: on none, it is a core of another order
    hung = ({"mode_force": 0.2, "mode_w": f / s.tau, "mode_zeta": 0.05} for f in (0.6, 1.6, 3.5))
    add("second_mode", *hung, second=True)
    if s.session > 1.5 * s.duration:
        add("stiffness_drift", *({"drift": c, "drift_time": 0.3 * s.session} for c in (0.1, -0.1)))
    add("sensor_lag", *({"lag": f * s.tau} for f in (0.2, 1.0)))
    add(
        "sensor_nonlinearity",
        {"s2": 0.05 / x},
        {"s2": -0.05 / x},
        {"s3": 0.03 / x**2},
        {"s2": 0.03 / x, "s3": 0.03 / x**2},
        {"bend": 0.5 / x},
        {"fold": 1.0},
    )
    add("backlash", *({"backlash": f * x} for f in (0.04, 0.2, 0.5)))
    add("backlash", *({"backlash": 0.1 * x, "coast": f / s.tau} for f in (0.05, 0.5)))
    add("mullins", *({"mullins": c, "mullins_length": 0.5 * x} for c in (0.15,)))
    add("sensor_gain", {"gain": 0.05})
    if s.a2 <= 0:
        add("added_mass", *({"a2": f * s.tau * damping} for f in (0.05, 0.5)))
    add(
        FREE,
        *({"place_damping": f * damping / x} for f in (-0.3, 0.5)),
        *({"place_damping2": f * damping / x**2} for f in (0.3, 2.0)),
    )
    add(FREE, *({"field_damping": f * damping / pull} for f in (-0.3, 0.5)))
    return all_forms


def named(name: str, slots: np.ndarray, scale: Scale) -> str:
    """The catalogue's name of a fitted form: signs and time constants decide those that share one."""
    v = {k: slots[INDEX[k]] for k in NAMES}
    if name == "viscoelastic":
        taus = [t for k, t in ((v["branch"], v["branch_tau"]), (v["branch2"], v["branch2_tau"])) if k]
        return "creep" if max(taus) > BORDER * scale.tau else "relaxation"
    if name == "hysteresis" and v["bouc"] > 0 and v["yield"] < GIVE:
        return "coulomb_friction"
    if name == "hysteresis" and v["drive_bouc"] and v["drive_yield"] < GIVE * scale.area:
        return "voltage_offset"  # a loop that is run through at once is the level it ends at
    if name == "charge":
        return "charge_leak" if v["charge"] < 0 else "charge_retention"
    if name == "spring":
        places = np.array([scale.bottom, (scale.top + scale.bottom) / 2, scale.top])
        step = 1e-3 * (scale.top - scale.bottom)
        tangent = (spring(v, places + step) - spring(v, places - step)) / (2 * step)
        return "stiffening" if (tangent[0] + tangent[2]) / 2 > tangent[1] else "softening"
    return name


def spring(v: dict, x: np.ndarray) -> np.ndarray:
    """Restoring force over a_0 of the spring's slots."""
    r = np.minimum((v["gent"] * x) ** 2, 0.97**2)
    f = x + v["k2"] * x**2 + v["k3"] * x**3 + v["k5"] * x**5 + x * r / (1 - r)
    f = f + v["root"] * (np.sign(x) * np.sqrt(np.abs(x) * v["reach"]) - x)
    if v["tanh"]:
        f = f + 0.97 * (np.tanh(v["tanh"] * x) / v["tanh"] - x)
    if v["expo"]:
        f = f - np.expm1(-v["expo"] * x) / v["expo"] - x
    if v["sine"]:
        f = f + np.sin(v["sine"] * x) / v["sine"] - x
    return f


def family(name: str) -> str:
    """Of a catalogue name."""
    return next((c.family for c in CATALOGUE if c.name == name), "parametric" if name != FREE else "found")


# -- the catalogue's rows ----------------------------------------------------------------------------------------------

# (name, form): slots of its numbers, in their order; "1/" where the row stores the inverse, "-" the opposite sign
ROWS: dict[tuple[str, str], tuple[str, ...]] = {
    ("electrode_rc", "one lag"): ("rc",),
    ("slew_limit", "rate limit"): ("1/slew",),
    ("voltage_clip", "hard"): ("1/clip",),
    ("voltage_offset", "constant"): ("offset",),
    ("dead_zone", "symmetric"): ("dead",),
    ("delay", "pure"): ("delay",),
    ("charge_leak", "one trap"): ("-charge", "charge_tau"),
    ("charge_retention", "one store"): ("charge", "charge_tau"),
    ("dielectric_saturation", "rational"): ("saturation",),
    ("stretch_coupling", "linear"): ("stretch",),
    ("stretch_coupling", "exponential"): ("stretch_exp",),
    ("stiffening", "limited chain"): ("gent",),
    ("softening", "saturating"): ("tanh",),
    ("softening", "exponential"): ("expo",),
    ("softening", "gravity"): ("sine",),
    ("end_stop", "above"): ("stop", "stop_at"),
    ("end_stop", "below"): ("low_stop", "-low_stop_at"),
    ("mullins", "exponential"): ("mullins", "mullins_length"),
    ("stiffness_drift", "settling"): ("drift", "drift_time"),
    ("hysteresis", "Dahl"): ("bouc", "yield"),
    ("hysteresis", "plays"): ("plays", "plays_width"),
    ("hysteresis", "plays of the drive"): ("play1", "play2", "play3", "play4", "play_range"),
    ("hysteresis", "Dahl of the command's integral"): ("drive_bouc", "drive_yield"),
    ("drag", "quadratic"): ("drag",),
    ("coulomb_friction", "Coulomb"): ("dry",),
    ("coulomb_friction", "loaded by the spring"): ("dry", "dry_load"),
    ("coulomb_friction", "smooth"): ("dry", "dry_speed"),
    ("coulomb_friction", "Stribeck"): ("dry", "rise", "rise_speed"),
    ("slack", "free fall"): ("slack",),
    ("second_mode", "hung on"): ("mode_force", "mode_w", "mode_zeta"),
    ("second_mode", "between film and sensor"): ("mode_gain", "mode_w", "mode_zeta"),
    ("backlash", "play"): ("backlash",),
    ("backlash", "coasting"): ("backlash", "coast"),
    ("sensor_lag", "one lag"): ("lag",),
    ("sensor_lag", "second order"): ("filter", "filter_zeta"),
    ("sensor_gain", "share"): ("gain",),
    ("sensor_nonlinearity", "quadratic and cubic"): ("s2", "s3"),
    ("sensor_nonlinearity", "saturating"): ("bend",),
    ("sensor_nonlinearity", "quadratic"): ("s2",),
    ("sensor_nonlinearity", "cubic"): ("s3",),
}
# numbers that do nothing where the strength beside them is off
_SHAPES = set(
    "charge_tau play_range reach stop_at low_stop_at mullins_length drift_time branch_tau branch2_tau yield "
    "plays_width rise_speed mode_w mode_zeta filter_zeta drive_yield".split()
)
_BRANCHES = (("branch", "branch_tau"), ("branch2", "branch2_tau"))
_TERMS = {
    "x^2": "k2", "x^3": "k3", "x^5": "k5", "x x'": "place_damping", "x^2 x'": "place_damping2", "x' F": "field_damping",
}  # fmt: skip


def row(name: str, form: str):
    """The catalogue's row, or None where it has none."""
    return next((c for c in CATALOGUE if (c.name, c.form) == (name, form)), None)


def _factor(parameter, rates: np.ndarray) -> float:
    """From a number per s (the simulator's) to the model's scaled one: its rates are powers of the state's scales."""
    return float(rates[0] ** -parameter.speed * (rates[0] * rates[min(1, len(rates) - 1)]) ** -parameter.acceleration)


def _slot(code: str) -> str:
    return code.removeprefix("-").removeprefix("1/")


def _number(slots: np.ndarray, code: str) -> float:
    value = slots[INDEX[_slot(code)]]
    return -value if code[0] == "-" else 1 / value if code.startswith("1/") else value


def effects_of(slots: np.ndarray, model: Model, omega: float) -> tuple[list[tuple], list[str]]:
    """The catalogue's effects that these slots are, each with its numbers' slots, and slots that no row has."""
    on = {k for k in NAMES if slots[INDEX[k]] != OFF[INDEX[k]]} - {"a0", "a1", "a2"}
    rates, effects, used = np.asarray(model.scales.rates, float), [], set()

    def add(name: str, form: str, codes: tuple[str, ...]) -> None:
        spec, keys = row(name, form), {_slot(c) for c in codes}
        if spec is not None and not keys & used:
            values = zip(spec.parameters, codes, strict=True)
            effects.append((spec(*(_number(slots, c) * _factor(p, rates) for p, c in values)), codes))
            used.update(keys)

    if slots[INDEX["bouc"]] > 0 and "bouc" in on:
        kappa, give, gamma = (slots[INDEX[k]] for k in ("bouc", "yield", "gamma"))
        if gamma:  # the simulator bounds it
            loop = lookup("hysteresis", "Bouc-Wen, either sign")(kappa, give, 1.5 * np.tanh(gamma / 1.5))
        elif give < GIVE:
            loop = lookup("coulomb_friction", "bristles")(slots[INDEX["a0"]] * kappa * give, give)
        else:
            loop = lookup("hysteresis", "Dahl")(kappa, give)
        codes = ("bouc", "yield", "gamma")[: 3 if gamma else 2]
        effects.append((loop, codes))
        used.update(codes)
    for (name, form), codes in sorted(ROWS.items(), key=lambda item: -len(item[1])):  # the fullest form that fits
        signed = name != "charge_leak" or slots[INDEX["charge"]] < 0
        if {_slot(c) for c in codes} - _SHAPES <= on - used and signed:
            add(name, form, codes)
    for strength, tau in _BRANCHES:
        if strength in on:
            add("creep" if slots[INDEX[tau]] * omega > BORDER else "relaxation", "one branch", (strength, tau))
    terms = {text: slot for text, slot in _TERMS.items() if slot in on - used}
    if terms:
        effects.append((_term(slots, terms, rates), tuple(terms.values())))
        used.update(terms.values())
    place = {(c.name, c.form): k for k, c in enumerate(CATALOGUE)}
    effects.sort(key=lambda pair: place.get((pair[0].name, pair[0].form), len(place)))
    return effects, sorted(on - used - _SHAPES)


def _term(slots: np.ndarray, chosen: dict[str, str], rates: np.ndarray):
    """Springs, dampers and friction by load as a sum of functions; `chosen`: the slot of each."""
    spec = term_row(tuple(chosen))
    unit = {slot: slots[INDEX["a0"]] if slot in ("k2", "k3", "k5") else 1.0 for slot in chosen.values()}
    numbers = zip(chosen.values(), spec.parameters, strict=True)
    return spec(*(float(slots[INDEX[slot]] * unit[slot] * _factor(p, rates)) for slot, p in numbers))


def slots_of(model: Model) -> tuple[np.ndarray, bool]:
    """The nominal's slots, and whether it has parts that are none (a trained encoder, other effects)."""
    slots = OFF.copy()
    core, lag, filtered = sections(model.physical_coefficients)
    scaled = core * model.scales.state[0] / model.scales.force
    for k, value in zip(("a0", "a1", "a2"), (*scaled, 0.0)[:3] if len(scaled) < 3 else scaled, strict=True):
        slots[INDEX[k]] = value
    slots[INDEX["lag"]] = lag
    if filtered:
        slots[INDEX["filter"]], slots[INDEX["filter_zeta"]] = filtered
    if model.hold == "zoh":
        slots[INDEX["delay"]] += model.dt / 2
    foreign = not isinstance(model.encoder, ConstantEncoder) or type(model.drive).__name__ != "DirectDrive"
    rates = np.asarray(model.scales.rates, float)
    for e in model.effects:
        codes = ROWS.get((e.name, e.form))
        taken = codes and any(slots[INDEX[_slot(c)]] != OFF[INDEX[_slot(c)]] and e.name != "delay" for c in codes)
        if not codes or taken:
            foreign = True
            continue
        for code, (p, value) in zip(codes, e.numbers(), strict=True):
            value = float(value) / _factor(p, rates)
            value = -value if code[0] == "-" else 1 / value if code.startswith("1/") else value
            slots[INDEX[_slot(code)]] = value + (slots[INDEX["delay"]] if code == "delay" else 0.0)
    return slots, foreign


def sections(a: np.ndarray) -> tuple[np.ndarray, float, tuple[float, float] | None]:
    """a_0 ... a_n as a core of order two at most, a lag (s) and a filter (s, damping) behind it.

    The core has the dominant pair: the slowest that oscillates, else the slowest two poles; poles beyond order four are
    lumped into the lag.
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


def model_of(
    case_nominal: np.ndarray, slots: np.ndarray, model: Model, omega: float
) -> tuple[Model, list[tuple], list[str]]:
    """The nominal with these slots in place of its own; what was added with its slots; and what no row can carry."""
    core, behind = ("a0", "a1", "a2"), ("delay", "lag", "filter", "filter_zeta")
    places = [INDEX[k] for k in core]
    slots = slots.copy()
    for k in ("delay", "lag", "filter"):  # what a fit has pushed to nothing is not there
        slots[INDEX[k]] *= slots[INDEX[k]] > 0.01 * model.dt
    slots[places] = _no_faster(slots[places], 2 / model.dt)
    change = slots.copy()
    same = (slots[places] > 0) == (case_nominal[places] > 0)
    if model.order <= 2 and same.all():
        factors = np.where(
            case_nominal[places] > 0, slots[places] / np.where(case_nominal[places] > 0, case_nominal[places], 1), 1
        )
        for k in NAMES:  # the nominal keeps its own parts; those that moved are made anew
            if k not in core and slots[INDEX[k]] == case_nominal[INDEX[k]]:
                change[INDEX[k]] = (
                    OFF[INDEX[k]] if k not in behind or case_nominal[INDEX[k]] == OFF[INDEX[k]] else change[INDEX[k]]
                )
        moved = [k for k in behind if slots[INDEX[k]] != case_nominal[INDEX[k]]]
        if model.hold == "zoh" and "delay" in moved:
            change[INDEX["delay"]] = max(change[INDEX["delay"]] - model.dt / 2, 0.0)
        own = tuple(e for e in model.effects if not (moved and (e.name, e.form) in _BEHIND))
        for k in () if moved else behind:
            change[INDEX[k]] = OFF[INDEX[k]]
        added, missing = effects_of(change, model, omega)
        new = [e for e, codes in added if not set(codes) <= set(behind) or moved]
        whole = replace(model.changed(factors[: model.order + 1]), effects=(*own, *new))
        return whole, added, missing
    added, missing = effects_of(change, model, omega)
    scale, force = np.asarray(model.scales.state, float), float(model.scales.force)
    a = slots[places] * force / scale[0]
    a = a if a[2] > 0 else a[:2]
    rate = omega if omega > 0 else 1.0
    state = scale[: len(a)] if len(scale) >= len(a) else scale[0] * rate ** np.arange(len(a))
    plain = linear_model(
        a, input_map=model.input_map, state_scale=state, force_scale=force, output=model.output, hold="foh",
        substeps=model.substeps, domain=model.domain,
    )  # fmt: skip
    whole = replace(plain, effects=tuple(e for e, _ in effects_of(change, plain, omega)[0]))
    return cast(Model, Fitted(whole, fitted_of(model).origin)), added, missing


def _no_faster(a: np.ndarray, most: float) -> np.ndarray:
    """Move the poles beyond `most` (1/s) in to it and leave the slow end of the response as it was.

    The search steps a linear plant exactly, whatever its poles; the rollout does not, and samples do not show poles
    that fast: a damper whose own lag was fitted to nothing ran away there.
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


_BEHIND = {("delay", "pure"), ("sensor_lag", "one lag"), ("sensor_lag", "second order")}
