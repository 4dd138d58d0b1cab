"""Keep trained parameters above lower bounds by a change of coordinates, so that the optimiser needs no bounds.

p = v for v >= p_min + 1,      p = p_min + exp(v - p_min - 1) below;      dp/dv is continuous and never zero

In float64, as the optimiser; the tokens have a similar function in the model's precision (`method/model/positive.py`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Vector = Float[np.ndarray, " parameters"]
_NEAREST = 1e-6  # to the bound, at which coordinates start


@dataclass(frozen=True)
class LowerBound:
    """The lower bound of every trained parameter; -inf: none.

    Attributes:
        least: p_min, shape (parameters,) or ().
    """

    least: np.ndarray

    def parameters(self, coordinates: Vector) -> Vector:
        """Return the parameters p at the coordinates v."""
        near = coordinates < self.least + 1
        return np.where(near, self.least + self.slopes(coordinates), coordinates)

    def coordinates(self, parameters: Vector) -> Vector:
        """Return the coordinates v of the parameters p; one at its bound or below is moved just above."""
        near = parameters < self.least + 1
        least = np.where(near, self.least, parameters)  # finite, so that no difference is nan
        above = np.maximum(parameters - least, _NEAREST)
        return np.where(near, least + 1 + np.log(above), parameters)

    def slopes(self, coordinates: Vector) -> Vector:
        """Compute dp/dv, which is also p - p_min where p differs from v."""
        near = coordinates < self.least + 1
        return np.where(near, np.exp(np.where(near, coordinates - self.least - 1, 0.0)), 1.0)


UNBOUNDED = LowerBound(np.asarray(-np.inf))
