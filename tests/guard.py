"""Figures of commit 01c30c9 that a rebuilt package must reproduce.

`files/guard/models.tar.xz` holds model files that 01c30c9 saved: every form of the catalogue alone, all of them in one
model, found terms, memories, a lag of the electrode, an ensemble, an adapted model. Beside it, as JSON, what 01c30c9
computed: `runs` of those files, `figures` of virtual actuators, `verdicts` of diagnoses. The archive stays as it is;
its headers were once written anew in version 2 of the format, its leaves are the bytes of 01c30c9.
Where a change is meant to move a figure, make that figure again, and say why in the same commit:

    python tests/guard.py runs|figures|verdicts [NAME ...]        all figures of that file, or the named ones
"""

import json
import re
import sys
import tarfile
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from typed import some

import pitp_jax as pitp
from pitp_jax.files.model_file.parts import EFFECTS
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.effects.spec import EffectSpec

FOLDER = Path(__file__).parent / "files" / "guard"
SAMPLES, EVERY = 960, 60  # of a run; every 60th sample is kept
MEMBERS = ("cone100_member_0", "cone100_member_1")


def stored(name: str) -> dict:
    """The figures of one file, by name."""
    return json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))


def names() -> list[str]:
    """The stored model files."""
    with tarfile.open(FOLDER / "models.tar.xz") as archive:
        return [name.removesuffix(".pitp") for name in archive.getnames()]


def refused() -> set[str]:
    """The stored models that hold a form which the catalogue no longer has."""
    with tarfile.open(FOLDER / "models.tar.xz") as archive:
        texts = {name: some(archive.extractfile(f"{name}.pitp")).read().decode("latin-1") for name in names()}
    forms = {name: set(re.findall(r'"name": "(\w+: [^"]+)"', text)) for name, text in texts.items()}
    return {name for name, some_forms in forms.items() if some_forms - set(EFFECTS)}


def unpack(folder: Path) -> Path:
    """Put the stored model files into a folder."""
    with tarfile.open(FOLDER / "models.tar.xz") as archive:
        archive.extractall(folder, filter="data")
    return folder


def drive(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Time and voltage for a stored model: two squared sines from 0 V on, below and through the resonance."""
    dt, top = (1e-3, 5000.0) if name.startswith("cone100") else (2e-3, 900.0)
    time = np.arange(SAMPLES) * dt
    return time, top * (0.65 * np.sin(np.pi * 1.3 * time) ** 2 + 0.35 * np.sin(np.pi * 4.1 * time) ** 2)


def free_run(folder: Path, name: str) -> np.ndarray:
    """Displacement of a stored model from rest, 20 s into its session, in float64 as its file is."""
    time, voltage = drive(name)
    with jax.enable_x64(True):
        model = among_all(pitp.load(folder / f"{name}.pitp").model)
        return pitp.rollout(model, voltage, time[1], begins="rest", zero="sensor", start_time=20.0)


@cache
def forms() -> tuple[EffectSpec, ...]:
    """The forms that a stored linear model of second order holds alone."""
    return tuple(form for form in CATALOGUE if form.key.replace(": ", "_").replace(" ", "_") in names())


def among_all(model: pitp.Model) -> pitp.Model:
    """A model of one form with every other form beside it, neutral: one compiled program runs them all."""
    if len(model.effects) != 1 or model.effects[0].spec not in forms():
        return model
    (own,) = model.effects
    neutral = {form: form(*map(jnp.float64, form.off)) for form in forms()}
    return replace(model, effects=tuple((neutral | {own.spec: own}).values()))


def ensemble_band(folder: Path) -> np.ndarray:
    """Mean and half width of the stored ensemble's band, one after the other."""
    time, voltage = drive(MEMBERS[0])
    record = pitp.Record("drive", time, voltage, free_run(folder, MEMBERS[0]))
    with jax.enable_x64(True):
        members = tuple(pitp.load(folder / f"{name}.pitp") for name in MEMBERS)
        (band,) = pitp.predict_band(pitp.Ensemble(members, error=0.01), [record])
    return np.concatenate([band.displacement, band.half_width])


def few(series: np.ndarray, digits: int = 9) -> list[float]:
    """Some samples of a series, rounded."""
    return [float(f"{x:.{digits}g}") for x in series[::EVERY]]


def runs(folder: Path) -> dict[str, Callable[[], list[float]]]:
    """The free run of every stored model, in m; `folder` holds them."""
    known = sorted({*names()} - refused())
    made: dict[str, Callable[[], list[float]]] = {n: lambda n=n: few(free_run(folder, n)) for n in known}
    return made | {"ensemble_band": lambda: few(ensemble_band(folder))}


def play(folder: Path, name: str, hum: float = 0.0) -> list[pitp.Record]:
    """Six records of a stored model, one after the other, noise 2 um; `hum`: amplitude of a tone of 17.3 Hz, m."""
    rng, time, records = np.random.default_rng(7), np.arange(1000) * 2e-3, []
    waves = {
        "sweep": np.sin(2 * np.pi * (0.5 + 1.2 * time) * time),
        "steps": np.repeat([0.2, 0.9, -0.5, 0.6, -0.9], 200),
        "multisine": sum(np.sin(2 * np.pi * f * time + k * k) for k, f in enumerate((0.7, 1.3, 2.9, 4.3, 6.1))) / 2.5,
    }
    waves |= {f"sine{f}": np.sin(2 * np.pi * f * time) for f in (0.8, 1.7, 3.1)}
    for k, (drive_name, wave) in enumerate(waves.items()):
        voltage = 600 + 350 * wave
        with jax.enable_x64(True):
            model = pitp.load(folder / f"{name}.pitp")
            x = pitp.rollout(model, voltage, time[1], begins="rest", zero="sensor", start_time=10.0 * k)
        x = x + hum * np.sin(2 * np.pi * 17.3 * time + k) + 2e-6 * rng.standard_normal(len(time))
        records.append(pitp.Record(drive_name, time + 10.0 * k, voltage, x))
    return records


# Names left out of the diagnoses, for time; what is planted is among the others, but for a leak of charge.
EXCLUDED = (
    "added_mass backlash charge_leak charge_retention dielectric_saturation end_stop hysteresis mullins "
    "parameter_change relaxation second_mode sensor_gain sensor_nonlinearity slack slew_limit softening "
    "stiffness_drift stretch_coupling voltage_offset"
).split()
DIAGNOSED: dict[str, tuple[str, dict]] = {
    "nothing": ("nominal", {}),
    "hum": ("nominal", {"hum": 4e-5}),
    "spring": ("stiffening_limited_chain", {}),
    "creep": ("creep_one_branch", {}),
    "creep, coefficients refitted": ("creep_one_branch", {"refit_nominal": True}),
    "electrode": ("electrode_rc_one_lag", {}),
    "delay": ("delay_pure", {}),
    "clip": ("voltage_clip_hard", {}),
    "friction": ("coulomb_friction_smooth", {}),
    "sensor's lag": ("sensor_lag_one_lag", {}),
    "spring and electrode": ("spring_and_electrode", {}),
    "a leak of charge, which is excluded": ("charge_leak_one_trap", {}),
}


def verdict(folder: Path, case: str) -> dict:
    """What a diagnosis of the stored nominal says of one planted effect."""
    name, options = DIAGNOSED[case]
    refit = options.get("refit_nominal", False)
    records = play(folder, name, options.get("hum", 0.0))
    nominal = pitp.load(folder / "nominal_single.pitp")
    said = pitp.diagnose(nominal, records, refit_nominal=refit, exclude=EXCLUDED).as_json()
    numbers = {f"gap {key}": said["gap"][key] for key in ("before", "after", "noise_floor", "closed_fraction")}
    for row in [row for row in said["ranking"] if row["effect"] in said["effects"][:1]][:1]:
        numbers |= {f"{row['effect']} {key}": value["value"] for key, value in row["parameters"].items()}
    rounded = {key: None if value is None else float(f"{value:.5g}") for key, value in numbers.items()}
    return {key: said[key] for key in ("verdict", "effects", "equivalent")} | {"numbers": rounded}


def verdicts(folder: Path) -> dict[str, Callable[[], dict]]:
    """What diagnoses say of planted effects; `folder` holds the stored models."""
    return {case: lambda case=case: verdict(folder, case) for case in DIAGNOSED}


# Of the paper's plants: duration (s) and highest frequency (Hz) of the sweep, its mean and amplitude (V).
SWEEPS = {"cone100": (30, 20, 3000), "cone122": (30, 20, 3000), "cone150": (30, 20, 3000), "roll": (5, 180, 700)}
# Of those that are trained: frequencies (Hz) of three sines, of one to predict, duration of each (s).
TRAINED = {"cone100": ((1.0, 4.0, 8.0), 2.7, 3.0), "roll": ((10.0, 50.0, 90.0), 33.0, 0.3)}


def figures_of(name: str) -> dict:
    """Coefficients of a plant's nominal; the motion under a planned voltage; a free run of a quickly trained model."""
    plant = pitp.plant(name)
    seconds, top, volts = SWEEPS[name]
    sweep = pitp.excitation.sweep(0.01, top, seconds, plant.rate_hz, volts, volts)
    linear = pitp.identify([pitp.record(plant, "sweep", *sweep, seed=20)]).model
    made = {"coefficients": [float(f"{a:.7g}") for a in linear.physical_coefficients]}
    if name not in TRAINED:
        return made
    frequencies, held_out, duration = TRAINED[name]
    time = np.arange(round(duration * plant.rate_hz)) / plant.rate_hz

    def sine(hz: float) -> pitp.Record:
        return pitp.record(plant, f"{hz:g} Hz", time, 0.67 * volts * (1 - np.cos(2 * np.pi * hz * time)), seed=20)

    settings = pitp.Settings(width=4, memories=2, epochs=2, stages=1, refine_steps=8)
    trained = pitp.train(linear, list(map(sine, frequencies)), settings=settings, key=jax.random.key(41)).model
    (run,) = pitp.predict(trained, [sine(held_out)])
    made["trained"] = few(run.displacement, 6)
    if name == "roll":  # its target is at a limit, where the plan moves by 0.4 % of range for 1e-12 of the target
        return made
    (reached,) = pitp.predict(linear, [sine(held_out)])
    wanted = pitp.Target(time[: len(time) // 3], 0.5 * reached.displacement[: len(time) // 3])
    return made | {"tracked": few(tracked(linear, wanted, 1 / plant.rate_hz), 6)}


def tracked(linear, wanted: pitp.Target, dt: float) -> np.ndarray:
    """The motion of a nominal under the voltage that is planned for a target."""
    return pitp.rollout(linear, pitp.feedforward(linear, wanted).voltage, dt, begins="rest")


def figures(_: Path) -> dict[str, Callable[[], dict]]:
    """What becomes of each virtual actuator; no stored model is needed."""
    return {name: lambda name=name: figures_of(name) for name in SWEEPS}


def main(kind: str, *chosen: str) -> None:
    """Make figures of one file again and write them beside the others."""
    makers = {"runs": runs, "figures": figures, "verdicts": verdicts}[kind](unpack(Path(tempfile.mkdtemp())))
    path = FOLDER / f"{kind}.json"
    made = stored(kind) if path.exists() and chosen else {}
    made |= {name: makers[name]() for name in chosen or makers}
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(made[name])}" for name in sorted(made))
    path.write_text("{\n" + lines + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
