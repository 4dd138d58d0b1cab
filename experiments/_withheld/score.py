"""Verdicts against truth.

    right   no_gap for none; the name first for one effect; both names for two; unknown if outside or left out
    tie     the name first, or among at most three declared equivalent
    closed  1 - e_after / e_before on the noise-free outputs of the held-out records, e^2 = mean (rms / range)^2

    numbers  where both forms are the same equation: within 1.96 of its own standard error of the true one

An effect whose noise-free gap is below half the noise floor cannot be seen: such cases are counted apart, and no_gap is
right. In a refit the nominal absorbs `added_mass`, `sensor_gain` and `parameter_change`: no_gap is right there too.
"""

from collections import Counter

import numpy as np

import pitp_jax as pitp

from . import plant as integrator
from .case import Case
from .catalogue import FORMS
from .outside import OUTSIDE

ABSORBED = ("added_mass", "sensor_gain", "parameter_change")
_MOST_TIED = 3


def runs(model, case: Case, names) -> dict[str, np.ndarray]:
    """Free runs of a model on the records of those names, in m; nan from where one diverged."""
    return {run.name: run.displacement for run in pitp.predict(model, [r for r in case.real if r.name in names])}


def pooled(outputs: dict[str, np.ndarray], case: Case, names) -> float:
    """Error of outputs in % of range, pooled over records, against noise-free ones; inf where a run diverged.

    Of a record that a diagnosis has shifted in time the first samples are missing.
    """
    shares = [np.mean((outputs[n] - case.true[n][-len(outputs[n]) :]) ** 2) / np.ptp(case.true[n]) ** 2 for n in names]
    return 100 * float(np.nan_to_num(np.sqrt(np.mean(shares)), nan=np.inf))


def true_closed(result, nominal, case: Case, names) -> float | None:
    """The closed fraction without noise on the records of those names.

    Before is the nominal's run in the result's `traces` (the refitted one in a refit) where it has them, else a run of
    the nominal given; after is always a run of `result.model`.
    """
    if not names:
        return None
    traces = {t.name: t.nominal for t in getattr(result, "traces", ())}
    before = traces if set(names) <= set(traces) else runs(nominal, case, names)
    share = 1 - pooled(runs(result.model, case, names), case, names) / pooled(before, case, names)
    return share if np.isfinite(share) else None


def _agreed(case: Case, kind) -> dict[tuple[str, str], dict[str, float]]:
    """True numbers in physical units, by (name, form) of the catalogue, where that is the withheld one's equation."""
    (form,), (p,), (c,) = (case.facts[k] for k in ("forms", "strengths", "constants"))
    second = 1 / (2 * np.pi * case.facts["f0_hz"])
    signed, zeta = c.get("sign", 1.0) * p, c.get("e", 1.0)
    part = 1 / kind.rate / integrator.substeps(FORMS["delay"], 1 / kind.rate / second)  # delays come in these
    return {
        "exact": {("delay", "pure"): {"time": round(p * second / part) * part}},
        "constant": {("voltage_offset", "constant"): {"offset": signed * kind.top}},
        "rigid": {("added_mass", "share"): {"d": p}},
        "gain": {("sensor_gain", "share"): {"d": signed}},
        "second_order": {("sensor_lag", "second order"): {"tau": p / (2 * zeta) * second, "zeta": zeta}},
    }.get(form, {})


def numbers_within(added, case: Case, kind) -> list[bool]:
    """Whether each number of the one effect found holds the true one in its 95 % interval, where forms agree."""
    if len(added) != 1 or len(case.facts["forms"]) != 1:
        return []
    truth = _agreed(case, kind).get((added[0].effect, added[0].form), {})
    told = added[0].parameters
    return [abs(told[k]["value"] - v) <= 1.96 * (told[k]["stderr"] or 0.0) for k, v in truth.items()]


def expected(label: str, left_out: bool) -> str:
    """Verdict that is right: explained, no_gap or unknown."""
    if label == "none":
        return "no_gap"
    return "unknown" if left_out or set(label.split("+")) & set(OUTSIDE) else "explained"


def right(label: str, row: dict, *, refit: bool, left_out: bool, ties: bool = False) -> bool:
    """Whether a row (`verdict`, `effects`, `equivalent`) says what is true; `ties` lets declared ties count."""
    want, names = expected(label, left_out), label.split("+")
    may_be_none = row.get("unseen") or (refit and label in ABSORBED and not left_out)
    if may_be_none and row["verdict"] == "no_gap":
        return True
    if row["verdict"] != want or want != "explained":
        return row["verdict"] == want
    if len(names) > 1:
        return set(names) <= set(row["effects"])
    tied = row["equivalent"] if ties and len(row["equivalent"]) <= _MOST_TIED else []
    return names[0] in (*row["effects"][:1], *tied)


def wrong_ones(labels: dict, rows: list[dict], **how) -> list[tuple]:
    """(truth, said, how often) of every wrong verdict, most frequent first."""
    said = Counter(
        (labels[r["key"]], "+".join(r["effects"]) if r["verdict"] == "explained" else r["verdict"])
        for r in rows
        if not right(labels[r["key"]], r, **how)
    )
    return [(truth, what, n) for (truth, what), n in said.most_common()]


def _rate(flags) -> str:
    flags = list(flags)
    return f"{sum(flags)}/{len(flags)}" if flags else "-"


def _median(values) -> float | None:
    values = [v for v in values if v is not None]
    return float(np.median(values)) if values else None


def summary(labels: dict, rows: list[dict], *, refit: bool, left_out: bool) -> list[tuple]:
    """(figure, value) of a whole run."""
    how = {"refit": refit, "left_out": left_out}
    parts = {"none": [], "single": [], "pair": [], "outside": [], "unseen": []}
    for row in rows:
        label = labels[row["key"]]
        outside = set(label.split("+")) & set(OUTSIDE)
        part = "none" if label == "none" else "outside" if outside else "pair" if "+" in label else "single"
        parts["unseen" if row.get("unseen") else part].append((label, row))
    single = parts["single"]
    tie = {"ties": not left_out}
    covered = [r["covered"] for r in rows if r.get("covered") is not None]
    return [
        ("left out: unknown" if left_out else "top-1", _rate(right(n, r, **how) for n, r in single)),
        ("name or declared tie", _rate(right(n, r, **how, **tie) for n, r in single)),
        ("no gap: false alarms", _rate(r["verdict"] != "no_gap" for _, r in parts["none"])),
        ("effects called no gap", _rate(r["verdict"] == "no_gap" for _, r in single + parts["pair"])),
        ("outside: unknown", _rate(r["verdict"] == "unknown" for _, r in parts["outside"])),
        ("pairs: both named", _rate(right(n, r, **how) for n, r in parts["pair"])),
        ("pairs: one named or more", _rate(bool(set(n.split("+")) & set(r["effects"])) for n, r in parts["pair"])),
        ("below the noise: right", _rate(right(n, r, **how, **tie) for n, r in parts["unseen"])),
        ("failed", _rate(r["verdict"] == "failed" for r in rows)),
        ("closed fraction, median said", _median(r["closed_fraction"] for r in rows)),
        ("closed fraction, median true", _median(r["true_closed"] for r in rows)),
        ("ci95 covers the true one", _rate(covered)),
        ("numbers within their 95 % interval", _rate(v for r in rows for v in r.get("within", []))),
        ("where: F1, median", _median(r.get("f1") for r in rows)),
        ("seconds a case, median", _median(r["seconds"] for r in rows)),
    ]
