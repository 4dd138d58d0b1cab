"""Worker of `deepsi`: SUBNET on windows of T steps behind an encoder, the best free run of the training records kept.

A past of zeros precedes every record: rest, which is also where a free run starts.
"""

import pickle
import sys
import time

import deepSI
import numpy as np
import torch

LATENT, PAST, AHEAD, BATCH = 6, 20, 100, 256


def record(inputs, x):
    """Inputs (K, 4) and outputs (K,) behind a past at rest."""
    u = np.concatenate([np.zeros((PAST, 4)), inputs]).astype(np.float32)
    return deepSI.Input_output_data(u=u, y=np.concatenate([np.zeros(PAST), x]).astype(np.float32))


def fit(path, place, seconds):
    """Rounds of iterations, each sized by the pace of the last to take 60 % of what time is left."""
    began, data = time.monotonic(), np.load(path)
    torch.manual_seed(0)
    torch.set_num_threads(1)  # the nets are small: more threads only wait for each other
    records = [record(i, x[:-1]) for i, x in zip(data["inputs"], data["targets"], strict=True)]
    count_u, count_y, norm = deepSI.get_nu_ny_and_auto_norm(records)
    model = deepSI.SUBNET(count_u, count_y, norm, nx=LATENT, nb=PAST, na=PAST)
    settings = {"T": AHEAD, "batch_size": BATCH, "optimizer": torch.optim.Adam(model.parameters(), lr=2e-3)}
    count = 20
    while count >= 20:
        tick = time.monotonic()
        deepSI.fit(model, records, records, n_its=count, val_freq=max(count // 10, 20), **settings)
        left = seconds - (time.monotonic() - began)
        count = int(0.6 * left * count / (time.monotonic() - tick))
    with open(place, "wb") as file:
        pickle.dump(model, file)


def run(place, source, target):
    """Free run of one record from rest."""
    with open(place, "rb") as file:
        model = pickle.load(file)
    inputs = np.load(source)["inputs"]
    inputs = np.concatenate([inputs, inputs[-1:]])
    np.savez(target, x=model.simulate(record(inputs, np.zeros(len(inputs)))).y[PAST:])


if __name__ == "__main__":
    if sys.argv[1] == "fit":
        fit(*sys.argv[2:4], float(sys.argv[4]))
    else:
        run(*sys.argv[2:5])
