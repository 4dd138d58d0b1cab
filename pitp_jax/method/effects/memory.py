"""Forces with memory: creep and hysteresis (port K), and springs that change over a session (port T).

k = sigma_0 is the stiffness of the nominal model.

creep, relaxation   f = k kappa (x - z),  tau z' = x - z;  creep where tau omega_0 > 15, relaxation below
hysteresis          f = k kappa mean_j (x - z_j),  z_j plays of x                          (Prandtl and Ishlinskii)
                    f = k kappa z,  dz = dx (1 - sgn(dx) z / r)                            (Dahl)
                    f = k kappa z,  dz = dx (1 - (sgn(dx z) + gamma) |z| / r)              (Bouc and Wen, either sign)
                    f = k kappa mean_j z_j,  dz_j = dx (1 - sgn(dx z_j) (q + sharp (q^4 - q))),
                    q = |z_j| / r_j                                                        (Dahl at four widths)
stiffness_drift     f = -k d (1 - exp(-t / T)) x,  t the session's clock

A hysteresis loop has the same area at every speed. One that yields by less than a twentieth of the stroke before it
slides is dry friction.
"""

import jax.numpy as jnp

from .kernels import CLOCK, bouc_wen, dahl, lag, play, rounded
from .spec import EffectSpec, Parameter, signed, strength

_GIVE = 0.05  # of the stroke: contacts that give less before they slide are dry friction, others a hysteresis
_STRENGTH = strength("kappa")
_WIDTH = (_STRENGTH, Parameter("width", "x", length=1))


def _by_time(p, k, plant):
    """Name a memory "creep" if it is slow compared with the plant, otherwise "relaxation"."""
    return "creep" if p.tau > 15.0 * plant.tau else "relaxation", "one branch", (p.kappa, p.tau)


def _by_give(p, k, plant):
    """Name Dahl's loop dry friction with bristles if it yields little before it slides."""
    if p.width < _GIVE:
        return "coulomb_friction", "bristles", (k * p.kappa * p.width, p.width)
    return "hysteresis", "Dahl", (p.kappa, p.width)


def _loop(form: str, parameters: tuple, about: str, equation: str, **how) -> tuple[EffectSpec, EffectSpec]:
    """Return a loop as a hysteresis, and as the dry friction that it is if it yields little before it slides."""

    def named(p, k, plant):
        return "coulomb_friction" if p.width < _GIVE else "hysteresis", form, tuple(vars(p).values())

    loop, friction = (
        EffectSpec(name, form, parameters, about, equation, "dissipation", "K", reported=named, **how)
        for name in ("hysteresis", "coulomb_friction")
    )
    return loop, friction


def _branch(name: str, title: str, **how) -> EffectSpec:
    return EffectSpec(
        name, "one branch", (_STRENGTH, Parameter("tau", "s")), title,
        "f = k kappa (x - z), tau z' = x - z", "viscoelastic", "K",
        kernel=lag(), law=lambda p, now: now.k * p.kappa * (now.x - now.z[0]), reported=_by_time, stiffens=True, **how,
    )  # fmt: skip


_PLAYS = _loop(
    "plays", _WIDTH, "Internal friction of the material makes a loop that is the same at every frequency.",
    "f = k kappa mean_j (x - z_j), z_j plays of half width (0.15, 0.4, 1, 2.2) width",
    # widths about even in their logarithm, so that the loop is rounded as measured ones are, by one parameter
    kernel=play(0.15, 0.4, 1.0, 2.2), law=lambda p, now: now.k * p.kappa * (now.x - now.z).mean(),
)  # fmt: skip
_BOUC_WEN = _loop(
    # beyond its bounds gamma makes a spring of any shape
    "Bouc-Wen, either sign", (*_WIDTH, Parameter("gamma", positive=False, least=-1.5, most=1.5)),
    "A loop that gets softer with distance, or harder with gamma below -1.",
    "f = k kappa z, dz = dx (1 - (sgn(dx z) + gamma) |z| / width)",
    kernel=bouc_wen(), stiffens=True, law=lambda p, now: now.k * p.kappa * now.z[0],
)  # fmt: skip
STICKING = _PLAYS[1], _BOUC_WEN[1]
MEMORIES = (
    _branch("creep", "The actuator keeps yielding slowly under a held load.", second=("relaxation", "one branch")),
    _branch("relaxation", "Part of the spring gives way within a few periods, which also damps."),
    _PLAYS[0],
    EffectSpec(
        "hysteresis", "Dahl", _WIDTH,
        "A force that builds up over a distance after each reversal and then stays constant.",
        "f = k kappa z, dz = dx (1 - sgn(dx) z / width)", "dissipation", "K", kernel=dahl(),
        stiffens=True, reported=_by_give, law=lambda p, now: now.k * p.kappa * now.z[0],
    ),
    _BOUC_WEN[0],
    EffectSpec(
        # contains Dahl's loop (spread 1, sharp 0), and nearly the plays (sharp 1)
        "hysteresis", "Dahl at four widths",
        (
            _STRENGTH, Parameter("width", "x", length=1, least=_GIVE),
            Parameter("sharp", most=1.0), Parameter("spread", least=1.0, most=5.0),
        ),
        "A loop of any roundness, as of a material whose parts begin to slide after different distances.",
        "f = k kappa mean_j z_j, dz_j = dx (1 - sgn(dx z_j) (q + sharp (q^4 - q))), q = |z_j| / r_j, "
        "r_j = width spread^(-1.5, -0.5, 0.5, 1.5)",
        "dissipation", "K", kernel=rounded(-3, -1, 1, 3), stiffens=True,
        law=lambda p, now: now.k * p.kappa * now.z.mean(),
    ),
    EffectSpec(
        "stiffness_drift", "settling", (signed("d"), Parameter("time", "s")),
        "The stiffness changes during the session, and settles.", "f = -k d (1 - exp(-t / time)) x", "drift", "T",
        kernel=CLOCK, law=lambda p, now: now.k * p.d * jnp.expm1(-now.z[0] / p.time) * now.x,
    ),
)  # fmt: skip
