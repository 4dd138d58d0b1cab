"""Pair the recordings of two sets by their commands, and by their responses where commands repeat.

    distance^2 = mean over the overlap of (y_a(t) - s y_b(t - offset))^2, means and both sensors' noise removed

Two sets of commands differ by one constant, which is no difference: an encoder reads 2048 at rest. At this constant
most recordings have a partner, so commands about two centres stay apart. An assignment problem finds the pairs: a
better command counts before a nearer response, a nearer response before an equal name. A difference between the
machines that is the same in all recordings does not change the pairs. An unpaired recording is a repeat if it lies
nearer to a paired recording of its own set than that one lies to its partner. It then gets the same partner.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...common.units import base_unit
from ...method.signal.initial_state import noise_of
from ...method.signal.record import Record
from .alignment import ALIKE, Alignment, align

_REFUSED = 1e6  # cost above any accepted one, and finite, as the assignment needs


@dataclass(frozen=True)
class Pair:
    """Two recordings of the same command, one from each set of recordings.

    Attributes:
        first, second: the recordings; both carry the command at times t and t - offset of their own clocks.
        offset: clock of `first` less clock of `second` at the same instant, s.
        correlation: of the two commands where they overlap; negative for a mirrored command.
        output_sign: -1 where the output of `second` is mirrored.
    """

    first: Record
    second: Record
    offset: float
    correlation: float
    output_sign: int = 1

    def command(self) -> np.ndarray:
        """Return the second recording's command at the times of the first, held at its ends, equal in sign, (T,)."""
        return np.sign(self.correlation) * np.interp(
            self.first.time - self.offset, self.second.time, self.second.voltage
        )

    @property
    def output_offset(self) -> float:
        """Return the mean of the second output less the first, base unit: a constant, which is not a difference."""
        apart = self.output() - self.first.displacement
        return float(np.nanmean(apart)) if np.isfinite(apart).any() else 0.0

    def as_json(self, first: str, second: str) -> dict[str, Any]:
        """Return both names under these keys, the offset of the clocks (s) and the correlation of the commands."""
        return {
            first: self.first.name, second: self.second.name, "clock_offset_s": self.offset,
            "correlation": self.correlation,
        }  # fmt: skip

    def output(self) -> np.ndarray:
        """Return the second recording's output at the times of the first, equal in sign, nan where missing, (T,)."""
        return self.output_sign * _at(self.first, self.second, self.offset)


@dataclass(frozen=True)
class Pairing:
    """The pairs of recordings found in two sets, and the recordings without a counterpart.

    Attributes:
        pairs: in the order of the first set; a recording may be in several.
        first_alone, second_alone: (name, reason) of recordings without a partner.
        repeated: of each set, groups of recordings with one command, paired by their responses.
        undecided: (name, partner, others): the others of the partner's set fit equally well.
        mirrored: whether the second set's command and its output have the opposite sign.
    """

    pairs: tuple[Pair, ...]
    first_alone: tuple[tuple[str, str], ...]
    second_alone: tuple[tuple[str, str], ...]
    repeated: tuple[tuple[tuple[str, ...], ...], tuple[tuple[str, ...], ...]] = ((), ())
    undecided: tuple[tuple[str, str, tuple[str, ...]], ...] = ()
    mirrored: tuple[bool, bool] = (False, False)

    @property
    def offsets(self) -> tuple[float, float]:
        """Return the constants by which commands and outputs of the first set exceed the second's, base units.

        They are 0 where the remaining difference is larger. Outputs of the commands' kind have the same constant.
        """
        if not self.pairs:
            return 0.0, 0.0
        a = self.pairs[0].first
        apart = [(p.first.voltage - p.command(), p.first.displacement - p.output()) for p in self.pairs]
        rows = [(np.mean(u), np.std(u), np.nanmedian(y), np.nanstd(y)) for u, y in apart]
        command, of_command, output, of_output = np.median(rows, 0).tolist()
        command *= abs(command) > of_command
        shared = command * (base_unit(a.voltage_unit) == base_unit(a.displacement_unit))
        return command, shared + (output - shared) * (abs(output - shared) > of_output)


def pair_records(
    first: Sequence[Record], second: Sequence[Record], *, shared: Literal["first", "second"] = "first"
) -> Pairing:
    """Find for each recording of one set the recording of the other set with the same command.

    Args:
        first, second: recordings of two machines, or of a machine and its simulator; rates may differ.
        shared: the set in which a recording with a unique command is the partner of all with that command.

    Returns:
        the pairs in the order of the first set, recordings without a partner, and undecided pairs.
    """
    both = [[align(a, b) for b in second] for a in first]
    same, mirrored = ([[tried[k] for tried in row] for row in both] for k in (0, 1))
    # a sine is its own mirror image half a period later, so the opposite sign must explain more recordings
    is_mirrored = _partnered(mirrored) > _partnered(same)
    table = _Table.of(first, second, _about_one_constant(mirrored if is_mirrored else same))
    cost = table.cost()
    rows, columns = linear_sum_assignment(cost)
    chosen = {(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if cost[i, j] < _REFUSED}
    turned = table.turned()
    exchanged = {(i, j) for j, i in _repeats(turned, {(j, i) for i, j in chosen}, shared == "first")}
    chosen |= _repeats(table, chosen, shared == "second") | exchanged
    pairs = []
    for i, j in sorted(chosen):
        m = table.matches[i][j]
        pairs.append(Pair(first[i], second[j], m.offset, m.correlation, table.output_sign))
    return Pairing(
        tuple(pairs), table.alone({i for i, _ in chosen}), turned.alone({j for _, j in chosen}),
        (turned.repeated({(j, i) for i, j in chosen}), table.repeated(chosen)), table.undecided(chosen),
        (is_mirrored, table.output_sign < 0),
    )  # fmt: skip


def _about_one_constant(matches: list[list[Alignment]]) -> list[list[Alignment]]:
    """Count in each misfit the distance from the constant at which the commands of the smaller set have partners.

    Of two such constants the smaller one counts: it adds a hundredth of its size to the distances.
    """
    shift = np.array([[m.shift if m.accepted else np.inf for m in row] for row in matches])

    def unmatched(constant: float) -> float:
        far = np.abs(shift - constant)
        return min(float(near[np.isfinite(near)].sum()) for near in (far.min(0), far.min(1))) + 0.01 * abs(constant)

    best = min(shift[np.isfinite(shift)].tolist(), key=unmatched, default=0.0)
    return [[replace(m, misfit=float(np.hypot(m.misfit, (m.shift - best) / m.spread))) for m in row] for row in matches]


def _partnered(matches: list[list[Alignment]]) -> int:
    """Count the recordings of both sets whose command occurs in the other set of recordings."""
    fits = np.array([[m.accepted for m in row] for row in matches])
    return int(fits.any(axis=0).sum() + fits.any(axis=1).sum())


@dataclass(frozen=True)
class _Table:
    """The alignment of every recording of one set with every one of the other; arrays of shape (first, second).

    Attributes:
        mine, others: the recordings.
        matches: of the commands.
        misfit: of the commands; inf where they differ.
        distance: squared distance of the responses, 0 within the noise; inf where the commands differ.
        noise: variances of both sensors' noise.
        output_sign: of the second set's outputs.
    """

    mine: Sequence[Record]
    others: Sequence[Record]
    matches: list[list[Alignment]]
    misfit: np.ndarray
    distance: np.ndarray
    noise: tuple[np.ndarray, np.ndarray]
    output_sign: int

    @classmethod
    def of(cls, first: Sequence[Record], second: Sequence[Record], matches: list[list[Alignment]]) -> "_Table":
        misfit = np.array([[m.misfit if m.accepted else np.inf for m in row] for row in matches])
        noise = noise_of(first) ** 2, noise_of(second) ** 2
        moments = {
            (i, j): _moments(first[i], second[j], matches[i][j].offset)
            for i, j in zip(*np.nonzero(_near(misfit) | _near(misfit.T).T), strict=True)
        }
        alike = [c / np.sqrt(a * b) for a, b, c in moments.values() if a * b > 0]
        sign = -1 if alike and np.median(alike) < -0.5 else 1
        distance = np.full(misfit.shape, np.inf)
        for (i, j), (a, b, c) in moments.items():
            distance[i, j] = max(a + b - 2 * sign * c - 2 * (noise[0][i] + noise[1][j]), 0.0)
        return cls(first, second, matches, misfit, distance, noise, sign)

    @property
    def near(self) -> np.ndarray:
        """Return whether no other recording of the second set has a better command for one of the first."""
        return _near(self.misfit)

    def turned(self) -> "_Table":
        """Return the same table with the two sets of recordings exchanged."""
        matches = [
            [replace(m, offset=-m.offset, size=1 / m.size if m.size else np.inf) for m in column]
            for column in zip(*self.matches, strict=True)
        ]
        return _Table(
            self.others, self.mine, matches, self.misfit.T, self.distance.T,
            (self.noise[1], self.noise[0]), self.output_sign,
        )  # fmt: skip

    def cost(self) -> np.ndarray:
        """Return the cost of each possible pair: the command counts most, then the response, then the name."""
        misfit, fits = self.misfit, np.isfinite(self.misfit)
        excess = np.where(fits, misfit, 0.0) - np.minimum(_allowed(misfit), _allowed(misfit.T).T)
        finite = self.distance[np.isfinite(self.distance)]
        response = self.distance / max(finite.max(initial=0.0), 1e-300)
        renamed = np.array([[a.name != b.name for b in self.others] for a in self.mine])
        # weights: the command before the response, and the name after it
        cost = 1e3 * np.maximum(excess, 0.0) + np.minimum(response, 1.0) + 1e-9 * renamed
        return np.where(fits, cost, _REFUSED)

    def apart(self, i: int, k: int, partner: int) -> float:
        """Return the squared distance of two responses of one set, aligned through a recording of the other set."""
        offset = self.matches[i][partner].offset - self.matches[k][partner].offset
        a, b, c = _moments(self.mine[i], self.mine[k], offset)
        return max(a + b - 2 * c - 2 * (self.noise[0][i] + self.noise[0][k]), 0.0)

    def alone(self, paired: set[int]) -> tuple[tuple[str, str], ...]:
        """Return the names of recordings without a counterpart, each with the reason."""
        return tuple((r.name, self._why(k)) for k, r in enumerate(self.mine) if k not in paired)

    def _why(self, i: int) -> str:
        best = max(range(len(self.others)), key=lambda j: abs(self.matches[i][j].correlation))
        m, name = self.matches[i][best], self.others[best].name
        if m.accepted:
            return f"its command equals that of {name}, which has a closer partner"
        if abs(m.correlation) >= ALIKE:
            return f"{name} has the same command at another size (factor {m.size:.3g}); check the units"
        return f"no command correlates by {ALIKE:g} or more with its own (closest: {name}, {m.correlation:.2f})"

    def repeated(self, chosen: set[tuple[int, int]]) -> tuple[tuple[str, ...], ...]:
        """Return the groups of recordings with equal commands that only their responses distinguish."""
        groups = set()
        for i, row in enumerate(self.near):
            group = tuple(np.flatnonzero(row).tolist())
            if any((i, j) not in chosen for j in group):
                groups.add(group)
        return tuple(tuple(self.others[j].name for j in group) for group in sorted(groups) if len(group) > 1)

    def undecided(self, chosen: set[tuple[int, int]]) -> tuple[tuple[str, str, tuple[str, ...]], ...]:
        """Return the pairs that are uncertain, because another recording has the same command and response."""
        uncertain = []
        for i, j in sorted(chosen):
            slack = self.noise[0][i] + self.noise[1]
            as_near = self.near[i] & (np.abs(self.distance[i] - self.distance[i, j]) <= slack)
            others = [self.others[k].name for k in np.flatnonzero(as_near).tolist() if (i, k) not in chosen]
            if others:
                uncertain.append((self.mine[i].name, self.others[j].name, tuple(others)))
        return tuple(uncertain)


def _allowed(misfit: np.ndarray) -> np.ndarray:
    """Return the misfit, of the command's deviation, up to which a command is as good as the best one."""
    return 1.5 * misfit.min(axis=1, keepdims=True) + 0.02


def _near(misfit: np.ndarray) -> np.ndarray:
    return np.isfinite(misfit) & (misfit <= _allowed(misfit))


def _repeats(table: _Table, chosen: set[tuple[int, int]], shared: bool) -> set[tuple[int, int]]:
    """Pair the remaining recordings of the first set with the counterpart of the recording that they repeat."""
    repeats = set()
    for i in sorted(set(range(len(table.mine))) - {i for i, _ in chosen}):
        fitting = np.flatnonzero(table.near[i]).tolist()
        if shared and len(fitting) == 1:
            repeats.add((i, fitting[0]))
            continue
        mates = [(table.apart(i, k, j), k, j) for k, j in chosen if j in fitting]
        if mates:
            apart, k, j = min(mates)
            if apart <= table.distance[k, j]:
                repeats.add((i, j))
    return repeats


def _at(a: Record, b: Record, offset: float) -> np.ndarray:
    """Interpolate the output of `b` at the times of `a`; nan outside and where missing, shape (T,)."""
    return np.interp(a.time - offset, b.time, b.displacement, left=np.nan, right=np.nan)


def _moments(a: Record, b: Record, offset: float) -> tuple[float, float, float]:
    """Return the variances of two outputs and their covariance, where both are measured."""
    y, z = a.displacement, _at(a, b, offset)
    known = np.isfinite(y) & np.isfinite(z)
    if not known.any():
        return 0.0, 0.0, 0.0
    (first, both), (_, second) = np.cov(y[known], z[known], bias=True).tolist()
    return first, second, both
