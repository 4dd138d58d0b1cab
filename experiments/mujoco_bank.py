"""A third party's physics: a joint in MuJoCo as the simulator and, with what the simulator lacks, as the robot.

    I q'' + D q' + K q = torque,   I = armature + m l^2

    python experiments/mujoco_bank.py [CASE ...] [--seed 1] [--out mujoco.jsonl] [--smoke]

Fourteen cases, drawn by the seed before anything runs: six mechanisms alone, four pairs of them, none, numbers only,
two causes outside the catalogue. MuJoCo integrates both; angles are read by a 14-bit encoder with noise of a third of a
step. Recordings of the ideal joint are the simulator, those of the other the robot: `pitp.diagnose(robot,
against=simulated)`. A case is right where exactly the planted names are said (or a tie that holds them), and outside
where none is; it is wrong where a name is said that is not there. The values told
are put back into MuJoCo and simulated again: `left` is what remains of the gap. Finished cases are read from --out.
Needs `pip install mujoco`.
"""

import argparse
import json
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

import pitp_jax as pitp

DT, STEP, SECONDS = 2e-3, 2.5e-4, 10.0  # s: of a sample, of MuJoCo, of a record
COUNT = 2 * np.pi / 2**14  # rad
NUMBERS = ("damping", "stiffness", "armature")


@dataclass(frozen=True)
class Joint:
    """What is written into MuJoCo's XML or done to its control; 0: absent.

    Attributes:
        stiffness, damping, armature: K in N m/rad, D in N m s/rad, kg m^2; the link adds 0.01 kg m^2.
        friction: MuJoCo's frictionloss, N m.
        gravity: m g l of a hanging link, N m; the ideal joint has its stiffness as a spring instead.
        clip: largest torque, N m.
        lag: time constant of the actuator (dyntype filter), s.
        delay: s, of the command.
        stop: the joint's range to either side, rad.
        play: dead band between the motor and the link that the encoder reads, rad.
        tail: a second body on an elastic hinge: its inertia, kg m^2.
        tail_spring, tail_damper: of its hinge, N m/rad, N m s/rad; 0: those of 4 Hz and a damping ratio of 0.03.
        cogging: amplitude of a torque sin(11 q), N m: outside the catalogue.
        sway: amplitude of a torque of its own clock, 0.83 Hz, N m: outside the catalogue.
    """

    stiffness: float = 2.0
    damping: float = 0.06
    armature: float = 0.01
    friction: float = 0.0
    gravity: float = 0.0
    clip: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    stop: float = 0.0
    play: float = 0.0
    tail: float = 0.0
    tail_spring: float = 0.0
    tail_damper: float = 0.0
    cogging: float = 0.0
    sway: float = 0.0


IDEAL = Joint()
MECHANISMS = {  # name: (changes, the names that are right)
    "friction": ({"friction": 0.07}, "coulomb_friction"),
    "gravity": ({"gravity": 2.0, "stiffness": 0.0}, "softening"),
    "clip": ({"clip": 0.6}, "voltage_clip"),
    "lag": ({"lag": 0.03}, "electrode_rc"),
    "delay": ({"delay": 0.024}, "delay"),
    "stop": ({"stop": 0.3}, "end_stop"),
    "play": ({"play": 0.04}, "backlash"),
    "tail": ({"tail": 0.004}, "second_mode"),
}
OUTSIDE = {"cogging": {"cogging": 0.15}, "sway": {"sway": 0.15}}


def cases(seed: int) -> dict[str, tuple[Joint, tuple[str, ...]]]:
    """Name to robot and right names; sizes within 30 % of the table's."""
    rng = np.random.default_rng(seed)

    def sized(changes: dict) -> dict:
        return {k: v * rng.uniform(0.7, 1.3) for k, v in changes.items()}

    drawn = {}
    for name in rng.choice(list(MECHANISMS), 6, replace=False):
        changes, right = MECHANISMS[name]
        drawn[str(name)] = (replace(IDEAL, **sized(changes)), (right,))
    while len(drawn) < 10:
        one, two = (str(n) for n in rng.choice(list(MECHANISMS), 2, replace=False))
        if f"{one}+{two}" not in drawn and f"{two}+{one}" not in drawn:
            both = sized(MECHANISMS[one][0]) | sized(MECHANISMS[two][0])
            drawn[f"{one}+{two}"] = (replace(IDEAL, **both), (MECHANISMS[one][1], MECHANISMS[two][1]))
    drawn["none"] = (IDEAL, ())
    numbers = {n: getattr(IDEAL, n) * f for n, f in zip(NUMBERS, rng.uniform(1.15, 1.5, 3), strict=True)}
    drawn["numbers"] = (replace(IDEAL, **numbers), ("parameter_change",))
    return drawn | {name: (replace(IDEAL, **sized(changes)), ()) for name, changes in OUTSIDE.items()}


def xml(j: Joint) -> str:
    """The joint as MuJoCo's XML; the torque goes to the motor, whose link swings about a vertical or hangs."""
    stop = f'limited="true" range="{-j.stop} {j.stop}"' if j.stop else ""
    lag = f'dyntype="filter" dynprm="{j.lag}"' if j.lag else ""
    clip = f'forcelimited="true" forcerange="{-j.clip} {j.clip}"' if j.clip else ""
    mass, length = (0.01 / 0.25**2, 0.25)
    hanging = j.gravity / (mass * length)  # the g that gives this m g l
    link = f'<geom type="sphere" size="0.01" pos="0 0 {-length}" mass="{mass}" contype="0" conaffinity="0"/>'
    if j.play:  # the motor alone turns the joint; the link follows between two stops
        half = j.play / 2
        link = (
            '<geom type="sphere" size="0.02" mass="0.05" contype="0" conaffinity="0"/><body>'
            f'<joint name="play" axis="0 1 0" limited="true" range="{-half} {half}" damping="0.002"'
            f' solreflimit="0.002 1"/>{link}</body>'
        )
    if j.tail:
        omega = 2 * np.pi * 4.0
        spring, damper = j.tail_spring or j.tail * omega**2, j.tail_damper or 0.06 * j.tail * omega
        link += (
            f'<body><joint name="tail" axis="0 1 0" stiffness="{spring}" damping="{damper}"/>'
            f'<inertial pos="0 0 0" mass="0.01" diaginertia="{j.tail} {j.tail} {j.tail}"/></body>'
        )
    return f"""<mujoco><compiler angle="radian"/>
    <option timestep="{STEP}" gravity="0 0 {-hanging}" integrator="implicitfast"/>
    <worldbody><body><joint name="q" axis="0 1 0" stiffness="{j.stiffness}" damping="{j.damping}"
    armature="{j.armature}" frictionloss="{j.friction}" {stop} solreflimit="0.004 1" solreffriction="0.004 1"/>{link}
    </body></worldbody><actuator><general joint="q" gainprm="1" {lag} {clip}/></actuator></mujoco>"""


def torques(seconds: float) -> dict[str, np.ndarray]:
    """Commands by name, N m, each from zero."""
    t = np.arange(round(seconds / DT)) * DT
    lines = np.arange(2, 60) / 10.0
    phases = np.random.default_rng(7).uniform(0, 2 * np.pi, len(lines))
    multisine = np.sin(2 * np.pi * lines[:, None] * t + phases[:, None]).sum(0)
    soft = np.minimum(t / 0.5, 1.0)
    return {
        "multisine": 0.8 * soft * multisine / np.abs(multisine).max(),
        "chirp": 0.3 * np.sin(2 * np.pi * (0.1 * t + (4.0 - 0.1) * t**2 / (2 * seconds))),
        "slow_sine": 0.9 * np.sin(2 * np.pi * 0.2 * t),
        "fast_sine": 0.4 * soft * np.sin(2 * np.pi * 1.3 * t),
        "triangle": 0.3 * 2 / np.pi * np.arcsin(np.sin(2 * np.pi * 0.4 * t)),
        "steps": np.array([0.0, 0.6, -0.4, 0.2, 0.8, -0.7, 0.1, 0.0])[np.minimum((t / 1.25).astype(int), 7)],
    }


def simulate(j: Joint, torque: np.ndarray) -> np.ndarray:
    """Angle of the link at every sample, rad; each torque is held for one sample."""
    model = mujoco.MjModel.from_xml_string(xml(j))
    data = mujoco.MjData(model)
    steps, late = round(DT / STEP), round(j.delay / STEP)  # of MuJoCo
    held = np.concatenate([np.zeros(late), np.repeat(torque, steps)])
    angle = np.empty(len(torque))
    for k in range(len(torque)):
        angle[k] = data.qpos[0] + (data.qpos[1] if j.play else 0.0)
        for u in held[k * steps : (k + 1) * steps]:
            data.ctrl[0] = u
            own = j.cogging * np.sin(11 * data.qpos[0]) + j.sway * np.sin(2 * np.pi * 0.83 * data.time)
            data.qfrc_applied[0] = own
            mujoco.mj_step(model, data)
    return angle


def recordings(j: Joint, seconds: float, seed: int | None) -> list[pitp.Record]:
    """Records of every torque; with a seed through the encoder and its noise."""
    rng, found = np.random.default_rng(seed), []
    for name, torque in torques(seconds).items():
        angle = simulate(j, torque)
        if seed is not None:
            angle = np.round((angle + COUNT / 3 * rng.standard_normal(len(angle))) / COUNT) * COUNT
        found.append(pitp.Record(name, np.arange(len(torque)) * DT, torque, angle, "N m", "rad"))
    return found


def misfit(robot: list[pitp.Record], other: list[pitp.Record]) -> float:
    """Pooled rms between two sets of records, % of the robot's range."""
    error = np.concatenate([a.displacement - b.displacement for a, b in zip(robot, other, strict=True)])
    return 100 * float(np.sqrt(np.mean(error**2)) / np.ptp(np.concatenate([r.displacement for r in robot])))


TYPED = {  # what the table of numbers says, and where it is typed in
    "stiffness": "stiffness", "damping": "damping", "inertia": "armature", "coulomb_friction level": "friction",
    "softening weight": "gravity", "delay time": "delay", "backlash width": "play", "end_stop place": "stop",
    "end_stop place, above": "stop", "end_stop place, below": "stop", "electrode_rc tau": "lag",
    "sensor_lag tau": "lag", "voltage_clip inverse": "clip", "second_mode inertia": "tail",
    "second_mode spring": "tail_spring",
    "second_mode damper": "tail_damper",
}  # fmt: skip


def put_back(found: pitp.SimToReal) -> Joint:
    """The ideal joint with what was said of the robot, typed in by the names of the table."""
    changes = {}
    for p in found.parameters:
        field = TYPED.get(p.name)
        if p.certain and field and np.isfinite(p.difference):
            changes[field] = max(getattr(IDEAL, field) + p.difference, 0.0)
    return replace(IDEAL, **changes)


def run(name: str, joint: Joint, right: tuple[str, ...], seconds: float, seed: int) -> dict:
    """One row of the table."""
    simulated, robot = recordings(IDEAL, seconds, None), recordings(joint, seconds, seed)
    began = time.perf_counter()
    found = pitp.diagnose(robot, against=simulated)
    took = time.perf_counter() - began
    said, tied = set(found.effects), set(found.robot.equivalent)
    fits = said == set(right) or (len(right) == len(said) == 1 and set(right) <= tied)
    gap = misfit(robot, recordings(IDEAL, seconds, seed))
    left = misfit(robot, recordings(put_back(found), seconds, seed)) / gap if said and gap > 0.1 else None
    return {"case": name, "right": right, "said": sorted(said), "verdict": found.verdict, "fits": fits,
            "wrong": bool(said - set(right)) and not fits, "gap_percent": gap, "left": left,
            "seconds": took, "robot": asdict(joint), "told": asdict(put_back(found))}  # fmt: skip


def main(argv=None) -> None:
    """Run what --out does not hold yet, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("mujoco.jsonl"))
    parser.add_argument("--smoke", action="store_true", help="one case of 2 s records: quick and meaningless")
    args = parser.parse_args(argv)
    drawn = cases(args.seed)
    args.out = Path(tempfile.mkdtemp()) / args.out.name if args.smoke else args.out
    rows = {r["case"]: r for r in map(json.loads, args.out.read_text().splitlines())} if args.out.exists() else {}
    for name in args.cases or (["none"] if args.smoke else drawn):
        if name not in rows:
            rows[name] = run(name, *drawn[name], 2.0 if args.smoke else SECONDS, 100 + args.seed)
            with args.out.open("a") as file:
                file.write(json.dumps(rows[name]) + "\n")
        r = rows[name]
        mark = "right" if r["fits"] else "WRONG" if r["wrong"] else "not named"
        left = "-" if r["left"] is None else f"{100 * r['left']:.0f} %"
        print(f"{name:16} {mark:10} {r['verdict']:10} said {', '.join(r['said']) or '-':40} planted"
              f" {', '.join(r['right']) or '-':36} gap {r['gap_percent']:5.2f} % left {left:6} {r['seconds']:.0f} s",
              flush=True)  # fmt: skip
    done = [rows[n] for n in drawn if n in rows]
    closed = sorted(r["left"] for r in done if r["left"] is not None)
    middle, worst = 100 * np.median(closed or [np.nan]), 100 * max(closed, default=np.nan)
    print(f"{sum(r['fits'] for r in done)} right, {sum(r['wrong'] for r in done)} wrong of {len(done)}")
    print(f"put back, of the gap left: median {middle:.0f} %, worst {worst:.0f} % of {len(closed)} named", flush=True)


if __name__ == "__main__":
    main()
