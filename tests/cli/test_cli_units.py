"""Every command speaks of a machine in the units of its recordings: a motor, A in and deg/s out, without V and m."""

import json
import re
import subprocess
from dataclasses import replace
from html import unescape
from zipfile import ZipFile

import diagnosis_cases
import numpy as np
import pytest
from cli_cases import columns_of, refused, truth
from exported import COMPILERS, Exported
from scipy.signal import lsim

from pitp_jax import Record
from pitp_jax.application.commands.amounts import amount, in_base
from pitp_jax.common.errors import BadInput
from pitp_jax.common.quantity import Quantity, Units, per_second
from pitp_jax.files.model_file import model_file
from pitp_jax.method.diagnose import joint as parameters
from pitp_jax.method.diagnose.next_experiment import excitations
from pitp_jax.method.diagnose.result import Added, Ranked
from pitp_jax.method.diagnose.term import equation
from pitp_jax.method.effects import CATALOGUE, effect
from pitp_jax.method.effects.physical import physical
from pitp_jax.method.effects.words import parameter
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.input_map import LinearInput
from pitp_jax.method.model.model import Output, linear_model
from pitp_jax.method.model.origin import Origin
from pitp_jax.method.train import training

TIME = np.arange(1500) / 500.0
DEGREE = np.pi / 180
OMEGA, ZETA, GAIN = 2 * np.pi * 4, 0.3, 200 * DEGREE  # 200 deg/s per A
COEFFICIENTS = np.array([1.0, 2 * ZETA / OMEGA, OMEGA**-2]) / GAIN
FOREIGN = re.compile(r"(?<![\w.*/^])(?:[kmu]?V|[cmuµn]?m|m/s\S*|V/s|V\^2\S*|rad|rad/s|N|Pa)(?![\w'=*(])")


def speed(current):
    """Response in deg/s to a current in A."""
    return lsim(([1.0], COEFFICIENTS[::-1]), current, TIME)[1] / DEGREE


@pytest.fixture(scope="module")
def motor(tmp_path_factory):
    """A folder with two recordings, a target and a model in A and deg/s."""
    root = tmp_path_factory.mktemp("motor")
    (root / "records").mkdir()
    waves = {"sweep": 2 * np.sin(2 * np.pi * (0.3 * TIME + 1.5 * TIME**2)), "sine": 1.5 * np.sin(2 * np.pi * 2 * TIME)}
    for name, current in waves.items():
        noise = 0.05 * np.random.default_rng(len(name)).standard_normal(len(TIME))
        write(root / "records" / f"{name}.csv", ("time_s", "input_A", "output_deg/s"), current, speed(current) + noise)
    wanted = speed(np.sin(2 * np.pi * TIME) ** 3)
    write(root / "target.csv", ("time_s", "output_deg/s"), wanted)
    model = linear_model(
        COEFFICIENTS, input_map=LinearInput(), state_scale=GAIN * OMEGA ** np.arange(3), force_scale=2.0,
        output=Output(), hold="foh", substeps=1, domain=Domain(0.002, (-2.0, 2.0), 80.0),
    )  # fmt: skip
    model_file.save(root / "model", Fitted(model, Origin("deg/s", "A", stderr=(1e-3, 1e-4, 1e-5))))
    return root


def write(path, header, *columns):
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(TIME, *columns, strict=True)]
    path.write_text("\n".join([",".join(header), *rows]) + "\n")


def told(page):
    """The text of a page, without its style and drawings' shapes."""
    text = re.sub(r"<style>.*?</style>|<defs>.*?</defs>", "", page, flags=re.DOTALL)
    return unescape(re.sub(r"<[^>]*>", "\n", text)).replace("\N{NARROW NO-BREAK SPACE}", " ")


def foreign(text):
    """Units that are none of this machine's."""
    return [line for line in text.splitlines() if FOREIGN.search(line)]


COMMANDS = {
    "check": ("records", "--out", "{out}"),
    "identify": (
        "records/sweep.csv",
        "--order",
        "2",
        "--input-map",
        "linear",
        "--out",
        "{out}",
        "--report",
        "{out}_page",
    ),
    "predict": ("model", "records", "--out", "{out}"),
    "simulate": ("model", "records/sine.csv", "--out", "{out}"),
    "invert": ("model", "target.csv", "--out", "{out}", "--max-input", "1.9", "--max-output", "300"),
    "plan": ("model", "--out", "{out}", "--duration", "20"),
    "info": ("model",),
    "compare": ("model", "model", "--out", "{out}"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_names_units_of_the_machine_alone(call, motor, tmp_path, monkeypatch, command):
    monkeypatch.chdir(motor)
    out = tmp_path / "out"
    code, text, err = call(command, *(word.format(out=out) for word in COMMANDS[command]), "--json", tmp_path / "j")
    assert code == 0, err
    assert foreign(text + err) == []
    pages = [told(path.read_text()) for path in tmp_path.rglob("*.html")]
    assert [line for page in pages for line in foreign(page)] == []
    headers = [path.read_text().splitlines()[0] for path in tmp_path.rglob("*.csv")]
    assert not [header for header in headers if "voltage" in header or "displacement" in header]
    assert {"check", "identify", "predict", "plan", "compare"} & {command} == ({command} if pages else set())


def test_invert_writes_the_input_in_the_unit_of_the_records(call, motor, tmp_path):
    """The first printed line names the largest value; the column is what the motor's driver takes."""
    code, text, _ = call("invert", motor / "model", motor / "target.csv", "--out", tmp_path / "v.csv")
    header, values = columns_of(tmp_path / "v.csv")
    assert code == 0 and header == ["time_s", "input_A", "target_deg/s", "infeasible", "saturated"]
    inside = np.isfinite(values[:, 2])
    np.testing.assert_allclose(values[inside, 1], np.sin(2 * np.pi * TIME) ** 3, atol=5e-3)
    np.testing.assert_allclose(values[inside, 2], speed(np.sin(2 * np.pi * TIME) ** 3), rtol=1e-6, atol=1e-6)
    assert text.startswith(f"largest input {np.abs(values[:, 1]).max():.4g} A: ")
    assert "limits: -2 to 2 A, at most 80 A/s (input and rate of the model's recordings)" in text


@pytest.mark.parametrize(
    ("option", "largest"), [("--max-input=0.5", 0.5), ("--max-voltage=500mA", 0.5), ("--max-input=0.5A", 0.5)]
)
def test_a_limit_is_in_the_unit_of_the_records_or_its_own(call, motor, tmp_path, option, largest):
    code, text, _ = call("invert", motor / "model", motor / "target.csv", "--out", tmp_path / "v.csv", option)
    assert code == 0 and "limits: -0.5 to 0.5 A" in text
    assert np.abs(columns_of(tmp_path / "v.csv")[1][:, 1]).max() == pytest.approx(largest, rel=1e-3)


@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        ("--max-input", "3kV", "give it in A, mA, uA"),
        ("--max-input-rate", "20deg/s", "give it in A/s, mA/s"),
        ("--max-output", "3mm", "give it in deg/s, rad/s, rpm"),
        ("--unit", "kV", "give it in A, mA, uA"),
        ("--max-input", "3parsecs", "not a number"),
        ("--max-input", "-3A", "not positive"),
    ],
)
def test_a_limit_of_another_kind_is_refused(call, motor, tmp_path, option, value, said):
    argv = ["invert", motor / "model", motor / "target.csv", "--out", tmp_path / "v.csv", f"{option}={value}"]
    assert said in refused(call(*argv)) and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "quantity", "rate", "base"),
    [
        ("3kV", "V", False, 3e3), ("3", "V", False, 3.0), ("0.3 µm", "mm", False, 3e-7), ("2", "mm", False, 2e-3),
        ("20deg", "rad", False, 20 * DEGREE), ("20", "deg", False, 20 * DEGREE), ("5e4 V/s", "V", True, 5e4),
        ("2kV/s", "V", True, 2e3), ("90deg/s2", "deg/s", True, 90 * DEGREE), ("90deg/s/s", "deg/s", True, 90 * DEGREE),
        ("4m/s^2", "m/s", True, 4.0), ("1.5N m", "N m", False, 1.5), ("7", "counts", False, 7.0),
    ],
)  # fmt: skip
def test_a_number_may_carry_its_unit(text, quantity, rate, base):
    assert in_base(amount(text), "--max-input", Quantity(quantity), rate=rate) == pytest.approx(base, rel=1e-12)


@pytest.mark.parametrize("text", ["", "kV", "nan", "inf", "3s", "1e", "--3", "3 kV V"])
def test_what_is_no_amount_is_not_read_as_one(text):
    assert amount(text) is None


def test_a_rate_needs_a_unit_of_a_rate():
    with pytest.raises(BadInput, match="V/s"):
        in_base(amount("3kV"), "--max-slew", Quantity("V"), rate=True)


@pytest.mark.parametrize(
    ("unit", "times", "rate"),
    [
        ("V", 1, "V/s"),
        ("m", 2, "m/s^2"),
        ("deg/s", 1, "deg/s^2"),
        ("m/s2", 1, "m/s^3"),
        ("rpm", 1, "rpm/s"),
        ("A", 0, "A"),
    ],
)
def test_a_derivative_has_the_unit_per_second(unit, times, rate):
    assert per_second(unit, times) == rate


@pytest.mark.parametrize(
    ("template", "force", "squared", "unit", "factor"),
    [
        ("V^2 s/x", 1, False, "A s/(deg/s)", DEGREE), ("V^2", 1, True, "A^2", 1.0),
        ("1/x^2", 0, True, "1/(deg/s)^2", DEGREE**2),
        ("x/s", 0, True, "deg/s^2", 1 / DEGREE), ("x", 0, True, "deg/s", 1 / DEGREE), ("s/V", 0, False, "s/A", 1.0),
        ("1/x^(1/2)", 0, True, "1/(deg/s)^(1/2)", DEGREE**0.5),
    ],
)  # fmt: skip
def test_numbers_of_effects_have_the_units_of_the_machine(template, force, squared, unit, factor):
    found = Units(Quantity("A"), Quantity("deg/s"), squared).parameter(template, force)
    assert found == (pytest.approx(factor, rel=1e-12), unit)


def test_a_voltage_stays_in_volts_and_a_length_in_metres(call, bench, tmp_path):
    """Records in kV and mm: limits in V and mm, coefficients in V^2/m, whatever the records' unit."""
    target, out = bench / "target.csv", tmp_path / "v.csv"
    code, text, _ = call(
        "invert", bench / "nominal", target, "--out", out, "--max-voltage", "1.2kV", "--max-output", "3"
    )
    assert (
        code == 0
        and "limits: 0 to 1200 V, at most 5e+04 V/s, displacement within 3 mm (rate of the model's recordings)" in text
    )
    assert call("info", bench / "nominal", "--json", tmp_path / "j")[0] == 0
    facts = json.loads((tmp_path / "j").read_text())
    assert facts["coefficients_unit"] == ["V^2/m", "V^2 s/m", "V^2 s^2/m"] and facts["output_unit"] == "m"


@pytest.mark.parametrize(
    ("polarity", "end"), [(1.0, "at 0 V.\n"), (-1.0, "at 0 V and decreases as the actuator extends")]
)
def test_a_reversed_sensor_is_named_in_words(call, bench, tmp_path, polarity, end):
    known = truth()
    output = Output(offset=18.412e-3, polarity=polarity)
    model_file.save(tmp_path / "m", Fitted(replace(known.model, output=output), known.origin))
    code, text, _ = call("info", tmp_path / "m")
    assert code == 0 and f"The sensor reads 18.41 mm {end}" in text
    assert ("(reversed sensor)" in text) == (polarity < 0)


@pytest.mark.parametrize("to", ["c", "fmu", "matlab"])
def test_exported_code_has_the_units_of_the_machine(call, motor, tmp_path, to):
    """Comments, pages and model descriptions; the first lines say what a target is."""
    code, text, _ = call("export", motor / "model", "--to", to, "--out", tmp_path / "rig")
    assert code == 0 and foreign(text) == []
    said = {path.name: path.read_text() for path in (tmp_path / "rig").iterdir() if path.suffix != ".fmu"}
    if to == "fmu":
        with ZipFile(tmp_path / "rig" / "pitp_model.fmu") as archive:
            said |= {name: archive.read(name).decode() for name in archive.namelist() if name.endswith((".xml", ".h"))}
        assert 'name="deg/s"' in said["modelDescription.xml"] and 'unit="A"' in said["modelDescription.xml"]
        assert f'factor="{DEGREE!r}"' in said["modelDescription.xml"]
    words = {name: commented(name, text) for name, text in said.items() if not name.endswith(".csv")}
    assert {name: lines for name, text in words.items() if (lines := foreign(text))} == {}
    assert "displacements in deg/s: 0 at 0 A, with the sensor's sign" in said["README.md"][:300]


def commented(name, text):
    """The comments of a source; all of a page or a model description but for SI's base units."""
    if name.endswith((".c", ".h", ".ino")):
        return "\n".join(re.findall(r"/\*.*?\*/|//[^\n]*", text, flags=re.DOTALL))
    if name.endswith(".m"):
        return "\n".join(re.findall(r"%[^\n]*", text))
    return re.sub(r"<BaseUnit [^>]*>", "", text) if name.endswith((".md", ".xml")) else ""


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
def test_exported_code_takes_amperes_and_gives_degrees_per_second(call, motor, tmp_path):
    """A step of 1 A ends at 200 deg/s, and the target of 200 deg/s asks for 1 A."""
    assert call("export", motor / "model", "--to", "c", "--out", tmp_path / "rig")[0] == 0
    made = Exported(tmp_path / "rig", 2)
    found = made.predict(np.where(np.arange(1500) > 0, 1.0, 0.0))
    np.testing.assert_allclose(found, speed(np.where(TIME > 0, 1.0, 0.0)), atol=1.0)
    assert found[-1] == pytest.approx(200, rel=1e-4)
    assert made.plan([[200.0, 0.0, 0.0]])[0] == pytest.approx(1.0, rel=1e-6)
    assert subprocess.run(["make"], cwd=tmp_path / "rig", capture_output=True).returncode == 0


@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
def test_a_reading_at_zero_volts_is_the_zero_of_exported_code(call, bench, tmp_path):
    """A laser that is mounted anew, at 30 mm and reversed: predictions, targets and the PI steps are from 0 V."""
    known = truth()
    reversed_ = replace(known.model, output=Output(offset=18.4e-3, polarity=-1.0))
    model_file.save(tmp_path / "m", Fitted(reversed_, known.origin))
    assert call("export", tmp_path / "m", "--to", "c", "--out", tmp_path / "rig")[0] == 0
    made = Exported(tmp_path / "rig", 2)
    still = made.predict(np.full(3000, 1000.0), y0=30e-3)
    assert still[0] == pytest.approx(0, abs=1e-4) and still[-1] == pytest.approx(1e-3, rel=1e-3)  # 1 mm at 1 kV
    rows = np.tile([1e-3, 0.0, 0.0], (1500, 1))
    short = 0.9e-3 * np.ones(1500)  # the actuator stays a tenth short: the voltage grows
    anew, before = (made.command(2, rows, at_rest - short, y0=at_rest)[0] for at_rest in (30e-3, 18.4e-3))
    np.testing.assert_allclose(anew, before, atol=1e-6)
    assert anew[-1] > anew[1] and made.command(2, rows, 30e-3 - 1.1e-3 * short / short, y0=30e-3)[0][-1] == 0
    assert "as the actuator extends" in (tmp_path / "rig" / "pitp_model.h").read_text()[:600]


def spoken(text):
    """The text without the names of effects, in which a word is no quantity."""
    return re.sub(r"\bvoltage_(?:clip|offset)\b", "", text)


def written(folder):
    """What the pages and the first lines of the tables in a folder say."""
    pages = [told(path.read_text()) for path in folder.rglob("*.html")]
    return "\n".join([*pages, *(path.read_text().splitlines()[0] for path in folder.rglob("*.csv"))])


def test_fit_names_units_of_the_machine_alone(call, motor, tmp_path, monkeypatch):
    """Terminal, JSON and the page with its figures; the factors of the tokens stand over the trained output."""

    def train(nominal, records, **_):
        region = np.array([[-2.0, 2.0]] * 2)
        made = replace(nominal, domain=replace(nominal.domain, region=region), effects=(effect("delay", time=0.004),))
        return training.Training(made, (), False, {}, tuple(training.RecordError(r.name, 1.0, 0.5) for r in records))

    monkeypatch.setattr("pitp_jax.application.commands.fit.train", train)
    options = ("--nominal", motor / "model", "--report", tmp_path / "page", "--json", tmp_path / "j")
    code, text, err = call("fit", motor / "records", "--out", tmp_path / "m", *options)
    page = written(tmp_path)
    assert code == 0, err
    assert foreign(text + err + page + (tmp_path / "j").read_text()) == []
    assert "output (deg/s)" in page and not re.search("volt|displacement", text + err + page)


def test_adapt_names_units_of_the_machine_alone(call, motor, tmp_path):
    options = ("--out", tmp_path / "m", "--json", tmp_path / "j")
    code, text, err = call("adapt", motor / "model", motor / "records" / "sine.csv", *options)
    said = text + err + (tmp_path / "j").read_text()
    assert code == 0 and foreign(said) == [] and not re.search("volt|displacement", said)


def candidates(model):
    """Every form of the catalogue, all its numbers 0.5 in the model's scales."""
    for spec in CATALOGUE:
        numbers = {p.name: physical(model, p, 0.5) for p in spec.parameters}
        yield Ranked(spec.name, "family", spec.form,
                     {k: {"value": v, "unit": unit, "stderr": None} for k, (v, unit) in numbers.items()},
                     1.0, 1.5, 0.5, (0.4, 0.6), 0.9)  # fmt: skip


def test_diagnose_names_units_of_the_machine_alone(call, motor, tmp_path, monkeypatch):
    """Every effect of the catalogue is named at once, with its numbers, an experiment and all figures."""
    model = model_file.load(motor / "model")
    ranking = tuple(candidates(model))
    names = tuple(dict.fromkeys(r.effect for r in ranking))
    known = diagnosis_cases.tied(diagnosis_cases.explained(model.model))
    assert known.next_experiment is not None
    played = excitations(-2.0, 2.0, 80.0, 4.0, 0.002, 1.0)
    words = next(name for name in played if "about zero" in name)
    found = replace(
        known, model=model, effects=names, ranking=ranking, budget=diagnosis_cases.budget(*((n, 0.01) for n in names)),
        added=tuple(Added(r.effect, r.form, r.parameters) for r in ranking),
        next_experiment=replace(known.next_experiment, excitation=words),
    )  # fmt: skip
    monkeypatch.setattr("pitp_jax.application.commands.diagnose.run_diagnosis", lambda *_, **__: found)
    options = ("--nominal", motor / "model", "--out", tmp_path / "d", "--json", tmp_path / "j")
    code, text, err = call("diagnose", motor / "records", *options)
    page = written(tmp_path)
    assert code == 0 and foreign(text + err + page) == [] and "warning" not in err
    assert {"output (deg/s)", "rate of the output (deg/s²)", "input (A)"} <= set(page.splitlines())
    assert not re.search("volt|displacement|velocity", spoken(text + err + page))
    used = {number["unit"] for r in ranking if r.effect != "second_mode" for number in r.parameters.values()}
    assert foreign("\n".join(unit for unit in used if unit != "rad/s")) == []


@pytest.mark.parametrize(("unit", "shown"), [("1/(deg/s)", "deg/s"), ("s/(deg/s)", "deg/s²"), ("s^2/A", "A/s²")])
def test_a_limit_in_a_unit_of_several_parts_is_read(unit, shown):
    name = "curvature" if unit.startswith("1") else "inverse"
    number = {"value": 0.5, "unit": unit, "stderr": None}
    assert parameter(name, number, "deg/s") == ("limit", f"2.00 {shown}")


def test_a_term_has_the_symbol_of_its_input():
    motor, actuator = Units(Quantity("A"), Quantity("deg/s"), False), Units()
    assert equation(("c1", "c3"), [], motor).endswith(" u") and equation(("c3",), [], actuator).endswith(" V^2")


def test_coefficients_of_a_simulator_of_speeds_have_a_unit_that_can_be_read():
    record = Record("a", TIME, TIME, TIME, "A", "deg/s")
    assert parameters.units(record, 2, None).of == ("A/(rad/s)", "A s/(rad/s)", "A s^2/(rad/s)")
