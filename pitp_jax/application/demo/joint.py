"""Simulate a robot's joint and its simulator with the same position commands: two folders, and a MuJoCo file.

    J q'' + D q' + Kp (q - c(t - T)) + Fc sgn(q') = 0,    angle read = play(q, w), rounded to the encoder's steps

The simulator lacks Fc, T and w. Each writes its own file format: the simulator radians at 200 Hz, the robot degrees at
500 Hz with its own clock. Solved by semi-implicit Euler steps; dry friction acts implicitly:

    v* = v + h a(q, v),    v = sgn(v*) max(|v*| - h Fc / J, 0),    q = q + h v
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...files.recordings.writing import write_csv, write_text_atomic

SIMULATED, ROBOT, SIMULATOR_FILE = "sim", "robot", "joint.xml"
POSITION_GAIN = 20.0  # Kp of the simulator and of the robot, N m/rad


@dataclass(frozen=True)
class Joint:
    """The parameters of a position-controlled robot joint, in SI units.

    Attributes:
        inertia, damping, position_gain: J in kg m^2, D in N m s/rad, Kp in N m/rad.
        friction: dry friction Fc, N m (MuJoCo: frictionloss).
        delay: T, s, from the command's time stamp to the torque.
        backlash: w, rad; the encoder sits behind it.
    """

    inertia: float = 0.05
    damping: float = 0.9
    position_gain: float = POSITION_GAIN
    friction: float = 0.0
    delay: float = 0.0
    backlash: float = 0.0


IDEAL = Joint()
REAL = replace(IDEAL, friction=0.7, delay=0.020, backlash=0.020)  # N m, s, rad: what the simulator lacks


def commands(seconds: float) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Return position commands by name, as functions of time (T,) in rad: 0 up to t = 0, constant after `seconds`."""

    def windowed(shape: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        return lambda t: shape(np.clip(t, 0.0, seconds))

    def chirp(t, low=0.1, high=6.0):  # the frequency grows exponentially: every octave takes equally long
        rate = np.log(high / low) / seconds
        return 0.35 * np.sin(2 * np.pi * low * np.expm1(rate * t) / rate)

    return {
        "chirp": windowed(chirp),
        "sine_0.3Hz": windowed(lambda t: 0.50 * np.sin(2 * np.pi * 0.3 * t)),
        "sine_1Hz": windowed(lambda t: 0.12 * np.sin(2 * np.pi * t)),
        "sine_2.5Hz": windowed(lambda t: 0.30 * np.sin(2 * np.pi * 2.5 * t)),
        # constant speed between sharp reversals, where backlash and dry friction are most visible
        "triangle": windowed(lambda t: 0.20 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.5 * t))),
        "steps": windowed(lambda t: 0.10 * (np.floor(t / 1.5) % 5) * (-1.0) ** np.floor(t / 3.0)),
    }


def simulate(joint: Joint, command: Callable[[np.ndarray], np.ndarray], time: np.ndarray) -> np.ndarray:
    """Simulate the measured angle (rad) at each sample, from standstill; a command is held for one sample.

    Args:
        joint: its numbers.
        command: position command as a function of time, rad.
        time: uniform sample times, s, shape (T,).
    """
    dt = float(time[1] - time[0])
    substeps = int(np.ceil(dt / 2.5e-4))
    h = dt / substeps
    # the command acting in each substep: sampled at its own time stamp, T later at the motor
    acting = np.arange(len(time) * substeps) * h - joint.delay
    held = command(time[0] + dt * np.floor(acting / dt + 1e-9)).tolist()  # 1e-9: k h / dt may round below its sample
    kp, d, slip = joint.position_gain / joint.inertia, joint.damping / joint.inertia, h * joint.friction / joint.inertia
    q = v = 0.0
    angles = np.empty(len(time))
    for k in range(len(time)):
        angles[k] = q
        for c in held[k * substeps : (k + 1) * substeps]:
            free = v + h * (kp * (c - q) - d * v)
            # friction stops a joint but never reverses it
            v = max(free - slip, 0.0) if free > 0 else min(free + slip, 0.0)
            q += h * v
    return _play(angles, joint.backlash / 2)


def _play(values: np.ndarray, half: float) -> np.ndarray:
    """Apply a backlash of this half width to a signal, starting in the middle of the gap, shape (T,)."""
    follower, out = 0.0, np.empty(len(values))
    for k, value in enumerate(values):
        follower = min(max(follower, value - half), value + half)
        out[k] = follower
    return out


def write(folder: Path, *, quick: bool) -> None:
    """Write recordings of simulator and robot as CSV, one per command, and the simulator as a MuJoCo file.

    Args:
        folder: where.
        quick: half as long.

    Raises:
        BadInput: a file cannot be written.
    """
    seconds = 9.0 if quick else 18.0
    rng, digit = np.random.default_rng(1), 2 * np.pi / 2**14  # rad, of the encoder
    write_text_atomic(folder / SIMULATOR_FILE, MJCF)
    for home in (SIMULATED, ROBOT):
        (folder / home).mkdir()
    for name, command in commands(seconds).items():
        time = np.arange(round(200 * (seconds + 1.0))) / 200
        columns = {"time_s": time, "input_rad": command(time), "output_rad": simulate(IDEAL, command, time)}
        write_csv(folder / SIMULATED / f"{name}.csv", columns)
        # the robot's log starts 0.7 s before the command
        time = np.arange(round(500 * (seconds + 1.7))) / 500 - 0.7
        angle = simulate(REAL, command, time)
        angle = digit * np.round((angle + 0.2 * digit * rng.standard_normal(len(angle))) / digit)
        columns = {"time_s": time - time[0], "input_deg": np.degrees(command(time)), "output_deg": np.degrees(angle)}
        write_csv(folder / ROBOT / f"{name}.csv", columns)


MJCF = f"""<mujoco model="joint">
  <compiler angle="radian"/>
  <option timestep="0.0005" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <joint name="elbow" axis="0 1 0" damping="{IDEAL.damping}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{IDEAL.inertia} {IDEAL.inertia} {IDEAL.inertia}"/>
    </body>
  </worldbody>
  <actuator>
    <position name="elbow" joint="elbow" kp="{IDEAL.position_gain}"/>
  </actuator>
</mujoco>
"""


def recordings() -> set[str]:
    """Return the names of the files that `write` makes, with their folders."""
    return {SIMULATOR_FILE} | {f"{home}/{name}.csv" for home in (SIMULATED, ROBOT) for name in commands(1.0)}
