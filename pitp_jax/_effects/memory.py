"""Add forces that remember (port K) and springs that change over a session (port T), k = sigma_0 of the nominal.

creep, relaxation   f = k kappa mean_i (x - z_i),  or, beside a nominal that is the fresh film,  -k kappa mean_i z_i
                    tau_i z_i' = x - z_i;  creep where tau omega_0 > 15, relaxation below: near the border they are tied
hysteresis          f = k kappa mean_j (x - z_j),  z_j plays of x                          (Prandtl and Ishlinskii)
                    f = k kappa z  or  k kappa (z - x),  dz = dx (1 - sgn(dx) z / r)       (Dahl; Bouc and Wen)
                    f = k kappa z,  dz = dx (1 - |z / r|^n) on loading, dx on unloading    (Wen, beta = gamma)
                    f = k kappa z,  dz = dx (1 - (sgn(dx z) + gamma) |z| / r)              (Bouc and Wen, either sign)
stiffness_drift     f = -k d (1 - exp(-t / T)) x  or  -k rate t x,  t the session's clock

A loop of hysteresis has the same area however fast it is run through.
"""

import jax.numpy as jnp

from .kernels import CLOCK, bouc_wen, dahl, lags, play
from .spec import EffectSpec, Parameter

_STRENGTH = Parameter("kappa", off=0.0)
_BRANCH = (_STRENGTH, Parameter("tau", "s"))
_WIDTH = (_STRENGTH, Parameter("width", "x", length=1))


def _branches(name: str, form: str, title: str, *ratios: float, fresh: bool = False) -> EffectSpec:
    """Build one row of creep or relaxation; `fresh`: the nominal is the film before it gave way."""
    pull = "-z_i" if fresh else "x - z_i"
    return EffectSpec(
        name, form, _BRANCH, title, f"f = k kappa mean_i ({pull}), tau_i z_i' = x - z_i, tau_i = tau {ratios}",
        "viscoelastic", "K", kernel=lags(*ratios),
        law=lambda p, now: now.k * p.kappa * (-now.z if fresh else now.x - now.z).mean(),
    )  # fmt: skip


BRANCHES = (
    _branches("creep", "one branch", "The actuator keeps yielding slowly under a held load.", 1.0),
    _branches("creep", "three branches", "It keeps yielding over three decades of time.", 0.2, 1.0, 5.0),
    _branches("creep", "loss of stiffness", "The spring slowly gives way while it is stretched.", 1.0, fresh=True),
    _branches("relaxation", "one branch", "Part of the spring gives way within a few periods, which also damps.", 1.0),
    _branches("relaxation", "three branches", "Parts of the spring give way at three speeds.", 0.25, 1.0, 4.0),
    _branches("relaxation", "loss of stiffness", "The spring gives way within a period.", 1.0, fresh=True),
)
LOOPS = (
    EffectSpec(
        "hysteresis", "plays", _WIDTH, "Rubbing inside the material makes a loop that is the same at every frequency.",
        "f = k kappa mean_j (x - z_j), z_j plays of half width (0.15, 0.4, 1, 2.2) width", "dissipation", "K",
        costly=True,
        # widths about evenly apart in their logarithm: the loop is rounded like a real one, by four numbers in one
        kernel=play(0.15, 0.4, 1.0, 2.2),
        law=lambda p, now: now.k * p.kappa * (now.x - now.z).mean(),
    ),
    EffectSpec(
        "hysteresis", "Dahl", _WIDTH, "A force that builds up over a distance after each turn and then stays.",
        "f = k kappa z, dz = dx (1 - sgn(dx) z / width)", "dissipation", "K", costly=True, kernel=dahl(),
        stiffens=True, law=lambda p, now: now.k * p.kappa * now.z[0],
    ),
    EffectSpec(
        "hysteresis", "Bouc-Wen", _WIDTH, "Part of the spring yields and slips.",
        "f = k kappa (z - x), dz = dx (1 - sgn(dx) z / width)", "dissipation", "K", costly=True, kernel=dahl(),
        law=lambda p, now: now.k * p.kappa * (now.z[0] - now.x),
    ),
    EffectSpec(
        "hysteresis", "Wen", (*_WIDTH, Parameter("sharpness")),
        "A spring that yields as smoothly or sharply as n says.",
        "f = k kappa z, dz = dx (1 - |z / width|^n) on loading, dx on unloading, n = sharpness", "dissipation", "K",
        costly=True, kernel=bouc_wen(lambda p: 1.0, lambda p: 0.0, lambda p: p.sharpness),
        law=lambda p, now: now.k * p.kappa * now.z[0],
    ),
    EffectSpec(
        # beyond its bounds gamma makes a spring of any shape
        "hysteresis", "Bouc-Wen, either sign", (*_WIDTH, Parameter("gamma", positive=False, least=-1.5, most=1.5)),
        "A loop that gets softer, or with gamma below -1 harder, the further it is run through.",
        "f = k kappa z, dz = dx (1 - (sgn(dx z) + gamma) |z| / width)", "dissipation", "K", costly=True,
        kernel=bouc_wen(lambda p: p.gamma + 1, lambda p: p.gamma - 1, lambda p: 1.0), stiffens=True,
        law=lambda p, now: now.k * p.kappa * now.z[0],
    ),
)  # fmt: skip


DRIFT = (
    EffectSpec(
        "stiffness_drift", "settling", (Parameter("d", positive=False, off=0.0), Parameter("time", "s")),
        "The stiffness changes as the session goes on, and settles.", "f = -k d (1 - exp(-t / time)) x", "drift", "T",
        costly=True, kernel=CLOCK, law=lambda p, now: now.k * p.d * jnp.expm1(-now.z[0] / p.time) * now.x,
    ),
    EffectSpec(
        "stiffness_drift", "steady", (Parameter("rate", "1/s", positive=False, off=0.0),),
        "The stiffness changes steadily over the session.", "f = -k rate t x", "drift", "T", costly=True, kernel=CLOCK,
        law=lambda p, now: -now.k * p.rate * now.z[0] * now.x,
    ),
)  # fmt: skip
