"""Properties of the public inverse and free run: each undoes the other, over random stable models, in float64.

Models of 1 mm at 1 kV and of order 1 to 4, with 80 to 320 samples a period of the resonance. Two errors are left:

    closed form   The decoder squares a voltage that is linear between samples. Its mean force lies (du)^2 / 6 off the
                  square at the samples: 1 V and 1 um at 0.08 of the largest voltage a step. Tokens that depend on the
                  motion change within a step: 2 V and 3 um.
    discrete      The derivatives come from a spline, the decoder's states from Runge-Kutta steps: (w dt)^4 of the
                  motion, 0.3 V and 0.2 um. Of order 1 no derivative is read, and only rounding is left. A delay of a
                  fraction of a sample is undone by interpolation: the error of the closed form.

Bounds are two to three times the largest errors of 60 random models of each kind.

Errors of the voltage are those at 1 kV: the square has no slope at 0 V, where the same force is more volts.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import pitp_jax as pitp
from pitp_jax.method.effects import effect

SAMPLES, HIGH, TRAVEL, NOISE = 400, 1e3, 1e-3, 3e-6  # V, m, m
EDGE = 40  # samples at both ends, where the spline's boundary conditions show
KINDS: tuple[Literal["discrete", "closed_form"], ...] = ("discrete", "closed_form")
FRACTION = st.floats(0.0, 1.0)
DRAWS = st.fixed_dictionaries(
    {
        "turns": st.floats(1 / 320, 1 / 80),  # of the resonance, per sample
        "damping": st.floats(0.05, 0.8),
        "ratio": st.floats(0.5, 2.0),  # excitation over resonance
        "second": st.floats(0.3, 1.0),  # largest voltage of the second recording over that of the first
        "parts": st.tuples(FRACTION, FRACTION, FRACTION),  # of the ranges of the effects' parameters
        "seed": st.integers(0, 10**6),  # of the weights
    }
)
EFFECTS = {
    "none": lambda dt, a, b, c: (),
    "spring and electrode": lambda dt, a, b, c: (
        effect("stiffening", c=0.4 * a), effect("electrode_rc", tau=(0.2 + 3 * b) * dt)),
    "creep and sensor": lambda dt, a, b, c: (
        effect("creep", kappa=0.3 * a, tau=(20 + 200 * b) * dt), effect("sensor_gain", d=0.3 * c - 0.15)),
    "film and delay": lambda dt, a, b, c: (effect("stretch_coupling", b=0.3 * a), effect("delay", time=5 * b * dt)),
}  # fmt: skip
SIZES = {1: 0.1, 2: 0.1, 3: 0.05, 4: 0.02}  # of the logits: poles of higher order bear less before they are unstable

# order, encoder, effects, sampling interval (s); largest errors of the discrete inverse and the closed form, V and m
CASES = [
    (1, "none", "none", 4e-3, (1e-3, 1e-9), (2.0, 2e-6)),
    (1, "compact", "none", 1e-3, (0.3, 2e-7), (6.0, 8e-6)),
    (2, "compact", "none", 1e-3, (0.8, 4e-7), (3.0, 3e-6)),
    (2, "paper", "none", 4e-3, (1.5, 1e-7), (3.0, 2e-6)),
    (2, "none", "spring and electrode", 1e-3, (1.5, 5e-7), (3.0, 3e-6)),
    (2, "none", "creep and sensor", 2.5e-4, (0.5, 6e-7), (3.0, 3e-6)),
    (3, "none", "film and delay", 1e-3, (6.0, 5e-6), (8.0, 6e-6)),
    (3, "paper", "none", 4e-3, (0.2, 1e-8), (2.0, 2e-6)),
    (4, "compact", "none", 1e-3, (0.8, 4e-7), (5.0, 4e-6)),
]


@pytest.fixture
def model_of(linear, nonlinear, shake, double):
    """fn(order, encoder, effects, dt, drawn): a stable model in float64."""

    def make(order, encoder, effects, dt, drawn):
        hz, size = drawn["turns"] / dt, SIZES[order]
        options = {"hz": hz, "damping": drawn["damping"], "dt": dt}
        if encoder == "compact":
            lags = dt * (20 + 100 * drawn["parts"][0]), dt * (200 + 600 * drawn["parts"][1])
            model = nonlinear(order, drawn["seed"], size, tau=lags, **options)
        else:
            model = linear(order, **options)
        if encoder == "paper":
            fresh = pitp.PaperEncoder(order + 1, order + 1, width=4, depth=1, key=jax.random.key(0))
            part = shake(fresh, size, drawn["seed"])
            model = replace(model, encoder=part, memory=pitp.ElapsedTime(SAMPLES * dt))
        domain = replace(model.domain, noise=NOISE)
        return double(replace(model, effects=EFFECTS[effects](dt, *drawn["parts"]), domain=domain))

    return make


def voltages(drawn):
    """Compute two voltages from rest to rest, without a kink, V, shape (2, time)."""
    sample = np.arange(SAMPLES)
    shape = np.sin(np.pi * drawn["ratio"] * drawn["turns"] * sample) ** 2 * np.sin(np.pi * sample / sample[-1]) ** 2
    return HIGH * np.outer([1.0, drawn["second"]], shape)


def check_round_trips(model, u, discrete, closed_form):
    """Assert inverse(free_run(u)) = u and free_run(inverse(x)) = x within bounds in V and m."""
    x = np.asarray(jax.vmap(partial(pitp.free_run, model))(u))
    inner, bounds = slice(EDGE, -EDGE), {"discrete": discrete, "closed_form": closed_form}
    for kind in KINDS:
        volts, metres = bounds[kind]
        found, unreachable = jax.vmap(partial(pitp.inverse, model, kind=kind))(x)
        again = jax.vmap(partial(pitp.free_run, model))(found)
        error = (np.asarray(found) ** 2 - u**2)[:, inner] / (2 * HIGH)
        assert np.abs(error).max() < volts, (kind, "V")
        assert np.abs(np.asarray(again) - x).max() < metres * max(np.ptp(x) / TRAVEL, 1), (kind, "m")
        assert not np.asarray(unreachable)[:, inner][u[:, inner] > 0.1 * HIGH].any()
        at_zero_volts = pitp.free_run(model, np.zeros(SAMPLES))
        assert not np.asarray(pitp.inverse(model, at_zero_volts, kind=kind)[1])[inner].any(), (kind, "rest")


def undo_each_other(model_of, case, examples):
    order, encoder, effects, dt, discrete, closed_form = case
    phases = Phase.explicit, Phase.reuse, Phase.generate  # no shrinking: it would run hundreds of models

    @settings(max_examples=examples, deadline=None, suppress_health_check=[HealthCheck.too_slow], phases=phases)
    @given(DRAWS)
    def check(drawn):
        with jax.enable_x64(True):
            check_round_trips(model_of(order, encoder, effects, dt, drawn), voltages(drawn), discrete, closed_form)

    check()


def test_inverse_and_free_run_undo_each_other(model_of):
    undo_each_other(model_of, CASES[2], 3)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda c: f"order {c[0]}, {c[1]}, {c[2]}")
def test_inverse_and_free_run_undo_each_other_for_every_kind_of_model(model_of, case):
    undo_each_other(model_of, case, 5)
