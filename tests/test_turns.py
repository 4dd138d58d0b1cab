"""Values on a circle: a servo solved by SciPy, its angle and its command wrapped as sensors do."""

import numpy as np
import pytest
from record_files import save_csv
from scipy.signal import lsim

from pitp_jax.files.recordings.reading import read, read_target
from pitp_jax.files.recordings.turns import unwrap

RATE = 100
TIME = np.arange(0, 10, 1 / RATE)
ON = np.clip(TIME - 0.5, 0, None)
COMMANDS = {  # deg
    "sine": 172 + 25 * np.sin(2 * np.pi * 1.1 * ON),
    "levels": 172 + 40 * np.random.default_rng(0).uniform(-1, 1, 30)[(ON / 0.6).astype(int)],
    "two levels": 172 + 30 * np.random.default_rng(1).choice([-1, 1], 60)[(ON / 0.2).astype(int)],
    "turning": 172 + 120 * ON,
}
ACROSS = {  # deg; a joint that really travels back through 0
    "two levels": 172 * np.where(ON % 4 < 2, 1.0, -1.0),
    "levels": np.random.default_rng(2).uniform(-178, 178, 12)[ON.astype(int)],
    "sine": 170 * np.sin(2 * np.pi * 2.2 * ON),
}
FORMS = {  # base unit, its values of a degree, where the circle begins (deg)
    "+-180 deg": ("rad", np.pi / 180, -180),
    "0 to 360 deg": ("rad", np.pi / 180, 0),
    "12 bits": ("counts", 4096 / 360, 0),
    "14 bits, signed": ("counts", 16384 / 360, -180),
}


def servo(command, hertz=2.5):
    w = 2 * np.pi * hertz
    return lsim(([w * w], [1, 0.8 * w, w * w]), command - command[0], TIME)[1] + command[0]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("wrapped", ["output", "both"])
def test_a_joint_that_turns_past_the_seam_is_continued(form, name, wrapped):
    unit, factor, low = FORMS[form]
    command = COMMANDS[name] + low + 180  # the seam lies 8 degrees beyond the middle of the motion
    angle = servo(command) + 0.05 * np.random.default_rng(3).standard_normal(len(TIME))
    if unit == "counts":
        command, angle = (np.floor(v * factor) / factor for v in (command, angle))

    def on_circle(values):
        return (values - low) % 360 + low

    shown = on_circle(command) if wrapped == "both" else command
    found_u, found_y, turns = unwrap(factor * shown, factor * on_circle(angle), (unit, unit))
    for found, truth in ((found_u, command), (found_y, angle)):
        # whole turns of the start are a matter of the zero
        assert np.ptp(found / factor - truth) < 1e-6
    assert turns[1] > 0 and (turns[0] > 0) == (wrapped == "both")


@pytest.mark.parametrize("name", ACROSS)
@pytest.mark.parametrize("gain", [1.0, -1.0, 0.1])
def test_a_joint_that_travels_back_through_zero_is_left(name, gain):
    command = np.deg2rad(ACROSS[name])
    u, y, turns = unwrap(command, gain * servo(command), ("rad", "rad"))
    assert turns == (0, 0) and np.array_equal(u, command) and np.array_equal(y, gain * servo(command))


def test_a_command_alone_is_unwrapped_where_the_output_counts_on():
    command = COMMANDS["turning"]
    u, _, turns = unwrap(np.deg2rad((command + 180) % 360 - 180), np.deg2rad(servo(command)), ("rad", "rad"))
    assert np.ptp(u - np.deg2rad(command)) < 1e-9 and turns[0] == 4


def test_what_lies_on_no_circle_is_left():
    converter = np.clip(np.round(2048 + 4000 * np.sin(2 * np.pi * TIME)), 0, 4095)  # a saturated converter's counts
    assert unwrap(converter, converter, ("counts", "counts"))[2] == (0, 0)
    length = np.deg2rad((COMMANDS["turning"] + 180) % 360 - 180)
    assert unwrap(length, length, ("V", "m"))[2] == (0, 0)


def test_a_file_in_degrees_is_unwrapped_and_says_so(tmp_path):
    command = COMMANDS["sine"]
    angle = (servo(command) + 180) % 360 - 180
    save_csv(tmp_path / "log.csv", {"time_s": TIME, "cmd_deg": command, "angle_deg": angle})
    (record,) = read(tmp_path / "log.csv")
    assert np.allclose(record.displacement, np.deg2rad(servo(command)), atol=1e-6)
    assert any("turns of the output unwrapped" in line for line in record.recognised["remarks"])
    save_csv(tmp_path / "target.csv", {"time_s": TIME, "angle_deg": angle})
    assert np.ptp(read_target(tmp_path / "target.csv").displacement) == pytest.approx(
        np.ptp(np.deg2rad(servo(command)))
    )
