"""Sizes of the rows. A smoke run takes small ones: quick, and its figures mean nothing.

The choice is an environment variable, so that the processes a row starts make it too.
"""

import os
from typing import TypeVar

SMOKE = "BENCHMARKS_SMOKE"
T = TypeVar("T")


def size(full: T, small: T) -> T:
    """The one that this run takes."""
    return small if os.environ.get(SMOKE) else full
