"""SUBNET by deepSI itself (Beintema, BSD; PyTorch), in the interpreter that has it."""

from . import foreign

ADVICE = "pip install deepSI, here or in an environment whose python PEERS_DEEPSI_PYTHON names (it brings PyTorch)"


def fit(nominal, records, seconds, key):
    """Encoder, state and output nets with the library's defaults, latent 6, past 20, windows of 100 steps."""
    python = foreign.interpreter("deepSI", "PEERS_DEEPSI_PYTHON", ADVICE)
    return foreign.fit("deepsi_worker.py", python, nominal, records, seconds)
