"""The model: one immutable pytree that is identified, trained, simulated, inverted, diagnosed and saved.

    F = sigma_off + sum_i sigma_i(S, m) x^(i),    F = map(V),  V = drive(u),    S = [x, ..., x^(n-1)]  (paper, eqs. 2-7)

Parts: encoder (features to tokens), memory (features beside S), input map (u^2 or u), drive (the electrodes), output
(sensor offset and direction), domain (range of the training data) and the effects of `method/effects`. A
`Fitted` is a model with its origin.
"""
