"""Check what was read, how each record starts, and whether the records suffice to identify and train a model.

    records (+ model) -> per record: initial state, offset, direction, noise, faults, input
                      -> over the set: coverage near the resonance, repeats, records that do not belong, advice

Verb: `check`. Without a model a linear model of order 2 is fitted without a message (`set_fit`);
`one_record.quick_problems` needs none.
"""
