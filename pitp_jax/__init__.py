"""pitp_jax: model, invert and diagnose dielectric elastomer actuators from recordings.

    records -> identify -> train -> decode / predict -> feedforward
                          diagnose -> a model with the missing effect

Names load on first use, so that `pitp --help` does not wait for JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the public list, in pipeline order, as a type checker sees it
    from ._decode import rest_state as rest_state
    from ._decode import rollout as rollout
    from ._diagnose.diagnosis import Diagnosis as Diagnosis
    from ._diagnose.diagnosis import diagnose as diagnose
    from ._discrete_inverse import discrete_inverse as discrete_inverse
    from ._ensemble import Band as Band
    from ._ensemble import Ensemble as Ensemble
    from ._ensemble import predict_band as predict_band
    from ._ensemble import train_ensemble as train_ensemble
    from ._errors import BadInput as BadInput
    from ._errors import ComputationFailed as ComputationFailed
    from ._feedforward import Feedforward as Feedforward
    from ._feedforward import feedforward as feedforward
    from ._file import load as load
    from ._file import save as save
    from ._identify import Identification as Identification
    from ._identify import identify as identify
    from ._metrics import e_rms_percent as e_rms_percent
    from ._metrics import nrmse_percent as nrmse_percent
    from ._metrics import rmhe_percent as rmhe_percent
    from ._metrics import rmse as rmse
    from ._model.model import Model as Model
    from ._plant import plant as plant
    from ._plant import record as record
    from ._plant import simulate as simulate
    from ._plant import stepper as stepper
    from ._predict import Prediction as Prediction
    from ._predict import predict as predict
    from ._realtime import CompiledStep as CompiledStep
    from ._realtime import decoder_step as decoder_step
    from ._realtime import inverse_step as inverse_step
    from ._realtime import restore_step as restore_step
    from ._record import excitation as excitation
    from ._record.reading import Target as Target
    from ._record.reading import read as read
    from ._record.reading import read_target as read_target
    from ._record.record import Record as Record
    from ._settings import Settings as Settings
    from ._shard import records_mesh as records_mesh
    from ._shard import sharded_inverse as sharded_inverse
    from ._shard import sharded_rollout as sharded_rollout
    from ._stream import invert_stream as invert_stream
    from ._train import Training as Training
    from ._train import train as train
    from ._trim import pi_trim as pi_trim

_HOME = {
    "Record": "._record.record", "read": "._record.reading", "Target": "._record.reading",
    "read_target": "._record.reading", "excitation": "._record.excitation",
    "identify": "._identify", "Identification": "._identify",
    "Model": "._model.model", "train": "._train", "Training": "._train", "Settings": "._settings",
    "train_ensemble": "._ensemble", "Ensemble": "._ensemble", "predict_band": "._ensemble", "Band": "._ensemble",
    "predict": "._predict", "Prediction": "._predict", "rollout": "._decode", "rest_state": "._decode",
    "feedforward": "._feedforward", "Feedforward": "._feedforward", "discrete_inverse": "._discrete_inverse",
    "pi_trim": "._trim", "e_rms_percent": "._metrics", "nrmse_percent": "._metrics", "rmse": "._metrics",
    "rmhe_percent": "._metrics", "save": "._file", "load": "._file",
    "diagnose": "._diagnose.diagnosis", "Diagnosis": "._diagnose.diagnosis",
    "invert_stream": "._stream", "inverse_step": "._realtime", "decoder_step": "._realtime",
    "restore_step": "._realtime", "CompiledStep": "._realtime",
    "records_mesh": "._shard", "sharded_rollout": "._shard", "sharded_inverse": "._shard",
    "plant": "._plant", "simulate": "._plant", "record": "._plant", "stepper": "._plant",
    "BadInput": "._errors", "ComputationFailed": "._errors",
}  # fmt: skip
__all__ = list(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]
__version__ = "0.1.0"


def __getattr__(name: str):
    """Import the home of a public name on first use."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = import_module(_HOME[name], __name__)
    found = home if _HOME[name].endswith(f".{name}") else getattr(home, name)
    globals()[name] = found
    return found


def __dir__():
    return sorted([*globals(), *_HOME])
