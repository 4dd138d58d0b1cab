"""The same models in PyTorch, as one would write them there: weights copied over, eq. 13 and the decoder's RK4 step.

Arrays are (features, samples): with a few features and many samples that is 2 to 3 times as fast as (samples,
features), since every operation then runs along memory. The paper's wide layers take either way alike.

Compact   three small nets and low polynomials (preset default)
Paper     n + 1 networks, each a branch per input, a fusion and two layers of 128 (the paper, Fig. 3)
"""

import jax
import numpy as np
import torch
from torch import nn

from pitp_jax.method.model.encoder import PaperEncoder, fast_memories
from pitp_jax.method.model.model import Model

DEVICE = "cuda" if jax.default_backend() == "gpu" and torch.cuda.is_available() else "cpu"  # where JAX computes


def tensor(array) -> torch.Tensor:
    """A copy on `DEVICE`, in the array's precision."""
    return torch.tensor(np.asarray(array), device=DEVICE)


def finished(result: torch.Tensor) -> torch.Tensor:
    """The result, computed: a GPU works on after a call returns."""
    if DEVICE == "cuda":
        torch.cuda.synchronize()
    return result


class Net(nn.Module):
    """One hidden tanh layer."""

    def __init__(self, net):
        super().__init__()
        for name in ("hidden", "readout"):
            self.register_parameter(name, nn.Parameter(tensor(getattr(net, name).weight)))
            self.register_parameter(f"{name}_bias", nn.Parameter(tensor(getattr(net, name).bias)[:, None]))

    def forward(self, features):
        return self.readout @ torch.tanh(self.hidden @ features + self.hidden_bias) + self.readout_bias


class Compact(nn.Module):
    """`CompactEncoder` for a batch of instants: (features, samples) to (logits, samples)."""

    def __init__(self, encoder):
        super().__init__()
        self.order, self.fast = encoder.order, fast_memories(encoder.bounds.shape[1] - encoder.order)
        self.spring, self.damping, self.past = Net(encoder.spring), Net(encoder.damping), Net(encoder.past)
        for name in ("spring_poly", "damping_poly", "fading"):
            self.register_parameter(name, nn.Parameter(tensor(getattr(encoder, name))))
        self.register_buffer("bounds", tensor(encoder.bounds.array(np.float32))[:, :, None])
        self.rows, self.columns = (tensor(i) for i in np.triu_indices(encoder.order))

    def forward(self, features):
        seen = torch.maximum(torch.minimum(features, self.bounds[1]), self.bounds[0])
        state, memory, x = seen[: self.order], seen[self.order :], seen[:1]
        ends = self.spring(x) + self.spring_poly @ torch.cat([x, x * x, x**3])
        products = torch.cat([state, state[self.rows] * state[self.columns]])
        middle = self.damping(seen) + self.damping_poly @ products
        weight = self.fading @ torch.cat([torch.ones_like(x), x, x * x])
        offset = (weight * memory).sum(0, keepdim=True) + self.past(torch.cat([x, memory[: self.fast]]))
        return torch.cat([ends[:1], middle, ends[1:], offset])


class Token(nn.Module):
    """One token's network of the paper."""

    def __init__(self, networks, k: int):
        super().__init__()
        branches = networks.branches
        self.branches = nn.ModuleList([nn.Linear(1, branches.bias.shape[2]) for _ in range(branches.bias.shape[1])])
        for i, branch in enumerate(self.branches):
            branch.weight.data, branch.bias.data = tensor(branches.weight[k, i]), tensor(branches.bias[k, i])
        layers = [networks.fusion, *networks.enhance, networks.readout]
        sizes = [(layer.weight[k], layer.bias[k]) for layer in layers]
        self.layers = nn.ModuleList([nn.Linear(w.shape[1], w.shape[0]) for w, _ in sizes])
        for layer, (weight, bias) in zip(self.layers, sizes, strict=True):
            layer.weight.data, layer.bias.data = tensor(weight), tensor(bias)

    def forward(self, features):
        h = torch.cat([torch.relu(b(features[:, i : i + 1])) for i, b in enumerate(self.branches)], 1)
        for layer in self.layers[:-1]:
            h = torch.relu(layer(h))
        return self.layers[-1](h)


class Paper(nn.Module):
    """`PaperEncoder` for a batch of instants: separate networks; (features, samples) to (logits, samples)."""

    def __init__(self, encoder):
        super().__init__()
        count = encoder.networks.readout.weight.shape[0]
        self.tokens = nn.ModuleList([Token(encoder.networks, k) for k in range(count)])

    def forward(self, features):
        logits = torch.cat([token(features.T) for token in self.tokens], 1).T
        return torch.cat([logits, torch.zeros_like(logits[:1])])


class Tokens(nn.Module):
    """Scaled tokens and the offset token (orders 1 and 2)."""

    def __init__(self, model: Model):
        super().__init__()
        self.encoder = Paper(model.encoder) if isinstance(model.encoder, PaperEncoder) else Compact(model.encoder)
        self.register_buffer("coefficients", tensor(model.coefficients)[:, None])

    def forward(self, features):
        logits = self.encoder(features)
        low = logits[:-1] < -0.5
        factor = torch.where(low, -0.25 / torch.where(low, logits[:-1], -1.0), 1 + logits[:-1])
        return self.coefficients * factor, logits[-1]


class Inverse(nn.Module):
    """Eq. 13: film voltage of every instant from features and [x, ..., x^(n)]."""

    def __init__(self, model: Model):
        super().__init__()
        self.tokens = Tokens(model)
        self.force_scale = float(model.scales.force)  # torch guards a NumPy scalar in a way that fails

    def forward(self, features, equation):
        tokens, offset = self.tokens(features)
        force = (tokens * equation).sum(0) + offset
        return torch.sqrt(torch.clamp(force * self.force_scale, min=0.0))


class Step(nn.Module):
    """One decoder step of `decoder` for a batch of records: state (n + K, records), three stage forces."""

    def __init__(self, model: Model, dt: float):
        super().__init__()
        self.tokens, self.order, self.dt = Tokens(model), model.order, dt
        self.register_buffer("rates", tensor(np.asarray(model.scales.rates, np.float32))[:, None])
        self.register_buffer("inverse_tau", torch.exp(-tensor(model.memory.log_tau))[:, None])

    def slope(self, state, tokens, offset, force):
        n = self.order
        highest = (force - offset - (tokens[:n] * state[:n]).sum(0)) / tokens[n]
        upper = self.rates * torch.cat([state[1:n], highest[None]])
        return torch.cat([upper, (state[:1] - state[n:]) * self.inverse_tau])

    def forward(self, state, first, middle, last):
        n, h = self.order, self.dt
        drift = torch.cat([self.rates[: n - 1] * state[1:n], torch.zeros_like(state[:1]),
                           (state[:1] - state[n:]) * self.inverse_tau])  # fmt: skip
        tokens, offset = self.tokens(state + h / 2 * drift)
        k1 = self.slope(state, tokens, offset, first)
        k2 = self.slope(state + h / 2 * k1, tokens, offset, middle)
        k3 = self.slope(state + h / 2 * k2, tokens, offset, middle)
        k4 = self.slope(state + h * k3, tokens, offset, last)
        return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def ode(self, state, force):
        """The continuous-token ODE's right-hand side (for torchdiffeq)."""
        return self.slope(state, *self.tokens(state), force)
