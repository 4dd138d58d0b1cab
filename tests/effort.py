"""What reading costs without a clock: calls, which grow with the rows where a loop runs over them, and memory."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path


def calls(function: Callable, name: str | None = None) -> int:
    """How many functions, of Python or of C, a call makes; with a name, only those of C so called."""
    count = 0

    def counted(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call") if name is None else event == "c_call" and argument.__name__ == name

    sys.setprofile(counted)
    try:
        function()
    finally:
        sys.setprofile(None)
    return count


_LIMITED = """
import resource, sys
import h5py, openpyxl, pandas, pitp_jax as pitp
pitp.read(sys.argv[2])  # so that what reading loads is there
status = open("/proc/self/status").read()
used = 1024 * int(status.split("VmData:")[1].split()[0])
resource.setrlimit(resource.RLIMIT_DATA, (used + (int(sys.argv[1]) << 20),) * 2)
try:
    print(pitp.read(sys.argv[3])[0].samples, "samples")
except pitp.BadInput as error:
    print(error)
"""


def read_within(mebibytes: int, like: Path, path: Path) -> str:
    """What reading a file says where the process may have that much more memory; MemoryError where that is too little.

    `like`: a small file of the same format, read before the limit is set.
    """
    command = [sys.executable, "-c", _LIMITED, str(mebibytes), str(like), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(__file__).parents[1], check=False)
    said = done.stdout + done.stderr
    if "MemoryError" in said or "allocate" in said:
        raise MemoryError(said.splitlines()[-1])
    assert done.returncode == 0, said
    return done.stdout.strip()
