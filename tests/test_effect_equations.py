"""Every form of every effect is its equation (`effect_equations`) integrated by SciPy, and nothing at zero effect."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from effect_equations import EQUATIONS, Equation
from jax.flatten_util import ravel_pytree
from scipy.integrate import solve_ivp

from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.effects.physical import physical_factor
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rollout, settled_state

HZ, DT, SAMPLES = 5.0, 1e-3, 640
TIME = np.arange(SAMPLES) * DT
# (sample, V): voltages linear in between, so that what is sampled is what SciPy sees; both signs, and a jump in neither
RAMPS = {
    "rest": ((0, 0), (80, 1100), (140, 1100), (260, -800), (340, -800), (400, 300), (520, 1000), (639, 1000)),
    "moving": ((0, 350), (100, 350), (220, -500), (360, 200), (480, 700), (639, 100)),
}
BEGINS = {"rest": (0.0, 0.0, 0.0), "moving": (0.9, -0.6, 0.0)}  # scaled x, x', x''
AGES = {"rest": 0.0, "moving": 100.0}  # s into the session
FORMS = {f.key: f for f in CATALOGUE}
CASES = [(name, values, n) for name, e in EQUATIONS.items() for values in e.values for n in e.within]


def test_every_form_has_its_equation_and_signed_numbers_both_signs():
    assert set(EQUATIONS) == set(FORMS), (
        "a form of the catalogue without an equation of its own, or the other way round"
    )
    for name, form in FORMS.items():
        for k, p in enumerate(form.parameters):
            if not p.positive:
                assert {np.sign(values[k]) for values in EQUATIONS[name].values} == {-1, 1}, (name, p.name)


def voltage(drive):
    places, volts = zip(*RAMPS[drive], strict=True)
    return np.interp(np.arange(SAMPLES), places, volts)


def physical(model, name, values):
    """A form's numbers in physical units, and the unit of displacement."""
    unit, force = model.scales.state, model.scales.force
    known = zip(FORMS[name].parameters, values, strict=True)
    return SimpleNamespace(**{p.name: v * physical_factor(p, unit, force) for p, v in known}, unit=unit[0])


def solution(model, name, values, drive):
    """Scaled readings by SciPy, ramp by ramp; `name` None: of the nominal."""
    e, p = (EQUATIONS[name], physical(model, name, values)) if name else (Equation((), {}), SimpleNamespace())
    n, u, scale = model.order, voltage(drive), model.scales.state
    nominal = list(model.physical_coefficients)
    a, late = e.inertia(nominal, p), e.earlier(p)
    begin = [b * c for b, c in zip(BEGINS[drive], scale, strict=False)][:n]
    state = np.array([*begin, *e.begin(begin[0], u[0] if drive == "moving" else 0.0, p)])

    def slope(t, state, sliding=0.0):
        """Of x, ..., x^(n-1) and the form's states; `sliding`: which way dry friction acts."""
        x, s, now = state[:n], state[n:], np.interp(t - late, TIME, u)
        v = x[1] if n > 1 else 0.0  # at order 1 a force of x' is not tested
        force = e.couple(e.film(now, s, p) ** 2, x[0], p) - e.force(x[0], v, s, p, nominal, t + AGES[drive])
        last = e.limit((force - np.dot(a[:n], x)) / a[n], p)
        last -= sliding * e.friction(x[0], v, last, p, a) / a[n] if sliding else 0.0
        last -= e.carried(x[0], last, s, p, a) / a[n] if e.carried else 0.0
        return [*x[1:], last, *e.rates(x[0], v if n > 1 else last, now, s, p)]

    kinks = sorted({min(TIME[k] + later, TIME[-1]) for k, _ in RAMPS[drive] for later in (0.0, late)})
    if e.friction:
        states = _slide_and_stick(slope, state, kinks, lambda x, last: e.friction(x, 0.0, last, p, a) / a[n])
    else:
        states = _through(slope, state, kinks, "LSODA" if e.stiff else "DOP853")
    return np.array([e.sensor(x[0], x[n:], p) + e.crosses(v, p) for x, v in zip(states, u, strict=True)]) / scale[0]


def _run(slope, state, first, last, **options):
    return solve_ivp(slope, (first, last), state, rtol=1e-9, atol=1e-13, dense_output=True, **options)


def _through(slope, state, kinks, method):
    found = []
    for first, last in zip(kinks[:-1], kinks[1:], strict=True):
        run = _run(slope, state, first, last, method=method)
        found.append(run.sol(TIME[(TIME >= first - 1e-12) & (TIME < last - 1e-12)]).T)
        state = run.y[:, -1]
    return np.concatenate([*found, state[None]])


def _slide_and_stick(slope, state, kinks, most):
    """Slide until x' is zero; stick until the rest of the force is more than the friction.

    `most`: of the friction over a_2, at x and the x'' that there were without it.
    """
    found, ends = np.zeros((SAMPLES, 2)), kinks[1:]
    first = kinks[0]

    def pull(t, state):
        return slope(t, [state[0], 0.0])[1]

    def surplus(t, state, more=0.0):
        last = pull(t, state)
        return abs(last) - most(state[0], last) * (1 + more)

    def too_much(t, state):
        return surplus(t, state, 1e-8)  # a little more than makes it stick, or it would do both

    lets_go: Any = too_much
    stops: Any = lambda t, state: state[1]  # noqa: E731

    lets_go.terminal, lets_go.direction, stops.terminal = True, 1, True
    while first < kinks[-1] - 1e-12:
        last = next(k for k in ends if k > first + 1e-12)
        still = abs(state[1]) < 1e-9
        if still and surplus(first, state) < 0:
            state = np.array([state[0], 0.0])
            run = _run(lambda t, s: [0.0, 0.0], state, first, last, events=lets_go, max_step=DT)
        else:
            sign = np.sign(pull(first, state) if still else state[1])
            stops.direction = -sign
            run = _run(lambda t, s, sign=sign: slope(t, s, sign), state, first, last, events=stops, max_step=DT)
        inside = (TIME >= first - 1e-12) & (TIME < run.t[-1] + 1e-12)
        found[inside] = run.sol(TIME[inside]).T if inside.any() else 0.0
        state, first = run.y[:, -1], run.t[-1]
    return found


def numbers(name, values, catalogue):
    """The numbers of all forms: neutral, but for one form."""
    found = []
    for form in catalogue:
        found.extend(values if form.key == name else form.off)
    return np.array(found)


def play(model, jobs):
    """Scaled readings of (name, values, drive), all forms the jobs name in one model; float64."""
    catalogue = [f for f in CATALOGUE if f.key in {name for name, *_ in jobs}]
    whole = replace(model, effects=tuple(f.neutral() for f in catalogue))

    def one(theta, volts, state, age):
        here = replace(whole, effects=unravel(theta))
        start = settled_state(here, state, state[0], jnp.where(state.any(), volts[0], 0.0), age)
        return ports.readings(here, rollout(here, volts, DT, start))

    with jax.enable_x64(True):
        unravel = ravel_pytree(jax.tree.map(jnp.float64, whole.effects))[1]
        theta = jnp.asarray(np.stack([numbers(name, values, catalogue) for name, values, _ in jobs]))
        volts = jnp.asarray(np.stack([voltage(drive) for *_, drive in jobs]))
        begin = jnp.asarray(np.stack([np.asarray(BEGINS[drive][: model.order]) for *_, drive in jobs]))
        ages = jnp.asarray(np.stack([AGES[drive] for *_, drive in jobs]))
        return np.asarray(jax.jit(jax.vmap(one))(theta, volts, begin, ages))


def idle(name, values):
    """The values with the neutral ones for those that have one."""
    return tuple(v if p.off is None else p.off for p, v in zip(FORMS[name].parameters, values, strict=True))


@pytest.fixture(scope="module")
def models(linear, double):
    """No two coefficients alike in the model's coordinates."""
    with jax.enable_x64(True):
        return {n: double(linear(n, hz=HZ, dt=DT).changed(np.linspace(1.1, 0.8, n + 1))) for n in (1, 2, 3)}


@pytest.fixture(scope="module")
def readings(models):
    """By order, name, values and drive: those of the equations' cases, and at zero effect."""
    found = {}
    for order, model in models.items():
        cases = [(name, values) for name, e in EQUATIONS.items() if order in e.within for values in e.values]
        cases += [(name, idle(name, values)) for name, values in cases]
        jobs = [(*case, drive) for case in cases for drive in RAMPS]
        found |= {(order, *job): y for job, y in zip(jobs, play(model, jobs), strict=True)}
    return found


@pytest.fixture(scope="module")
def bare(models):
    """The nominal's by SciPy, by order and drive."""
    return {(n, drive): solution(model, None, (), drive) for n, model in models.items() for drive in RAMPS}


@pytest.mark.parametrize(("name", "values", "order"), CASES)
def test_a_form_is_its_equation(models, readings, bare, name, values, order):
    """Beside the largest change it makes under either drive."""
    acts, errors = [], []
    for drive in RAMPS:
        truth = solution(models[order], name, values, drive)
        acts.append(np.abs(truth - bare[order, drive]).max())
        errors.append(np.abs(readings[order, name, values, drive] - truth).max())
    assert max(acts) > 0.03
    assert max(errors) < EQUATIONS[name].within[order] * max(acts)


@pytest.mark.parametrize(("name", "values", "order"), CASES)
def test_at_zero_effect_a_form_is_nothing(readings, bare, name, values, order):
    """Whatever its other numbers, from any beginning."""
    for drive in RAMPS:
        found = readings[order, name, idle(name, values), drive]
        assert np.abs(found - bare[order, drive]).max() < 1e-6
