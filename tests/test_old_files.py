"""Model files that version 0.2.0 wrote, one for every kind of part: they load, and compute what they computed then."""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import pitp_jax as pitp

FILES = Path(__file__).parent / "files" / "models_0_2_0"
RUNS = json.loads((FILES / "free_runs.json").read_text())
TIME = 5e-3 * np.arange(60)
VOLTAGE = np.round(900 * np.sin(np.pi * 2.5 * TIME + 4 * TIME**2) ** 2)  # V, starts at rest
OWN = ("own_encoder", "adapted_own")


class Spring(eqx.Module):
    """The user's encoder in two of the files: sigma_0 follows x^2; two weights."""

    weight: jax.Array
    bias: jax.Array

    def __call__(self, features):
        return jnp.zeros(4, features.dtype).at[0].set(self.weight * features[0] ** 2 + self.bias)


def loaded(path: Path):
    """The model of a file, its own encoder beside it where the file holds one."""
    zero = jnp.zeros((), jnp.float32)
    return pitp.load(path, encoder=Spring(zero, zero) if path.stem in OWN else None)


def test_every_file_has_its_free_run():
    assert sorted(RUNS) == sorted(path.stem for path in FILES.glob("*.pitp"))


@pytest.mark.parametrize("name", sorted(RUNS))
def test_an_old_file_loads_and_runs_as_it_did(name):
    model, known = loaded(FILES / f"{name}.pitp"), np.asarray(RUNS[name])
    found = np.asarray(pitp.free_run(model, jnp.asarray(VOLTAGE, jnp.float32)))
    np.testing.assert_allclose(found, known, rtol=0, atol=1e-4 * np.ptp(known))


@pytest.mark.parametrize("name", sorted(RUNS))
def test_an_old_file_is_written_again_with_the_same_numbers(name, tmp_path):
    model = loaded(FILES / f"{name}.pitp")
    path = tmp_path / f"{name}.pitp"
    pitp.save(path, model)
    again = loaded(path)
    old, new = (jax.tree.leaves(eqx.filter(m, eqx.is_array)) for m in (model, again))
    assert len(old) == len(new) and all(np.array_equal(a, b) for a, b in zip(old, new, strict=True))
