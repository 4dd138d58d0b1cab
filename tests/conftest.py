"""How the suite runs: kept programs, equal draws, little memory. What its files share is in `common_fixtures.py`."""

import ctypes
import gc
import os
from importlib.metadata import version
from pathlib import Path

import pytest
from hypothesis import settings
from packaging.version import Version

# Programs that take long to compile are shared among the suite's processes, and kept for the next run of it.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "programs"))
os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(2**31))  # with a limit, processes lock the folder
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the suite's processes share the cores already
_RESIDENT_MB, _MAPPINGS = 1_150, 20_000  # of a process, beyond which its programs are dropped

# Two runs of the suite draw the same examples; HYPOTHESIS_DRAWS=fresh looks for new ones.
settings.register_profile("same", derandomize=True)
settings.register_profile("fresh", print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_DRAWS", "same"))


def pytest_configure(config):
    """Load the package, except in the process that only deals out the tests (`-n`).

    The default suite mostly compiles, so it does without most optimisations of XLA and LLVM; `-m slow` has what users
    have, and so do the tests of the machine code itself (`code_of_users`).
    """
    if config.getoption("dist", "no") != "no" and not hasattr(config, "workerinput"):
        return
    short = config.getoption("markexpr") == "not slow and not exhaustive"
    if short and Version(version("jaxlib")) < Version("0.10"):
        # the older emitters compile the same programs in two thirds of the time; later releases have them no more
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_use_fusion_emitters=false"
    gc.disable()  # 3 s of collecting while modules load, which make no garbage
    config.pluginmanager.import_plugin("common_fixtures")
    import jax

    jax.config.update("jax_disable_most_optimizations", short)
    if short:
        import common_fixtures

        common_fixtures.compile_quickly()


def pytest_collection_finish():
    gc.freeze()  # modules stay: no later collection looks through them
    gc.set_threshold(20_000, 10, 20)  # 6 of 100 s were spent on collecting every 2,000 (700 before Python 3.13) objects
    gc.enable()


@pytest.fixture(scope="module", autouse=True)
def _few_programs():
    """Compiled programs are dropped after a file, before the process grows beyond 1.5 GB or out of memory mappings.

    Linux allows 65,530, a program takes about eight, and XLA crashes where it gets no more (`execution_engine.cc: LLVM
    compilation error: Cannot allocate memory`): two processes that share the suite came to that after 1,800 tests.
    Freed memory goes back to the system by `malloc_trim` alone.
    """
    yield
    status, maps = Path("/proc/self/statm"), Path("/proc/self/maps")
    if not status.exists():
        return
    resident = int(status.read_text().split()[1]) * os.sysconf("SC_PAGESIZE") / 2**20
    if resident < _RESIDENT_MB and maps.read_bytes().count(b"\n") < _MAPPINGS:
        return
    import equinox as eqx
    import jax

    eqx.clear_caches()
    jax.clear_caches()
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # of the GNU library
    if trim is not None:
        trim(0)
