"""Records over one device, eight devices and two processes: the answers of one plain call."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typed import some

from pitp_jax import BadInput, records_mesh, rest_state, sharded_inverse, sharded_rollout
from pitp_jax.method.simulate.decoder import rollout
from pitp_jax.method.simulate.devices import local_rows, spread

WORKER = Path(__file__).with_name("shard_worker.py")
PARTS = {"rollout", "inverse", "slopes"}


def start(devices, *args):
    flags = f"--xla_force_host_platform_device_count={devices} --xla_backend_optimization_level=0"  # compiles faster
    env = dict(os.environ, XLA_FLAGS=flags, JAX_PLATFORMS="cpu")
    return subprocess.Popen([sys.executable, str(WORKER), *args], env=env, stdout=subprocess.PIPE, text=True)


def answer(process):
    out, _ = process.communicate(timeout=240)
    assert process.returncode == 0
    return json.loads(out.splitlines()[-1])


@pytest.fixture(scope="module")
def running():
    """Eight devices in one process, and two processes of two devices on loopback, side by side."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    one, pair = start(8), [start(2, address, "2", str(k)) for k in range(2)]
    yield one, pair
    for process in (one, *pair):  # a worker of the suite may have asked for none of the answers
        process.kill()
        process.wait()
        some(process.stdout).close()


def test_one_device_rolls_out_and_inverts_as_without(linear, coefficients):
    """Free runs are those of one record at a time; the inverse is sqrt(a_0 x + a_1 x' + a_2 x'') of known motions."""
    model, mesh, t, w = linear(2), records_mesh(jax.devices()[:1]), np.arange(400) * 1e-3, 2 * np.pi * 1.5
    volts = np.stack([300 * np.sin((1 + r) * 4 * t) ** 2 for r in range(3)])
    rest = np.asarray(rest_state(model))
    found = sharded_rollout(model, volts, 1e-3, np.tile(rest, (3, 1)), mesh)
    truth = [rollout(model, jnp.asarray(u, jnp.float32), 1e-3, rest_state(model)) for u in volts]
    np.testing.assert_allclose(found, truth, rtol=0, atol=2e-5 * np.abs(truth).max())
    motion = np.stack([1.5 - 2 * np.cos(w * t) + 0.5 * np.cos(2 * w * t), 2 * w * np.sin(w * t) - w * np.sin(2 * w * t),
                       2 * w**2 * (np.cos(w * t) - np.cos(2 * w * t))])  # fmt: skip
    sizes = np.array([[2e-4], [4e-4]])
    wanted = np.sqrt(np.maximum(sizes * (coefficients(2) @ motion), 0.0))
    np.testing.assert_allclose(
        sharded_inverse(model, sizes * motion[0], 1e-3, mesh), wanted, rtol=0, atol=1e-3 * wanted.max()
    )


@pytest.mark.slow
def test_equal_on_eight_devices(running):
    """11 records on eight devices: some are padding."""
    found = answer(running[0])
    assert (found["devices"], found["local"]) == (8, 8)
    assert found["errors"].keys() == PARTS | {"free runs, errors", "free runs, slopes"}
    assert max(found["errors"].values()) < 2e-5


@pytest.mark.slow
def test_equal_on_two_processes(running):
    """Every process checks its own records."""
    for found in map(answer, running[1]):
        assert (found["devices"], found["local"]) == (4, 2)
        assert found["errors"].keys() == PARTS
        assert max(found["errors"].values()) < 2e-5


def test_records_come_back_in_order_without_the_padding():
    mesh = records_mesh()
    rows = np.arange(15.0).reshape(5, 3).astype(np.float32)
    placed = spread((rows,), mesh)[0]
    assert placed.shape[0] % len(jax.devices()) == 0
    np.testing.assert_array_equal(local_rows(placed, 5), rows)


@pytest.mark.parametrize("batch", [(np.zeros((0, 3)),), (np.zeros((2, 3)), np.zeros((3, 3)))])
def test_uneven_or_empty_batches_are_refused(batch):
    with pytest.raises(BadInput, match="records"):
        spread(batch, records_mesh())
