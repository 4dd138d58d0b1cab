"""The result of a diagnosis: its verdict, the evidence, and the model that is handed back."""

from dataclasses import dataclass, field

import numpy as np

from ..model.fitted import Fitted
from .gap import Gap
from .next_experiment import Experiment
from .parts import Parts
from .result import Added, Ranked
from .term import Term
from .traces import Trace
from .words import lines, result_line, summary


@dataclass(frozen=True)
class Diagnosis:
    """A verdict on the errors of a model, with the reported effects, their evidence and the improved model.

    Attributes:
        verdict: "explained" (the effects are certain or tied, and nothing else can be predicted), "partly" (the same,
            but more can be predicted), "no_gap" (the nominal errs no more than on its own recordings, or than the
            sensor) or "unknown" (no effect is certain).
        effects: reported effects (parts beyond a linear equation, such as friction or a delay), most important first;
            empty unless explained or partly.
        equivalent: effects that these data do not separate from effects[0]; if there are too many, with it.
        added: effects of the augmented model beyond the nominal, with form and parameters.
        gap: errors of the nominal and of the returned model, % of range, and the fraction closed.
        budget: fractions of the nominal's error energy by cause: parameters, effects, explainable, not explainable.
        ranking: effects added alone to the linear model, with their errors on recordings left out.
        where: fractions of the error by recording, frequency, time, displacement, velocity and voltage.
        next_experiment: a voltage to record, which separates an effect from `equivalent` ones; or None.
        probability: per effect, P that the best set without it has a larger error.
        fitted: names of the recordings to which the returned model was fitted.
        heldout: names of those whose errors in `gap` and `ranking` are of fits without them (with fewer than four
            recordings, or one that shows the effect, of fits without the part in question); empty with one recording.
        folds: records left out together, or in parts.
        shift: in a refit, every refitted coefficient divided by the given one, shape (n + 1,) for order n.
        traces: every record with the outputs of the nominal and the returned model.
        notes: one line for everything left out, not tried or not reported.
        model: the best model that beats the nominal out of fold, otherwise the nominal.
        handed_back: the returned model's parts beyond the nominal.
        parts: the parts of `handed_back` with parameters, intervals and certainty, under every verdict.
        refit: "asked", "automatic" or "no": whether the nominal's coefficients were refitted.
        reason: why the verdict is "unknown", one sentence.
        term: an unnamed force as an equation found in the data.
        lane_steps: the work of the search, samples x steps a sample x simulations.
        clock_shift: time (s) by which the output column was ahead of the input column; removed before the diagnosis.
        input_lag: time constant (s) of the low pass behind which the input column was recorded; removed likewise. 0 in
            a refit, because a zero of the plant does the same.
        interrupted: the search was interrupted; the result is the best scored so far.
    """

    verdict: str
    effects: tuple[str, ...]
    equivalent: tuple[str, ...]
    added: tuple[Added, ...]
    gap: Gap
    ranking: tuple[Ranked, ...]
    where: dict
    next_experiment: Experiment | None
    fitted: tuple[str, ...]
    heldout: tuple[str, ...]
    shift: np.ndarray
    traces: tuple[Trace, ...]
    model: Fitted
    notes: tuple[str, ...] = ()
    term: Term | None = None
    budget: dict = field(default_factory=dict)
    probability: dict = field(default_factory=dict)
    folds: tuple[tuple[str, ...], ...] = ()
    handed_back: tuple[str, ...] = ()
    parts: Parts = Parts()
    refit: str = "no"
    reason: str = ""
    lane_steps: int = 0
    clock_shift: float = 0.0
    input_lag: float = 0.0
    interrupted: bool = False

    @property
    def records(self) -> dict[str, list]:
        """Return record names: `fitted`, `heldout` (predicted out of fold), `folds` (left out together)."""
        return {"fitted": list(self.fitted), "heldout": list(self.heldout), "folds": [list(f) for f in self.folds]}

    def as_json(self, csv: str | None = None) -> dict:
        """Return the diagnosis as the dict of docs/contract.md; `csv`: the file with the next experiment."""
        experiment = self.next_experiment
        return {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "equivalent": list(self.equivalent),
            "budget": self.budget,
            "added": [vars(a) for a in self.added],
            "gap": vars(self.gap) | {"ci95": list(self.gap.ci95) if self.gap.ci95 else None},
            "ranking": [vars(r) | {"ci95": list(r.ci95) if r.ci95 else None} for r in self.ranking],
            "where": self.where | ({"summary": result_line(self)} if self.verdict == "no_gap" else {}),
            "next_experiment": None
            if experiment is None
            else {"separates": list(experiment.separates), "excitation": experiment.excitation, "csv": csv},
            "records": self.records,
            "pieces": None,
            "handed_back": list(self.handed_back),
            "parts": self.parts.as_json(),
            "refit": self.refit,
            "clock_shift_s": self.clock_shift,
            "input_lag_s": self.input_lag,
            "coefficients_over_given": [float(v) for v in self.shift],
            "notes": list(self.notes),
            "term": self.term.as_json() if self.term else None,
        }

    def __repr__(self) -> str:
        """Return the first lines of the diagnosis, at most ten."""
        text = str(self).splitlines()
        more = [f"and {len(text) - 9} lines more (print it)"] if len(text) > 10 else text[9:10]
        return "\n".join([f"Diagnosis: {text[0]}", *text[1:9], *more])

    def _repr_html_(self) -> str:
        """Return the first screen of the diagnosis page as HTML."""
        return summary(self).first_screen()

    def __str__(self) -> str:
        """Return the diagnosis as a few lines for the terminal."""
        return "\n".join([*lines(self), *(f"note: {line}" for line in self.notes if line != self.reason)])
