"""Search for the best set of effects: add effects one by one to the two best sets, scored out of fold.

Level d holds the best form of every set of level d - 1 plus one effect: all forms take a few steps on some recordings,
and the best two on all recordings are optimised; the best sets then exchange the forms of their earlier effects. Sets
are then refitted without each fold in order of their in-sample error, until that exceeds the third-best out-of-fold
error; later sets cannot be among the best three. A set improves the fit significantly if its error is below FIRST (then
FURTHER for every effect) times that of the last such set, with P >= SURE. A level without such a set is skipped.
"""

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.spec import EffectSpec
from . import rules
from .budget import Budget
from .data import FEWEST_FOLDS, Case
from .evidence import Evidence, evidence, probability
from .fit import PREVIEW, Fit, Fitter
from .library import (
    CHANGED,
    CORE,
    DELAY,
    DOUBLED,
    FILTER,
    FILTER_ZETA,
    INDEX,
    LAG,
    LATE,
    LONE,
    OFFSET,
    ROWS,
    SHIFT,
    Form,
    bounds,
    forms,
    group,
    named,
    slots_of_row,
)
from .scale import scale_of

BEAM, DEPTH = 2, 4  # fronts, effects of a set
_FIRST_SETS, _SETS = 12, 8  # hypotheses fitted after the first look: of one effect, and for each further front
_CERTAIN = 4  # hypotheses fitted to their optimum whatever their first steps gain
_RANKED = 3  # hypotheses of a level whose out-of-fold order is certain
_STARTS, _FIRST_STEPS, STEPS, _FOLD_STEPS = 4, 4, 40, 6  # starts of a set; first, most and fold steps
_REFIT_RUNS = 40  # runs of all records for one refit without a fold
_AT_A_TIME = 4  # sets fitted between checks of the clock, if time is limited
PARAMETERS = "parameters"
# the effect that a slot adds to a linear model
_ADDED_BY = {slot: group(r.name) for r in ROWS for slot in slots_of_row(r)} | {"a2": "added_mass"}


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, fitted to all records and scored by cross-validation.

    Attributes:
        fit: to all records.
        labels: catalogue names, in the order of `fit.names`.
        residuals: out of fold, per record.
        evidence: of those.
        without: slots of the refits without each fold, shape (folds, slots).
    """

    fit: Fit
    labels: tuple[str, ...]
    residuals: list[np.ndarray]
    evidence: Evidence
    without: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def names(self) -> tuple[str, ...]:
        """Return the search names of the effects in the hypothesis."""
        return self.fit.names

    @property
    def rms(self) -> float:
        """Return the geometric mean over records of the out-of-fold rms error, in scaled units."""
        return self.evidence.rms

    def reaches(self, error: float, times: float = rules.OWN) -> bool:
        """Return whether the error is at most `times` another one, such as the nominal model's own.

        A record counts at least as the nominal model's own error, so that quiet records do not hide a gap of another.
        With OWN times this error, a single record slightly above the limit would decide alone.
        """
        own = replace(self.evidence, least=self.evidence.least / rules.OWN**2)
        return own.rms <= times * error


def needed(chosen: Hypothesis, rival: Hypothesis) -> float:
    """Return the probability that the rival's error is larger by at least GAIN.

    A smaller difference depends on the simulator's own error.
    """
    return probability(chosen.evidence, rival.evidence, 1 - rules.GAIN)


class Search:
    """A search over sets of effects; it stores every hypothesis that was tried."""

    structural = False  # whether only the linear structure of a refit has names

    def __init__(
        self, case: Case, refit: bool, exclude: Sequence[str] = (), budget: Budget | None = None, own: float = 0.0,
        misfit: float = 0.0,
    ):  # fmt: skip
        self.case, self.refit, self.exclude = case, refit, set(exclude)
        self.own, self.misfit = own, misfit  # the nominal's own error with the sensor's noise, and beyond it
        self.budget = budget or Budget()
        self.budget.run_steps = sum(len(s.output) for s in case.series) * case.simulator.substeps
        self.fitter = Fitter(case, self.budget)
        self.floors = np.array(self.fitter.floors)
        self.samples = sum(int(s.counts.sum()) for s in case.series)
        self.every: dict[frozenset, Hypothesis] = {}
        self.waiting: dict[frozenset, Fit] = {}  # at their optimum, not refitted without folds
        self.others: dict[frozenset, list[Fit]] = {}  # all forms of a set that were fitted to their optimum
        self._climbed: set[tuple[str, ...]] = set()  # a front's effects and the added one: fitted before
        # parts of the nominal's linear model that exist at all
        self.core = tuple(k for k in (*CORE, DELAY, LAG, FILTER) if case.nominal[INDEX[k]] > 0)
        # a plant without a spring is identified with the offset of its input
        self.core += tuple(k for k in (OFFSET,) if refit and case.nominal[INDEX[k]])
        # A delay shorter than one (thinned) sample belongs to the hold. A longer one is treated as an effect, not as a
        # changed coefficient.
        short = not refit and case.nominal[INDEX[DELAY]] < case.dt
        self.movable = tuple(k for k in self.core if not (short and k == DELAY))
        given = Fit((), (), case.nominal.copy(), case.starts.copy())
        self.fitter.fit([given], 0)
        self.given = self._scored([given])[0]
        self.linear = self._linear()
        base = self.linear if refit else self.given
        self.base = base
        self.scale = scale_of(case, base.fit)
        self.every[frozenset()] = base
        self.fitter.bounds = bounds(self.scale)
        self.library = [f for f in forms(self.scale) if self._is_tried(f)]
        if not refit and CHANGED not in self.exclude:
            moved = replace(self.linear, fit=self.linear.fit.again(names=(PARAMETERS,)), labels=(CHANGED,))
            self.every[frozenset([PARAMETERS])] = moved
            self.library += [Form(PARAMETERS, None, {})]

    def _is_tried(self, form: Form) -> bool:
        """Return whether an effect can be added to the base model and is not excluded."""
        spec, mass = form.spec, self.scale.a2 > 0
        if spec is None or spec.only_given or form.name in self.exclude:
            return False
        if spec.needs_mass and not mass or spec.squares and not self.case.simulator.square:
            return False
        if spec.reported is None and spec.name in self.exclude:
            return False
        if spec is SHIFT and DELAY in self.movable:  # the delay of the nominal model may be shorter
            return False
        # in a refit these parameters of the linear model are free in every set
        free = {"gain", *(["mass"] if mass else []), *(["delay"] if DELAY in self.core else [])}
        return not (self.refit and spec.moves in free) and not (OFFSET in self.core and form.name == "voltage_offset")

    def weigh(self, rows: Sequence[np.ndarray]) -> Evidence:
        """Summarise out-of-fold residuals as evidence."""
        return evidence(rows, np.sqrt(self.floors), rules.OWN * self.misfit, self.case.blocks)

    # -- fits ----------------------------------------------------------------------------------------------------------

    def _scored(self, fits: Sequence[Fit]) -> list[Hypothesis]:
        rows, slots = self.fitter.refitted_without(fits, _FOLD_STEPS)
        return [Hypothesis(f, self.labels(f), r, self.weigh(r), s) for f, r, s in zip(fits, rows, slots, strict=True)]

    def labels(self, fit: Fit) -> tuple[str, ...]:
        """Return the catalogue names of the effects in a fit."""
        return tuple(CHANGED if n == PARAMETERS else named(n, fit.slots, self.scale) for n in fit.names)

    def _linear(self) -> Hypothesis:
        """Refit the linear model without effects; if the nominal model is refitted, also with other structures.

        Choose the structure with the fewest parameters that no other structure beats by 5 % with probability 0.9.
        Effects act on a core of order two at most, and a superfluous lag behind it would hide them. If few records make
        a refit worse out of fold than the given nominal, effects start from the nominal's structure and are compared
        with it: an effect that only compensates for a poor refit is not reported.
        """
        fits = [self._structure(self.movable, {})]
        if self.refit:
            fits += self._structures()
        self.fitter.fit(fits, STEPS)
        # of several fits of one structure the best, whatever its start
        best: dict[tuple[str, ...], Fit] = {}
        for f in sorted((f for f in fits if np.isfinite(f.cost)), key=lambda f: f.cost):
            best.setdefault(f.free, f)
        tried = self._scored([*best.values()] or fits[:1])
        self.linears = sorted(tried, key=lambda h: len(h.fit.free))
        least = min(tried, key=lambda h: h.rms)
        good = (h for h in self.linears if h is least or probability(least.evidence, h.evidence, 0.95) < rules.SURE)
        plainest = next(good)
        if self.refit and self.given.rms < plainest.rms:
            own = next((h for h in tried if h.fit.free == self.movable), plainest)
            return replace(own, residuals=self.given.residuals, evidence=self.given.evidence)
        return plainest

    def _structure(self, free: tuple[str, ...], values: dict[str, float]) -> Fit:
        slots = self.case.nominal.copy()
        for k in (DELAY, LAG, FILTER, "a2"):
            slots[INDEX[k]] *= k in free or (not self.refit and k in self.core)
        for k, v in values.items():
            slots[INDEX[k]] = v
        return Fit((), free, slots, self.case.starts.copy())

    def _structures(self) -> list[Fit]:
        """Return initial guesses of linear models of orders one to four, with a mass, a delay, a lag or a filter."""
        v = {k: self.case.nominal[INDEX[k]] for k in (*CORE, LAG, FILTER, FILTER_ZETA)}
        dt, late = self.case.dt, self.case.nominal[INDEX[DELAY]]
        own, core = self.core, tuple(k for k in self.core if k not in (LAG, FILTER))
        # the nominal's total lag at low frequencies as one time constant, of a plant with a spring
        tau = max(v["a1"] / v["a0"] + v[LAG] + 2 * v[FILTER_ZETA] * v[FILTER], dt) if v["a0"] > 0 else 0.0
        fits = []
        for faster in (0.5, 2.0):
            fits.append(self._structure(own, {"a1": v["a1"] * faster, "a2": v["a2"] * faster**2}))
        if not late:
            fits.append(self._structure((*own, DELAY), {DELAY: dt}))
        if tau and ("a2" not in core or core != own):
            for share in (0.03, 0.3):
                numbers = {"a1": v["a0"] * tau, "a2": share * v["a0"] * tau**2}
                fits.append(self._structure((*(k for k in core if k != "a2"), "a2"), numbers))
        if tau and own != ("a0", "a1"):
            fits.append(self._structure(("a0", "a1"), {"a1": v["a0"] * tau}))
            fits.append(self._structure(("a0", "a1", DELAY), {"a1": v["a0"] * tau, DELAY: late or dt}))
        if LAG not in own and FILTER not in own:
            numbers = {LAG: 0.3 * max(tau, dt)}, {FILTER: 0.2 * max(tau, dt), FILTER_ZETA: 0.3}
            fits += [self._structure((*own, *extra), extra) for extra in numbers]
        return fits

    def extend(self, fronts: Sequence[Hypothesis], without: Set[str] = frozenset()) -> None:
        """Add one more effect to each hypothesis in `fronts`, fit the best forms, and score them out of fold."""
        groups: dict[frozenset, list[Fit]] = {}
        below: dict[int, Fit] = {}
        for front in fronts:
            for form in self.library:
                key = frozenset([*front.names, form.name])
                if form.name in {*front.names, *without} or key in self.every or key in self.waiting:
                    continue
                groups.setdefault(key, []).append(start := self._started(front.fit, form))
                below[id(start)] = front.fit
        groups = self._foremost(groups, below, _SETS * len(fronts) if fronts[0].names else _FIRST_SETS)
        # beside a front fitted before, a hypothesis converges to the same result
        fresh = {key: [f for f in g if f.names not in self._climbed] for key, g in groups.items()}
        keys = [key for key, g in fresh.items() if g]
        # the most promising first; without a limit of time all of them together
        size, depth = len(keys) if np.isinf(self.budget.seconds) else _AT_A_TIME, len(fronts[0].names) + 1
        for first in range(0, len(keys), max(size, 1)):
            some = {key: fresh[key] for key in keys[first : first + size]}
            names = " and ".join("+".join(sorted(key)) for key in some)
            if first and not self.budget.allows(names):
                continue
            # a hypothesis counts only after its out-of-fold score, so the fits reserve time for that
            with self.budget.keeping(_RANKED * len(self.case.folds) * _REFIT_RUNS * self.budget.run_steps):
                self._climb(some)
            self.judge(depth, without)

    def _climb(self, groups: dict[frozenset, list[Fit]]) -> None:
        """Fit the candidates, and queue those that lower the error of the hypothesis that they extend.

        The first steps use few records only, so the best hypotheses continue even if these steps improve no other
        record.
        """
        for f in (starts := [f for g in groups.values() for f in g]):
            f.fold = PREVIEW
            self._climbed.add(f.names)
        self.fitter.fit(starts, _FIRST_STEPS)
        groups = {
            key: [f.again(fold=None, cost=np.inf, residuals=[], jacobian=None) for f in g if np.isfinite(f.cost)]
            for key, g in groups.items()
        }
        self.fitter.fit([f for g in groups.values() for f in g], 0)
        groups = {key: _continued(_distinct(sorted(g, key=lambda f: f.cost))) for key, g in groups.items()}
        order = sorted(groups, key=lambda key: min((f.cost for f in groups[key]), default=np.inf))
        gaining = {key: [f for f in g if self._gains(f)] for key, g in groups.items()}
        groups = gaining | {key: gaining[key] or groups[key] for key in order[:_CERTAIN]}
        self.fitter.fit([f for g in groups.values() for f in g], STEPS)
        groups = {key: gained for key, g in groups.items() if (gained := [f for f in g if self._gains(f)])}
        self.others |= groups
        for fit in self._on_other_fronts(self._richer([self._plainest(g) for g in groups.values()])):
            if not self.exclude & set(self.labels(fit)):
                self.waiting[frozenset(fit.names)] = fit

    def _gains(self, fit: Fit) -> bool:
        """Return whether a fit lowers the error of the hypothesis that it extends by at least GAIN."""
        return self._leaves_less(fit, self.every[frozenset(fit.names[:-1])].fit)

    def _leaves_less(self, fit: Fit, other: Fit) -> bool:
        """Return whether a fit has GAIN less error than another; errors below the nominal model's own count as that."""
        return bool(np.isfinite(fit.cost) and self._log_error(fit) < self._log_error(other) - 2 * rules.GAIN)

    def _log_error(self, fit: Fit) -> float:
        """Return the logarithm of a fit's mean square error, limited below by the nominal model's own error."""
        total = 0.0
        for r, floor in zip(fit.residuals, self.floors, strict=True):
            seen = r[np.isfinite(r)]
            total += len(seen) * np.log(max(np.mean(seen**2) + floor, (rules.OWN * self.misfit) ** 2))
        return total / self.samples

    def judge(self, depth: int, without: Set[str] = frozenset()) -> None:
        """Cross-validate the waiting hypotheses of `depth` effects, until the best three are certain.

        The in-sample error of a fit is never above its out-of-fold error. Hypotheses are therefore refitted in order of
        their in-sample error, and one above the third-best out-of-fold error waits.
        """
        fits = [f for f in self.waiting.values() if len(f.names) == depth and not without & set(f.names)]
        errors = {id(f): self.weigh(f.residuals).rms for f in fits}
        fits.sort(key=lambda f: errors[id(f)])
        while fits:
            best = self.level(depth, without)[:_RANKED]
            if len(best) == _RANKED and errors[id(fits[0])] >= best[-1].rms:
                break
            count = max(_RANKED - len(best), 1)
            if not self.budget.allows(f"hypotheses of {depth} effect{'s' * (depth > 1)} out of fold"):
                break
            self._settle(fits[:count])
            fits = fits[count:]

    def hypothesis_of(self, names: Set[str]) -> Hypothesis | None:
        """Return the hypothesis of these effects, cross-validated if necessary; None if it was not tried."""
        key = frozenset(names)
        if key in self.waiting:
            self._settle([self.waiting[key]])
        return self.every.get(key)

    def exchanged(self, h: Hypothesis, name: str, row: EffectSpec) -> Hypothesis | None:
        """Return a set with another row instead of one effect, starting at the same value; None if out of budget."""
        if not self.budget.allows(f"{row.name} instead of {name}"):
            return None
        mine = [k for form in self.library if form.name == name for k in form.start]
        slots, free = h.fit.slots.copy(), tuple(k for k in h.fit.free if k not in mine)
        ((old,), (new,)) = mine[:1], slots_of_row(row)
        slots[INDEX[new]] = max(slots[INDEX[old]] - self.case.nominal[INDEX[old]], 0.01 * self.case.dt)
        slots[INDEX[old]] = self.case.nominal[INDEX[old]]
        names = tuple(row.name if n == name else n for n in h.names)
        one = h.fit.anew(names=names, free=(*free, new), slots=slots, residuals=[])
        fits = [f for f in self.fitter.fit([one], STEPS) if np.isfinite(f.cost)]
        return next(iter(self._scored(fits)), None)

    def _settle(self, fits: Sequence[Fit]) -> None:
        for h in self._scored(fits):
            self.every[frozenset(h.names)] = h
            self.waiting.pop(frozenset(h.names), None)

    def _plainest(self, forms: Sequence[Fit]) -> Fit:
        """Return the fit with the fewest parameters whose error is at most GAIN above the best.

        Under another name it may be more by GAIN of the error that the effect is added to: two times of an electrode's
        lag, 3 % apart, were two of a film that charges and discharges unlike.
        """
        best = min(forms, key=lambda f: f.cost)

        def is_as_good(f: Fit) -> bool:
            if self.labels(f) == self.labels(best):
                return not self._leaves_less(best, f)
            fits = f, best, self.every[frozenset(best.names[:-1])].fit
            own, least, before = (np.exp(self._log_error(g) / 2) for g in fits)
            return bool(own - least < rules.GAIN * before)

        return min(filter(is_as_good, forms), key=lambda f: (len(f.free), f.cost))

    def _richer(self, fits: Sequence[Fit]) -> list[Fit]:
        """Add a second time constant, a decade apart, to memory effects where this reduces the error by GAIN."""
        more: list[tuple[int, Fit]] = []
        for n, f in enumerate(fits):
            if f.names[-1] not in DOUBLED:
                continue
            (strength, tau), second = DOUBLED[f.names[-1]]
            # a decade apart, because two nearer branches act as one with a time constant between them
            for ratio in (0.1, 10.0):
                slots, free = f.slots.copy(), (*f.free, *second)
                slots[[INDEX[k] for k in second]] = 0.3 * f.value(strength), ratio * f.value(tau)
                more.append((n, f.anew(free=free, slots=slots)))
        return self._improved(fits, more)

    def _on_other_fronts(self, fits: Sequence[Fit]) -> list[Fit]:
        """Refit the best sets on what else they can build on; keep one if its error is lower by GAIN.

        Alone, a form may take what another effect does, and a structure fit a wrong effect: a polynomial beat the right
        spring while a friction was missing, and friction without its mass had six times the error.
        """
        many = []
        for n in sorted(range(len(fits)), key=lambda n: fits[n].cost)[:BEAM]:
            f = fits[n]
            # other forms of all effects but the last, and in a refit the other linear structures
            fronts = [(front, f.names[-1:]) for front in self.others.get(frozenset(f.names[:-1]), [])]
            fronts += [(h.fit, f.names) for h in self.linears if self.refit]
            for front, names in fronts:
                own = {k for r in ROWS if group(r.name) in names for k in slots_of_row(r)}
                own |= {k for form in self.library if form.name in names for k in form.start}
                own |= {*(self.movable if PARAMETERS in names else ())}
                free = (*front.free, *(k for k in f.free if k in own))
                if own & {*front.free} or {*free} == {*f.free}:
                    continue
                slots = front.slots.copy()
                kept = [INDEX[k] for k in (*own, *({*front.free} & {*f.free}))]
                slots[kept] = f.slots[kept]
                many.append((n, f.anew(free=free, slots=slots)))
        return self._improved(fits, many)

    def _improved(self, fits: Sequence[Fit], tried: Sequence[tuple[int, Fit]]) -> list[Fit]:
        """Fit further sets, each with the index of the fit that it replaces where its error is lower by GAIN."""
        self.fitter.fit([f for _, f in tried], STEPS)
        best = list(fits)
        for n, f in tried:
            if f.cost < best[n].cost and self._leaves_less(f, fits[n]):
                best[n] = f
        return best

    def _foremost(self, groups: dict[frozenset, list[Fit]], below: dict[int, Fit], most: int):
        """Return the most promising initial guesses of the most promising sets of effects.

        An effect that improves the fit together with another may do nothing alone, so the first level is a poor guide.
        """
        many = [(key, f) for key, group in groups.items() for f in group]
        costs = self.fitter.foreseen([f for _, f in many], [below[id(f)] for _, f in many])
        ranked: dict[frozenset, list[Fit]] = {}
        for n in np.argsort(costs, kind="stable"):
            ranked.setdefault(many[n][0], []).append(many[n][1])
        return {
            key: _varied(group)[: max(_STARTS, len({frozenset(f.free) for f in group}))]  # at least one of each form
            for key, group in list(ranked.items())[:most]
        }

    def _started(self, front: Fit, form: Form) -> Fit:
        slots = front.slots.copy()
        if form.name == PARAMETERS:
            free = tuple(dict.fromkeys((*self.movable, *front.free)))
            return front.anew(names=(*front.names, PARAMETERS), free=free, slots=slots)
        for k, v in form.start.items():
            slots[INDEX[k]] = v
        free = tuple(dict.fromkeys((*front.free, *form.free)))
        # added stiffness is first subtracted from the core's, so that the start is as stiff as the base
        if "a0" in free:
            slots[0] /= max(1 + form.stiffness, 1.0)
        # so is an added time from its lag: at small amplitudes a lag before the square is one behind it, and no descent
        # leads from one to the other
        if LAG in front.free and LAG not in form.start:
            late = sum(slots[INDEX[k]] for k in form.start if k in LATE)
            slots[INDEX[LAG]] = max(slots[INDEX[LAG]] - late, 0.1 * slots[INDEX[LAG]])
        return front.anew(names=(*front.names, form.name), free=free, slots=slots, residuals=[])

    def each_alone(self) -> Evidence | None:
        """Cross-validate a separate linear model for each recording; None if at least four are left out as a whole.

        Leaving out parts of recordings cannot show whether all recordings come from one machine: parameters fitted to
        two loads at once describe neither, and predict a third load worse than the nominal does.
        """
        count = len(self.case.series)
        if count == 1 or (count >= FEWEST_FOLDS and self.case.blocks == 1):
            return None
        rows: list[np.ndarray] = []
        for k in range(count):
            fitter = Fitter(self.case.alone([k]), self.budget)
            fit = self.linear.fit.again(starts=self.linear.fit.starts[[k]], residuals=[], jacobian=None, cost=np.inf)
            fitter.fit([fit], STEPS)
            (((apart,),), _) = fitter.refitted_without([fit], _FOLD_STEPS)
            rows.append(apart)
        return self.weigh(rows)

    def fewer_moved(self) -> None:
        """Reset refitted coefficients of the best set to their nominal values where the change is not needed."""
        best = self.best()
        if PARAMETERS not in best.names:
            return
        kept, candidates = best, [k for k in self.movable if k in best.fit.free]
        while len(candidates) > 1:
            fits = [self._put_back(kept.fit, k) for k in candidates]
            tried = self._scored([f for f in self.fitter.fit(fits, STEPS) if np.isfinite(f.cost)])
            good = [h for h in tried if needed(kept, h) < rules.SURE]
            if not good:
                break
            kept = min(good, key=lambda h: h.evidence.bare.rms)
            candidates = [k for k in candidates if k in kept.fit.free]
        self.every[frozenset(best.names)] = kept
        # a single one that is an effect of its own, such as the mass
        for name in {f.name for f in self.library if f.name in LONE and [*f.start] == candidates} - {*kept.names}:
            names = tuple(name if n == PARAMETERS else n for n in kept.names)
            fit = replace(kept.fit, names=names)
            self.every[frozenset(names)] = replace(kept, fit=fit, labels=self.labels(fit))

    def _put_back(self, fit: Fit, name: str) -> Fit:
        slots = fit.slots.copy()
        slots[INDEX[name]] = self.case.nominal[INDEX[name]]
        return fit.anew(free=tuple(k for k in fit.free if k != name), slots=slots)

    # -- the beam ------------------------------------------------------------------------------------------------------

    def begins(self) -> bool:
        """Return whether a first effect surely takes a twentieth of the error: a weak one is then searched."""
        self.extend([self.base])
        first = self.level(1)[:1]
        return any(probability(h.evidence.bare, self.given.evidence.bare, rules.WEAK) >= rules.SURE for h in first)

    def run(self) -> None:
        """Search sets of one, two and more effects, and store the hypotheses in `every`."""
        # in a refit for every linear structure, because gear friction cannot be found without its mass or its delay
        fronts, levels = [self.base], [self.base]
        fronts += [h for h in self.linears if h.fit.free != self.base.fit.free] if self.refit else []
        for depth in range(1, DEPTH + 1):
            if depth == 1 and not self.budget.allows("sets of 1 effect"):
                break
            self.budget.begin(f"sets of {depth}: added to {' and '.join(dict.fromkeys(map(_written, fronts)))}")
            self.extend(fronts)
            level = self.level(depth)
            if not level:
                break
            if depth == 1 and not any(h.rms < rules.FIRST * self.base.rms for h in level[:1]):
                self.budget.begin("no single effect improves the fit significantly")
            levels.append(level[0])
            least = min(levels[:-1], key=lambda h: h.rms)
            # at the nominal's own error there is nothing more to explain
            settled = level[0].reaches(self.own)
            helps = level[0].rms < rules.FIRST * least.rms
            if settled or (not helps and depth > 1) or not self.budget.allows(f"sets of {depth + 1} effects"):
                break
            fronts = level[:BEAM]
            if depth == 1 and not self.refit:
                fronts += [h for h in level[BEAM:] if h.names == (PARAMETERS,)]
        self._backward()
        self.fewer_moved()
        if not self.best().names and {*self.base.fit.free} > {*self.movable}:
            self.name_structures()

    def name_structures(self) -> None:
        """Search among the structures of a refit alone: what one adds to the nominal's own is an effect.

        Without a name, a lag behind the core closed 94 % of a gap that had no cause.
        """
        named: dict[frozenset, Hypothesis] = {}
        for h in self.linears:
            if {*h.fit.free} >= {*self.movable}:
                names = tuple(dict.fromkeys(_ADDED_BY[k] for k in h.fit.free if k not in self.movable))
                other = named.get(frozenset(names))
                # a lag and a filter have one name, and the filter one number more
                if other is None or needed(h, other) >= rules.SURE:
                    named[frozenset(names)] = replace(h, fit=h.fit.again(names=names), labels=names)
        own = named.setdefault(frozenset(), self.given)  # where a refit of the nominal's own structure diverged
        before = self.every, self.base, self.linear
        self.every, self.base, self.linear = named, own, own
        self.structural = bool(self.best().names)
        if self.structural:
            self.waiting.clear()
        else:
            self.every, self.base, self.linear = before

    def level(self, depth: int, without: Set[str] = frozenset()) -> list[Hypothesis]:
        """Return the hypotheses of `depth` effects that lack the effects in `without`, best first."""
        sets = [h for h in self.every.values() if len(h.names) == depth and not without & set(h.names)]
        return sorted(sets, key=lambda h: h.rms)

    def _backward(self) -> None:
        """Fit the best set without each of its effects, because the first may have replaced a later one."""
        best = self.best()
        if len(best.names) > 2:
            for name in best.names:
                key = frozenset(best.names) - {name}
                if key not in self.every:
                    self._again(best, key)

    def _again(self, whole: Hypothesis, key: frozenset) -> None:
        fit = whole.fit
        keep = [f for f in self.library if f.name in key]
        slots = self.base.fit.slots.copy()
        free = []
        moved = PARAMETERS in key or self.refit  # otherwise the set without them would change them unnamed
        others = [f for f in self.library if f.name in fit.names]
        for k in fit.free:
            linear = not any(k in f.start for f in others)
            if (moved and linear) or any(k in f.start for f in keep):
                slots[INDEX[k]] = fit.slots[INDEX[k]]
                free.append(k)
        names = tuple(n for n in fit.names if n in key)
        one = fit.anew(names=names, free=tuple(dict.fromkeys(free)), slots=slots)
        (done,) = self.fitter.fit([one], STEPS)
        done = min((done, self.waiting.get(key, done)), key=lambda f: f.cost)
        if np.isfinite(done.cost):
            self._settle([done])

    def best(self) -> Hypothesis:
        """Return the last set of effects, in order of size, that improves the fit significantly."""
        best, floor = self.base, self.own
        # over all that was tried, including sets of the backward step
        deepest = max(len(h.names) for h in self.every.values())
        for depth in range(1, deepest + 1):
            level = self.level(depth)
            if best.reaches(floor) or not level:
                break
            h, more = self._fewest_numbers(level), depth - len(best.names)
            ratio = rules.FURTHER**more if best.names else rules.FIRST * rules.FURTHER ** (depth - 1)
            # its size on these recordings, and P that it gains at all: draws may lack a stop that three of seven reach
            if h.rms <= ratio * best.rms and needed(h, best) >= rules.SURE:
                best = h
        return best

    def single(self) -> int | None:
        """Return the record that alone shows an effect which no draw of records makes certain; None if there is none.

            N = (sum_r |d_r|)^2 / sum_r d_r^2 < 2,   d_r = n_r log(MSE_r / MSE_r of the smallest set of all)

        A draw of n records lacks one of them with (1 - 1/n)^n > 1 - SURE, so what only one shows is never certain.
        """
        least = min(self.every.values(), key=lambda h: h.rms)
        whole = self.case.blocks == 1 and len(self.case.series) >= FEWEST_FOLDS
        if not whole or self.best().names or least.rms > rules.FIRST * self.base.rms:
            return None
        gains = self.base.evidence.bare.per_record - least.evidence.bare.per_record
        return int(np.argmax(gains)) if np.sum(np.abs(gains)) ** 2 < 2 * np.sum(gains**2) else None

    def _fewest_numbers(self, level: list[Hypothesis]) -> Hypothesis:
        """Return the best of equally large sets, or an equally good one with fewer or only linear parameters."""
        best = self._plainer(level, level[0], lambda h: PARAMETERS in h.names)
        if PARAMETERS in best.names:
            others = {*best.names} - {PARAMETERS}
            return self._plainer(level, best, lambda h: others <= {*h.names} and bool({*h.names} & {*LONE} - others))
        # fewer parameters win a tie, because they had less room to fit by chance
        as_good = (h for h in level if len(h.fit.free) < len(best.fit.free) and needed(best, h) < rules.SURE)
        return min(as_good, key=lambda h: (len(h.fit.free), h.rms), default=best)

    @staticmethod
    def _plainer(level: list[Hypothesis], best: Hypothesis, plain: Callable[[Hypothesis], bool]) -> Hypothesis:
        if plain(best):
            return best
        return next((h for h in level if plain(h) and needed(best, h) < rules.SURE), best)

    def steps(self, chosen: Hypothesis) -> list[Hypothesis]:
        """Return the hypotheses from the base model to the chosen set, one more effect each, the best first.

        Changed coefficients come last: beside an effect they take what its form lacks.
        """
        steps: list[Hypothesis] = [self.linear] if self.refit else []
        have: frozenset = frozenset()
        while have != frozenset(chosen.names):
            more = {*chosen.names} - have - {PARAMETERS} or {PARAMETERS}
            known = [h for h in (self.every.get(have | {n}) for n in more) if h is not None]
            step = min(known, key=lambda h: h.rms) if known else chosen
            # the last step ends at the chosen set, not at a similar one with other starts
            step = chosen if len(have) + 1 == len(chosen.names) else step
            steps.append(step)
            have = frozenset(step.names)
        return steps

    def without(self, names: Set[str], depth: int) -> None:
        """Search again for sets of at most `depth` effects without some effects, to find alternatives."""
        self.judge(1, names)
        for d in range(2, depth + 1):
            fronts = self.level(d - 1, names)[:BEAM]
            if fronts and self.budget.allows(f"rivals of {' and '.join(sorted(names))}"):
                self.extend(fronts, names)
            self.judge(d, names)


def _written(h: Hypothesis) -> str:
    return "+".join(h.labels) or "the linear model"


def _varied(fits: Sequence[Fit]) -> list[Fit]:
    """Order fits best first, with the k-th best of each form before the next one of any form."""
    turns: list[int] = []
    for n, f in enumerate(fits):
        turns.append(sum({*f.free} == {*g.free} for g in fits[:n]))
    return [fits[n] for n in sorted(range(len(fits)), key=lambda n: (turns[n], n))]


def _continued(fits: Sequence[Fit]) -> list[Fit]:
    """Return the best fits of two forms, and the best one with the fewest parameters, which wins a tie.

    `fits`: best first.
    """
    ordered = _varied(fits)
    plainest = min(ordered, key=lambda f: len(f.free), default=None)
    return [f for n, f in enumerate(ordered) if n < 2 or f is plainest]


def _distinct(fits: Sequence[Fit]) -> list[Fit]:
    """Remove fits that converged to the same result."""
    kept: list[Fit] = []
    for f in fits:
        if not any(set(f.free) == set(g.free) and abs(f.cost - g.cost) < 1e-4 * abs(g.cost) for g in kept):
            kept.append(f)
    return kept
