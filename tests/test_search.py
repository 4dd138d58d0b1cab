"""The order of a search: what is refitted without folds, and what its first steps must not drop."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from played import nominal_of, play

from pitp_jax.method.diagnose import diagnosis, handing_back
from pitp_jax.method.diagnose.budget import Budget
from pitp_jax.method.diagnose.clocks import Fault
from pitp_jax.method.diagnose.data import build_case, excitations
from pitp_jax.method.diagnose.evidence import evidence
from pitp_jax.method.diagnose.fit import PREVIEW, Fit
from pitp_jax.method.diagnose.gap import gap_of, out_of_fold
from pitp_jax.method.diagnose.library import EARLY, INDEX, LAG, MONITOR, NAMES, Form, slots_of_row
from pitp_jax.method.diagnose.search import PARAMETERS, STEPS, Hypothesis, Search
from pitp_jax.method.diagnose.verdict import Decision
from pitp_jax.method.effects import lookup

SAMPLES = 1000


def fit_of(*names, cost=np.inf):
    return Fit(names, (), np.zeros(1), np.zeros((1, 2)), cost=cost, residuals=[np.full(SAMPLES, cost)])


def bare_search() -> Any:
    """A search without a case, in which a residual's size is its error."""
    search: Any = object.__new__(Search)
    search.every, search.waiting, search._climbed, search.exclude = {}, {}, set(), set()
    search.samples, search.budget, search.refit = SAMPLES, Budget(), False
    search.others, search.linears, search.library = {}, [], []
    search.weigh = lambda rows: evidence(rows, np.zeros(1))
    search.labels = lambda fit: fit.names
    return search


def hypothesis(fit, error) -> Hypothesis:
    return Hypothesis(fit, fit.names, [], evidence([np.full(SAMPLES, error)], np.zeros(1)))


@pytest.mark.parametrize("seed", range(5))
def test_the_best_three_out_of_fold_are_found_without_refitting_all(seed):
    """Fits leave more out of fold than in sample, each by a factor of its own."""
    rng = np.random.default_rng(seed)
    inside = rng.uniform(1.0, 10.0, 30)
    outside = dict(enumerate(inside * rng.uniform(1.0, 1.3, 30)))
    search, refitted = bare_search(), []

    def scored(fits):
        refitted.extend(f.names[0] for f in fits)
        return [hypothesis(f, outside[int(f.names[0])]) for f in fits]

    search._scored = scored
    search.waiting = {frozenset([str(k)]): fit_of(str(k), cost=e) for k, e in enumerate(inside)}
    search.judge(1)
    wanted = sorted(outside, key=lambda k: outside[k])[:3]
    assert [int(h.names[0]) for h in search.level(1)[:3]] == wanted
    assert len(refitted) < 15
    # of those that lack the best the three best as well
    best = search.level(1)[0].names[0]
    search.judge(1, {best})
    wanted = sorted(outside, key=lambda k: outside[k])[1:4]
    assert [int(h.names[0]) for h in search.level(1, {best})[:3]] == wanted


def test_the_best_four_go_to_their_optimum_whatever_their_first_steps_gain():
    """Six hypotheses; after the first steps all leave more than the base, at their optimum all leave less."""
    search, to_the_end = bare_search(), []
    search.every = {frozenset(): hypothesis(fit_of(cost=0.0), 1.0)}
    search.every[frozenset()].fit.residuals = [np.ones(SAMPLES)]
    search.floors, search.misfit, search.samples = np.zeros(1), 0.0, SAMPLES

    def fitted(fits, iterations):
        for f in fits:
            f.cost = float(f.names[0]) * (1 if iterations < STEPS else -1)
            f.residuals = [np.full(SAMPLES, np.exp(0.5 * f.cost))]
        if iterations == STEPS:
            to_the_end.extend(f.names[0] for f in fits)

    search.fitter = SimpleNamespace(fit=fitted)
    search._climb({frozenset([n]): [fit_of(n)] for n in "615243"})
    assert sorted(to_the_end) == list("1234")
    assert set(search.waiting) == {frozenset(n) for n in "1234"}


def test_what_fits_all_recordings_goes_on_whatever_fits_a_few():
    """In a sweep with a jump resonance the right form of a spring was the fifth best, in all records the best."""
    few, every = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0, "e": 9.0}, {"a": 4.0, "b": 3.0, "c": 2.0, "d": 1.0, "e": 9.0}
    search, to_the_end = bare_search(), []
    search.every = {frozenset(): hypothesis(fit_of(cost=9.0), 9.0)}
    search.floors, search.misfit = np.zeros(1), 0.0

    def fitted(fits, iterations):
        for f in fits:
            f.cost = (few if f.fold == PREVIEW else every)[f.free[0]]
            f.residuals = [np.full(SAMPLES, np.exp(0.5 * f.cost))]
        if iterations == STEPS:
            to_the_end.extend(f.free[0] for f in fits)

    search.fitter = SimpleNamespace(fit=fitted)
    search._plainest = lambda forms: forms[0]
    starts = [replace(fit_of("spring"), free=(k,), slots=np.zeros(len(NAMES)), unit=np.ones(1)) for k in "abcde"]
    search._climb({frozenset(["spring"]): starts})
    assert sorted(to_the_end) == ["c", "d"]


def test_the_form_of_a_first_effect_is_exchanged_once_a_second_is_there():
    """Alone a polynomial beat the right spring, a limited chain, because it took a part of a friction."""
    search = bare_search()
    search.floors, search.misfit, chain = np.zeros(1), 0.0, "stiffening: limited chain, curvature"
    polynomial = tuple(k for k in NAMES if k.startswith("stiffening: polynomial"))
    friction = tuple(k for k in NAMES if k.startswith("coulomb_friction: smooth"))

    def fit(names, values, cost):
        slots = np.zeros(len(NAMES))
        slots[[INDEX[k] for k in values]] = [*values.values()]
        return Fit(names, tuple(values), slots, np.zeros((1, 2)), cost=cost, residuals=[np.full(SAMPLES, cost)])

    alone = fit(("spring",), dict.fromkeys(polynomial, 0.1), 0.070)
    other = fit(("spring",), {chain: 0.3}, 0.081)
    both = fit(("spring", "coulomb_friction"), dict.fromkeys((*polynomial, *friction), 0.2), 0.011)
    search.others = {frozenset(["spring"]): [alone, other]}

    def fitted(fits, iterations):
        for f in fits:
            assert f.value(chain) == 0.3 and all(f.value(k) == 0.2 for k in friction)
            assert not any(f.value(k) for k in polynomial)
            f.cost, f.residuals = 0.007, [np.full(SAMPLES, 0.007)]

    search.fitter = SimpleNamespace(fit=fitted)
    (found,) = search._on_other_fronts([both])
    assert found.cost == 0.007 and {*found.free} == {chain, *friction}


def compared(*improved: int, names: str = "abcde", blocks: int = 1) -> Any:
    """A search over records of these names, in which one set has a third of the base's error on some of them."""
    search, size = bare_search(), len(names)

    def scored(fit, *helped: int) -> Hypothesis:
        rows = [np.full(SAMPLES, 0.3 if k in helped else 1.0) for k in range(size)]
        return Hypothesis(fit, fit.names, rows, evidence(rows, np.zeros(size)))

    search.base, search.own = scored(fit_of()), 0.0
    search.case = SimpleNamespace(blocks=blocks, series=names)
    search.every = {frozenset(): search.base, frozenset(["clip"]): scored(fit_of("clip"), *improved)}
    return search


def test_a_set_that_improves_one_of_many_records_is_judged_on_parts():
    """Every third draw of five records lacks the fifth, so nothing that it alone shows can be certain."""
    assert compared(4).single() == 4
    assert compared(4).best().names == () and compared(0, 1, 2, 3, 4).best().names == ("clip",)
    assert compared(3, 4).single() is None and compared().single() is None and compared(0, 1, 2, 3, 4).single() is None
    accepted: Any = compared(4)
    accepted.best = lambda: SimpleNamespace(names=("clip",))
    assert accepted.single() is None
    # parts of fewer than four recordings are left out already
    assert compared(1, names="abc").single() is None and compared(4, blocks=4).single() is None


def sized(errors: dict[tuple[str, ...], list[float]]) -> Any:
    """A search that has tried sets of these errors, one for every record; the set without names is its base."""
    search, size = bare_search(), len(next(iter(errors.values())))
    for names, row in errors.items():
        rows = [np.full(SAMPLES, e) for e in row]
        made = Hypothesis(fit_of(*names), names, rows, evidence(rows, np.zeros(size)))
        search.every[frozenset(names)] = made
    search.base, search.own = search.every[frozenset()], 0.0
    search.case = SimpleNamespace(blocks=1, series=range(size))
    return search


def test_what_three_of_seven_recordings_show_is_a_further_effect():
    """One draw in eight holds fewer than two of the three: the gain there is smaller, and still a gain."""
    stop, three = [0.3] * 4, [0.1] * 3
    search = sized({(): [1.0] * 7, ("lag",): [0.3] * 7, ("lag", "stop"): stop + three})
    assert search.best().names == ("lag", "stop")
    # of a size that does not count it is not accepted, however certain
    small = sized({(): [1.0] * 7, ("lag",): [0.3] * 7, ("lag", "stop"): [0.26] * 7})
    assert small.best().names == ("lag",)


def test_changed_coefficients_are_the_last_step_of_a_set():
    """They close more than the effect, but only the effect's own form is lacking."""
    search = sized({(): [1.0], (PARAMETERS,): [0.3], ("drag",): [0.5], (PARAMETERS, "drag"): [0.2]})
    steps = search.steps(search.every[frozenset([PARAMETERS, "drag"])])
    assert [h.names for h in steps] == [("drag",), (PARAMETERS, "drag")]


@pytest.mark.parametrize(("second", "kept"), [(0.56, ("friction",)), (0.5, ("friction", "clip"))])
def test_a_part_more_is_handed_back_where_it_predicts_a_tenth_better(second, kept):
    search = sized({(): [1.0] * 4, ("friction",): [0.6] * 4, ("friction", "clip"): [second] * 4})
    bare = search.base.evidence
    decision = Decision("unknown", search.base, (), {}, {}, {}, bare, bare, 0.0)
    assert handing_back._largest(search, decision).names == kept


@pytest.mark.parametrize(("returned", "before", "closed"), [((), 1.0, 0.0), (("spring",), 0.5, 0.6)])
def test_a_gap_is_that_of_what_is_handed_back(returned, before, closed):
    """A refit halves the error and is not handed back: the error remains, and -100 % was closed."""
    search = sized({(): [0.5] * 4, ("spring",): [0.2] * 4})
    rows = [np.full(SAMPLES, 1.0)] * 4
    search.given = Hypothesis(fit_of(), (), rows, evidence(rows, np.zeros(4)))
    search.case.series = [SimpleNamespace(span=100.0)] * 4
    handed = search.every[frozenset(returned)] if returned else search.given
    decision = Decision("unknown", search.base, (), {}, {}, {}, search.given.evidence, search.base.evidence, 0.0)
    found = gap_of(search, decision, out_of_fold(search, handed), 0.0, "")
    assert (found.before, found.closed_fraction) == pytest.approx((before, closed))
    assert found.explainable == pytest.approx(0.2)


RC, LOW_PASS = "electrode_rc: one lag, tau", {MONITOR: 0.02}


@pytest.mark.parametrize(
    ("found", "refit", "fault"),
    [
        ({EARLY: 0.013, RC: 0.001}, False, Fault(early=0.013)),
        ({EARLY: 0.001, RC: 0.013}, False, Fault()),  # the second section of an electrode's lag
        (LOW_PASS, False, Fault(lag=0.02)),
        (LOW_PASS, True, Fault()),  # a zero of the plant
    ],
)
def test_only_what_a_machine_cannot_do_is_a_fault_of_the_recordings(linear, monkeypatch, found, refit, fault):
    """Each lead is certain; beside a longer lag, or in a refit, a machine answers in the same way."""
    slots = np.zeros(len(NAMES))
    for name, value in found.items():
        slots[INDEX[name]] = value
    best = hypothesis(Fit(("clock_shift",), tuple(found), slots, np.zeros((1, 2))), 1.0)
    search = bare_search()
    search.best, search.case = lambda: best, SimpleNamespace(nominal=np.zeros(len(NAMES)))
    outcome = diagnosis._Searched(search, 4, 0.0, 0.0, 0.0, "", False)
    monkeypatch.setattr(diagnosis, "_searched", lambda *given: outcome)
    monkeypatch.setattr(diagnosis, "rival_without", lambda *given: best)
    monkeypatch.setattr(diagnosis, "needed", lambda *given: 1.0)
    nominal = nominal_of(linear)
    records = play(nominal)[:1]
    _, taken, left = diagnosis._searched_without_fault(nominal, records, refit, (), Budget())
    assert taken == fault and (left[0] is records[0]) == (fault == Fault())


@pytest.fixture(scope="module")
def recorded(linear):
    """A nominal and five of its records."""
    nominal = nominal_of(linear)
    return nominal, play(nominal)[:5]


def test_parts_that_are_left_out_cover_every_record_once(recorded):
    case = build_case(*recorded)
    parts = case.in_parts()
    assert case.blocks == 1 and parts.blocks == len(parts.folds) == 4
    tested = np.array([[m.sum() for m in parts.tested(fold)] for fold in range(4)])
    np.testing.assert_array_equal(tested.sum(0), [s.counts.sum() for s in case.series])
    assert np.all(np.abs(tested - tested.mean(0)) < 1)
    for fold in range(4):  # and a fit without them does not use them
        masks = zip(parts.masks(fold), parts.tested(fold), strict=True)
        assert all(not np.any((mask > 0) & left_out) for mask, left_out in masks)


@pytest.mark.parametrize(("time", "lag"), [(0.6, 1.4), (2.0, 0.2), (5.0, 0.2)])
def test_an_added_time_is_subtracted_from_the_lag_of_the_core(time, lag):
    """At small amplitudes their sum stays; a tenth of the lag is left, which can vanish or grow."""
    slots = np.zeros(len(NAMES))
    slots[[0, 1, 2, INDEX[LAG]]] = 1.0, 0.1, 0.01, 2.0
    electrode, friction = "electrode_rc: one lag", "coulomb_friction: Coulomb"
    given = (
        ((LAG,), electrode, lag),
        ((), electrode, 2.0),
        ((LAG,), friction, 2.0),
        ((LAG,), "sensor_lag: one lag", time),
    )
    for free, key, left in given:
        spec = lookup(*key.split(": "))
        start = {name: time for name in slots_of_row(spec)}
        front = Fit((), ("a0", "a1", "a2", *free), slots.copy(), np.zeros((1, 2)))
        found = Search._started(bare_search(), front, Form(spec.name, spec, start))
        assert found.value(LAG) == pytest.approx(left) and front.value(LAG) == 2.0
        assert [found.value(k) for k in start] == [time]


@pytest.mark.slow
def test_a_linear_model_of_each_recording_is_a_rival_where_parts_are_left_out(recorded):
    case = build_case(*recorded)
    whole, parts = (Search(c, False, (), Budget(), 0.0, 0.0).each_alone() for c in (case, case.in_parts()))
    assert whole is None and parts is not None and np.all(np.isfinite(parts.mse))


@pytest.mark.parametrize("accepted", [("clip",), ()])
def test_a_search_on_parts_counts_only_if_it_accepts_a_set(recorded, monkeypatch, accepted):
    """Otherwise the search that leaves out whole recordings is judged, as before."""

    class Found(Search):
        def __init__(self, case, *_):
            self.case, self.own, self.misfit = case, 0.0, 0.0
            self.given: Any = SimpleNamespace(reaches=lambda own: False)

        def run(self):
            pass

        def single(self):
            return 3 if self.case.blocks == 1 else None

        def best(self) -> Any:
            return SimpleNamespace(names=accepted if self.case.blocks == 4 else ())

    monkeypatch.setattr(diagnosis, "Search", Found)
    limit = Budget()
    found = diagnosis._searched(recorded[0], recorded[1], False, (), limit)
    case = build_case(*recorded)
    all_of_them, one = excitations(case), excitations(case.alone([3]))
    assert one < all_of_them
    assert (found.search.case.blocks, found.distinct) == ((4, one) if accepted else (1, all_of_them))
