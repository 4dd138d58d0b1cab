"""Adapt: a model of an actuator and a short recording of it on another day -> the same model, a few numbers moved.

    measured = direction x(t; factors) + zero + noise,    factors on stiffness, damping, inertia, gain, electrode, creep

Verb: `adapt`; it says `unchanged`, `adapted` (which numbers, by how much) or `retrain`.
"""

from .adaptation import Adaptation as Adaptation
from .adaptation import adapt as adapt
