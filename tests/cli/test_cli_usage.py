"""The command line itself: usage errors, help, version, and what it imports."""

import os
import shlex
import subprocess
import sys
import tomllib

import numpy as np
import pytest
from cli_cases import refused

import pitp_jax
from pitp_jax.application.commands.main import _parser
from pitp_jax.common.errors import BadInput


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["frobnicate"],
        ["identify"],
        ["identify", "x"],
        ["identify", "x", "--out", "y", "--order", "7"],
        ["identify", "x", "--out", "y", "--order", "0"],
        ["identify", "x", "--out", "y", "--order", "two"],
        ["identify", "x", "--out", "y", "--input-map", "cubic"],
        ["fit", "x", "--out", "y", "--seed", "-1"],
        ["fit", "x", "--out", "y", "--seed", "1.5"],
        ["fit", "x", "--out", "y", "--preset", "best"],
        ["fit", "x", "--out", "y", "--ord", "2"],
        ["predict", "m"],
        ["invert", "m", "t"],
        ["invert", "m", "t", "--out", "v", "--max-voltage", "0"],
        ["invert", "m", "t", "--out", "v", "--max-voltage", "nan"],
        ["invert", "m", "t", "--out", "v", "--max-voltage", "inf"],
        ["invert", "m", "t", "--out", "v", "--max-slew", "-5"],
        ["invert", "m", "t", "--out", "v", "--input-column", "voltage_V"],
        ["demo", "--plant", "sphere"],
        ["info"],
    ],
)
def test_usage_errors(call, argv):
    assert "--help" in refused(call(*argv))


LISTS = {"--each", "--learn", "--validate", "--against", "--join", "--joint", "--held-out"}


def test_an_option_given_twice_is_refused_or_a_list():
    """Of all options of all commands, whatever synonym is taken; a list grows."""
    (commands,) = (a.choices for a in _parser()._actions if isinstance(a.choices, dict))
    options = [
        (parser, a) for parser in commands.values() for a in parser._actions if a.option_strings and a.nargs != 0
    ]
    assert len(options) > 150
    for parser, action in options:
        first, *_, last = [*action.option_strings] * 2
        values = [str(next(iter(action.choices or "1")))] * (action.nargs if isinstance(action.nargs, int) else 1)
        if first not in LISTS:
            with pytest.raises(BadInput, match="given twice"):
                parser.parse_args([first, *values, last, *values])
    said = _parser().parse_args("identify a --out m --validate b --validate c d".split())
    assert said.validate == ["b", "c", "d"]
    said = _parser().parse_args("diagnose a --against b --against c".split())
    assert said.against == ["b", "c"]


def test_two_inputs_are_refused_with_a_command_that_names_one(call, tmp_path):
    path = machine_log(tmp_path / "log.csv", "time_s,left_kV,angle_deg")
    twice = ["--input-column", "left_kV", "--input-column", "angle_deg"]
    assert "one input" in refused(call("identify", path, "--out", tmp_path / "m", *twice))
    line = refused(call("identify", path, "--out", tmp_path / "m", "--input-column", "left_kV,angle_deg"))
    assert "one input" in line
    proposed = shlex.split(line.rpartition("; try: pitp ")[2])
    assert proposed[proposed.index("--input-column") + 1 :] == ["left_kV", "--output-column", "angle_deg"]


@pytest.mark.parametrize("command", [[], ["plan"], ["identify"], ["fit"], ["predict"], ["invert"], ["info"], ["demo"]])
def test_help(call, command):
    code, out, err = call(*command, "--help")
    assert code == 0
    assert out.startswith("usage: pitp")
    assert err == ""


def test_version(call):
    assert call("--version")[:2] == (0, f"pitp {pitp_jax.__version__}\n")


def test_the_parser_needs_no_jax():
    code = (
        "import sys\n"
        "from pitp_jax.application.commands.main import main\n"
        "assert main(['--help']) == 0 and main(['fit']) == 2\n"
        "heavy = {'jax', 'numpy', 'scipy', 'equinox', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


@pytest.mark.parametrize(
    ("command", "idle"),
    [("info", "pandas scipy.signal scipy.optimize optimistix"), ("predict", "scipy.signal scipy.optimize optimistix")],
)
def test_a_command_loads_nothing_that_it_does_not_use(command, idle):
    """What identifies comes with the commands that fit: it was a third of all that a prediction loaded."""
    code = (
        f"import sys, pitp_jax.application.commands.{command}; print([m for m in {idle.split()} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"


@pytest.mark.slow
def test_module_is_the_program_and_a_closed_pipe_is_quiet(bench):
    command = f"set -o pipefail; '{sys.executable}' -m pitp_jax info '{bench / 'nominal'}' | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_standard_output_on_a_full_disk(bench):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "pitp_jax", "info", str(bench / "nominal")]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("pitp: error: ")


@pytest.mark.slow
def test_compiled_programs_are_kept_unless_told_otherwise(bench, tmp_path):
    """In the user's cache folder, by a process that starts without JAX; a second one adds nothing and says no more."""
    ours = ("JAX_COMPILATION_CACHE", "JAX_PERSISTENT_CACHE", "TF_CPP_MIN_LOG_LEVEL")
    home = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    home |= dict.fromkeys(("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"), str(tmp_path))
    command = [sys.executable, "-m", "pitp_jax", "predict", str(bench / "nominal"), str(bench / "records")]

    def kept(*options):
        done = subprocess.run([*command, *options], env=home, check=True, capture_output=True, text=True)
        assert all(line.startswith("pitp: ") for line in done.stderr.splitlines()), done.stderr
        return {p.name for p in tmp_path.rglob("*-cache")}

    assert kept("--no-cache") == set()
    first = kept()
    assert first
    assert kept() == first


def machine_log(path, header):
    rows = [f"{k / 100},{np.sin(k / 9):.6f},{np.cos(k / 9):.6f}" for k in range(200)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        ("time_s,ctrl [rad],qpos [rad]", ("ctrl", "qpos")),
        ("time_s,qvel_rad/s,ctrl [rad]", ("ctrl", "qvel")),
        ("time_s,action [rad],joint_pos [rad]", ("action", "joint_pos")),
        ("t [s],command_m,position_m", ("command", "pos")),
        ("time_s,qfrc_applied [N m],qpos [rad]", ("qfrc_applied", "qpos")),
        ("time_s,target_rad,qpos_rad", ("target", "qpos")),
        ("time_s,cmd_rad,qpos_rad", ("cmd", "qpos")),
    ],
)
def test_names_of_simulators_are_columns(tmp_path, header, columns):
    (record,) = pitp_jax.read(machine_log(tmp_path / "log.csv", header))
    assert columns[0] in record.recognised["input"] and columns[1] in record.recognised["output"]


def test_a_proposed_command_is_of_the_command_that_was_run(call, tmp_path):
    """Run as it is proposed, it gets past the refusal."""
    path = machine_log(tmp_path / "log.csv", "time_s,left_rad,right_rad")
    argv = ["identify", path, "--out", tmp_path / "m", "--order", "1", "--input-map", "linear"]
    line = refused(call(*argv))
    proposed = shlex.split(line.rpartition("; try: pitp ")[2])
    assert proposed[: len(argv)] == [str(a) for a in argv] and "--input-column" in proposed
    assert "--input-column" not in call(*proposed)[2].rpartition("; try: ")[2]


def test_a_command_is_proposed_before_a_current(call, tmp_path):
    path = machine_log(tmp_path / "log.csv", "time_s,present_current_mA,goal_position")
    table = path.read_text().splitlines()
    path.write_text("\n".join([f"{table[0]},present_position"] + [f"{row},{k % 7}" for k, row in enumerate(table[1:])]))
    assert "--input-column goal_position" in refused(call("check", path)).rpartition("; try: pitp check ")[2]


def test_of_files_of_two_kinds_a_pitp_toml_is_proposed(call, tmp_path):
    machine_log(tmp_path / "good.csv", "time_s,command_rad,angle_rad")
    machine_log(tmp_path / "log.csv", "time_s,left_rad,right_rad")
    line = refused(call("identify", tmp_path, "--out", tmp_path / "m"))
    _, mark, proposed = line.partition(f"; write into {tmp_path / 'pitp.toml'}: ")
    assert mark
    (tmp_path / "pitp.toml").write_text("\n".join(['["log.csv"]', *tomllib_lines(proposed)]))
    assert len(pitp_jax.read(tmp_path)) == 2


def tomllib_lines(proposed):
    """The entry that a refusal proposes, as lines of a table."""
    return [f'{key} = "{value}"' for key, value in tomllib.loads(proposed.strip())["log.csv"].items()]


def test_for_one_of_two_sets_a_pitp_toml_is_proposed(call, tmp_path):
    sim, robot = tmp_path / "sim", tmp_path / "robot"
    sim.mkdir()
    robot.mkdir()
    machine_log(sim / "log.csv", "time_s,left_rad,right_rad")
    machine_log(robot / "log.csv", "time_s,command_rad,angle_rad")
    line = refused(call("compare", sim, robot))
    _, mark, proposed = line.partition(f"; write into {sim / 'pitp.toml'}: ")
    assert mark and "pitp check" not in line
    assert "input-column" in tomllib.loads(proposed.strip())["*"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--nominal m.pitp --mjcf arm.xml --joint q --out gap", "--mjcf only works with --against"),
        ("--against sim --mjcf arm.xml --joint q", "--mjcf only works with --against and --out DIR"),
        ("--against sim --joint q", "--joint and --actuator only work with --mjcf XML"),
        ("--against sim --mjcf gone.xml --joint q --out gap", "gone.xml: No such file"),
    ],
)
def test_a_mujoco_file_needs_its_options(options, words, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = refused(call("diagnose", "robot", *options.split()))
    assert words in line
