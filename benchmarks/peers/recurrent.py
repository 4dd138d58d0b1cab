"""GRU and LSTM: h_{k+1} = cell(h_k, (u_k, u_k^2, u_{k+1}, u_{k+1}^2)),   x_k = W h_k,   h_0 = 0.

Gates start with time constants spread from one step to a whole record (chrono initialisation, Tallec and Ollivier
2018): a plain start forgets within a few samples what creep needs for seconds.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from .descent import descend, free_run
from .grid import batch, make_grid

HIDDEN = 40


class Recurrent(eqx.Module):
    """One cell and a linear readout without bias: rest reads zero."""

    cell: eqx.nn.GRUCell | eqx.nn.LSTMCell
    out: eqx.nn.Linear

    def rest(self):
        """Hidden state of an actuator at rest; (h, c) for an LSTM."""
        h = jnp.zeros(self.cell.hidden_size)
        return (h, h) if isinstance(self.cell, eqx.nn.LSTMCell) else h

    def step(self, state, inputs):
        """Advance one coarse sample."""
        return self.cell(inputs, state)

    def read(self, state):
        """Scaled displacement."""
        return self.out(state[0] if isinstance(state, tuple) else state)[0]


def make(kind: str, longest: int, key) -> Recurrent:
    """A network whose memories reach from one step to `longest` steps."""
    key_cell, key_out, key_time = jax.random.split(key, 3)
    keep = jax.random.uniform(key_time, (HIDDEN,), maxval=float(jnp.log(longest)))  # log time constants
    cell = {"gru": eqx.nn.GRUCell, "lstm": eqx.nn.LSTMCell}[kind](4, HIDDEN, key=key_cell)
    bias = jnp.zeros_like(cell.bias).at[HIDDEN : 2 * HIDDEN].set(keep)
    if kind == "lstm":  # its gates: input, forget, cell, output; the GRU's: reset, keep, new
        bias = bias.at[:HIDDEN].set(-keep)
    cell = eqx.tree_at(lambda c: c.bias, cell, bias)
    return Recurrent(cell, eqx.nn.Linear(HIDDEN, 1, use_bias=False, key=key_out))


def fit(nominal, records, seconds, key, *, cell):
    """Truncated back-propagation through time on the coarse grid."""
    grid = make_grid(nominal, records)
    data = batch(grid, records)
    network = descend(make(cell, data[0].shape[1], key), *data, seconds)
    return lambda record: grid.restore(record, free_run(network, grid.inputs(record)))
