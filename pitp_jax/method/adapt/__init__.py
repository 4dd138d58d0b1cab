"""Adapt a model: update a few parameters from a short recording of the same actuator on another day.

    measured = direction x(t; factors) + offset + noise,  factors on stiffness, damping, inertia, gain, electrode, creep

Verb: `adapt`; its verdict is `unchanged`, `adapted` (which parameters, by how much) or `retrain`.
"""
