"""Errors for requests that cannot be served; the command line turns them into exit codes 2 and 3.

A message may quote text from a file: `cleaned` removes the control characters that a terminal would execute.
"""

import sys
import unicodedata


class BadInput(ValueError):
    """Bad input or usage; the message is one line with the file, the place and the remedy (exit code 2)."""


class ComputationFailed(RuntimeError):
    """A failed computation, such as a diverged simulation; the message is one line with advice (exit code 3)."""


def refuse_if(*checks: tuple[object, str]) -> None:
    """Refuse a request with the message of the first check (condition, message) whose condition holds.

    Raises:
        BadInput: with that message.
    """
    for wrong, message in checks:
        if wrong:
            raise BadInput(message)


def refuse_traced(name: str, instead: str, *values: object) -> None:
    """Refuse values that JAX traces, because the function `name` runs on the host only.

    Raises:
        BadInput: with the function to use under jit, vmap and grad.
    """
    jax = sys.modules.get("jax")  # if JAX is not loaded, nothing is traced
    traced = jax is not None and any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))
    refuse_if((traced, f"{name} cannot be traced by jit, vmap or grad; use {instead} instead"))


def cleaned(text: object) -> str:
    """Replace control and format characters in a text by `_`, because a terminal or page would obey them."""
    return "".join("_" if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp") else c for c in str(text))
