"""The x64 switch of the research code around: the package keeps its own precision, and its answers."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pitp_jax import e_rms_percent

pytestmark = pytest.mark.slow
WORKER = Path(__file__).with_name("precision_worker.py")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """What the worker says."""
    place = tmp_path_factory.mktemp("precision") / "found.npz"
    quick = "--xla_backend_optimization_level=0"  # compiles faster
    env = dict(os.environ, JAX_ENABLE_X64="1", XLA_FLAGS=quick)
    subprocess.run([sys.executable, str(WORKER), str(place)], env=env, timeout=300, check=True)
    return np.load(place)


def test_models_stay_in_float32(found):
    assert list(found["dtypes"]) == ["float32"]


def test_it_trains(found):
    """To the sensor's noise, 0.1 %, and what two nets leave after 8 steps; the nominal leaves 2 %."""
    assert e_rms_percent(found["nominal"], found["measured"]) > 1.5
    assert e_rms_percent(found["predicted"], found["measured"]) < 0.8
    assert e_rms_percent(found["moving"][400:], found["measured"][800:]) < 0.8


def test_every_way_rolls_out_the_same(found):
    for way in ("predicted", "sharded"):
        assert e_rms_percent(found["rolled"], found[way]) < 1e-3


def test_it_inverts(found):
    assert found["self_check"] < 0.3


def test_it_diagnoses(found):
    assert list(found["effects"]) == ["electrode_rc"]
