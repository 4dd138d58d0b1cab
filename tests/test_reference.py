"""The reference's ridge beside one that stacks the rows of every fold and solves it for every penalty."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from pitp_jax.method.diagnose import reference
from pitp_jax.method.diagnose.data import Case, Series, _folds
from pitp_jax.method.diagnose.evidence import evidence
from pitp_jax.method.diagnose.fit import Fit
from pitp_jax.method.diagnose.search import Hypothesis
from pitp_jax.method.signal.record import Record

COLUMNS = 5


def part_of(cls, **fields) -> Any:
    """An object of a class with some of its fields."""
    made = object.__new__(cls)
    for name, value in fields.items():
        object.__setattr__(made, name, value)
    return made


def drawn(sizes):
    """A case of records of these sizes, a hypothesis and columns that explain a part of its residuals."""
    rng = np.random.default_rng(0)
    columns = [3 + rng.standard_normal((n, COLUMNS)) * (1, 10, 0.1, 1, 2) for n in sizes]
    true = rng.standard_normal(COLUMNS)
    targets = [x @ true / 10 + rng.standard_normal(len(x)) for x in columns]
    targets[1][50:60] = np.nan
    records = [Record(str(k), np.arange(n) / 100, np.arange(n) / n, np.arange(n) / n) for k, n in enumerate(sizes)]
    series = tuple(
        part_of(Series, record=records[k], output=np.zeros(n), counts=np.isfinite(y), span=1.0 + k)
        for k, (n, y) in enumerate(zip(sizes, targets, strict=True))
    )
    case = part_of(Case, series=series, folds=_folds(series))
    fit = Fit((), (), np.zeros(1), np.zeros((len(sizes), 2)), residuals=targets)
    return case, Hypothesis(fit, (), targets, evidence(targets, np.zeros(len(sizes)))), columns


def stacked(case, h, columns, penalty):
    """Sum of squares left over of every record."""
    total, weights = np.zeros(len(columns)), 1 / np.sqrt(h.evidence.mse)
    for fold in range(len(case.folds)):
        xs, ys = [], []
        for k, mask in enumerate(case.masks(fold)):
            seen = mask > 0
            if seen.any():
                x, y = columns[k][seen], h.residuals[k][seen]
                xs.append((x - x.mean(0)) * weights[k])
                ys.append((y - y.mean()) * weights[k])
        x, y = np.concatenate(xs), np.concatenate(ys)
        size = x.std(0)
        w = np.linalg.solve(
            x.T @ x / len(x) / np.outer(size, size) + penalty * np.eye(COLUMNS), x.T @ y / len(x) / size
        )
        for k, tested in enumerate(case.tested(fold)):
            if tested.any():
                e = h.residuals[k][tested] - ((columns[k][tested] - columns[k][tested].mean(0)) / size) @ w
                total[k] += np.sum((e - (e.mean() if case.blocks == 1 else 0.0)) ** 2)
    return total


@pytest.mark.parametrize("sizes", [(400, 700, 300, 500), (900, 700)])
def test_moments_give_the_ridge_of_stacked_rows(sizes):
    """Records left out whole, and in halves."""
    case, h, columns = drawn(sizes)
    found = reference._ridge(case, h, columns, np.zeros(len(sizes)))
    for penalty, e in zip(reference._PENALTIES, found, strict=True):
        squares = np.bincount(e.records, e.squares, len(sizes))
        np.testing.assert_allclose(squares, stacked(case, h, columns, penalty), rtol=1e-6)


def test_every_so_many_rows_of_a_long_case_tell_nearly_the_same(monkeypatch):
    case, h, columns = drawn((400, 700, 300, 500))
    whole = min(e.score for e in reference._ridge(case, h, columns, np.zeros(4)))
    monkeypatch.setattr(reference, "_ROWS", 700)
    part = min(e.score for e in reference._ridge(case, h, columns, np.zeros(4)))
    assert part != whole
    assert part == pytest.approx(whole, abs=0.02)


def test_a_plant_almost_without_a_spring_integrates():
    """1 / (T s + 1), T = 1e13 s: after n samples of a force of 1 it has moved by (n - 1/2) dt / T."""
    b, a = reference.sampled(np.array([1e13, 1.0]), 0.02)
    assert lfilter(b, a, np.ones(100)) == pytest.approx((np.arange(100) + 0.5) * 0.02 / 1e13, rel=1e-9)
