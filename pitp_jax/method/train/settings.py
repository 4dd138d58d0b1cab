"""Settings of a training: presets, and the parts of a model that they select.

settings + nominal -> memory (time constants), encoder (at the nominal), drive (its first lag) and other lags
                      learned with it, prior weight of the nets

The figures behind each default stand in docs/decisions/training.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...common.errors import refuse_if
from ..effects import lookup
from ..effects.physical import in_scales
from ..model.dominant import has_spring
from ..model.drive import ElectrodeLag
from ..model.encoder import CompactEncoder, PaperEncoder
from ..model.memory import AbstractMemory, ElapsedTime, FadingMemory, NoMemory, RingingMemory
from ..model.model import Model
from ..model.own_encoder import build_own
from ..signal.derivative import DIFFERENCES
from ..signal.long_record import LongRecord
from ..signal.preprocess import StateRecord
from .dataset import Dataset
from .second_resonance import second_mass

_WORDS = {
    "encoder": ("compact", "paper", "own"),
    "memory": ("fading", "elapsed", "none"),
    "drive": ("electrode", "direct"),
    "scaling": ("rms", "paper"),
    "difference": tuple(DIFFERENCES),
}


PARTS = {name: lookup(name) for name in ("delay", "sensor_lag")}


@dataclass(frozen=True)
class Settings:
    """The settings of a training. Brackets hold the paper's symbols (Algorithm 1, III-D).

    Tokens are the coefficients of the equation of motion, which the encoder computes from the state; the physics
    residual is what this equation leaves of the force on the recordings (eq. 12).

    Attributes:
        encoder: "compact", "paper", or "own", which `train(..., encoder=MODULE)` sets.
        width: hidden size of the compact encoder's nets.
        offset: whether the compact encoder has an offset token.
        few: below this number of records with a squared input, the compact encoder is smaller (`frugal`): damping
            independent of memories, one coupling for all tokens.
        memory: "fading" (the displacement behind low passes; none for a plant without a spring, whose compact encoder
            does not see x either), "elapsed" (the time since the start) or "none".
        memories: number of fading memories, log-spaced from 2 / omega_0 (the nominal's natural frequency, rad/s) to the
            longest record, or to a quarter of the nominal's stored record if that is longer than training
            (`creep_balance`).
        ringing: whether to test for a second mass along the motion (`second_resonance`).
        drive: "electrode" (a learned lag before the square, if there is a square, initially 0.1 / omega_0) or "direct".
        parts: further learned parts between amplifier and sensor, initially 0.1 / omega_0: "delay", "sensor_lag".
        scaling: "rms" (training rms of each derivative) or "paper" (eq. 3).
        difference: "stencil" (8th order) or "central" (eq. 8).
        epochs [n], rate [lr]: epochs and learning rate of the first stage; every stage multiplies them by decay_epochs
            [r] and decay_rate [c].
        widen [a], narrow [b]: by these a stage multiplies the upper and the lower bound of every coefficient, which
            begin at the nominal's.
        penalty [alpha, beta]: weights of a coefficient above its upper and below its lower bound.
        stages: largest number of stages.
        tolerance [epsilon]: another stage follows only if a stage lowers the physics residual by this fraction.
        huber: width of SmoothL1 in units of the largest force.
        batch: minibatch size.
        refine_steps: largest number of Levenberg-Marquardt steps (Jacobians) on free runs.
        starts: largest number of starts of the free runs, if the first makes a record worse than the nominal or
            converges badly.
        firmness: prior weight of the nets of spring and damping in the free runs, in (1 %)^2; every other parameter has
            1e-4. Default: 1e-4; with `few` records and a squared input 0.06 over their number, because the error is a
            mean over records; 1e-3 for a linear input, where it extrapolates in amplitude.

    Raises:
        BadInput: an unknown word.
    """

    encoder: str = "compact"
    width: int = 8
    offset: bool = True
    few: int = 8
    memory: str = "fading"
    memories: int = 5
    ringing: bool = True
    drive: str = "electrode"
    parts: tuple[str, ...] = ()
    scaling: str = "rms"
    difference: str = "stencil"
    epochs: int = 8
    decay_epochs: float = 0.971
    rate: float = 3e-3
    decay_rate: float = 0.6
    widen: float = 1.5
    narrow: float = 0.6
    penalty: tuple[float, float] = (0.1, 0.1)
    stages: int = 4
    tolerance: float = 0.01
    huber: float = 0.05
    batch: int = 2048
    refine_steps: int = 40
    starts: int = 3
    firmness: float | None = None

    def __post_init__(self):
        """Refuse unknown words in the settings, which would silently act as the default."""
        for name, known in _WORDS.items():
            word = getattr(self, name)
            refuse_if((word not in known, f"settings: {name} {word!r} is unknown; use one of {', '.join(known)}"))
        for part in self.parts:
            refuse_if((part not in PARTS, f"settings: part {part!r} is unknown; use {' or '.join(PARTS)}"))


PRESETS = {
    "default": Settings(),
    "paper": Settings(
        encoder="paper", memory="elapsed", drive="direct", scaling="paper", difference="central", epochs=10, rate=1e-3,
        decay_rate=0.8, widen=1.2, narrow=0.8, penalty=(2.0, 2.0), huber=1.0, refine_steps=0, stages=8,
    ),
}  # fmt: skip


def preset_of(name: str) -> Settings:
    """Return the preset of this name; refuse an unknown name."""
    refuse_if((name not in PRESETS, f"unknown preset {name!r}; use one of {', '.join(PRESETS)}"))
    return PRESETS[name]


def memory_of(
    settings: Settings, nominal: Model, long: LongRecord | None, states: Sequence[StateRecord]
) -> AbstractMemory:
    """Build the memory that the settings ask for; time constants run from the resonance to the longest record.

    A `long` record extends them to a quarter of its length, in which a lag can settle. A second mass is added if the
    motion shows one.
    """
    longest = max(len(s.time) * s.dt for s in states)
    # a lag as long as the record would be a ramp in it, and no sample would show its final value
    if long is not None:
        longest = max(longest, long.seconds / 4)
    if settings.memory == "elapsed":
        return ElapsedTime(horizon=float(longest))
    if settings.memory == "none":
        return NoMemory()
    # a lag faster than the resonance is only x and x', which the encoder already sees
    tau = np.geomspace(min(2.0 / nominal.natural_frequency, longest / 20), longest, settings.memories)
    lags = jnp.asarray(np.log(tau), jnp.float32)
    # before any training, because nets trained without the mode have already imitated it
    mass = second_mass(states, nominal.natural_frequency, tau) if settings.ringing else None
    if mass is None:
        return FadingMemory(lags)
    omega, zeta = jnp.log(jnp.asarray(mass[:2], jnp.float32))
    return RingingMemory(omega, zeta, lags)


def firmness_of(settings: Settings, model: Model, records: int) -> float:
    """Return the prior weight of spring and damping nets: larger for a linear input, largest for few records."""
    if settings.firmness is not None:
        return settings.firmness
    if isinstance(model.encoder, CompactEncoder) and model.encoder.frugal:
        return 0.06 / records  # the error is a mean over records: fewer carry less information
    return 1e-4 if model.input_map.one_sided else 1e-3


def with_drive(model: Model, settings: Settings) -> Model:
    """Return the model with an initial electrode lag for simulations; the equation error ignores this lag.

    Without a square after it, a lag is one more linear pole, which the order already includes.
    """
    if settings.drive != "electrode" or not model.input_map.one_sided:
        return model
    # a tenth of a radian of the resonance: short enough to change little, long enough to have a slope
    lag = ElectrodeLag(jnp.asarray(np.log(0.1 / model.natural_frequency), jnp.float32))
    return eqx.tree_at(lambda m: m.drive, model, lag)


def with_parts(model: Model, nominal: Model, settings: Settings) -> Model:
    """Return the model with its initial electrode lag, the nominal model's effects, and the parts in the settings.

    An effect present from the start is fitted with the encoder, so that the nets need not learn it.
    """
    begin = jnp.asarray(0.1 / nominal.natural_frequency, jnp.float32)
    old, new = nominal.scales, model.scales
    # training has its own scales; an effect's parameters are stored in those of its model
    given = tuple(in_scales(e, (old.state, old.force), (new.state, new.force)) for e in nominal.effects)
    present = {e.name for e in given}  # a second delay beside the nominal's would leave both undetermined
    effects = (*given, *(PARTS[part](begin) for part in settings.parts if part not in present))
    return replace(with_drive(model, settings), effects=effects)


def with_encoder(data: Dataset, settings: Settings, own, key) -> Model:
    """Return the nominal model with a new encoder; `own`: the user's module or function."""
    model = data.model
    n, memories = model.order, model.memory.size
    if own is not None:
        encoder = build_own(own, n + memories, n + 2, key)
    elif settings.encoder == "paper":
        encoder = PaperEncoder(n + memories, n + 1, key=key)
    else:
        low, high = data.region.T.copy()
        if not has_spring(model.physical_coefficients):
            low[0] = high[0] = 0.0  # as without lags of x
        # a slow memory barely moves in short records: it gets at least a quarter of x's range
        half = np.maximum(high - low, 0.25 * (high[0] - low[0])) / 2
        bounds = (low + high) / 2 + 2 * np.array([[-1.0], [1.0]]) * half
        frugal = model.input_map.one_sided and len(data.features) < settings.few
        encoder = CompactEncoder(
            n, memories, width=settings.width, offset=settings.offset, frugal=frugal, bounds=bounds, key=key
        )
    return eqx.tree_at(lambda m: m.encoder, model, encoder)
