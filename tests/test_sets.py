"""Sets of records: what does not belong together is refused by name, and clocks that show absolute time are told."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pitp_jax as pitp
from pitp_jax.common.errors import BadInput
from pitp_jax.method.diagnose.data import build_case
from pitp_jax.method.effects import lookup
from pitp_jax.method.signal.sets import alike, check_set, clock_start

DT, SAMPLES, EPOCH = 2e-3, 800, 1.7e9
TIME = np.arange(SAMPLES) * DT


def record(name, dt=DT, begins=0.0):
    volts = 500 * (1 - np.cos(2 * np.pi * 1.5 * TIME))
    x = 1e-9 * volts**2
    return pitp.Record(name, begins + TIME * dt / DT, volts, x)


@pytest.mark.parametrize("use", ["identify", "train", "predict", "diagnose"])
def test_several_rates_are_refused_by_name(linear, use):
    records = [record("fast"), record("slow", 2 * DT)]
    calls = {
        "identify": lambda: pitp.identify(records),
        "train": lambda: pitp.train(linear(2, dt=DT), records, key=jax.random.key(0)),
        "predict": lambda: pitp.predict(linear(2, dt=DT), records),
        "diagnose": lambda: pitp.diagnose(linear(2, dt=DT), records),
    }
    with pytest.raises(BadInput, match="'slow': time column: sampled every 0.004 s, but record 'fast' every 0.002 s"):
        calls[use]()


@pytest.mark.parametrize(("given", "word"), [([], "no records"), (record("one"), "'one': give a list")])
def test_what_is_no_set_is_refused(given, word):
    with pytest.raises(BadInput, match=word):
        check_set(given)


def cut(lengths):
    return [replace(r, time=r.time[:n], voltage=r.voltage[:n], displacement=r.displacement[:n])
            for n, r in ((n, record(f"{k}: {n}")) for k, n in enumerate(lengths))]  # fmt: skip


@pytest.mark.parametrize(
    ("lengths", "sets"),
    [
        ([800, 300, 500], [[0, 1, 2]]),  # 2400 for 1600
        ([100, 800, 100, 450, 100, 90], [[1, 3], [0, 2, 4, 5]]),  # 4800 for 1640
        ([64] * 3, [[0, 1, 2]]),
    ],
)
def test_records_are_padded_beside_their_like(lengths, sets):
    assert alike(cut(lengths)) == sets


@pytest.mark.slow
def test_predictions_come_in_the_order_of_the_records(linear):
    model, records = linear(2, dt=DT), cut([100, 800, 120, 90, 110])
    for found, r in zip(pitp.predict(model, records), records, strict=True):
        assert (found.name, len(found.displacement)) == (r.name, r.samples)


def test_only_absolute_clocks_have_a_start():
    assert clock_start([record("a", begins=300.0), record("b")]) == 0.0
    assert clock_start([record("b", begins=EPOCH + 50), record("a", begins=EPOCH)]) == EPOCH


@pytest.mark.slow
def test_drift_is_the_same_by_either_clock(linear):
    """A spring that settles within a minute, records one to four minutes into a session."""
    drift = lookup("stiffness_drift")(*(jnp.asarray(v, jnp.float32) for v in (0.3, 60.0)))
    session = [record(f"{k}", begins=60.0 * k) for k in range(4)]
    dated = [replace(r, time=r.time + EPOCH) for r in session]
    model = replace(linear(2, dt=DT), effects=(drift,))
    told = replace(model, domain=replace(model.domain, clock=clock_start(dated)))
    own, absolute = pitp.predict(model, session), pitp.predict(told, dated)
    for a, b in zip(own, absolute, strict=True):
        np.testing.assert_allclose(a.displacement, b.displacement, rtol=0, atol=1e-6 * np.ptp(a.displacement))
    assert np.ptp(own[3].displacement) > 1.1 * np.ptp(own[0].displacement)
    ages = [d.age for d in build_case(told, dated).simulator.drives]
    np.testing.assert_allclose(ages, [d.age for d in build_case(model, session).simulator.drives], atol=1e-6)
