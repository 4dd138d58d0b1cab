"""The catalogue's pages, one per effect, made from its rows: equation, parameters, signature, what it resembles.

    signature   d = y_effect - y_nominal        on every drive of `drives`, its first form at the numbers of the tests
    refit       share of |d|^2 that the nominal's coefficients take up when they are fitted along
    resembles   b with the largest |cos(d_a, d_b)| over all drives;  parted by the drive with most of |d_a - beta d_b|^2

The nominal model is an actuator of 5 Hz, damping ratio 0.1, F = u^2; all forms run as rows of one compiled program.
`docs/hooks.py` puts the pages into the site. To look at them without it: `python docs/catalogue.py FOLDER`.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
from scipy.signal import lsim

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from effect_numbers import NUMBERS

from pitp_jax.application.pages.drawing import ERROR, MEASURED
from pitp_jax.method.effects import CATALOGUE
from pitp_jax.method.effects.spec import EffectSpec
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.input_map import SquareInput
from pitp_jax.method.model.model import Model, Output, linear_model
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout

HZ, ZETA, DT, SAMPLES = 5.0, 0.1, 2e-3, 2000  # 4 s, what one compiled chunk holds
STIFFNESS = 1e9  # V^2/m: 1 mm at 1000 V
TIME = np.arange(SAMPLES) * DT
EFFECTS = Path(__file__).with_name("effects.md")
PORTS = {
    "IN": "the drive, before the square",
    "SQ": "the coupling, on the force of the voltage",
    "K": "the restoring force",
    "C": "the dissipation",
    "M": "the inertia",
    "T": "slow changes during the session",
    "OUT": "the sensor",
}


def drives() -> dict[str, np.ndarray]:
    """Voltages by name, from 0 V, each 4 s."""
    chirp = np.pi * (1.0 + 3.0 * TIME) * TIME  # 0.5 to 12.5 Hz
    levels = 1000 * np.repeat([0.0, 0.6, 1.0, 0.4, 0.0], SAMPLES // 5)
    rise = np.convolve(np.pad(levels, (25, 0)), np.ones(26) / 26, "valid")
    return {
        "steps": rise,
        "slow sine": 500 * (1 - np.cos(2 * np.pi * TIME / 2)),
        "sweep": 500 * (1 - np.cos(chirp)),
        "sweep at a third of the voltage": 500 / 3 * (1 - np.cos(chirp)),
        "sine about 0 V": 1000 * np.sin(2 * np.pi * 2 * TIME),
    }


def runs(model: Model, played) -> np.ndarray:
    """Readings (mm) from rest under every drive, one a minute of a session."""
    found = []
    for k, u in enumerate(played):
        states = rollout(model, jnp.asarray(u, jnp.float32), DT, rest_state(model, 60.0 * k))
        found.append(np.asarray(ports.readings(model, states), float))
    return np.stack(found)


def responses() -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], dict[str, SimpleNamespace]]:
    """What the nominal does, how its coefficients move it, what every effect makes of it, and the numbers used.

    Returns:
        y (drives, T) in mm; its slopes in the coefficients (3, drives, T); by name (drives, T) and (form, values).
    """
    omega = 2 * np.pi * HZ
    a = STIFFNESS * np.array([1.0, 2 * ZETA / omega, 1 / omega**2])
    known = Domain(DT, (-1000.0, 1000.0), 1e6)
    model = linear_model(
        a, input_map=SquareInput(), state_scale=1e-3 * omega ** np.arange(3), force_scale=1e6, output=Output(),
        hold="foh", substeps=1, domain=known,
    )  # fmt: skip
    played = list(drives().values())
    first: dict[str, EffectSpec] = {}
    for form in CATALOGUE:
        first.setdefault(form.name, form)
    numbers = {n: SimpleNamespace(form=f, values=NUMBERS[f.key]) for n, f in first.items()}
    nominal = runs(model, played)
    made = {n: runs(replace(model, effects=(k.form(*k.values),)), played) for n, k in numbers.items()}

    def linear(factors):
        return np.stack([lsim(([1.0], (a * factors)[::-1]), u**2, TIME)[1] for u in played]) * 1e3

    slopes = np.stack([(linear(1 + 1e-3 * np.eye(3)[i]) - linear(np.ones(3))) / 1e-3 for i in range(3)])
    return nominal, slopes, made, numbers


@cache
def pages() -> dict[str, str]:
    """File names and their text: `index.md`, NAME.md and NAME-n.svg of every effect."""
    nominal, slopes, made, numbers = responses()
    moved = {name: y - nominal for name, y in made.items()}
    found = {}
    for name, y in made.items():
        form, values = numbers[name].form, numbers[name].values
        kinds = ("steps", over_time), ("slow sine", over_drive), ("sweep", over_frequency), ("", difference)
        for k, (kind, draw) in enumerate(kinds):
            found[f"{name}-{k}.svg"] = draw(kind, nominal, y)
        near, left = resembles(name, moved, np.ptp(nominal, axis=1))
        found[f"{name}.md"] = page(name, form, values, absorbed(moved[name], slopes), near, left)
    found["index.md"] = index(tuple(made))
    return found


def absorbed(d: np.ndarray, slopes: np.ndarray) -> float:
    """Share of an effect's energy that a refit of the nominal's coefficients takes up."""
    columns = slopes.reshape(len(slopes), -1).T
    rest = d.ravel() - columns @ np.linalg.lstsq(columns, d.ravel(), rcond=None)[0]
    return float(1 - rest @ rest / (d.ravel() @ d.ravel()))


def resembles(name: str, moved: Mapping[str, np.ndarray], span) -> tuple[list[tuple[str, float]], dict[str, float]]:
    """The three effects that move the output most alike, with |cos|; by drive what parts the first, rms % of range."""
    d = moved[name]

    def cos(e):
        return float(abs(np.vdot(d, e)) / np.sqrt(np.vdot(d, d) * np.vdot(e, e)))

    near = sorted(((b, cos(e)) for b, e in moved.items() if b != name), key=lambda p: -p[1])[:3]
    rival = moved[near[0][0]]
    apart = d - np.vdot(d, rival) / np.vdot(rival, rival) * rival
    return near, dict(zip(drives(), 100 * np.sqrt((apart**2).mean(axis=1)) / span, strict=True))


def rows_of_effects() -> dict[str, list[str]]:
    """Cells of the table in effects.md, by name."""
    lines = [line for line in EFFECTS.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    return {line.split("`")[1]: [c.strip() for c in line.strip("|").split(" | ")] for line in lines}


def page(name: str, form: EffectSpec, values, share: float, near, left) -> str:
    """The page of one effect."""
    forms = [f for f in CATALOGUE if f.name == name]
    used = ", ".join(f"{p.name} = {v:.3g}" for p, v in zip(form.parameters, values, strict=True))
    ports = ", ".join(dict.fromkeys(f"{PORTS[f.port]} ({f.port})" for f in forms))
    tells = rows_of_effects()[name][-1]
    text = [
        "---\nhide: [toc]\n---",
        f"# {name}",
        forms[0].title,
        f"`{name}` · family {form.family} · enters at {ports}",
        f"Recognised by: **{tells}**.",
        "## Signature",
        "\n".join(f"![{name}: {what}]({name}-{k}.svg){{ .half }}" for k, what in enumerate(
            ("displacement under steps", "displacement over the squared voltage", "amplitude over frequency",
             "change by the effect, over time"))),
        f"Grey without, orange with the effect: form *{form.form}* at {used} (displacement in units of 1 mm, force in "
        f"units of (1 kV)²). The nominal model is an actuator of {HZ:g} Hz, damping ratio {ZETA:g}, 1 mm at 1 kV; no "
        "noise. Drawn by `docs/catalogue.py`.",
        "## Equation",
        "| form | | equation | parameters |\n|---|---|---|---|\n" + "\n".join(_row(f) for f in forms),
        "`x` in a unit stands for the unit of the displacement; k is the nominal model's stiffness.",
        "## Confused with",
        "Effects with the most similar change of this actuator's output (1: proportional for all five inputs), at the "
        "strength shown:",
        "| effect | likeness |\n|---|---|\n" + "\n".join(f"| [`{b}`]({b}.md) | {c:.2f} |" for b, c in near),
        f"A refit of the nominal model's three coefficients hides {100 * share:.0f} % of this effect's energy here: "
        + ("little remains visible, so keep a nominal model from before the change." if share > 0.8 else
           "a part remains visible after `--refit-nominal`." if share > 0.3 else
           "most of it remains visible after `--refit-nominal`."),
        "## Which recording separates it",
        f"Remaining difference from `{near[0][0]}`, if both are scaled to fit all five inputs best:",
        "| input | rms, % of range |\n|---|---|\n"
        + "\n".join(f"| {d} | {v:.2g} |" for d, v in sorted(left.items(), key=lambda p: -p[1])),
        "For your own actuator `pitp diagnose` computes this, and writes the input as a CSV to play if two effects "
        "are tied ([how a diagnosis is made](../effects.md#how-a-diagnosis-is-made)).",
    ]  # fmt: skip
    return "\n\n".join(text) + "\n"


def _row(form: EffectSpec) -> str:
    equation = form.equation.replace("|", "\\|")
    units = ", ".join(f"{p.name} [{p.unit.replace('|', '')}]" for p in form.parameters)
    return f"| {form.form} | {form.title} | `{equation}` | {units} |"


def groups() -> dict[str, dict[str, str]]:
    """The effects by the place where they act: of each its name and what happens, in plain words."""
    first = {form.name: form for form in reversed(CATALOGUE)}
    names = dict.fromkeys(form.name for form in CATALOGUE)
    by_place = {place: {n: first[n].title for n in names if first[n].port == port} for port, place in PORTS.items()}
    return {f"{place[:1].upper()}{place[1:]}": here for place, here in by_place.items() if here}


def index(names: Sequence[str]) -> str:
    """The list, with what each is recognised by."""
    rows = rows_of_effects()
    head = [
        "# The catalogue",
        "The effects that a diagnosis can report, one page each, by the place where they act. The pages are made from "
        "the catalogue when this site is built; [effects](../effects.md) has all forms in one table.",
    ]
    for place, here in groups().items():
        lines = [f"| [`{n}`]({n}.md) | {title} | {rows[n][-1]} |" for n, title in here.items() if n in names]
        if lines:
            head += [f"## {place}", "| effect | what happens | recognised by |\n|---|---|---|\n" + "\n".join(lines)]
    return "\n\n".join(head) + "\n"


def over_time(kind: str, nominal: np.ndarray, y: np.ndarray) -> str:
    """x(t)."""
    k = list(drives()).index(kind)
    return svg((TIME, nominal[k]), (TIME, y[k]), "time (s)", "displacement (mm)", "Steps: displacement")


def over_drive(kind: str, nominal: np.ndarray, y: np.ndarray) -> str:
    """The loop x over u^2."""
    k = list(drives()).index(kind)
    u = (drives()[kind] / 1e3) ** 2
    return svg((u, nominal[k]), (u, y[k]), "squared voltage (kV²)", "displacement (mm)", "Slow sine: loop")


def over_frequency(kind: str, nominal: np.ndarray, y: np.ndarray) -> str:
    """Half the range of x within a period of the chirp, over its frequency."""
    k = list(drives()).index(kind)
    hz = 0.5 + 3.0 * TIME
    ends = np.searchsorted(np.cumsum(hz) * DT, np.arange(1, int((hz.sum()) * DT)))

    def half_range(x):
        return np.array([np.ptp(x[a:b]) / 2 for a, b in zip(ends[:-1], ends[1:], strict=True)])

    at = hz[(ends[:-1] + ends[1:]) // 2]
    return svg((at, half_range(nominal[k])), (at, half_range(y[k])), "frequency of the input (Hz)", "amplitude (mm)",
               "Sweep: amplitude")  # fmt: skip


def difference(kind: str, nominal: np.ndarray, y: np.ndarray) -> str:
    """What the effect changes, on the drive where that is most of the range."""
    d = 1e3 * (y - nominal)
    k = int(np.argmax((d**2).mean(axis=1) / np.ptp(nominal, axis=1) ** 2))
    return svg((TIME, 0 * d[k]), (TIME, d[k]), "time (s)", "difference (µm)", f"Difference: {list(drives())[k]}")


def svg(before, after, x: str, y: str, title: str) -> str:
    """Two lines on one pair of axes, 360 by 250."""
    left, right, top, bottom = 52, 350, 26, 206
    xs, ys = (np.concatenate([before[i], after[i]]) for i in (0, 1))
    (x0, x1), (y0, y1) = (float(xs.min()), float(xs.max())), (float(np.nanmin(ys)), float(np.nanmax(ys)))
    y0, y1 = y0 - 0.05 * (y1 - y0), y1 + 0.05 * (y1 - y0)

    def place(a, b):
        return left + (a - x0) / (x1 - x0) * (right - left), bottom - (b - y0) / (y1 - y0) * (bottom - top)

    def path(line, color, width):
        a, b = place(*(np.asarray(v)[:: max(len(v) // 700, 1)] for v in line))
        points = " ".join(f"{p:.1f},{q:.1f}" for p, q in zip(a, b, strict=True) if np.isfinite(q))
        return f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{width}"/>'

    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 360 250" font-family="sans-serif" font-size="12">',
        '<rect width="360" height="250" fill="#ffffff"/>',
        f'<text x="{left}" y="16" font-weight="bold">{title}</text>',
    ]
    for v in ticks(x0, x1):
        at = place(v, y0)[0]
        parts.append(f'<line x1="{at:.1f}" x2="{at:.1f}" y1="{top}" y2="{bottom}" stroke="#e6e6e6"/>')
        parts.append(f'<text x="{at:.1f}" y="{bottom + 16}" text-anchor="middle">{v:g}</text>')
    for v in ticks(y0, y1):
        at = place(x0, v)[1]
        parts.append(f'<line x1="{left}" x2="{right}" y1="{at:.1f}" y2="{at:.1f}" stroke="#e6e6e6"/>')
        parts.append(f'<text x="{left - 6}" y="{at + 4:.1f}" text-anchor="end">{v:g}</text>')
    parts += [
        path(before, MEASURED, 2.6), path(after, ERROR, 1.5),
        f'<text x="{(left + right) / 2}" y="242" text-anchor="middle">{x}</text>',
        f'<text transform="translate(13 {(top + bottom) / 2}) rotate(-90)" text-anchor="middle">{y}</text>', "</svg>",
    ]  # fmt: skip
    return "\n".join(parts)


def ticks(low: float, high: float) -> list[float]:
    """Three to six round numbers."""
    raw = (high - low) / 4
    unit = 10 ** np.floor(np.log10(raw))
    size = next(m * unit for m in (1, 2, 5, 10) if m * unit >= raw)
    return [float(round(k * size, 10)) for k in range(int(np.ceil(low / size)), int(np.floor(high / size)) + 1)]


if __name__ == "__main__":
    Path(sys.argv[1]).mkdir(exist_ok=True)
    for file, text in pages().items():
        (Path(sys.argv[1]) / file).write_text(text, encoding="utf-8")
