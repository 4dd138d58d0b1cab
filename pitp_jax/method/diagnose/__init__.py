"""Diagnose a model: where it disagrees with recordings, which effect is missing, how much that explains.

    sum_i a_i x^(i) = coupling(V, x) - f_effect(x, x', states),   every candidate set scored out of fold

Verb: `diagnose`. Steps: thinned records (`data`) -> a simulator with a slot for every effect (`simulator`, `library`)
-> fits on whole free runs (`fit`) -> a search of candidate sets (`search`) and a flexible reference (`reference`),
compared by a bootstrap (`evidence`) -> verdict (`verdict`, `rules`), returned model (`handing_back`) with its parts
(`parts`), gap (`gap`) and budget (`shares`); `report/` draws it.
"""
