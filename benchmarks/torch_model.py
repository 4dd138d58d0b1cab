"""The same models in PyTorch, as one would write them there: weights copied over, eq. 13 and the decoder's RK4 step.

Compact   three small nets and low polynomials (preset default)
Paper     n + 1 networks, each a branch per input, a fusion and two layers of 128 (the paper, Fig. 3)
"""

import numpy as np
import torch
from torch import nn

from pitp_jax._model.encoder import PaperEncoder, fast_memories
from pitp_jax._model.model import Model


def tensor(array) -> torch.Tensor:
    """A copy, in the array's precision."""
    return torch.tensor(np.asarray(array))


def linear(layer) -> nn.Linear:
    """An equinox layer."""
    found = nn.Linear(layer.weight.shape[-1], layer.weight.shape[-2])
    found.weight.data, found.bias.data = tensor(layer.weight), tensor(layer.bias)
    return found


class Net(nn.Module):
    """One hidden tanh layer."""

    def __init__(self, net):
        super().__init__()
        self.hidden, self.readout = linear(net.hidden), linear(net.readout)

    def forward(self, features):
        return self.readout(torch.tanh(self.hidden(features)))


class Compact(nn.Module):
    """`CompactEncoder` for a batch of instants."""

    def __init__(self, encoder):
        super().__init__()
        self.order, self.fast = encoder.order, fast_memories(encoder.bounds.shape[1] - encoder.order)
        self.spring, self.damping, self.past = Net(encoder.spring), Net(encoder.damping), Net(encoder.past)
        for name in ("spring_poly", "damping_poly", "fading", "bounds"):
            self.register_buffer(name, tensor(getattr(encoder, name)))
        self.rows, self.columns = (torch.tensor(i) for i in np.triu_indices(encoder.order))

    def forward(self, features):
        seen = torch.maximum(torch.minimum(features, self.bounds[1]), self.bounds[0])
        state, memory, x = seen[:, : self.order], seen[:, self.order :], seen[:, :1]
        ends = self.spring(x) + torch.cat([x, x * x, x**3], 1) @ self.spring_poly.T
        products = torch.cat([state, state[:, self.rows] * state[:, self.columns]], 1)
        middle = self.damping(seen) + products @ self.damping_poly.T
        weight = torch.cat([torch.ones_like(x), x, x * x], 1) @ self.fading.T
        offset = (weight * memory).sum(1, keepdim=True) + self.past(torch.cat([x, memory[:, : self.fast]], 1))
        return torch.cat([ends[:, :1], middle, ends[:, 1:], offset], 1)


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
    """`PaperEncoder` for a batch of instants: separate networks."""

    def __init__(self, encoder):
        super().__init__()
        count = encoder.networks.readout.weight.shape[0]
        self.tokens = nn.ModuleList([Token(encoder.networks, k) for k in range(count)])

    def forward(self, features):
        logits = torch.cat([token(features) for token in self.tokens], 1)
        return torch.cat([logits, torch.zeros_like(logits[:, :1])], 1)


class Tokens(nn.Module):
    """Scaled tokens and the offset token (orders 1 and 2)."""

    def __init__(self, model: Model):
        super().__init__()
        self.encoder = Paper(model.encoder) if isinstance(model.encoder, PaperEncoder) else Compact(model.encoder)
        self.register_buffer("coefficients", tensor(model.coefficients))

    def forward(self, features):
        logits = self.encoder(features)
        low = logits[:, :-1] < -0.5
        factor = torch.where(low, -0.25 / torch.where(low, logits[:, :-1], -1.0), 1 + logits[:, :-1])
        return self.coefficients * factor, logits[:, -1]


class Inverse(nn.Module):
    """Eq. 13: film voltage of every instant from features and [x, ..., x^(n)]."""

    def __init__(self, model: Model):
        super().__init__()
        self.tokens, self.force_scale = Tokens(model), model.scales.force

    def forward(self, features, equation):
        tokens, offset = self.tokens(features)
        force = (tokens * equation).sum(1) + offset
        return torch.sqrt(torch.clamp(force * self.force_scale, min=0.0))


class Step(nn.Module):
    """One decoder step of `decoder` for a batch of records: state (records, n + K), three stage forces."""

    def __init__(self, model: Model, dt: float):
        super().__init__()
        self.tokens, self.order, self.dt = Tokens(model), model.order, dt
        self.register_buffer("rates", tensor(model.scales.rates.astype(np.float32)))
        self.register_buffer("inverse_tau", torch.exp(-tensor(model.memory.log_tau)))

    def slope(self, state, tokens, offset, force):
        n = self.order
        highest = (force - offset - (tokens[:, :n] * state[:, :n]).sum(1)) / tokens[:, n]
        upper = self.rates * torch.cat([state[:, 1:n], highest[:, None]], 1)
        return torch.cat([upper, (state[:, :1] - state[:, n:]) * self.inverse_tau], 1)

    def forward(self, state, first, middle, last):
        n, h = self.order, self.dt
        drift = torch.cat([self.rates[: n - 1] * state[:, 1:n], torch.zeros_like(state[:, :1]),
                           (state[:, :1] - state[:, n:]) * self.inverse_tau], 1)  # fmt: skip
        tokens, offset = self.tokens(state + h / 2 * drift)
        k1 = self.slope(state, tokens, offset, first)
        k2 = self.slope(state + h / 2 * k1, tokens, offset, middle)
        k3 = self.slope(state + h / 2 * k2, tokens, offset, middle)
        k4 = self.slope(state + h * k3, tokens, offset, last)
        return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def ode(self, state, force):
        """The continuous-token ODE's right-hand side (for torchdiffeq)."""
        return self.slope(state, *self.tokens(state), force)
