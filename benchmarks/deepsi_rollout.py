"""Free runs of deepSI's SUBNET with the library's default nets: another model, so its time and no error.

    x_{k+1} = f(x_k, u_k),    y_k = h(x_k)    (all records at once, as its `forward` unrolls them)

The weights are untrained: they do not change how long a step takes. One thread, as for the other PyTorch ways.
"""

import deepSI
import numpy as np
import torch

LATENT, PAST = 6, 20


def subnet(film):
    """Fn() -> outputs (records, time) under film voltages (records, time), V, behind a past at rest."""
    u = np.array(film, np.float32)
    norm = deepSI.Norm(u.mean(), u.std(), 0.0, 1.0)
    model = deepSI.SUBNET("scalar", "scalar", norm, nx=LATENT, nb=PAST, na=PAST).eval()
    past, future = torch.zeros(len(u), PAST), torch.from_numpy(u)

    def run():
        torch.set_num_threads(1)
        with torch.inference_mode():
            return model(past, past, future)

    return run
