"""A guard for changes of the diagnosis: practice cases, traps, measured rigs and healthy machines, case by case.

    python experiments/diagnosis_guard.py [--out guard.json] [--shared ../shared] [--only NAME,...] [--keep]

It prints right, tied, unknown or wrong and the CPU seconds of every case (programs are compiled once for all), and
fails where an answer is worse than the one kept in `diagnosis_guard.json`; `--keep` stores this run's answers there.
A finished case is not run again: delete the file of `--out` when the code has changed. Of all scripts only this one
reads what is true of a case, after its diagnosis.

    right    every name and nothing else; `no_gap` for a healthy machine; an honest answer of a trap
    tied     a name is true, or tied with one that is
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from yardstick import ROOT, script

KEPT = Path(__file__).with_suffix(".json")
RIGS = ("xl330_200", "silverbox", "drives", "tanks", "so101_pitch")
HEALTHY = (("cone", "white"), ("cone", "ar"), ("cone", "coarse"), ("roll", "ar98"), ("roll", "average"))
ORDER = ("wrong", "unknown", "tied", "right")
ALIKE = {"relaxation": "creep", "hum": "steady_tone"}  # two names of one cause


def cases(shared: Path) -> dict[str, list[str]]:
    """Return the command of every case that can be run, the long ones first; `{}` is the case's own folder."""
    found: dict[str, list[str]] = {}
    for room in ("gap", "traps", "rigs"):
        folder = shared / room
        if not folder.is_dir():
            print(f"skipped: {room}, because there is no folder {folder}", flush=True)
        elif room == "rigs":
            for name in RIGS:
                command = [str(folder / "score.py"), "--pitp", "{}/pitp", "--only", name, "--json", "{}/found.json"]
                found[f"rigs/{name}"] = command
        else:
            for case in sorted(p.parent for p in folder.glob("*/real")):
                found[f"{room}/{case.name}"] = [__file__, "--case", str(case), "--json", "{}/found.json"]
    for kind, noise in HEALTHY:
        options = ("--none", "1", "--kinds", kind, "--seeds", "61", "--noise", noise, "--results", "{}/rows")
        found[f"healthy/{kind}-{noise}"] = script("withheld_effect", *options)
    return found


def diagnosed(case: Path, out: Path) -> None:
    """Identify a case's clean recordings, diagnose its real ones, and write what a user reads."""
    import pitp_jax as pitp

    found = pitp.diagnose(pitp.identify(pitp.read(case / "clean")).model, pitp.read(case / "real")).as_json()
    out.write_text(json.dumps({k: found[k] for k in ("verdict", "effects", "equivalent", "gap", "budget")}))


def run(command: list[str], programs: Path) -> dict:
    """Run one case in a folder of its own; return what it wrote, or its error, and its CPU seconds."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pitp = folder / "pitp"
        pitp.write_text(f'#!/bin/sh\nPYTHONPATH={ROOT} exec {sys.executable} -m pitp_jax "$@"\n')
        pitp.chmod(0o755)
        environment = os.environ | {
            "PYTHONPATH": f"{ROOT}:{ROOT / 'experiments'}", "OPENBLAS_NUM_THREADS": "1", "TF_CPP_MIN_LOG_LEVEL": "3",
            "JAX_PLATFORMS": "cpu", "JAX_COMPILATION_CACHE_DIR": str(programs),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
        }  # fmt: skip
        words = [word.replace("{}", name) for word in command]
        with (folder / "said").open("w") as said:
            child = subprocess.Popen([sys.executable, *words], cwd=folder, env=environment, stdout=said, stderr=said)
            _, status, used = os.wait4(child.pid, 0)
            child.returncode = os.waitstatus_to_exitcode(status)
        written = [*folder.glob("found.json"), *folder.glob("rows/*.json")]
        told = json.loads(written[0].read_text()) if written else {"failed": (folder / "said").read_text()[-300:]}
        return {"found": told, "cpu_s": round(used.ru_utime + used.ru_stime, 1)}


def judged(name: str, found: dict, shared: Path) -> str:
    """Return how right the answer of a case is, one of ORDER; "failed" without an answer."""
    room, case = name.split("/")
    if room == "rigs":
        row = found.get(case, {})
        if "refused" in row:  # its linear model explains nothing, and says so
            return "unknown"
        return {"-": "unknown"}.get(row["says"], row["says"]) if "says" in row else "failed"
    if "verdict" not in found:
        return "failed"
    said, effects = alike(found["effects"]), found.get("budget", {}).get("effects", {})
    ties = [alike([name, *row["equivalent"]]) for name, row in effects.items()]
    if room == "traps":
        answer = alike([*found["effects"], *found["equivalent"]]) if said else {found["verdict"]}
        honest = json.loads((shared / room / "truth.json").read_text())[case]["honest"]
        if answer in [alike(h.split("+")) for h in honest]:
            return "right"
        return "wrong" if answer != {"unknown"} else "unknown"
    truth = set()
    if room == "gap":
        truth = alike(json.loads((shared / room / "truth.json").read_text())["cases"][case]["effect"].split("+"))
    if truth <= {"none"}:
        return {"no_gap": "right", "unknown": "unknown"}.get(found["verdict"], "wrong")
    if found["verdict"] == "no_gap" or any(not tie & truth for tie in ties) or (said and not said & truth and not ties):
        return "wrong"
    if not said:
        return "unknown"
    return "right" if said == truth and all(len(tie) == 1 for tie in ties) else "tied"


def alike(names) -> set[str]:
    """Return names of causes, with one name for each cause."""
    return {ALIKE.get(name, name) for name in names}


def main() -> None:
    """Run the cases that --out does not hold yet, and compare every answer with the kept one."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("guard.json"), help="results, case by case")
    parser.add_argument("--shared", type=Path, default=ROOT.parent / "shared", help="folder with gap, traps and rigs")
    parser.add_argument("--only", help="beginnings of names, separated by commas, such as gap/creep,traps")
    parser.add_argument("--keep", action="store_true", help="store the answers as those to compare with")
    parser.add_argument("--smoke", action="store_true", help="no case, and the kept answers as a table")
    parser.add_argument("--case", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        diagnosed(options.case, options.json)
        return
    kept = json.loads(KEPT.read_text()) if KEPT.is_file() else {}
    if options.smoke:
        print("\n".join(f"{name}: {answer}" for name, answer in kept.items()))
        return
    shared, done = options.shared.resolve(), json.loads(options.out.read_text()) if options.out.is_file() else {}
    asked = cases(shared)
    if options.only:
        asked = {n: c for n, c in asked.items() if any(n.startswith(o) for o in options.only.split(","))}
    worse = []
    for name, command in asked.items():
        if name not in done:
            done[name] = run(command, options.out.resolve().with_suffix(".programs"))
            options.out.write_text(json.dumps(done, indent=1) + "\n")
        answer, found = judged(name, done[name]["found"], shared), done[name]["found"]
        if ORDER.index(answer) < ORDER.index(kept.get(name, "wrong")) if answer in ORDER else True:
            worse.append(name)
        told = found.get(name.split("/")[1], found)
        words = [told.get("verdict", str(told.get("failed"))), *(told.get("effects") or told.get("names") or ())]
        print(f"{name:46} {answer:8} {done[name]['cpu_s']:7.1f} CPU s  {' '.join(map(str, words))}", flush=True)
        kept |= {name: answer} if options.keep else {}
    answers = Counter(judged(n, done[n]["found"], shared) for n in asked)
    print(", ".join(f"{answers[a]} {a}" for a in (*ORDER[::-1], "failed")), f"of {len(asked)}")
    if options.keep:
        KEPT.write_text(json.dumps(dict(sorted(kept.items())), indent=1) + "\n")
    if worse:
        sys.exit(f"worse than {KEPT.name}: {', '.join(worse)}")


if __name__ == "__main__":
    main()
