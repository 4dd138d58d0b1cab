"""A whole fit of the default preset, and one Adam step of its equation error beside the same step in PyTorch.

The records are those of ../shared/bench where that exists, else the quick protocol of the built-in virtual actuator
with the demo's short training. A whole fit runs once; nothing else fits this model, so only the step has a peer.
"""

import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp

import pitp_jax as pitp
from pitp_jax.application.demo import protocol
from pitp_jax.method.fit.parameters import trainable
from pitp_jax.method.train import training
from pitp_jax.method.train.dataset import build_dataset
from pitp_jax.method.train.settings import PRESETS, memory_of, with_encoder

from .clock import peak_mb, take_turns
from .sizes import size

_DATA = Path(__file__).resolve().parents[2] / "shared" / "bench"


def records(name: str):
    """Sweep, training and held-out records, the settings they go with, and what they are."""
    folder = _DATA / name
    if size(folder.is_dir(), False):
        parts = [pitp.read(folder / part) for part in ("sweep", "train", "test")]
        return *parts, PRESETS["default"], "recordings"
    actuator = pitp.plant(name)
    parts = [protocol.measure(actuator, protocol.excitations(name, part, True)) for part in ("sweep", "train", "test")]
    quick = protocol.QUICK_TRAINING | size({}, {"epochs": 1, "stages": 1, "refine_steps": 2, "width": 4, "memories": 2})
    parts = [part[: size(None, 3)] for part in parts]
    return *parts, replace(PRESETS["default"], **quick), "virtual, quick"


def step_ways(nominal, train, settings) -> tuple[dict, str]:
    """One epoch of ours, a few steps of PyTorch's; both report per step through `scale`."""
    settings = replace(settings, few=0)  # the whole network, however few the records
    memory = partial(memory_of, settings, nominal, None)
    data = build_dataset(nominal, train, scaling=settings.scaling, difference=settings.difference, memory=memory)
    model = with_encoder(data, settings, None, jax.random.key(0))
    params, static = eqx.partition(model.encoder, trainable(model).encoder)
    state = training._OPTIMISER.init(params)
    box_rate = jnp.asarray([0.6, 1.5]), jnp.asarray(1e-3)
    few, how = data.equation.take(slice(0, 20 * settings.batch)), training.in_an_epoch(settings)

    def ours():
        return training._epoch(params, static, state, model, few, *box_rate, jax.random.key(1), **how)[2]

    steps = max(few.force.shape[0] // settings.batch, 1)
    try:
        import torch

        from .torch_model import Tokens, tensor
    except ImportError as error:
        return {"pitp_jax": (ours, steps)}, f"{error.name} is not installed"
    torch.set_num_threads(1)
    network = Tokens(model)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    batch = [tensor(a[: settings.batch].T) for a in (few.features, few.equation, few.force)]

    def theirs():
        features, equation, force = batch
        for _ in range(steps):
            tokens, offset = network(features)
            left = (tokens * equation).sum(0) + offset - force
            physics = torch.nn.functional.smooth_l1_loss(left, torch.zeros_like(left), beta=settings.huber)
            factor = tokens / network.coefficients
            over, under = torch.relu(factor - 1.5), torch.relu(0.6 - factor)
            optimiser.zero_grad()
            (physics + (0.1 * over + 0.1 * under).mean()).backward()
            optimiser.step()

    return {"pitp_jax": (ours, steps), "PyTorch eager, one thread": (theirs, steps)}, ""


def measure_fit(name: str, seconds: float) -> dict:
    """The row of one actuator."""
    sweep, train, test, settings, kind = records(name)
    began = time.perf_counter()
    nominal = pitp.identify(sweep).model
    identified = time.perf_counter() - began
    began = time.perf_counter()
    model = pitp.train(nominal, train, settings=settings, key=jax.random.key(0)).model
    taken, used = time.perf_counter() - began, peak_mb()  # before the peer's arrays stand beside it
    ways, why = step_ways(nominal, train, settings)
    found = take_turns({n: run for n, (run, _) in ways.items()}, min(seconds, 5.0))
    steps = {n: found[n]["median_ms"] / count for n, (_, count) in ways.items()}
    runs = zip(pitp.predict(model, test), test, strict=True)
    errors = sorted(pitp.e_rms_percent(p.displacement, r.displacement, p.scored) for p, r in runs)
    whole = {key: 1e3 * taken for key in ("median_ms", "p10_ms", "p90_ms")}
    return {**whole, "compile_s": found["pitp_jax"]["compile_s"], "runs": 1, "peer": None, "peer_median_ms": None,
            "ratio": None, "data": kind, "records": len(train), "identify_s": identified, "step_ms": steps,
            "peak_mb": used, "held_out_median_percent": errors[len(errors) // 2], "peer_skipped": why}  # fmt: skip
