"""The numbers that decide, all of them, and what each was set on.

P is "best of the library", not the chance of being right: what is no form of the library is named by nothing here.
Rates are those of the studies in docs/decisions/verdict.md, of 27 saved decisions on measured machines unless said.
"""

SURE = 0.9  # P asked of every claim; 0.8: one more wrong name of 27, 0.95: one right one lost
LIKELY = 0.5  # P from which a part of the model that is handed back is called likely: better than not, no claim
FIRST = 0.9  # of the linear model's error: what a first name must reach
FURTHER = 0.8  # and each further name, of what was left; 0.9: one more wrong
HALF = 0.5  # a deeper set that leaves less than this of a set's error: nothing is said yet; without: one more wrong
LISTED = 0.1  # of the energy closed: what a name of a set must add to be told; without: one more wrong
TWICE = 2.0  # error that the best rival must leave where there are few excitations; 1.2: one more wrong
EXCITATIONS = 4  # below so many distinct ones; frozen rule on 18 unseen machines: 5 right and 2 wrong for 5 and 6
OWN = 1.2  # times the nominal's own error: no gap up to there; at 1.5 an electrode's lag was read as a delay
LEFT = 4.0  # times the nominal's own error that "explained" may leave; planted effects left 1.0 to 1.8, a wrong set 13
GAIN = 0.02  # what closes less of an error explains nothing of it
TIED = 3  # names at most that are told as tied
