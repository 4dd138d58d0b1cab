"""Twelve robots in MuJoCo: two folders and an XML file in, the XML with the identified numbers out, played again.

    arm.xml + sim/ + robot/  ->  pitp diagnose --against --mjcf  ->  arm_identified.xml  ->  held-out commands  ->  gap

    python experiments/mjcf_bank.py [NUMBER ...] [--seed 1] [--out bank.jsonl] [--smoke]

Each robot is drawn by the seed: a position servo or a torque motor, angles in degrees or radians in the XML, numbers in
nested defaults or on the joint, and three differences from its simulator among friction, damping, armature, delay,
gain (kp or gear), an offset load, range, force limit. An encoder of 14 bits with noise of a third of a step reads the
robot. The diagnosis sees the two folders and the XML. `left` is the gap on held-out commands after over before, the
sensor's noise taken off both. Finished robots are read from --out. Needs `pip install mujoco`.
"""

import argparse
import json
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import pitp_jax as pitp
from pitp_jax.files.mjcf.play import play

DT, SECONDS = 5e-3, 10.0  # s: of a sample, of a record
COUNT = 2 * np.pi / 2**14  # rad
ROBOTS = 12


@dataclass(frozen=True)
class Arm:
    """Numbers of one joint, SI; `servo`: a position servo of gain kp and kv, otherwise a motor of this gear."""

    servo: bool
    degrees: bool
    nested: bool
    kp: float = 20.0
    kv: float = 0.4
    gear: float = 1.0
    damping: float = 0.3
    armature: float = 0.02
    stiffness: float = 0.0
    friction: float = 0.0
    delay: float = 0.0
    load: float = 0.0  # kg at 0.25 m along the link
    range: float = 0.0
    force: float = 0.0


def xml(arm: Arm) -> str:
    """As a user would have written it."""
    unit = 180 / np.pi if arm.degrees else 1.0
    joint = f'damping="{arm.damping}" armature="{arm.armature}"'
    if arm.friction:
        joint += f' frictionloss="{arm.friction}"'
    drive = f'kp="{arm.kp}" kv="{arm.kv}"' if arm.servo else f'gear="{arm.gear}"'
    kind = "position" if arm.servo else "motor"
    stop = f' range="{-arm.range * unit} {arm.range * unit}"' if arm.range else ""
    spring = f' stiffness="{arm.stiffness}"' if arm.stiffness else ""
    late = f' delay="{arm.delay}" nsample="{int(np.ceil(arm.delay / 1e-3)) + 1}"' if arm.delay else ""
    force = f' forcerange="{-arm.force} {arm.force}"' if arm.force else ""
    load = f'<geom type="sphere" size="0.02" pos="0 0 -0.25" mass="{arm.load}" group="1"/>' if arm.load else ""
    defaults = ""
    if arm.nested:
        defaults = (
            f'<default><joint damping="1"/><default class="arm"><default class="elbow"><joint {joint}/>'
            f"<{kind} {drive}/></default></default></default>"
        )
        joint, drive = 'class="elbow"', 'class="elbow"'
    return f"""<mujoco model="arm">
  <compiler angle="{"degree" if arm.degrees else "radian"}"/>
  <option timestep="0.001" gravity="0 0 -9.81" integrator="implicitfast"/>
  {defaults}
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <!-- the arm turns about a horizontal axis, its link balanced -->
    <body name="link">
      <joint name="elbow" axis="0 1 0" {joint}{spring}{stop}/>
      <geom type="capsule" size="0.02" fromto="0 0 -0.15 0 0 0.15" mass="0.8"/>{load}
    </body>
  </worldbody>
  <actuator>
    <{kind} name="drive" joint="elbow" {drive}{late}{force}/>
  </actuator>
</mujoco>
""".replace("  \n", "")


def drawn(seed: int, number: int) -> tuple[Arm, Arm, list[str]]:
    """The simulator's arm, the robot's, and what differs."""
    rng = np.random.default_rng([seed, number])
    servo = bool(number % 2 == 0)
    ideal = Arm(servo, degrees=bool(rng.integers(2)), nested=bool(rng.integers(2)))
    if not servo:
        ideal = replace(ideal, stiffness=float(rng.uniform(1.5, 3.0)))
    changes = {
        "friction": lambda: {"friction": float(rng.uniform(0.05, 0.15) * (4 if servo else 1))},
        "damping": lambda: {"damping": float(0.3 * rng.uniform(1.3, 2.0))},
        "armature": lambda: {"armature": float(0.02 * rng.uniform(1.4, 2.5))},
        "delay": lambda: {"delay": float(rng.integers(8, 30)) * 1e-3},
        "gain": lambda: {"kp": float(20 * rng.uniform(0.6, 0.85))} if servo else {"gear": float(rng.uniform(0.7, 0.9))},
        "load": lambda: {"load": float(rng.uniform(0.1, 0.25))},
        "range": lambda: {"range": float(rng.uniform(0.3, 0.4))},
        "force": lambda: {"force": float(rng.uniform(3.0, 5.0))},
    }
    names = [str(n) for n in rng.choice([c for c in changes if servo or c != "force"], 3, replace=False)]
    robot = {}
    for name in names:
        robot |= changes[name]()
    return ideal, replace(ideal, **robot), names


def commands(servo: bool, seconds: float, seed: int, held_out: bool) -> dict[str, np.ndarray]:
    """Commands by name: angles in rad, or torques in N m."""
    t = np.arange(round(seconds / DT)) * DT
    size = 1.0 if servo else 1.6
    soft = np.minimum(t / 0.5, 1.0) * np.minimum((seconds - t) / 0.5, 1.0)
    if held_out:
        rng = np.random.default_rng(seed)
        lines = rng.uniform(0.1, 4.0, 12)
        mix = sum(np.sin(2 * np.pi * f * t + p) / (1 + f) for f, p in zip(lines, rng.uniform(0, 6, 12), strict=True))
        walk = np.repeat(rng.uniform(-0.4, 0.4, int(seconds) + 1), round(1 / DT))[: len(t)]
        return {"mixture": size * 0.4 * soft * mix / np.abs(mix).max(), "levels": size * walk * np.minimum(t / 0.1, 1)}
    rate = np.log(60.0) / seconds
    return {
        "chirp": size * 0.3 * soft * np.sin(2 * np.pi * 0.1 * np.expm1(rate * t) / rate),
        "slow_sine": size * 0.45 * np.sin(2 * np.pi * 0.2 * t),
        "sine_1Hz": size * 0.2 * soft * np.sin(2 * np.pi * 1.0 * t),
        "sine_2.5Hz": size * 0.3 * soft * np.sin(2 * np.pi * 2.5 * t),
        "triangle": size * 0.25 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.4 * t)),
        "steps": size * np.array([0.0, 0.3, -0.2, 0.1, 0.4, -0.35, 0.05, 0.0])[np.minimum((t / 1.25).astype(int), 7)],
    }


def recorded(file: Path, drives: dict[str, np.ndarray], unit: str, seed: int | None) -> list[pitp.Record]:
    """Records of the file's joint under every command; with a seed through the encoder and its noise."""
    rng, found = np.random.default_rng(seed), []
    for name, drive in drives.items():
        time_ = np.arange(len(drive)) * DT
        still = pitp.Record(name, time_, drive, np.zeros(len(drive)), voltage_unit=unit, displacement_unit="rad")
        (angle,) = play(file, "elbow", [still])
        if seed is not None:
            angle = np.round((angle + COUNT / 3 * rng.standard_normal(len(angle))) / COUNT) * COUNT
        found.append(pitp.Record(name, time_, drive, angle, voltage_unit=unit, displacement_unit="rad"))
    return found


def run(seed: int, number: int, seconds: float) -> dict:
    """One robot: diagnose, write, play the held-out commands."""
    sim, robot, names = drawn(seed, number)
    unit = "rad" if sim.servo else "N m"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "arm.xml").write_text(xml(sim))
        (folder / "robot.xml").write_text(xml(robot))
        drives = commands(sim.servo, seconds, seed, False)
        simulated = recorded(folder / "arm.xml", drives, unit, None)
        real = recorded(folder / "robot.xml", drives, unit, number + 1)
        began = time.process_time()
        found = pitp.diagnose(real, against=simulated)
        written = pitp.write_mjcf(found, folder / "arm.xml", "elbow", folder / "gap")
        spent = time.process_time() - began
        unseen = recorded(folder / "robot.xml", commands(sim.servo, seconds, seed + 100, True), unit, number + 100)
        checked = pitp.verify_mjcf(real, written.file, "elbow", before=folder / "arm.xml", held_out=unseen)
    noise = 100 * COUNT * np.sqrt(1 / 9 + 1 / 12) / np.sqrt(np.mean([np.ptp(r.displacement) ** 2 for r in unseen]))
    before, after = (np.sqrt(max((checked.gap(True, after=a) or 0.0) ** 2 - noise**2, 0.0)) for a in (False, True))
    return {
        "robot": number, "servo": sim.servo, "differences": {n: _true(robot, n) for n in names},
        "verdict": found.verdict, "effects": list(found.effects), "typed": [c.text for c in written.changes if c.text],
        "not_written": [n.words for n in written.left], "before": float(before), "after": float(after),
        "left": float(after / before), "better": checked.better, "cpu_s": spent,
    }  # fmt: skip


def _true(arm: Arm, name: str) -> float:
    return getattr(arm, {"gain": "kp" if arm.servo else "gear"}.get(name, name))


def main() -> None:
    """Print a row a robot, then how many fall by 90 %."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("numbers", nargs="*", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--smoke", action="store_true")
    options = parser.parse_args()
    kept = options.out.read_text().splitlines() if options.out and options.out.is_file() else []
    rows = {row["robot"]: row for row in map(json.loads, kept) if row["seed"] == options.seed}
    for number in options.numbers or (range(1) if options.smoke else range(ROBOTS)):
        if number not in rows:
            rows[number] = run(options.seed, number, 4.0 if options.smoke else SECONDS) | {"seed": options.seed}
            if options.out:
                with open(options.out, "a") as file:
                    file.write(json.dumps(rows[number]) + "\n")
        row = rows[number]
        print(f"{number:2d} {'servo' if row['servo'] else 'motor'} {row['verdict']:10} gap {row['before']:6.2f} -> "
              f"{row['after']:6.2f} % (left {row['left']:.2f})  true {row['differences']}")  # fmt: skip
        for text in row["typed"]:
            print(f"      {text}")
        if row["not_written"]:
            print(f"      not written: {', '.join(row['not_written'])}")
    left = [row["left"] for row in rows.values()]
    print(f"{sum(x <= 0.1 for x in left)} of {len(left)} fall by 90 %; {sum(x > 1 for x in left)} rise")


if __name__ == "__main__":
    main()
