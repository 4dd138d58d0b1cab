"""A neural state space by jax-sysid (Bemporad, Apache-2.0), in the interpreter whose JAX its pins allow."""

from . import foreign

ADVICE = (
    "jax-sysid 1.1.0 pins jax<=0.4.31, equinox<=0.11.10 and diffrax<=0.6.1, older than this package needs; "
    "install it in an environment of its own and name its python in PEERS_JAX_SYSID_PYTHON"
)


def fit(nominal, records, seconds, key):
    """Adam, then L-BFGS, on full free runs of all records."""
    python = foreign.interpreter("jax_sysid.models", "PEERS_JAX_SYSID_PYTHON", ADVICE)
    return foreign.fit("sysid_worker.py", python, nominal, records, seconds)
