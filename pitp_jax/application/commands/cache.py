"""Keep compiled programs in the user's cache folder, so that a second `pitp predict` compiles nothing."""

import os
import platform
import sys
from pathlib import Path

from platformdirs import user_cache_dir


def keep_programs(shortest: float) -> None:
    """Choose the folder in which JAX keeps compiled programs; environment variables take precedence.

    Each computer has its own folder, because a home folder may be shared and programs are specific to a processor.
    Programs that compile in less than `shortest` seconds are not kept.
    """
    if "jax" in sys.modules:
        return
    # JAX 0.9 prints several kilobytes for every kept program that it loads: compiler preferences (+prefer-no-gather)
    # that the processor does not list. Errors are still raised.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    folder = Path(user_cache_dir("pitp_jax", appauthor=False)) / "programs" / (platform.node() or "here")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # no place to keep them: compile again
        return
    if not os.access(folder, os.W_OK):
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    # bytes; above it the least recently used programs are deleted
    os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(2**30))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", str(shortest))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
