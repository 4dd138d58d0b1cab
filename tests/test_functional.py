"""The functional core: free_run, inverse, residual, memory_along, tokens_along, and which leaves are parameters."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import optax
import pytest
from jax.sharding import PartitionSpec
from scipy.signal import butter, lsim, sosfiltfilt
from typed import untyped

import pitp_jax as pitp
from pitp_jax import excitation
from pitp_jax.method.effects import effect
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import AdaptedEncoder, PaperEncoder
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.memory import ElapsedTime
from pitp_jax.method.signal.record import Record
from pitp_jax.method.train.dataset import build_dataset
from pitp_jax.method.train.equation_error import loss

DT, HZ = 2e-3, 10.0
TIME = DT * np.arange(600)


def volts(hz=2.0, high=700.0):
    """From rest, without a kink: once up and down in a window, its end at rest again."""
    return high * np.sin(np.pi * hz * TIME) ** 2 * np.sin(np.pi * TIME / TIME[-1]) ** 2


@pytest.fixture(scope="module")
def plain(linear):
    return linear(2, HZ, dt=DT)


@pytest.fixture(scope="module")
def trained(nonlinear):
    drive = ElectrodeLag(jnp.asarray(np.log(4e-3), jnp.float32))
    return replace(nonlinear(2, hz=HZ, dt=DT, size=0.05), drive=drive)


def names(tree):
    return sorted(jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(tree))


def test_parameters_are_the_inexact_leaves(trained):
    """Coefficients, encoder, memory times, drive and effects; no scale, limit, interval or bound."""
    adapted = AdaptedEncoder(trained.encoder, jnp.ones(()), jnp.ones((2,)), jnp.zeros((2,)), np.array([-1.0, 0.0, 1.0]))
    domain = replace(trained.domain, voltage_range=(0.0, 3e3), region=((-1.0, 1.0),) * 4, clock=3.0)
    model = replace(trained, encoder=adapted, effects=(effect("stiffening", c=0.2),), domain=domain)
    params, static = eqx.partition(model, eqx.is_inexact_array)
    weights = [".encoder.inner" + n for n in names(eqx.filter(trained.encoder, eqx.is_array))]
    assert not any("bounds" in name for name in weights)
    others = [".coefficients", ".memory.log_tau", ".drive.log_tau", ".effects[0].c"]
    assert names(params) == sorted([*weights, *others, ".encoder.offset", ".encoder.creep", ".encoder.tilt"])
    assert all(leaf is None for leaf in jax.tree.leaves(params.domain, is_leaf=lambda a: a is None))
    np.testing.assert_array_equal(eqx.combine(params, static).coefficients, model.coefficients)
    elapsed = eqx.tree_at(lambda m: m.memory, model, ElapsedTime(3.0))
    assert names(eqx.filter(elapsed.memory, eqx.is_inexact_array)) == []


@pytest.mark.slow
def test_a_plain_optax_loop_is_as_good_as_one_with_parts_picked_by_hand():
    """A virtual cone, whose creep and electrode the linear model lacks; 20 steps of Adam on all inexact leaves."""
    cone, rate = pitp.plant("cone100"), 250.0
    sines = [excitation.sine(hz, 3.0, rate, 1500.0, 1500.0) for hz in (1.0, 3.0)]
    sweep = pitp.record(cone, "sweep", *excitation.sweep(0.5, 12.0, 8.0, rate, 1500.0, 1500.0), seed=0)
    nominal = pitp.identify([sweep], order=2, hold="foh").model.model
    records = [pitp.record(cone, str(k), *wave, seed=0) for k, wave in enumerate(sines)]
    u = jnp.stack([jnp.asarray(r.voltage, jnp.float32) for r in records])
    x = jnp.stack([jnp.asarray(nominal.output.to_model(r.displacement), jnp.float32) for r in records])
    model = replace(
        nominal,
        drive=ElectrodeLag(jnp.asarray(np.log(2e-3), jnp.float32)),
        effects=(effect("creep", kappa=0.02, tau=0.5),),
    )
    spec = jax.tree.map(lambda _: False, model)
    by_hand = eqx.tree_at(
        lambda m: (m.coefficients, m.drive.log_tau, m.effects[0].kappa, m.effects[0].tau), spec, (True,) * 4
    )

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def error(params, static):
        runs = jax.vmap(lambda v: pitp.free_run(eqx.combine(params, static), v))(u)
        return 100 * jnp.sqrt(jnp.mean((runs - x) ** 2 / jnp.ptp(x, axis=1, keepdims=True) ** 2))

    def loop(chosen):
        params, static = eqx.partition(model, chosen)
        optimiser, values = optax.adam(1e-2), []
        state = optimiser.init(params)
        for _ in range(20):
            value, grads = error(params, static)
            updates, state = optimiser.update(grads, state)
            params = eqx.apply_updates(params, updates)
            values.append(float(value))
        return values

    plainly, picked = loop(eqx.is_inexact_array), loop(by_hand)
    np.testing.assert_allclose(plainly, picked, rtol=1e-4)
    assert plainly[-1] < 0.85 * plainly[0]


def test_free_run_is_the_equations_solution(plain):
    u = volts()
    truth = lsim(([1.0], plain.physical_coefficients[::-1]), u**2, TIME)[1]
    found = pitp.free_run(plain, u)
    # the square of a voltage that is linear between samples is not the line between the squares: some (w dt)^2
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-3 * np.ptp(truth))
    np.testing.assert_allclose(found, pitp.rollout(plain, u), rtol=0, atol=1e-6 * np.ptp(truth))


@pytest.mark.slow  # random models of every kind stand in test_round_trips
@pytest.mark.parametrize(("kind", "bound"), [("closed_form", 1e-3), ("discrete", 5e-6)])
def test_a_free_run_of_the_inverse_is_the_target(trained, double, kind, bound):
    """Closed: eq. 13 holds tokens nowhere, the decoder over a step, some (w dt)^2 / 12 of a nonlinear force.

    Discrete: its memories follow a line between samples, the decoder's a Runge-Kutta step.
    """
    with jax.enable_x64(True):
        model, u = double(trained), volts()
        x = pitp.free_run(model, u)
        found, unreachable = pitp.inverse(model, x, kind=kind)
        assert not unreachable[20:-20].any()
        again = pitp.free_run(model, found)
        np.testing.assert_allclose(again, x, rtol=0, atol=bound * np.ptp(x))


def test_what_no_voltage_makes_is_marked_and_clipped(plain):
    wanted = 1e-4 * np.sin(2 * np.pi * TIME)
    found, unreachable = pitp.inverse(plain, wanted)
    pulled = wanted < -2e-6
    assert unreachable[pulled].all() and not unreachable[wanted > 2e-6].any()
    assert (np.asarray(found)[pulled] == 0).all()


def test_a_reversed_sensor_changes_nothing_behind_a_square_and_the_sign_behind_a_linear_input(linear):
    square, turned = (linear(2, HZ, dt=DT, offset=0.3, polarity=p) for p in (1.0, -1.0))
    np.testing.assert_array_equal(pitp.free_run(square, volts()), pitp.free_run(turned, volts()))
    straight, turned = (linear(2, HZ, dt=DT, input_map=LinearInput(), polarity=p) for p in (1.0, -1.0))
    x = pitp.free_run(straight, volts())
    np.testing.assert_array_equal(pitp.free_run(turned, volts()), -x)
    np.testing.assert_allclose(pitp.inverse(turned, -x)[0], pitp.inverse(straight, x)[0])


@pytest.mark.slow
def test_readings_of_the_sensor_are_as_good_as_the_displacement(linear, double):
    """zero="sensor" takes offset and direction out; a number is the reading at 0 V of a sensor with direction +1."""
    with jax.enable_x64(True):
        model = double(linear(2, HZ, dt=DT, offset=3e-4, polarity=-1.0))
        x = 1e-4 * np.sin(np.pi * TIME) ** 4
        truth = pitp.inverse(model, x)[0]
        np.testing.assert_allclose(pitp.inverse(model, 3e-4 - x, zero="sensor")[0], truth, rtol=0, atol=1e-3)
        np.testing.assert_allclose(pitp.inverse(model, x + 3e-4, zero=3e-4)[0], truth, rtol=0, atol=1e-3)
        found = pitp.residual(model, truth, 3e-4 - x, zero="sensor")
        assert np.abs(found)[60:-60].max() < 1e-3


REFUSED = {
    "rollout": ("free_run", lambda m, u: pitp.rollout(m, u)),
    "predict": ("free_run", lambda m, u: pitp.predict(m, [])),
    "feedforward": ("inverse", lambda m, u: pitp.feedforward(m, pitp.Target(TIME, 0 * TIME)).voltage),
    "Target": ("inverse", lambda m, u: pitp.Target(TIME, u).displacement),
    "Record": ("free_run or residual", lambda m, u: pitp.Record("a", TIME, u, u).voltage),
    "sharded_inverse": ("inverse", lambda m, u: pitp.sharded_inverse(m, u[None], DT, pitp.records_mesh())),
    "sharded_rollout": ("free_run", lambda m, u: pitp.sharded_rollout(m, u[None], DT, u, pitp.records_mesh())),
    "invert_stream": ("inverse", lambda m, u: list(pitp.invert_stream(m, [u], DT))[0].voltage),
    "error": ("jax.numpy", lambda m, u: pitp.e_rms_percent(u, u)),
}


@pytest.fixture
def unchecked():
    """Switch off the suite's own checks of types, which would refuse a wrong type first."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", REFUSED)
def test_what_runs_on_the_host_names_the_function_to_trace(plain, name):
    instead, function = REFUSED[name]
    arrays, static = eqx.partition(plain, eqx.is_inexact_array)
    with pytest.raises(pitp.BadInput, match=f"{name}.*cannot be traced.*use .*{instead}"):
        jax.make_jaxpr(lambda arrays, u: function(eqx.combine(arrays, static), u))(arrays, volts())


WRONG = {
    "free_run": ("voltage is a Record, not an array of numbers", lambda m, r: pitp.free_run(m, r)),
    "free_run of two": (
        r"voltage has shape \(2, 600\): give one recording",
        lambda m, r: pitp.free_run(m, untyped([TIME, TIME])),
    ),
    "inverse": ("displacement is a str, not an array", lambda m, r: pitp.inverse(m, untyped("left"))),
    "memory_along": ("displacement is a Record", pitp.memory_along),
    "tokens_along": ("displacement is a Record", pitp.tokens_along),
    "residual": ("voltage is a Record", lambda m, r: pitp.residual(m, r, TIME)),
    "residual_loss": ("displacement is a Record", lambda m, r: pitp.residual_loss(m, TIME, r)),
    "predict_band": ("a Model is not an ensemble", lambda m, r: pitp.predict_band(m, [r])),
    "invert_stream": ("blocks is one array: give a list", lambda m, r: list(pitp.invert_stream(m, TIME, DT))),
}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_signal_is_refused_by_name(plain, name):
    message, function = WRONG[name]
    with pytest.raises(pitp.BadInput, match=message):
        function(plain, Record("a", TIME, TIME, TIME))


def test_memories_are_lags_of_the_displacement(trained):
    x = np.asarray(pitp.free_run(trained, volts()), np.float64)
    found = pitp.memory_along(trained, x)
    for k, tau in enumerate(np.exp(np.asarray(trained.memory.log_tau, np.float64))):
        truth = lsim(([1.0], [tau, 1.0]), x, TIME)[1]
        np.testing.assert_allclose(found[:, k], truth, rtol=0, atol=1e-4 * np.abs(truth).max())


def test_tokens_times_the_motion_are_the_force(plain, trained, double):
    with jax.enable_x64(True):
        model = double(plain)
        tokens = pitp.tokens_along(model, 1e-4 * TIME)
        np.testing.assert_allclose(tokens, np.tile(model.physical_coefficients, (600, 1)), rtol=1e-12)
        one = double(trained)
        t = np.arange(600) * DT
        x = 1e-4 * np.sin(3 * t) ** 4
        tokens = pitp.tokens_along(one, x)
        state = np.array([x[300], 12e-4 * np.sin(3 * t[300]) ** 3 * np.cos(3 * t[300])])
        memory = pitp.memory_along(one, x)[300]
        features = jnp.concatenate([state / np.array(one.scales.state[:2]), memory / one.scales.state[0]])
        truth = (
            eqx.filter_jit(lambda m, at: m.tokens(at))(one, features)[0] * one.scales.force / np.array(one.scales.state)
        )
        np.testing.assert_allclose(tokens[300], truth, rtol=1e-7)


def test_the_residual_is_the_trainings(plain, shake):
    """Along one recording as `build_dataset` prepares it, but for the 8th-order stencil beside the spline."""
    u = 700 * np.sin(np.pi * 2 * TIME * (1 + TIME)) ** 2
    x = np.asarray(pitp.free_run(plain, u), np.float64) + 1e-7 * np.random.default_rng(0).standard_normal(600)
    record = Record("a", TIME, u, x)
    data = build_dataset(plain, [record], scaling="rms", difference="stencil", memory=lambda states: plain.memory)
    model = eqx.tree_at(lambda m: m.coefficients, data.model, data.model.coefficients * jnp.array([1.02, 0.9, 1.05]))
    equation = data.equation
    truth = equation.equation @ model.coefficients - equation.force
    found = pitp.residual(model, u, x)[data.valid[0]]
    np.testing.assert_allclose(found, truth, rtol=0, atol=2e-3)
    box = (0.95, 1.04)
    total, _ = eqx.filter_jit(loss)(model, equation, box, width=0.05, penalty=(0.1, 0.1))
    assert float(pitp.residual_loss(model, u, x, box=box)) == pytest.approx(float(total), rel=0.02)
    assert float(pitp.residual_loss(model, u, x)) < float(total)


def test_the_force_is_filtered_as_by_scipy_forwards_and_backwards(plain):
    """Of an actuator held at 0 the filtered force remains: a Butterworth of order 4 at 40 Hz, on three sines."""
    force = sum(np.sin(2 * np.pi * hz * TIME + hz) for hz in (10.0, 40.0, 50.0)) + 4.0
    unit = np.asarray(pitp.residual(plain, np.full(600, 100.0), np.zeros(600)))[300]  # of 100 V, not filtered
    found = pitp.residual(plain, 100 * np.sqrt(force), np.zeros(600), cutoff_hz=40.0)
    truth = sosfiltfilt(butter(4, 40.0, output="sos", fs=1 / DT), force)
    np.testing.assert_allclose(found[150:-150] / unit, truth[150:-150], rtol=0, atol=2e-3)


def functions():
    def volts_to(function):
        return function, volts()

    x = 1e-4 * np.sin(2 * np.pi * TIME) ** 4
    return {
        "free_run": (pitp.free_run, volts()),
        "inverse": (lambda m, y: pitp.inverse(m, y)[0], x),
        "discrete": (lambda m, y: pitp.inverse(m, y, kind="discrete")[0], x),
        "residual": (lambda m, y: pitp.residual(m, 0.5 * volts(), y), x),
        "residual_loss": (lambda m, y: pitp.residual_loss(m, 0.5 * volts(), y), x),
        "memory_along": (pitp.memory_along, x),
        "tokens_along": (pitp.tokens_along, x),
    }


NAMES = list(functions())


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_transformation_gives_the_same_numbers(trained, double, name):
    """jit, vmap, checkpoint and shard_map; no second trace for other numbers of the same shape."""
    function, given = functions()[name]
    with jax.enable_x64(True):
        model, many = double(trained), jnp.stack([given, 0.9 * given, 0.5 * given])
        plainly = np.stack([function(model, row) for row in many])
        scale = np.abs(plainly).max()
        count = []

        def counted(m, y):
            count.append(name)
            return function(m, y)

        one = jax.jit(counted)
        alike = partial(np.testing.assert_allclose, rtol=0, atol=1e-9 * scale)
        alike(np.stack([one(model, row) for row in many]), plainly)
        other = replace(model, scales=replace(model.scales, force=model.scales.force * 1.5))
        one(other, many[0])
        assert len(count) == 1
        alike(jax.jit(jax.vmap(function, (None, 0)))(model, many), plainly)
        models = jax.tree.map(lambda *leaves: jnp.stack(leaves), model, other)
        alike(jax.vmap(function, (0, None))(models, many[0])[0], plainly[0])
        alike(jax.checkpoint(function)(model, many[0]), plainly[0])
        spread = jax.shard_map(
            jax.vmap(partial(function, model)), mesh=pitp.records_mesh(jax.devices()[:1]),
            in_specs=PartitionSpec("records"), out_specs=PartitionSpec("records"), check_vma=False,
        )  # fmt: skip
        alike(jax.jit(spread)(many), plainly)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gradients_are_finite_differences(trained, double, name):
    """With respect to the parameters and to the signal, in float64; forward and reverse mode agree."""
    function, given = functions()[name]
    with jax.enable_x64(True):
        model = double(trained)
        params, static = eqx.partition(model, eqx.is_inexact_array)
        rng = np.random.default_rng(1)
        push = jax.tree.map(lambda a: jnp.asarray(rng.standard_normal(a.shape)), params)
        away = jnp.asarray(np.sin(np.pi * TIME / TIME[-1]) ** 4 * np.abs(given).max())

        def value(s):
            moved = jax.tree.map(lambda a, b: a + s[0] * b, params, push)
            out = function(eqx.combine(moved, static), given + s[1] * away)
            return jnp.sum(out[40:-40] ** 2) if out.ndim else out

        value = jax.jit(value)
        zero, h = jnp.zeros(2), 1e-7  # the root of a force near 0 bends within a wider step
        slopes = jax.grad(value)(zero)
        steps = h * np.eye(2)
        truth = [(value(zero + d) - value(zero - d)) / (2 * h) for d in steps]
        np.testing.assert_allclose(slopes, truth, rtol=2e-4, atol=1e-6 * np.abs(truth).max())
        np.testing.assert_allclose(jax.jacfwd(value)(zero), slopes, rtol=1e-8, atol=1e-9 * np.abs(truth).max())


MODELS = {
    "order 1": lambda linear, nonlinear: linear(1, HZ, dt=DT),
    "order 3": lambda linear, nonlinear: linear(3, HZ, dt=DT),
    "order 6": lambda linear, nonlinear: linear(6, 4.0, dt=DT),
    "paper": lambda linear, nonlinear: replace(
        linear(2, HZ, dt=DT), encoder=PaperEncoder(3, 3, width=8, key=jax.random.key(0)), memory=ElapsedTime(3.0)
    ),
    "substeps": lambda linear, nonlinear: linear(2, HZ, dt=DT, substeps=3),
    "held": lambda linear, nonlinear: linear(2, HZ, dt=DT, hold="zoh"),
    "spring": lambda linear, nonlinear: replace(nonlinear(2, hz=HZ, dt=DT), effects=(effect("stiffening", c=0.3),)),
    "creep": lambda linear, nonlinear: replace(
        linear(2, HZ, dt=DT), effects=(effect("creep", kappa=0.3, tau=0.4), effect("sensor_gain", d=0.1))
    ),
    "coupled": lambda linear, nonlinear: replace(
        linear(3, HZ, dt=DT), effects=(effect("stretch_coupling", b=0.2), effect("delay", time=3 * DT))
    ),
    "late": lambda linear, nonlinear: replace(
        linear(2, HZ, dt=DT), effects=(effect("electrode_rc", tau=5e-3), effect("sensor_lag", tau=6e-3))
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_every_kind_of_model_is_run_inverted_and_judged(linear, nonlinear, double, name):
    """Inverse after forward to 0.3 % of range, the residual of its own run to 0.5 % of the largest force."""
    with jax.enable_x64(True):
        model, u = double(MODELS[name](linear, nonlinear)), volts()
        x = pitp.free_run(model, u)
        for kind, bound in (("closed_form", 3e-3 if name != "held" else 3e-2), ("discrete", 3e-3)):
            found, _ = pitp.inverse(model, x, kind=kind)  # type: ignore[arg-type]
            np.testing.assert_allclose(pitp.free_run(model, found), x, rtol=0, atol=bound * np.ptp(x))
        # both in units of the force that was played
        assert np.abs(pitp.residual(model, u, x))[60:-60].max() < 0.02 * 0.49
        assert pitp.memory_along(model, x).shape == (600, model.memory.size)
        assert pitp.tokens_along(model, x).shape == (600, model.order + 1)
        assert np.isfinite(pitp.residual_loss(model, u, x))
