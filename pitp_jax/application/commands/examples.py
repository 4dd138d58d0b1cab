"""Write the end of every command's help: two examples with files of `pitp demo --quick`, and a page to read."""

EXAMPLES = {
    "demo": ("pitp demo --quick", "pitp demo --plant roll --out roll"),
    "check": ("pitp check demo/records", "pitp check demo/held_out --out checked"),
    "plan": (
        "pitp plan --max-voltage 6000 --band 0.5 10 --out session",
        "pitp plan demo/nominal.pitp --max-displacement 3 --out session_2",
    ),
    "identify": (
        "pitp identify demo/records/sweep.csv --out nominal.pitp",
        "pitp identify demo/records/sweep.csv --order 2 --learn delay --out nominal.pitp --json orders.json",
    ),
    "fit": (
        "pitp fit demo/records --out model.pitp",
        "pitp fit demo/records --nominal demo/nominal.pitp --learn delay --out model.pitp",
    ),
    "predict": (
        "pitp predict demo/model.pitp demo/held_out",
        "pitp predict demo/nominal.pitp demo/records/sweep.csv --out predicted --json scores.json",
    ),
    "simulate": (
        "pitp simulate demo/model.pitp demo/held_out/triangle.csv",
        "pitp simulate demo/nominal.pitp demo/held_out --out simulated --json ranges.json",
    ),
    "invert": (
        "pitp invert demo/model.pitp demo/target.csv --out voltage.csv",
        "pitp invert demo/model.pitp demo/target.csv --out voltage.csv --max-voltage 4500 --max-slew 2e5 --rate 2000",
    ),
    "diagnose": (
        "pitp diagnose demo/held_out --nominal demo/model.pitp",
        "pitp diagnose demo/robot --against demo/sim --position-gain 20 --out gap",
    ),
    "verify": (
        "pitp verify demo/robot --mjcf demo/joint.xml --joint elbow --out check",
        "pitp verify demo/robot/chirp.csv --mjcf demo/joint.xml --joint elbow --held-out demo/robot/steps.csv",
    ),
    "adapt": (
        "pitp adapt demo/model.pitp demo/held_out/complex.csv --out today.pitp",
        "pitp adapt demo/nominal.pitp demo/held_out/triangle.csv --out today.pitp --json changed.json",
    ),
    "export": (
        "pitp export demo/model.pitp --to c --out rig_c",
        "pitp export demo/nominal.pitp --to matlab --out rig_matlab --name cone",
    ),
    "compare": (
        "pitp compare demo/nominal.pitp demo/model.pitp",
        "pitp compare demo/records/sweep.csv demo/records --out compared --json differences.json",
    ),
    "info": ("pitp info demo/model.pitp", "pitp info demo/nominal.pitp --json nominal.json"),
}


def ending(command: str) -> str:
    """Return the text below a command's options: examples and a page to read."""
    page = {
        "plan": "which_recordings",
        "diagnose": "my_rig_disagrees",
        **dict.fromkeys(("check", "adapt", "compare"), "another_day"),
        "export": "to_the_rig",
        "verify": "i_have_a_simulator",
    }.get(command, "start")
    return "\n".join(["examples:", *(f"  {line}" for line in EXAMPLES[command]), "", f"more: docs/{page}.md"])
