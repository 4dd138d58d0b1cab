"""Compile LLVM text to machine code with llvmlite, and keep the object files beside the programs that JAX keeps.

The key of a file is a hash of the text, of LLVM's version, and of the processor with its features, so a changed step or
another computer never gets an old file. A step that the package's sources determine is found by its identity as well,
without being traced. Where JAX keeps no programs (`--no-cache`, Python without a cache folder), or
the folder cannot be written, the text is compiled again, which takes 0.3 s.
"""

import ctypes
import ctypes.util
import hashlib
import os
import sys
import tempfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax

from .vectors import LIBRARY

_LARGEST = 2**26  # bytes of all object files, above which the least recently used ones are deleted
_engines: list[Any] = []  # machine code lives as long as its engine


@lru_cache(1)
def machine() -> tuple[Any, Any, str]:
    """Return llvmlite's binding, this computer as a target, and the text that names it.

    Raises:
        ImportError: llvmlite is not installed.
        RuntimeError: LLVM does not know this processor, or a function of the C library is missing.
    """
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple().create_target_machine(
        # addresses of 64 bits: constants may lie 2 GB from the code in a large process, where LLVM ended the process
        cpu=processor,
        features=features,
        opt=3,
        reloc="static",
        codemodel="large",
        jit=True,
    )
    _name_functions(llvm)
    known = "large", *map(str, llvm.llvm_version_info), llvm.get_default_triple(), processor, features
    return llvm, target, "\0".join(known)


def _name_functions(llvm) -> None:
    """Give LLVM the addresses of the functions that machine code may call: an unknown name would end the process."""
    if sys.platform == "win32":
        library, stack = ctypes.CDLL("ucrtbase"), ctypes.CDLL("ntdll")
        llvm.add_symbol("__chkstk", ctypes.cast(stack["__chkstk"], ctypes.c_void_p).value)
    else:
        library = ctypes.CDLL(ctypes.util.find_library("m"))
    for name in (*LIBRARY, "floor", "ceil"):
        llvm.add_symbol(name, ctypes.cast(library[name], ctypes.c_void_p).value)


def widest() -> int:
    """Return the number of doubles in a vector register of this processor."""
    features = machine()[2]
    if "+avx512f" in features:
        return 8
    return 4 if "+avx2" in features else 2


def optimised(llvm, target, text: str) -> Any:
    """Return the module of a text after LLVM's optimisations for a target."""
    module = llvm.parse_assembly(text)
    module.verify()
    passes = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(module, passes)
    return module


def address_of(text: str, *, named: str | None = None, outputs: int = 0) -> int:
    """Return the address of the function `run` of a text, from its object file or compiled now.

    `named`: where known, its identity, by which `look_up` finds the object file and the number of outputs again.
    """
    llvm, target, _ = machine()
    name = _hash(text)
    code = _read(f"{name}.o")
    if code is None:
        code = target.emit_object(optimised(llvm, target, text))
        _write(f"{name}.o", code)
    if named is not None:
        _write(f"{_hash(named)}.name", f"{outputs} {name}".encode())
    return _loaded(code)


def look_up(named: str) -> tuple[int, int] | None:
    """Return the number of outputs and the address of a function by its identity; None if no file is known."""
    known = _read(f"{_hash(named)}.name")
    outputs, name = known.decode().split() if known else (0, "")
    code = _read(f"{name}.o") if known else None
    return None if code is None else (int(outputs), _loaded(code))


def _hash(text: str) -> str:
    return hashlib.sha256((machine()[2] + text).encode()).hexdigest()[:40]


def _loaded(code: bytes) -> int:
    """Return the address of the function `run` of an object file."""
    llvm, target, _ = machine()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), target)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _engines.append(engine)
    return engine.get_function_address("run")


def _folder() -> Path | None:
    kept = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    return Path(kept) / "steps" if kept and "://" not in str(kept) else None


def _read(name: str) -> bytes | None:
    """Return a kept file with the hash at its end, if it is whole."""
    folder = _folder()
    if folder is None:
        return None
    path = folder / name
    try:
        data = path.read_bytes()
        os.utime(path)  # used now
    except OSError:
        return None
    code, written = data[:-32], data[-32:]
    return code if hashlib.sha256(code).digest() == written else None


def _write(name: str, code: bytes) -> None:
    """Keep a file whole or not at all; delete the least recently used ones above the limit."""
    folder = _folder()
    if folder is None:
        return
    path = folder / name
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(code + hashlib.sha256(code).digest())
        os.replace(file.name, path)
        files = sorted(((f.stat().st_mtime, f.stat().st_size, f) for f in path.parent.glob("*")), reverse=True)
        total = 0
        for _, size, file in files:
            total += size
            if total > _LARGEST:
                file.unlink(missing_ok=True)
