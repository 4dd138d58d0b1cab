"""All decision constants of the diagnosis, each with the evidence for its value.

P is the probability of being the best of the library, not of being right: a cause outside the library cannot be named.
Rates come from the studies in docs/decisions/verdict.md, of 27 saved decisions on measured machines unless stated.
"""

SURE = 0.9  # P required for every claim; 0.8: one more wrong effect of 27, 0.95: one right one lost
LIKELY = 0.5  # P from which a part of the returned model is called likely: better than not, not a claim
HARM = 1.25  # times the nominal's error: what a returned model may leave on a single recording
FIRST = 0.9  # of the linear model's error: what a first effect must reach
FURTHER = 0.8  # and each further effect, of the remaining error; 0.9: one more wrong
HALF = 0.5  # a deeper set with less than this fraction of a set's error: no effect is reported; without: one more wrong
LISTED = 0.1  # of the error closed: what an effect of a set must add to be reported; without: one more wrong
TWICE = 2.0  # times the error: what the best rival must exceed with few excitations; 1.2: one more wrong
EXCITATIONS = 4  # few are less distinct ones than this; frozen rule on 18 new machines: 5 right and 2 wrong for 5 and 6
OWN = 1.2  # times the nominal's own error: no gap up to there; at 1.5 an electrode's lag was read as a delay
SETTLED = 1.05  # times it: no gap without a search; up to OWN the first step of the search is looked at
WEAK = 0.95  # of the error: what a first effect must reach for a search between SETTLED and OWN
USUAL = 1.5  # times it: also no gap where nothing improves the fit; healthy sets of coloured noise have 0.9 to 1.3
PARTLY = 4.0  # times the nominal's own error: above, a verdict is at best partly; planted effects 1.0 to 1.8, a trap 13
GAIN = 0.02  # a smaller closed fraction of an error counts as none
TIED = 3  # effects at most that are reported as tied
