"""What the tests of several commands run on: records and a model on disk, verbs that only note their call."""

import errno

import numpy as np
import pytest
from cli_cases import DRIVES, TIME, motion, truth, write_record

from pitp_jax import Record
from pitp_jax.application.commands.main import main
from pitp_jax.files.model_file import model_file
from pitp_jax.files.recordings import writing
from pitp_jax.method.identify import identification
from pitp_jax.method.invert import feedforward_plan


@pytest.fixture(scope="session")
def bench(tmp_path_factory):
    """A folder with records and a nominal model: read only."""
    root = tmp_path_factory.mktemp("bench")
    (root / "records").mkdir()
    for name in DRIVES:
        write_record(root / "records" / f"{name}.csv", *motion(name), units=("kV", "mm"))
    model_file.save(root / "nominal", truth())
    rise = 0.5 * (1 - np.cos(np.pi * np.clip(TIME / 1.0, 0, 1)))
    wanted = 1e-3 * rise * (1.0 + 0.5 * np.sin(2 * np.pi * TIME))
    (root / "target.csv").write_text(
        "time_s,displacement_mm\n" + "".join(f"{t:.6f},{1e3 * x:.9g}\n" for t, x in zip(TIME, wanted, strict=True))
    )
    return root


@pytest.fixture
def call(capsys):
    """Run `pitp` in this process; the exit code, standard output and error."""

    def run(*argv):
        code = main([str(a) for a in argv])
        return code, *capsys.readouterr()

    return run


@pytest.fixture(scope="session")
def identified():
    """A real identification, once."""
    return identification.identify([Record("sweep", TIME, *motion("sweep"), "kV", "mm")], order=2)


@pytest.fixture
def quick_identify(monkeypatch, identified):
    """`identify` that only notes what it was called with."""
    calls = []

    def fake(records, **options):
        calls.append(([r.name for r in records], options))
        return identified

    monkeypatch.setattr("pitp_jax.application.commands.fit.identify", fake)
    monkeypatch.setattr("pitp_jax.application.commands.identify.run_identify", fake)
    return calls


@pytest.fixture
def quick_inverse(monkeypatch):
    """`feedforward` that only notes its limits."""
    calls = []

    def fake(model, target, *, max_voltage=None, max_slew=None, **ends):
        calls.append((target, max_voltage, max_slew, ends))
        time = np.arange(-100, 2100) * target.dt
        count, inside = len(time), (time >= 0) & (time < 4)
        return feedforward_plan.Feedforward(
            time=time, voltage=np.linspace(0, 1500, count), infeasible=np.arange(count) < 7,
            saturated=np.arange(count) < 3, target=inside, wanted=np.where(inside, 1e-3, np.nan),
            outside_training_share=0.25,
            self_check_e_rms_percent=float("nan"), equation_e_rms_percent=0.5,
            warnings=("25 % of the target lies outside\nthe trained region",),
        )  # fmt: skip

    monkeypatch.setattr("pitp_jax.application.commands.invert.feedforward", fake)
    return calls


@pytest.fixture
def full_disk(monkeypatch):
    """Writing fails from the n-th file on: `full_disk(n)`."""
    real, count = writing._replace, []

    def set_limit(n):
        def fake(target, data):
            count.append(target)
            if len(count) >= n:
                raise OSError(errno.ENOSPC, "No space left on device")
            real(target, data)

        monkeypatch.setattr(writing, "_replace", fake)

    return set_limit
