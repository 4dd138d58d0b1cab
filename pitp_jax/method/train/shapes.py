"""Store the array shapes of a training, so that a training on other recordings can have them too.

Most of the time of a short training is compilation. JAX compiles a program for every shape of its arrays, and the
shapes of a training follow from its recordings and its nominal model.
"""

from dataclasses import dataclass

import jax
import numpy as np

from ..model.programs import on_device
from .equation_error import EquationData


@dataclass(frozen=True)
class Shapes:
    """The array shapes of a training.

    Attributes:
        block: recorded samples per sample of the training.
        period: of the nominal model's resonance, s; the lengths of windows and the thinning follow from it.
        samples: of the equation error.
        valid: per record, True where its filtered state is valid, shape (T,); the starts of windows follow from it.
        ringing: whether the memory holds a second mass.
    """

    block: int
    period: float
    samples: int
    valid: tuple[np.ndarray, ...]
    ringing: bool

    def starts(self, own: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """Return where windows may start: the stored samples, or `own` ones if the records differ in length."""
        same = [len(v) for v in self.valid] == [len(v) for v in own]
        return self.valid if same else own

    def filled(self, data: EquationData) -> EquationData:
        """Repeat the samples of the equation error from the first one on, until they are as many."""
        index = np.arange(self.samples) % len(data.force)
        return jax.tree.map(lambda a: on_device(np.asarray(a)[index]), data)  # on the host, without a program
