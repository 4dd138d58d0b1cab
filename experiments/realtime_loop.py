"""A loop in real time: the exported inverse in one process with a timer, a virtual actuator in another, UDP between.

The controller is compiled C that sends a voltage every millisecond; the actuator answers with its displacement when a
voltage comes. Printed: e_rms of the loop beside what `feedforward` reaches when it is played, with PI and without, on
the actuator and on one whose membrane is 3 % softer; drawn: how late the calls were.
"""

import argparse
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile, gettempdir

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import pitp_jax as pitp

HERE = Path(__file__).parent
SOFTER = 0.97


def main(smoke: bool = False, argv=()):
    """Export, compile, play, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", type=Path, help="model file of a cone100 (default: identified here, linear)")
    parser.add_argument("--hz", type=float, default=2.0, help="of the target")
    parser.add_argument("--out", type=Path, default=HERE / "figures", help="folder of the figure")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args(list(argv))
    if smoke or options.smoke:
        options.out = Path(gettempdir()) / "pitp_smoke"
    actuator = pitp.plant("cone100")
    dt, seconds = 1 / actuator.rate_hz, 1.0 if smoke or options.smoke else 10.0
    model = pitp.load(options.model) if options.model else identified(actuator)
    time = np.arange(round(seconds / dt)) * dt
    target = wanted(options.hz, time)
    early = wanted(options.hz, time + dt / 2)  # a held voltage acts half a sample late
    drifted = replace(actuator, spring=SOFTER * actuator.spring)
    with TemporaryDirectory() as folder:
        controller = built(model, Path(folder))
        print(f"{'cell':28}| feedforward | loop e_rms (%) | with PI (%) | latest call (us)")
        for label, plant in (("same plant", actuator), ("3 % softer", drifted)):
            plan = pitp.feedforward(model, pitp.Target(time, target))
            u = plan.voltage[np.flatnonzero(plan.target)[0] :][: len(time)]
            open_loop = pitp.e_rms_percent(np.asarray(pitp.simulate(plant, time, u)), target)
            runs = [played(controller, plant, early, dt, model.order, on) for on in (False, True)]
            errors = [pitp.e_rms_percent(x, target) for x, _ in runs]
            late = np.concatenate([lateness for _, lateness in runs])
            name = f"cone100, {options.hz:g} Hz, {label}"
            print(f"{name:28}| {open_loop:.2f} | {errors[0]:.2f} | {errors[1]:.2f} | {1e6 * late.max():.0f}")
    draw(late, options.out)


def wanted(hz: float, time: np.ndarray) -> np.ndarray:
    """The target (m), from rest."""
    return 0.6e-3 * np.sin(np.pi * hz * time) ** 2 * -np.expm1(-((1.5 * hz * time) ** 3))


def identified(actuator) -> pitp.Model:
    """The linear model of one sweep."""
    time = np.arange(20_000) / actuator.rate_hz
    sweep = pitp.record(actuator, "sweep", time, 1500 + 1500 * np.sin(2 * np.pi * (0.1 + 0.4 * time) * time), seed=1)
    return pitp.identify([sweep], order=2).model


def built(model: pitp.Model, folder: Path) -> Path:
    """The controller, compiled with the exported model."""
    pitp.export_c(model, folder / "model")
    sources = [HERE / "realtime" / "controller.c", folder / "model" / "pitp_model.c"]
    binary = folder / "controller"
    command = ["cc", "-O2", "-std=gnu99", "-I", folder / "model", "-o", binary, *sources, "-lm"]
    subprocess.run(command, check=True)
    return binary


def played(controller: Path, plant, target: np.ndarray, dt: float, order: int, trim: bool):
    """Displacement of the actuator along the loop (m), and how late each call was (s)."""
    rows = np.stack([target], -1)
    for _ in range(order):
        rows = np.column_stack([rows, np.gradient(rows[:, -1], dt)])
    step, state = pitp.stepper(plant, hold="zoh")
    advance = jax.jit(step)
    state = jax.tree.map(jnp.asarray, state)
    jax.block_until_ready(advance(state, 0.0, 0.0))
    seen = np.zeros(len(target))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line, TemporaryFile() as wanted, TemporaryFile() as found:
        line.bind(("127.0.0.1", 0))
        line.settimeout(5.0)
        wanted.write(np.ascontiguousarray(rows, np.float64).tobytes())
        wanted.seek(0)
        call = [str(controller), str(line.getsockname()[1]), str(len(target)), str(int(trim))]
        with subprocess.Popen(call, stdin=wanted, stdout=found) as process:
            x = 0.0
            for k in range(len(target)):
                data, sender = line.recvfrom(8)
                volts, seen[k] = float(np.frombuffer(data)[0]), x
                state, moved = advance(state, volts, volts)
                x = float(moved)
                line.sendto(np.float64(x).tobytes(), sender)
            process.wait(5.0)
        found.seek(0)
        said = np.frombuffer(found.read()).reshape(-1, 3)
    return seen, said[:, 0]


def draw(late: np.ndarray, folder: Path) -> None:
    """How late the calls were."""
    figure = Figure(figsize=(6.0, 2.6), layout="constrained")
    ax = figure.subplots()
    ax.hist(1e6 * late, bins=80, log=True)
    ax.set(xlabel="late (us)", ylabel="calls", title=f"{len(late)} calls, latest {1e6 * late.max():.0f} us")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "realtime_loop.png", dpi=150)


if __name__ == "__main__":
    main(argv=sys.argv[1:])
