"""Train the models of an ensemble, distributed over all JAX processes, which exchange them as model files.

Of P JAX processes, number p trains the members p, p + P, ...; in the end every process has them all.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import numpy as np
from jax.experimental.multihost_utils import process_allgather

from ...method.model.fitted import Fitted
from ...method.model.model import Model
from ...method.model.own_encoder import own_module
from ...method.signal.initial_state import in_motion
from ...method.signal.record import Record
from ...method.signal.sets import check_set
from ...method.train.ensemble import Ensemble, check_members
from ...method.train.training import train
from .model_file import load, save


def train_ensemble(nominal: Model | Fitted, records: Sequence[Record], *, members: int = 4, key, **options) -> Ensemble:
    """Train `members` models with keys split from `key`, distributed over all JAX processes.

    Args:
        nominal, records: as for `train`, the same in every process.
        members: models, at least 2.
        key: JAX key.
        **options: as for `train`.

    Returns:
        models, and the error not shown by their spread.

    Raises:
        ValueError: fewer than 2 members.

    Examples:
        >>> ensemble = pitp.train_ensemble(model, records, members=2, key=jax.random.key(0))  # doctest: +SKIP
    """
    check_members(members)
    check_set(records)
    records, _ = in_motion(records)
    # every process splits in the same way, and takes its own
    keys, processes = jax.random.split(key, members), jax.process_count()
    mine = range(jax.process_index(), members, processes)
    # same records for all; the initial nets and the order of minibatches differ
    models = tuple(train(nominal, records, key=keys[k], **options).model for k in mine)
    models = _gathered(models, members) if processes > 1 else models
    return Ensemble.calibrated(models, records)


def _gathered(own: Sequence[Fitted], members: int) -> tuple[Fitted, ...]:
    """Gather the members that all JAX processes have trained, in order, with their origins."""
    processes = jax.process_count()
    with TemporaryDirectory() as folder:
        path, packed = Path(folder) / "member.pitp", []
        for model in own:
            save(path, model)
            packed.append(np.frombuffer(path.read_bytes(), np.uint8))
        # every process contributes arrays of one shape: empty ones if it trained fewer
        packed += [np.zeros(0, np.uint8)] * (-(-members // processes) - len(packed))
        sizes = np.asarray(process_allgather(np.array([len(p) for p in packed])))
        padded = np.stack([np.pad(p, (0, sizes.max() - len(p))) for p in packed])
        files, models = np.asarray(process_allgather(padded)), []
        for k in range(members):
            slot = k % processes, k // processes
            path.write_bytes(files[slot][: sizes[slot]].tobytes())
            models.append(load(path, encoder=own_module(own[0].encoder) if own else None))
    return tuple(models)
