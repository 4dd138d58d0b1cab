"""Peers: simulators of the same actuator, fitted to the same records, run freely on the same held-out ones.

    fit(nominal, records, seconds, key) -> predictor,     predictor(record) = displacement under its voltage alone

A peer is one module with such a `fit` and one line here. `needs` lists what it imports beyond the package's own
dependencies; where one is missing the peer is skipped and its row says why.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

Predictor = Callable[..., np.ndarray]


class Skipped(Exception):
    """This peer cannot run here; the text says why."""


@dataclass(frozen=True)
class Peer:
    """One line of the table.

    Attributes:
        name: as printed and as `--only` takes it.
        module: file in this folder.
        invertible: whether a voltage can be computed from a target displacement without a search over voltages.
        options: keyword arguments of its `fit`.
    """

    name: str
    module: str
    invertible: bool
    options: dict = field(default_factory=dict)

    @property
    def fit(self) -> Callable[..., Predictor]:
        """Its `fit`; raises `Skipped` when the module cannot be imported."""
        try:
            return import_module(f"{__name__}.{self.module}").fit
        except ImportError as error:
            raise Skipped(f"{error.name or error} is not installed") from error


OURS = "pitp_jax default"
PEERS = (
    Peer(OURS, "package", True, {"preset": "default"}),
    Peer("paper preset", "package", True, {"preset": "paper"}),
    Peer("constant tokens", "constant", True),
    Peer("Hammerstein", "hammerstein", True),
    Peer("lumped", "lumped", True),
    Peer("lumped + electrode", "lumped", True, {"electrode": True}),
    Peer("NARX", "narx", False),
    Peer("GRU", "recurrent", False, {"cell": "gru"}),
    Peer("LSTM", "recurrent", False, {"cell": "lstm"}),
    Peer("SUBNET-style", "subnet", False),
    Peer("deepSI SUBNET", "deepsi", False),
    Peer("jax-sysid", "sysid", False),
)
