"""Simulate a model: compute its displacement under a voltage (paper, eq. 7).

    x^(n) = (F - sigma_off - sum_{i<n} sigma_i x^(i)) / sigma_n,   RK4, tokens frozen over half a step ahead

Verbs: `rollout` (a voltage, in the rig's units), `predict` (whole sets of records, likewise), `decoder.rollout` (states
in the model's coordinates, pure and differentiable). `batched_rollout` is the same function, faster for many records;
`ports` applies the effects.
"""
