"""Choose between networks, physical effects, or both, by the error on excitations that were left out.

    records -> encoder | physical | both, each fitted without one excitation in turn -> errors on it -> one of them

Of the structures that predict as well as the best one, the one with the fewest parameters is chosen.
"""
