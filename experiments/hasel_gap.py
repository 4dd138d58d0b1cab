"""Diagnosis on a measured Peano-HASEL actuator: what the model trained on slow motion misses at 7 Hz.

    1. nominal: order 2, identified on the small steps; diagnosed on large steps and the 3 Hz sine; scored at 7 Hz
    2. trained on the steps and 3 Hz, then diagnosed on 3 and 7 Hz halves: what is left
    3. the commanded voltage as input: what the amplifier did, beside the voltage that was measured

    python experiments/hasel_gap.py [--data ../shared] [--parts 1,2,3] [--smoke]

The load is only pulled: once the film lets go it falls freely. That can be seen without any model, in the acceleration
of the record itself, whose distribution is cut at -g on one side only; the script prints it.
"""
