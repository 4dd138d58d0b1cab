"""Real laser habits, through the Python API: the same actuator comes out, in the user's own coordinates.

One linear actuator (F = u^2, 8 Hz, damping 0.08, 1 mm at 1 kV) under a sweep of 6 s at 1 kHz; noise 2 um on 25 mm.
"""

import numpy as np
import pytest
from scipy.linalg import expm

import pitp_jax as pitp
from pitp_jax.files.recordings.writing import write_csv

DT, SAMPLES, NOISE = 1e-3, 6000, 2e-6
OMEGA, DAMPING, STIFFNESS = 2 * np.pi * 8.0, 0.08, 1e9
TRUTH = STIFFNESS * np.array([1.0, 2 * DAMPING / OMEGA, 1 / OMEGA**2])
TIME = np.arange(SAMPLES) * DT
MOVING, TURNING = 1549, 1500  # cuts at half height and nearly full speed; and 11 mm up, still for a moment
CUT = 4400  # samples


def response(voltage, finer=10):
    """Displacement from rest in m: exact steps of dt / 10 under the square of the linear voltage."""
    h = DT / finer
    chained = np.array(
        [[0, 1, 0, 0], [-(OMEGA**2), -2 * DAMPING * OMEGA, OMEGA**2 / STIFFNESS, 0], [0, 0, 0, 1 / h], [0, 0, 0, 0]]
    )
    exact = expm(chained * h)[:2]
    force = np.interp(np.arange((len(voltage) - 1) * finer + 1) / finer, np.arange(len(voltage)), voltage) ** 2
    state, x = np.zeros(2), np.zeros(len(force))
    for k in range(len(force) - 1):
        state = exact @ np.array([*state, force[k], force[k + 1] - force[k]])
        x[k + 1] = state[0]
    return x[::finer]


@pytest.fixture(scope="module")
def sweep():
    """Voltage in V, true displacement and measured one in m; from rest."""
    u = 1500 - 1500 * np.cos(2 * np.pi * (0.2 * TIME + (12 - 0.2) / 12 * TIME**2))
    x = response(u)
    return u, x, x + NOISE * np.random.default_rng(0).standard_normal(SAMPLES)


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    """fn(name, columns...): a CSV file, alone in its folder unless `folder` is given."""

    def make(name="sweep.csv", *, folder=None, **columns):
        path = (folder or tmp_path_factory.mktemp("rig")) / name
        write_csv(path, columns)
        return path

    return make


@pytest.fixture(scope="module")
def study():
    """fn(*paths): the records read, identified at order 2, and the free run of each."""

    def run(*paths):
        records = pitp.read(*paths)
        found = pitp.identify(records, order=2)
        return records, found, pitp.predict(found.model, records)

    return run


@pytest.fixture(scope="module")
def clean(sweep, write, study):
    u, _, y = sweep
    return study(write(time_s=TIME, voltage_V=u, displacement_m=y))


def same_actuator(found, rel=1e-3):
    np.testing.assert_allclose(found.model.physical_coefficients, TRUTH, rtol=rel)
    np.testing.assert_allclose(found.chosen.natural_hz, 8.0, rtol=rel)


def test_the_clean_record(clean, sweep):
    (record,), found, (run,) = clean
    same_actuator(found, 2e-4)
    assert found.rest == {"sweep": True}
    assert found.chosen.offset == pytest.approx(0.0, abs=NOISE)
    assert found.chosen.polarity == 1.0
    assert not run.estimated_start
    assert run.scored.all()
    assert np.abs(run.displacement - sweep[1]).max() < 5 * NOISE
    assert np.sqrt(np.mean((run.displacement - record.displacement) ** 2)) < 1.2 * NOISE


@pytest.mark.parametrize("zero", [3e-3, -0.12])
def test_an_arbitrary_zero(clean, sweep, write, study, zero):
    u, x, y = sweep
    _, found, (run,) = study(write(time_s=TIME, voltage_V=u, displacement_m=y + zero))
    same_actuator(found)
    assert found.chosen.offset == pytest.approx(zero, abs=2 * NOISE)
    assert found.rest == {"sweep": True}
    np.testing.assert_allclose(run.displacement, x + zero, atol=5 * NOISE)
    np.testing.assert_allclose(run.displacement - zero, clean[2][0].displacement, atol=2 * NOISE)


def test_a_reversed_sign(clean, sweep, write, study):
    u, x, y = sweep
    _, found, (run,) = study(write(time_s=TIME, voltage_V=u, displacement_m=2e-3 - y))
    same_actuator(found)
    assert found.chosen.polarity == -1.0
    assert found.chosen.offset == pytest.approx(2e-3, abs=2 * NOISE)
    np.testing.assert_allclose(run.displacement, 2e-3 - x, atol=5 * NOISE)


@pytest.mark.parametrize(
    ("columns", "units"),
    [
        ({"time_s": 1.0, "voltage_kV": 1e-3, "displacement_mm": 1e3}, ("kV", "mm")),
        ({"time_ms": 1e3, "voltage_mV": 1e3, "displacement_um": 1e6}, ("mV", "um")),
    ],
)
def test_other_units_give_the_same_model(clean, sweep, write, study, columns, units):
    u, _, y = sweep
    values = {name: factor * v for (name, factor), v in zip(columns.items(), (TIME, u, y), strict=True)}
    (record,), found, (run,) = study(write(**values))
    assert (record.voltage_unit, record.displacement_unit) == units
    assert (found.model.origin.voltage_unit, found.model.origin.displacement_unit) == units
    np.testing.assert_allclose(found.model.physical_coefficients, clean[1].model.physical_coefficients, rtol=1e-6)
    np.testing.assert_allclose(run.displacement, clean[2][0].displacement, atol=1e-8)


def test_volts_taken_for_kilovolts_would_not_go_unseen(sweep, write):
    """The unit is the column's name: 1 kV written as `voltage_V` is another actuator, a million times softer."""
    u, _, y = sweep
    mistaken = pitp.read(write(time_s=TIME, voltage_V=u / 1e3, displacement_m=y))
    found = pitp.identify(mistaken, order=2)
    np.testing.assert_allclose(found.model.physical_coefficients, TRUTH / 1e6, rtol=1e-3)


def test_gaps_of_200_samples(clean, sweep, write, study):
    u, x, y = sweep
    holes = y.copy()
    for start in (700, 2500, 4100):
        holes[start : start + 200] = np.nan
    (record,), found, (run,) = study(write(time_s=TIME, voltage_V=u, displacement_m=holes))
    assert record.missing == 600
    same_actuator(found)
    assert found.chosen.offset == pytest.approx(0.0, abs=NOISE)
    assert np.isfinite(run.displacement).all()
    np.testing.assert_allclose(run.displacement, x, atol=5 * NOISE)  # through the gaps too
    np.testing.assert_allclose(run.displacement, clean[2][0].displacement, atol=2 * NOISE)


def test_a_gap_at_the_start(sweep, write, study):
    u, x, y = sweep
    late = np.where(TIME < 0.2, np.nan, y)
    (record,), found, (run,) = study(write(time_s=TIME, voltage_V=u, displacement_m=late))
    assert record.missing == 200
    same_actuator(found)
    np.testing.assert_allclose(run.displacement[200:], x[200:], atol=10 * NOISE)


def test_a_record_that_starts_moving(sweep, write, study):
    time, u, x, y = (v[MOVING : MOVING + CUT] for v in (TIME, *sweep))
    (record,), found, (run,) = study(write(time_s=time, voltage_V=u, displacement_m=y + 3e-3))
    assert found.rest == {"sweep": False}
    same_actuator(found)
    assert found.chosen.offset == pytest.approx(3e-3, abs=10 * NOISE)
    assert run.estimated_start
    used = int(np.argmax(run.scored))
    assert used == pytest.approx(1.5 / (8.0 * DT), abs=1)  # periods of the mode
    np.testing.assert_array_equal(run.scored, np.arange(record.samples) >= used)
    np.testing.assert_allclose(run.displacement[used:], x[used:] + 3e-3, atol=20 * NOISE)


@pytest.mark.parametrize(
    ("first", "cut"),
    [("resting", MOVING), ("resting", TURNING), ("moving", MOVING), ("moving", TURNING)],
)
def test_a_moving_record_beside_a_resting_one(sweep, write, study, tmp_path, first, cut):
    u, x, y = sweep
    part = slice(cut, cut + CUT)
    names = ("b_resting.csv", "a_moving.csv") if first == "moving" else ("a_resting.csv", "b_moving.csv")
    write(names[0], folder=tmp_path, time_s=TIME, voltage_V=u, displacement_m=y - 1e-3)
    write(names[1], folder=tmp_path, time_s=TIME[part], voltage_V=u[part], displacement_m=y[part] - 1e-3)
    _, found, runs = study(tmp_path)
    assert {name.split("_")[1]: rest for name, rest in found.rest.items()} == {"resting": True, "moving": False}
    same_actuator(found)
    for run in runs:
        start = 0 if "resting" in run.name else cut
        assert run.estimated_start == (start > 0)
        wanted = x[start : start + len(run.displacement)] - 1e-3
        np.testing.assert_allclose(run.displacement[50:], wanted[50:], atol=20 * NOISE)


def test_a_lone_record_that_starts_at_a_turning_point(sweep, write, study):
    time, u, _, y = (v[TURNING : TURNING + CUT] for v in (TIME, *sweep))
    _, found, _ = study(write(time_s=time, voltage_V=u, displacement_m=y))
    same_actuator(found)


def test_a_first_record_of_five_samples_is_refused_by_name(sweep, write, tmp_path):
    u, _, y = sweep
    write("a_first.csv", folder=tmp_path, time_s=TIME[:5], voltage_V=u[:5], displacement_m=y[:5])
    write("b_sweep.csv", folder=tmp_path, time_s=TIME, voltage_V=u, displacement_m=y)
    with pytest.raises(pitp.BadInput) as refusal:
        pitp.read(tmp_path)
    (line,) = str(refusal.value).splitlines()
    for part in ("a_first.csv", "time_s", "5 in all", "64"):
        assert part in line
    assert [r.name for r in pitp.read(tmp_path / "b_sweep.csv")] == ["b_sweep"]


def test_a_feedforward_speaks_the_users_coordinates(clean, sweep, write, study):
    """From a zeroed, reversed, mm record: the same voltage for the same motion."""
    u, _, y = sweep
    _, found, _ = study(write(time_s=TIME, voltage_kV=u / 1e3, displacement_mm=1e3 * (5e-3 - y)))
    motion = 1e-3 + 5e-4 * np.sin(2 * np.pi * 2 * TIME[:1500])
    plain = pitp.feedforward(clean[1].model, pitp.Target(TIME[:1500], motion))
    offset = found.chosen.offset
    mirrored = pitp.feedforward(found.model, pitp.Target(TIME[:1500], offset - motion), zero="sensor")
    np.testing.assert_allclose(mirrored.voltage[mirrored.target], plain.voltage[plain.target], atol=1.0)
    assert mirrored.self_check_e_rms_percent < 0.01
