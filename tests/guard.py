"""Figures of commit 01c30c9 that a rebuilt package must reproduce.

`files/guard/models.tar.xz` holds model files that 01c30c9 saved: every form of the catalogue alone, all of them in one
model, found terms, memories, a lag of the electrode, an ensemble, an adapted model. Beside it, as JSON, what 01c30c9
computed: `runs` of those files, `figures` of virtual actuators, `verdicts` of diagnoses. The archive stays as it is.
Where a change is meant to move a figure, make that figure again, and say why in the same commit:

    python tests/guard.py runs|figures|verdicts [NAME ...]        all figures of that file, or the named ones
"""

import json
import sys
import tarfile
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

import pitp_jax as pitp

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
        return pitp.rollout(pitp.load(folder / f"{name}.pitp"), voltage, time[1], begins="rest", start_time=20.0)


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
    made: dict[str, Callable[[], list[float]]] = {n: lambda n=n: few(free_run(folder, n)) for n in names()}
    return made | {"ensemble_band": lambda: few(ensemble_band(folder))}


def main(kind: str, *chosen: str) -> None:
    """Make figures of one file again and write them beside the others."""
    makers = {"runs": runs}[kind](unpack(Path(tempfile.mkdtemp())))
    path = FOLDER / f"{kind}.json"
    made = stored(kind) if path.exists() and chosen else {}
    made |= {name: makers[name]() for name in chosen or makers}
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(made[name])}" for name in sorted(made))
    path.write_text("{\n" + lines + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
