"""FMUs and MATLAB functions against the same steps by JAX in float64; the command line."""

import json
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import pitp_jax as pitp
from pitp_jax.application.commands.main import main
from pitp_jax.files.export.plan import plan, played
from pitp_jax.method.invert import steps
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.input_map import LinearInput

pytestmark = pytest.mark.skipif(not shutil.which("cc"), reason="no C compiler")


@pytest.fixture(scope="module")
def fmus(actuator, tmp_path_factory):
    """Folders of both versions."""
    made = {fmi: tmp_path_factory.mktemp("fmu") / "out" for fmi in (2, 3)}
    for fmi, folder in made.items():
        pitp.export_fmu(actuator, folder, name="cone", fmi=fmi)
    return made


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_is_complete(fmus, fmi):
    assert sorted(p.name for p in fmus[fmi].iterdir()) == [
        "README.md", "check.py", "pitp_cone.fmu", "pitp_cone_in.csv", "pitp_cone_ref.csv", "pitp_cone_ref.opt",
    ]  # fmt: skip
    assert not [p for p in fmus[fmi].glob("*.[mp][dy]") if "@" in p.read_text()]
    with zipfile.ZipFile(fmus[fmi] / "pitp_cone.fmu") as archive:
        names = archive.namelist()
        texts = [archive.read(n).decode() for n in names if not n.endswith(".so")]
    assert {"modelDescription.xml", "sources/pitp_cone.c", "sources/pitp_cone.h", "sources/fmu.c"} <= set(names)
    assert not [t for t in texts if "@" in t]


def table(file):
    return np.genfromtxt(file, delimiter=",", names=True)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_importer_plays_it(fmus, fmi):
    """FMPy finds nothing to say, and its run of the cross-check input is the reference; a state comes back."""
    fmpy = pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    file = str(fmus[fmi] / "pitp_cone.fmu")
    assert validate_fmu(file) == []
    drive, reference = table(fmus[fmi] / "pitp_cone_in.csv"), table(fmus[fmi] / "pitp_cone_ref.csv")
    assert np.ptp(reference["displacement"]) > 0 and np.ptp(reference["command"]) > 0
    run = fmpy.simulate_fmu(file, input=drive, step_size=1e-3, output_interval=1e-3, stop_time=1.0)
    for name in ("displacement", "command"):
        found = np.interp(reference["time"], run["time"], run[name])
        np.testing.assert_allclose(found, reference[name], rtol=0, atol=1e-6 * np.ptp(reference[name]))


def test_an_fmu_checks_itself(fmus, tmp_path):
    """`check.py` passes, and fails on another reference."""
    pytest.importorskip("fmpy")
    shutil.copytree(fmus[2], tmp_path / "out")
    command = [sys.executable, str(tmp_path / "out" / "check.py")]
    told = subprocess.run(command, capture_output=True, text=True)
    assert told.returncode == 0, told.stderr
    reference = tmp_path / "out" / "pitp_cone_ref.csv"
    rows = table(reference)
    rows["command"] *= 1.01
    np.savetxt(reference, rows, delimiter=",", header="time,displacement,command", comments="")
    assert subprocess.run(command, capture_output=True).returncode != 0


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_comes_back(fmus, fmi):
    """Steps after a restored, and after a deserialised, state are the steps after the saved one."""
    fmpy = pytest.importorskip("fmpy")
    file = str(fmus[fmi] / "pitp_cone.fmu")
    folder, description = fmpy.extract(file), fmpy.read_model_description(file)
    fmu = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    get, set_ = (fmu.getReal, fmu.setReal) if fmi == 2 else (fmu.getFloat64, fmu.setFloat64)
    at = {v.name: v.valueReference for v in description.modelVariables}
    if fmi == 2:
        fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()

    def go(volts, first):
        found = []
        for k in range(20):
            set_([at["voltage"]], [volts])
            fmu.doStep(currentCommunicationPoint=(first + k) * 1e-3, communicationStepSize=1e-3)
            found += get([at["displacement"]])
        return np.array(found)

    go(1000.0, 0)
    save, restore, free, pack, unpack = (
        getattr(fmu, f"{verb}{'FMUstate' if fmi == 2 else 'FMUState'}")
        for verb in ("get", "set", "free", "serialize", "deSerialize" if fmi == 2 else "deserialize")
    )
    state = save()
    packed, once = pack(state), go(500.0, 20)
    for again in (state, unpack(packed)):
        restore(again)
        np.testing.assert_array_equal(go(500.0, 20), once)
        free(again)
    assert once[0] != once[-1]
    fmu.terminate()
    fmu.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.exhaustive
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.skipif(not shutil.which("cmake"), reason="no cmake")
def test_its_sources_compile(fmus, fmi, tmp_path):
    pytest.importorskip("fmpy")
    file = shutil.copy(fmus[fmi] / "pitp_cone.fmu", tmp_path)
    command = ["fmpy", "compile", "--all-warnings", "--warning-as-error", str(file)]
    done = subprocess.run([str(Path(sys.executable).with_name("fmpy")), *command[1:]], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


PLAY = """
u = load('u.txt'); x = load('x.txt'); s = []; y = zeros(size(u));
for k = 1:numel(u), [y(k), s] = pitp_model_predict(u(k), s); end
s = []; v = y;
for k = 1:numel(u), [v(k), s] = pitp_model_inverse(x(k, :), s); end
f = fopen('out.txt', 'w'); fprintf(f, '%.17g %.17g\\n', [y v]'); fclose(f);
"""


@pytest.mark.skipif(not shutil.which("octave"), reason="no GNU Octave")
def test_octave_plays_the_functions(nonlinear, bounded, tmp_path):
    model = bounded(nonlinear(2, offset=1e-3))
    pitp.export_matlab(model, tmp_path / "m")
    check = "pitp_model_check"
    assert sorted(p.name for p in (tmp_path / "m").iterdir()) == [
        "README.md", f"{check}.m", "pitp_model_inverse.m", "pitp_model_predict.m",
    ]  # fmt: skip
    subprocess.run(["octave", "--no-gui", "-qf", "--eval", check], cwd=tmp_path / "m", check=True)
    test = plan(model, "model", None, "double").test
    np.savetxt(tmp_path / "m" / "u.txt", test.voltage[:300], fmt="%.17g")
    np.savetxt(tmp_path / "m" / "x.txt", test.motion[:300], fmt="%.17g")
    (tmp_path / "m" / "play.m").write_text(PLAY)
    subprocess.run(["octave", "--no-gui", "-qf", "play.m"], cwd=tmp_path / "m", check=True)
    y, u = np.loadtxt(tmp_path / "m" / "out.txt").T
    np.testing.assert_allclose(y, test.displacement[:300], rtol=0, atol=1e-12 * np.ptp(test.displacement))
    np.testing.assert_allclose(u**2, test.planned[:300] ** 2, rtol=0, atol=1e-12 * np.max(test.planned) ** 2)


def test_a_held_voltage_is_a_zoh_step(linear, tmp_path):
    """What an FMU takes: u from t to t + DT gives the displacement at t + DT."""
    model, u = linear(2, hold="zoh"), 500 * np.random.default_rng(0).uniform(size=50)
    (held,) = played(steps.predict(plan(model, "m", None, "double").model, 1e-3, held=True), u, 0.0)
    (own,) = played(steps.predict(plan(model, "m", None, "double").model, 1e-3), np.append(u, 0.0), 0.0)
    np.testing.assert_allclose(held, own[1:], rtol=0, atol=1e-15)


@pytest.mark.parametrize("tau", [4e-5, 4e-4, 4e-3])
def test_a_held_voltage_behind_an_electrode_is_held(linear, tmp_path, tau):
    """A staircase against the exact solution of lag and oscillator (SciPy); lags of 0.04 to 4 steps."""
    model = eqx.tree_at(lambda m: m.drive, linear(2, hz=20.0, input_map=LinearInput()), ElectrodeLag(jnp.log(tau)))
    u = np.repeat(500 * np.random.default_rng(0).uniform(size=20), 5)
    (found,) = played(steps.predict(plan(model, "m", None, "double").model, 1e-3, held=True), u, 0.0)
    a0, a1, a2 = model.physical_coefficients
    # [V, x, x'] under a constant u
    A = np.array([[-1 / tau, 0, 0], [0, 0, 1], [1 / a2, -a0 / a2, -a1 / a2]])
    over = expm(np.block([[A, np.array([[1 / tau], [0], [0]])], [np.zeros((1, 4))]]) * 1e-3)
    state, exact = np.zeros(4), []
    for volts in u:
        state = over @ np.append(state[:3], volts)
        exact.append(state[1])
    assert np.abs(found - exact).max() < 2e-3 * np.abs(np.diff(exact)).max()


def test_the_command_line(actuator, tmp_path, capsys):
    model, out = str(tmp_path / "model"), tmp_path / "out"
    pitp.save(model, actuator)
    names = ["--precision", "single", "--name", "cone", "--json", str(tmp_path / "j")]
    assert main(["export", model, "--to", "c", "--out", str(out), *names]) == 0
    told = json.loads((tmp_path / "j").read_text())
    assert told["rate_hz"] == pytest.approx(1000) and told["rate_costs_e_rms_percent"] is None
    assert 1 < told["pi"]["max_sensitivity"] < 2 < told["pi"]["gain_margin"]
    said = capsys.readouterr().out
    assert "pitp_cone" in said and "maximum sensitivity" in said
    assert "float" in (out / "pitp_cone.h").read_text()


@pytest.mark.parametrize(
    "options",
    [
        ["--to", "c", "--fmi", "3"],
        ["--to", "matlab", "--precision", "single"],
        ["--to", "simulink"],
        ["--to", "c", "--name", "a-b"],
        ["--to", "c", "--rate", "0"],
        ["--to", "c", "--rate", "2"],
        ["--to", "fmu", "--fmi", "1"],
        [],
    ],
)
def test_bad_requests_get_one_line(actuator, tmp_path, capsys, options):
    model = str(tmp_path / "model")
    pitp.save(model, actuator)
    assert main(["export", model, "--out", str(tmp_path / "out"), *options]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and said.startswith("pitp: error:")
    assert [p.name for p in tmp_path.iterdir()] == ["model"]
