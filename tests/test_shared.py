"""Identification on every record set in ../shared: it converges from its own start, or refuses with advice."""

from pathlib import Path

import numpy as np
import pytest

import pitp_jax as pitp

SHARED = Path(__file__).resolve().parents[1].parent / "shared"
LINEAR = ("silverbox",)  # electronics: the input is not squared


def record_sets():
    folders = [*SHARED.glob("bench/*/sweep"), *SHARED.glob("data/*"), *SHARED.glob("gap/*/clean")]
    return sorted(str(f.relative_to(SHARED)) for f in folders if f.is_dir())


pytestmark = [
    pytest.mark.exhaustive,
    pytest.mark.skipif(not record_sets(), reason="no ../shared beside the repository"),
]


@pytest.mark.parametrize("folder", record_sets() or ["none"])
def test_identify_converges_or_refuses(folder):
    records = pitp.read(SHARED / folder)
    sweeps = [r for r in records if "sweep" in r.name]
    input_map = "linear" if any(name in folder for name in LINEAR) else "square"
    try:
        found = pitp.identify(sweeps or records, input_map=input_map)
    except pitp.ComputationFailed as refusal:
        (line,) = str(refusal).splitlines()
        assert "identif" in line
        assert "record" in line
        return
    fit = found.chosen
    assert fit.converged
    assert fit.identifiable
    assert np.isfinite(fit.stderr).all()
    assert (fit.coefficients > 0).all()  # stable: no pole can be on the right with a negative coefficient
    assert (np.roots(fit.coefficients[::-1]).real < 0).all()
    for run in pitp.predict(found.model, records):
        assert not run.diverged
        assert np.isfinite(run.displacement).all()
