"""Mutated record files and model files: each is read, or refused in one line; never a traceback, a hang or a flood.

    python -m experiments.fuzz_files [--count 10000] [--models 1000] [--seed 0] [--resume FILE]

Bytes, lines, cells, columns, archives and nested objects are mutated, of small files in every format; model files get
new numbers under a valid seal. A case fails by any exception but BadInput, by a message with control characters, by 5 s
of computing, or by 256 MiB of memory beyond the start of its process. Cases run in child processes: a crash is one too.
"""

import argparse
import gzip
import hashlib
import io
import json
import multiprocessing
import os
import re
import resource
import struct
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import scipy.io

from pitp_jax import BadInput, read

SECONDS, BYTES, BATCH = 5.0, 256 << 20, 250
NASTY = (
    "", "nan", "inf", "-inf", "1e400", "1e-400", "1e308", "-0", "0x10", "1_000", "1,5", "1.5.2", "--", "NaN", "None",
    "\x1b[2J", "$\\frac{", "=1+1", "9" * 400, "2026-11-23 10:00:00", "10:00", "µ", "\u202e", '"', "'", "#",
    "%", "\\", ";",
)  # fmt: skip
Table = dict[str, np.ndarray]


def table(rng: np.random.Generator) -> Table:
    """A small record."""
    count = int(rng.choice([10, 64, 300, 2000]))
    t = np.arange(count) / 1000
    return {
        "time_s": t,
        "voltage_V": 1000 + 500 * np.sin(9 * t),
        "displacement_mm": np.sin(9 * t) + 1e-3 * rng.normal(size=count),
    }


def text(rng: np.random.Generator, values: Table) -> bytes:
    """It as text, in some dialect, its cells and lines mutated."""
    separator, decimal = [(",", "."), (";", ","), ("\t", "."), (" ", "."), (";", "."), ("|", ".")][rng.integers(6)]
    rows = [list(values)] + [
        [f"{v:.6g}".replace(".", decimal) for v in row] for row in zip(*values.values(), strict=True)
    ]
    for _ in range(rng.integers(0, 3)):
        mutate_cells(rng, rows)
    lines = [separator.join(row) for row in rows]
    for _ in range(max(rng.integers(-3, 3), 0)):
        k = int(rng.integers(len(lines)))
        change = rng.integers(6)
        if change == 0:
            lines.insert(k, "# " + NASTY[rng.integers(len(NASTY))])
        elif change == 1:
            lines.insert(k, "")
        elif change == 2:
            lines[k] = lines[k][: rng.integers(len(lines[k]) + 1)]
        elif change == 3:
            lines[k : k + 1] = [lines[k]] * int(rng.integers(0, 50))
        elif change == 4:
            lines[k] += separator * int(rng.integers(1, 9))
        else:
            lines[k] = separator.join([NASTY[rng.integers(len(NASTY))]] * int(rng.choice([1, 3, 3000, 100_000])))
        lines = lines or [""]
    end = ["\n", "\r\n", "\r"][rng.integers(3)]
    encoding = ["utf-8", "utf-8-sig", "utf-16", "latin-1", "utf-16-le"][rng.integers(5)]
    return end.join(lines).encode(encoding, "replace")


def mutate_cells(rng: np.random.Generator, rows: list[list[str]]) -> None:
    """One change of cells or columns, in place."""
    kind, column = rng.integers(6), int(rng.integers(3))
    if kind == 0:
        row = rows[rng.integers(len(rows))]
        row[rng.integers(len(row))] = NASTY[rng.integers(len(NASTY))]
    elif kind == 1:
        rows[0][min(column, len(rows[0]) - 1)] = NASTY[rng.integers(len(NASTY))]
    elif kind == 2:
        for row in rows:
            row.append(row[column % len(row)])
    elif kind == 3:
        for row in rows:
            row[:] = [cell for k, cell in enumerate(row) if k != column] or [""]
    elif kind == 4:
        value = NASTY[rng.integers(len(NASTY))]
        for row in rows[1:]:
            row[column % len(row)] = value
    else:
        for row in rows[rng.integers(len(rows)) :]:
            row[column % len(row)] += "e9"


def h5(rng: np.random.Generator, values: Table) -> bytes:
    """HDF5 with groups, links, odd types."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        place = file.create_group("a") if rng.random() < 0.4 else file
        for name, column in values.items():
            place[name] = column
        change = rng.integers(9)
        if change == 0:
            file["soft"] = h5py.SoftLink("/soft")
        elif change == 1:
            file["out"] = h5py.ExternalLink("/etc/passwd", "/x")
        elif change == 2:
            deep = file
            for _ in range(100):
                deep = deep.create_group("g")
            deep["back"] = file["/"]
        elif change == 3:
            file.create_dataset("huge_V", shape=(1 << 40,), chunks=(1 << 20,), dtype="f8", compression="gzip")
        elif change == 4:
            del place["voltage_V"]
            place.create_dataset("voltage_V", shape=(1 << 33,), chunks=(1 << 16,), dtype="f8", compression="gzip")
        elif change == 5:
            file["text"] = np.array([b"a"] * 9)
            place["time_s"].attrs["unit"] = [1, 2]
        elif change == 6:
            for k in range(5000):
                file.create_group(f"x{k}")
    return buffer.getvalue()


def npz(rng: np.random.Generator, values: Table) -> bytes:
    """NumPy archives: objects, headers that lie, members that unfold to much."""
    buffer, values = io.BytesIO(), dict(values)
    change = rng.integers(6)
    if change == 0:
        values["voltage_V"] = np.array([{}, []], dtype=object)
    if change == 1:
        values["displacement_mm"] = np.zeros((3, 4, 5))
    (np.savez_compressed if rng.random() < 0.5 else np.savez)(buffer, **values)  # pyright: ignore[reportArgumentType]
    if change >= 2:
        with zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED) as archive:
            if change == 2:
                archive.writestr("huge_V.npy", b"\0" * (64 << 20))
            elif change == 3:
                shape = str((1 << int(rng.integers(1, 62)),) * int(rng.integers(1, 4))).encode()
                head = b"{'descr': '<f8', 'fortran_order': False, 'shape': " + shape + b", }"
                head = head.ljust(118) + b"\n"
                archive.writestr("time_ms.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
            elif change == 4:
                archive.writestr("time_us.npy", rng.bytes(200))
    return buffer.getvalue()


def mat(rng: np.random.Generator, values: Table) -> bytes:
    """MATLAB files: structs, cells in cells."""
    buffer, change = io.BytesIO(), rng.integers(5)
    inside: dict = {name: column.reshape(-1, 1) for name, column in values.items()}
    if change == 0:
        inside = {"data": {**inside, "units": "s, V, mm"}}
    elif change == 1:
        nested = np.zeros(1)
        for _ in range(int(rng.choice([2, 50, 400]))):
            outer = np.empty(1, dtype=object)
            outer[0] = nested
            nested = outer
        inside["nested"] = nested
    elif change == 3 and rng.random() < 0.3:
        return nested_cells(int(rng.choice([3, 10, 20_000])))
    elif change == 2:
        inside = {"a": dict(inside), "b": dict(inside), "c": np.full((3, 3), "x", dtype=object)}
    scipy.io.savemat(buffer, inside, do_compression=bool(rng.integers(2)))
    return buffer.getvalue()


def nested_cells(depth: int) -> bytes:
    """A MATLAB file of cells in cells, which scipy's writer would not survive."""
    element = b""
    for _ in range(depth):
        flags = struct.pack("<IIII", 6, 8, 1, 0)
        dims = struct.pack("<IIII", 5, 8, 1, 1)
        name = struct.pack("<II", 1, 0)
        body = flags + dims + name + element
        element = struct.pack("<II", 14, len(body)) + body
        if len(element) > 8 << 20:
            break
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + element


def xlsx(rng: np.random.Generator, values: Table) -> bytes:
    """A workbook whose parts are mutated and zipped again."""
    import openpyxl

    book, buffer = openpyxl.Workbook(write_only=True), io.BytesIO()
    sheet = book.create_sheet("a")
    rows = [list(values), *zip(*values.values(), strict=True)][:300]
    for row in rows:
        sheet.append(
            [v if rng.random() > 0.001 else NASTY[3] for v in map(lambda c: c if isinstance(c, str) else float(c), row)]
        )
    book.save(buffer)
    old, fresh = zipfile.ZipFile(buffer), io.BytesIO()
    part = str(rng.choice(old.namelist()))
    with zipfile.ZipFile(fresh, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in old.namelist():
            data = old.read(name)
            if name == part and rng.random() < 0.5:
                data = flip(rng, data)
            if name.startswith("xl/worksheets") and rng.random() < 0.3:
                cell = str(rng.choice(["XFD1048576", "A999999999999", "ZZZZZ1", "$", "B0"]))
                data = re.sub(rb'r="B\d+"', b'r="' + cell.encode() + b'"', data, count=int(rng.integers(1, 4)))
            if rng.random() < 0.02:
                data = b'<!DOCTYPE a [<!ENTITY a "' + b"a" * 999 + b'">' + b"".join(
                    b'<!ENTITY a%d "%s">' % (k, (b"&a%d;" % (k - 1) if k else b"&a;") * 20) for k in range(8)
                ) + b"]><a>&a7;</a>"  # fmt: skip
            archive.writestr(name, data)
    return fresh.getvalue()


def flip(rng: np.random.Generator, data: bytes) -> bytes:
    """Bytes flipped, cut, doubled or made up."""
    made = bytearray(data)
    for _ in range(int(rng.choice([0, 0, 0, 0, 1, 2, 50]))):
        if not made:
            break
        at, change = int(rng.integers(len(made))), rng.integers(6)
        if change < 3:
            made[at] = int(rng.integers(256))
        elif change == 3:
            del made[at : at + int(rng.integers(1, 40))]
        elif change == 4:
            made[at:at] = rng.bytes(int(rng.integers(1, 40)))
        elif rng.random() < 0.2:
            del made[at:]
    return bytes(made)


def archived(rng: np.random.Generator, data: bytes) -> bytes:
    """Compressed once, twice, or a bomb."""
    change = rng.integers(12)
    if change == 0:
        return gzip.compress(gzip.compress(data))
    if change == 1:
        return gzip.compress(b"1,2,3\n" * int(rng.choice([10_000, 5_000_000])))
    if change == 2:
        return gzip.compress(data)[: int(rng.integers(10, 200))]
    if change == 3:
        return gzip.compress(data) * int(rng.integers(2, 5)) + b"\0" * 100
    return gzip.compress(data)


WRITERS: dict[str, Callable[[np.random.Generator, Table], bytes]] = {
    ".csv": text, ".txt": text, ".dat": text, ".tsv": text, ".lvm": text, ".csv.gz": text, ".h5": h5, ".npz": npz,
    ".mat": mat, ".xlsx": xlsx,
}  # fmt: skip


def record_case(seed: int, folder: Path) -> Path:
    """One mutated record file."""
    rng = np.random.default_rng(seed)
    suffix = str(rng.choice(list(WRITERS)))
    data = WRITERS[suffix](rng, table(rng))
    if suffix.endswith(".gz"):
        data = archived(rng, data)
    if suffix != ".xlsx" or rng.random() < 0.2:
        data = flip(rng, data)
    if rng.random() < 0.03:
        suffix = str(rng.choice(list(WRITERS)))
    path = folder / f"{rng.choice(['a', 'b$', 'c' + chr(27) + '[2J'])}{seed}{suffix}"
    path.write_bytes(data)
    return path


def model_case(seed: int, folder: Path, whole: list[bytes]) -> Path:
    """One mutated model file, its seal right in most."""
    rng = np.random.default_rng(seed)
    magic, _, rest = whole[rng.integers(len(whole))].split(b"\n", 2)
    header, end = json.JSONDecoder().raw_decode(rest.decode("latin-1"))
    arrays = rest[end + 1 :]
    for _ in range(int(rng.choice([0, 1, 1, 2, 4]))):
        mutate_json(rng, header)
    if rng.random() < 0.03:
        header["effects"] = [{"name": "coulomb_friction_tanh"}] * 100_000
    body = json.dumps(header).encode() + b"\n" + (flip(rng, arrays) if rng.random() < 0.4 else arrays)
    if rng.random() < 0.2:
        body = flip(rng, body)
    seal = hashlib.sha256(body).hexdigest().encode()
    data = magic + b"\nsha256 " + seal + b"\n" + body
    path = folder / f"model{seed}"
    path.write_bytes(flip(rng, data) if rng.random() < 0.1 else data)
    return path


def mutate_json(rng: np.random.Generator, value) -> None:
    """One entry somewhere in it replaced."""
    odd = (
        0,
        -1,
        1e300,
        {"float": "nan"},
        {"float": "inf"},
        None,
        "x",
        [],
        {},
        True,
        10**30,
        4096,
        -0.0,
        [[[]]],
        1e-300,
    )
    while isinstance(value, (dict, list)) and value:
        key = list(value)[rng.integers(len(value))] if isinstance(value, dict) else int(rng.integers(len(value)))
        inner = value[key]
        if not (isinstance(inner, (dict, list)) and inner) or rng.random() < 0.2:
            if rng.random() < 0.1:
                del value[key]
            else:
                value[key] = odd[rng.integers(len(odd))]
            return
        value = inner


def _batch(kind: str, seeds: range, folder: str, queue) -> None:
    """Run cases in this process and report the failed ones."""
    from pitp_jax import load

    whole = [path.read_bytes() for path in sorted(Path(folder, "models").iterdir())]
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in seeds:
        queue.put(("begins", seed, ""))
        path = record_case(seed, Path(folder)) if kind == "record" else model_case(seed, Path(folder), whole)
        begun, outcome = time.process_time(), "read"
        try:
            (read if kind == "record" else load)(path)
        except BadInput as error:
            outcome = "refused"
            if re.search(r"[\x00-\x1f\x7f-\x9f]", str(error)):
                queue.put(("failed", seed, f"control characters in {str(error)!r}"))
        except BaseException as error:  # what the command line would call unexpected
            queue.put(("failed", seed, f"{path.name}: {type(error).__name__}: {str(error)[:200]}"))
        used = time.process_time() - begun
        grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start)
        if used > SECONDS:
            queue.put(("failed", seed, f"{path.name}: {used:.1f} s"))
        if grown > BYTES:
            queue.put(("failed", seed, f"{path.name}: {grown >> 20} MiB"))
            start += grown // 1024
        queue.put((outcome, seed, used))
        path.unlink()


def run(kind: str, count: int, seed: int, folder: str, done: Path | None) -> int:
    """All cases of a kind, a batch a process; the number that failed. Batches named in the file `done` are skipped."""
    tally = dict.fromkeys(("read", "refused", "failed", "slowest"), 0)
    known = {} if done is None or not done.exists() else json.loads(done.read_text())
    for begin in range(seed, seed + count, BATCH):
        name = f"{kind} {begin} to {min(begin + BATCH, seed + count) - 1}"
        known[name] = known.get(name) or _in_a_child(kind, range(begin, min(begin + BATCH, seed + count)), folder)
        if done is not None:
            done.write_text(json.dumps(known, indent=1))
        for word, value in known[name].items():
            tally[word] = max(tally[word], value) if word == "slowest" else tally[word] + value
    told = f"{tally['read']} read, {tally['refused']} refused, {tally['failed']} failed"
    print(f"{kind} files: {count} cases, {told}, slowest {tally['slowest']:.2f} s")
    return tally["failed"]


def _in_a_child(kind: str, seeds: range, folder: str) -> dict:
    """Counts of a batch of cases; one that ends its process is a failure, and the others go on in another."""
    context, current, tally = multiprocessing.get_context("spawn"), seeds.start, {"read": 0, "refused": 0}
    failed, slowest = 0, 0.0
    while current < seeds.stop:
        queue = context.Queue()
        child = context.Process(target=_batch, args=(kind, range(current, seeds.stop), folder, queue))
        child.start()
        while child.is_alive() or not queue.empty():
            try:
                word, at, told = queue.get(timeout=1.0)
            except Exception:  # nothing yet
                continue
            current = at
            if word == "failed":
                failed += 1
                print(f"{kind} {at}: {told}", flush=True)
            elif word in tally:
                tally[word] += 1
                slowest = max(slowest, told)
        child.join()
        if child.exitcode:
            failed += 1
            print(f"{kind} {current}: the process ended with {child.exitcode}", flush=True)
        current = current + 1 if child.exitcode else seeds.stop
    return {**tally, "failed": failed, "slowest": slowest}


def _models(folder: Path) -> None:
    """Whole model files to mutate."""
    import jax
    import jax.numpy as jnp

    from pitp_jax import save
    from pitp_jax.method.effects import CATALOGUE
    from pitp_jax.method.model.domain import Domain
    from pitp_jax.method.model.encoder import CompactEncoder, ConstantEncoder
    from pitp_jax.method.model.input_map import SquareInput
    from pitp_jax.method.model.memory import FadingMemory, NoMemory
    from pitp_jax.method.model.model import Model, Output, Scales

    folder.mkdir()
    for name, encoder, memory, effects in (
        ("nominal", ConstantEncoder(4), NoMemory(), ()),
        ("effects", ConstantEncoder(4), NoMemory(), tuple(effect.neutral() for effect in CATALOGUE[:3])),
        ("trained", CompactEncoder(2, 2, width=4, key=jax.random.key(0)), FadingMemory(jnp.arange(2.0)), ()),
    ):
        shown = Domain(1e-3, (0.0, 3e3), 1e5, ((-1.0, 1.0),) * 2)
        scales = Scales((1e-3, 3e-2, 1.0), 1e6)
        save(
            folder / name,
            Model(jnp.ones(3), SquareInput(), encoder, memory, Output(), scales, domain=shown, effects=effects),
        )


def main() -> int:
    """Fuzz, print a line per failure and a summary; 1 where a case failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=10_000, help="record files")
    parser.add_argument("--models", type=int, default=1_000, help="model files")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--resume", type=Path, metavar="FILE", help="of the batches done: they are not run again")
    parser.add_argument("--smoke", action="store_true", help="quick and meaningless")
    options = parser.parse_args()
    if options.smoke:
        options.count, options.models = 20, 5
    with tempfile.TemporaryDirectory() as folder:
        _models(Path(folder, "models"))
        counts = {"record": options.count, "model": options.models}
        failed = sum(run(kind, count, options.seed, folder, options.resume) for kind, count in counts.items())
    return int(failed > 0)


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    sys.exit(main())
