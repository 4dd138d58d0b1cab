"""Identify linear models: fit an ODE of the smallest sufficient order to recordings.

    sum_i a_i x^(i) = u^2 (or u),    min over a, offsets and initial states of sum (y - x)^2   (output error; tfest)

Verb: `identify`. Starts come from the frequency response (`frequency_response`, `frequency_fit`) or ARX (`starts`);
order, delay and hold are chosen together by blocks left out (`heldout`, `candidates`).
"""
