"""Group a simulator's recordings by simulated machine, for example several loads or gains in one folder.

Several plants are present if the same command gives different responses. Each such response starts a group; a group's
linear model is

    y = g R(p) u + c,   R: order 2, unit gain        p, g common to a group, c of every recording, by least squares

A recording belongs to the group whose model has the smallest residual on it. Two groups are merged if the residual of
their common model is at most twice that of separate models.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ...method.identify.linear_ode import respond
from ...method.signal.record import Record
from ...method.signal.reduced import means

_AS_WELL = 2.0  # times the residual of one model per group
_MATTERS = 0.02  # of the outputs' rms: residual of a common model from which several are worthwhile
_SAME = 0.01  # of the command's deviation: commands that differ by less are equal
_SAMPLES, _MOST = 1500, 60  # of a recording; recordings that are compared
_DAMPINGS = (0.1, 0.4, 1.5)


@dataclass(frozen=True)
class Groups:
    """Recordings grouped by the machine that they seem to come from.

    Attributes:
        members: names of the recordings of each group, the largest group first.
        common: residual of one linear model for all, fraction of the outputs' rms.
        own: the same with one linear model a group.
    """

    members: tuple[tuple[str, ...], ...]
    common: float
    own: float

    def __str__(self) -> str:
        names = [f"{', '.join(names[:3])}{', ...' * (len(names) > 3)} ({len(names)})" for names in self.members]
        return (
            f"The simulator's recordings fall into {len(self.members)} groups, as if made on several plants: one "
            f"common linear model leaves {100 * self.common:.2g} % of their output unexplained, one model for each "
            f"group {100 * self.own:.2g} %. The groups: {'; '.join(names)}. Give --by-group to diagnose each, or one "
            "folder for each load or gain"
        )


@dataclass(frozen=True)
class _Thin:
    """A recording averaged to few samples: command, output without mean, and where the output was measured."""

    name: str
    dt: float
    drive: np.ndarray
    output: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True)
class _Fit:
    """A linear model of some recordings: logarithms of pole coefficients, gain, and residual sum of squares."""

    logs: np.ndarray
    gain: float
    left: float


def groups_of(records: Sequence[Record]) -> Groups | None:
    """Group recordings by the machine behind them; return None if one linear model is sufficient for all.

    Args:
        records: of one rate.
    """
    if not 2 < len(records) <= _MOST:
        return None
    thin = [_thinned(record) for record in records]
    # the command with the most recordings gives the initial groups
    seeds = max(([b for b in thin if _same(a, b)] for a in thin), key=len)
    if len(seeds) < 2:
        return None
    fits = [_fitted([seed], None) for seed in seeds]
    owners = [min(range(len(fits)), key=lambda k: _left(fits[k], record)) for record in thin]
    members = [[r for r, owner in zip(thin, owners, strict=True) if owner == k] for k in range(len(fits))]
    groups = [(some, _fitted(some, fit)) for some, fit in zip(members, fits, strict=True) if some]
    while len(groups) > 1:
        trials = []
        for i, (first, fit) in enumerate(groups):
            for j, (second, other) in enumerate(groups[:i]):
                both = _fitted([*first, *second], fit, other)
                trials.append((both.left / max(fit.left + other.left, 1e-300), i, j, both))
        ratio, i, j, both = min(trials, key=lambda trial: trial[0])
        if ratio > _AS_WELL**2:
            break
        joined = ([*groups[i][0], *groups[j][0]], both)
        groups = [group for k, group in enumerate(groups) if k not in (i, j)] + [joined]
    if len(groups) < 2:
        return None
    common = _fitted(thin, *(fit for _, fit in groups))
    whole = sum(float(np.sum(r.output[r.seen] ** 2)) for r in thin)
    parts = [np.sqrt(left / whole) for left in (common.left, sum(fit.left for _, fit in groups))]
    if parts[0] < max(_MATTERS, _AS_WELL * parts[1]):
        return None
    order = {record.name: k for k, record in enumerate(thin)}
    names = [tuple(sorted((r.name for r in some), key=order.__getitem__)) for some, _ in groups]
    return Groups(tuple(sorted(names, key=lambda some: (-len(some), order[some[0]]))), float(parts[0]), float(parts[1]))


def _thinned(record: Record) -> _Thin:
    step = -(-record.samples // _SAMPLES)
    drive, output = means(record.voltage, step), means(record.displacement, step)
    seen = np.isfinite(output)
    mean = output[seen].mean() if seen.any() else 0.0
    return _Thin(record.name, record.dt * step, drive, np.where(seen, output - mean, 0.0), seen)


def _same(a: _Thin, b: _Thin) -> bool:
    """Return whether two recordings have the same command, sample by sample."""
    if len(a.drive) != len(b.drive):
        return False
    return float(np.std(a.drive - b.drive)) <= _SAME * float(np.std(a.drive)) > 0


def _run(logs: np.ndarray, record: _Thin) -> np.ndarray:
    """Simulate a unit-gain model under a recording's command, from equilibrium at the first sample, without mean."""
    run = respond(logs, record.drive, step=record.dt, square=False, hold="foh", settled=True)
    return run - run[record.seen].mean()


def _left(fit: _Fit, record: _Thin) -> float:
    """Return the residual sum of squares of a linear model on a recording."""
    return float(np.sum(((record.output - fit.gain * _run(fit.logs, record))[record.seen]) ** 2))


def _fitted(records: Sequence[_Thin], *starts: _Fit | None) -> _Fit:
    """Fit one linear model to recordings, starting from models of some of them or from a grid of modes."""
    output = np.concatenate([record.output[record.seen] for record in records])

    def rest(logs: np.ndarray) -> tuple[np.ndarray, float]:
        run = np.concatenate([_run(logs, record)[record.seen] for record in records])
        gain = float(run @ output) / max(float(run @ run), 1e-300)
        return np.nan_to_num(output - gain * run, nan=1e6, posinf=1e6, neginf=-1e6), gain

    tried = [fit.logs for fit in starts if fit is not None]
    if not tried:
        fast, slow = np.pi / (4 * records[0].dt), 4 * np.pi / (records[0].dt * len(records[0].drive))
        grid = [(np.log(2 * z * w), 2 * np.log(w)) for w in np.geomspace(slow, fast, 10) for z in _DAMPINGS]
        tried = sorted(map(np.array, grid), key=lambda logs: float(np.sum(rest(logs)[0] ** 2)))[:2]
    bounds = np.log(1e-3 / records[0].dt / len(records[0].drive)), np.log(1e3 / records[0].dt)
    limits = [bounds[0], 2 * bounds[0]], [bounds[1], 2 * bounds[1]]
    found = [least_squares(lambda logs: rest(logs)[0], np.clip(t, *limits), bounds=limits, max_nfev=40) for t in tried]
    best = min(found, key=lambda one: one.cost)
    return _Fit(best.x, rest(best.x)[1], 2 * float(best.cost))
