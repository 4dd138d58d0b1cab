"""A nominal beside its own runs, and every form of the catalogue in one program: what tests of effects share."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from pitp_jax.method.model.model import Model
from pitp_jax.method.simulate import ports
from pitp_jax.method.simulate.decoder import rest_state, rollout


@dataclass(frozen=True)
class Beside:
    """A nominal and its runs: voltage, age, run, span of every drive."""

    model: Model
    series: tuple[SimpleNamespace, ...]


def beside(model, voltages, dt, apart=10.0) -> Beside:
    """Free runs from rest under these drives, one every `apart` seconds of a session."""
    series = []
    run = eqx.filter_jit(lambda volts: rollout(model, volts, dt, rest_state(model))[:, 0])
    for k, u in enumerate(voltages):
        x = np.asarray(run(jnp.asarray(u, jnp.float32)), float)
        series.append(SimpleNamespace(voltage=u, age=apart * k, run=x, span=float(np.ptp(x))))
    return Beside(model, tuple(series))


class Composite:
    """The nominal with all these forms, neutral unless a run's numbers say otherwise: one program for all of them."""

    def __init__(self, case: Beside, forms, dt):
        self.case, self.forms = case, list(forms)
        neutral = tuple(f.neutral() for f in forms)
        self._neutral, unravel = ravel_pytree(neutral)
        whole = replace(case.model, effects=neutral)
        self._sizes = np.cumsum([0, *(len(f.parameters) for f in forms)])

        def run(theta, volts, age):
            model = replace(whole, effects=unravel(theta))
            return ports.readings(model, rollout(model, volts, dt, rest_state(model, age)))

        self._run = eqx.filter_jit(jax.vmap(run))

    def runs(self, jobs) -> np.ndarray:
        """Scaled readings of (drive, form or None, values), shape (jobs, T), side by side in one call."""
        thetas = np.tile(self._neutral, (len(jobs), 1))
        for theta, (_, form, values) in zip(thetas, jobs, strict=True):
            if form is not None:
                first = self._sizes[self.forms.index(form)]
                theta[first : first + len(values)] = values
        series = [self.case.series[drive] for drive, *_ in jobs]
        volts, ages = (np.array([getattr(s, name) for s in series], np.float32) for name in ("voltage", "age"))
        return np.asarray(self._run(thetas, volts, ages), float)
