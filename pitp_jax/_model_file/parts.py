"""List the parts a model file may hold by name, and turn a model into plain values and back.

    describe(model)  ->  header of JSON values        encode: a float that is not finite -> {"float": "inf"}
    build(header)    ->  a model whose leaves are placeholders of the right shapes

A part belongs to a file only by its line in one of five registries: input maps, encoders, memories, drives, effects.
"""

import base64
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._effects import CATALOGUE, FOUND_TERM
from .._effects.effect import Effect
from .._effects.found_term import NAMES as LISTED
from .._effects.found_term import term_row
from .._errors import BadInput
from .._model.drive import DirectDrive, ElectrodeLag
from .._model.encoder import AdaptedEncoder, CompactEncoder, ConstantEncoder, PaperEncoder
from .._model.input_map import LinearInput, SquareInput
from .._model.memory import ElapsedTime, FadingMemory, NoMemory, RingingMemory
from .._model.model import Model, Output, Provenance, Scales
from .._record.long_record import LongRecord

LARGEST = 4096  # no size of a part is near this; building a larger one could take all memory


@dataclass(frozen=True)
class Part:
    """How one kind of part is stored: its class, the plain numbers that rebuild it, and its constructor.

    Attributes:
        cls: the class; a part is stored under this name only where its type is exactly this.
        describe: part to keyword arguments of `build`, JSON values only.
        build: keyword arguments to a part with the same leaves' shapes; called abstractly.
    """

    cls: type
    describe: Callable[[Any], dict]
    build: Callable[..., Any]


def _compact_sizes(encoder: CompactEncoder) -> dict:
    return {
        "order": encoder.order,
        "memories": encoder.bounds.shape[1] - encoder.order,
        "width": encoder.spring.readout.in_features,
        "offset": int(encoder.offset),
        "frugal": int(encoder.frugal),
    }


def _paper_sizes(encoder: PaperEncoder) -> dict:
    tokens, width, fused = encoder.networks.fusion.weight.shape
    return {
        "features": fused // width,
        "tokens": tokens,
        "width": width,
        "depth": len(encoder.networks.enhance),
        "dropout": encoder.networks.dropout.p,
    }


def _nothing(part) -> dict:
    return {}


def _key():
    return jax.random.key(0)


INPUT_MAPS = {
    "square": Part(SquareInput, _nothing, SquareInput),
    "linear": Part(LinearInput, _nothing, LinearInput),
}
ENCODERS = {
    "constant": Part(ConstantEncoder, lambda e: {"outputs": e.outputs}, ConstantEncoder),
    "compact": Part(
        CompactEncoder,
        _compact_sizes,
        lambda offset, frugal=0, **k: CompactEncoder(**k, offset=bool(offset), frugal=bool(frugal), key=_key()),
    ),
    "paper": Part(PaperEncoder, _paper_sizes, lambda **k: PaperEncoder(**k, key=_key())),
}


def _adapted_sizes(encoder: AdaptedEncoder) -> dict:
    """Describe the inner encoder by its sizes beside its name, in one flat line."""
    inner = _named(ENCODERS, encoder.inner)
    return {"lags": len(encoder.creep), "of": inner.pop("name"), **inner}


def _adapted(lags: int, of: str, **sizes) -> AdaptedEncoder:
    inner = ENCODERS[of].build(**sizes)
    return AdaptedEncoder(inner, jnp.zeros(()), jnp.zeros((lags,)), jnp.zeros((2,)), jnp.zeros((3,)))


ENCODERS["adapted"] = Part(AdaptedEncoder, _adapted_sizes, _adapted)
MEMORIES = {
    "none": Part(NoMemory, _nothing, NoMemory),
    "elapsed": Part(ElapsedTime, lambda m: {"horizon": float(m.horizon)}, ElapsedTime),
    "fading": Part(FadingMemory, lambda m: {"size": m.size}, lambda size: FadingMemory(jnp.zeros((size,)))),
    "ringing": Part(
        RingingMemory,
        lambda m: {"lags": m.size - 2},
        lambda lags: RingingMemory(jnp.zeros(()), jnp.zeros(()), jnp.zeros((lags,))),
    ),
}
DRIVES = {
    "direct": Part(DirectDrive, _nothing, DirectDrive),
    "electrode_lag": Part(ElectrodeLag, _nothing, lambda: ElectrodeLag(jnp.zeros(()))),
}
EFFECTS = {spec.key: Part(Effect, _nothing, spec.neutral) for spec in CATALOGUE} | {
    FOUND_TERM.key: Part(
        Effect,
        lambda e: {f"function{k}": LISTED.index(name) for k, name in enumerate(e.spec.functions)},
        lambda **k: term_row(tuple(LISTED[int(place)] for place in k.values())).neutral(),
    )
}


def describe(model: Model) -> dict:
    """Describe the model, without its leaves, by plain values."""
    source = model.provenance
    return {
        "order": model.order,
        "hold": model.hold,
        "substeps": int(model.substeps),
        "input_map": _named(INPUT_MAPS, model.input_map),
        "encoder": _named(ENCODERS, model.encoder),
        "memory": _named(MEMORIES, model.memory),
        "drive": _named(DRIVES, model.drive),
        "effects": [_effect(e) for e in model.effects],
        "output": {"offset": float(model.output.offset), "polarity": float(model.output.polarity)},
        "scales": {
            "state": model.scales.state.tolist(),
            "force": float(model.scales.force),
            "sections": model.scales.sections.tolist(),
        },
        "provenance": {
            "dt": float(source.dt),
            "displacement_unit": source.displacement_unit,
            "voltage_unit": source.voltage_unit,
            "voltage_range": [float(v) for v in source.voltage_range],
            "slew": float(source.slew),
            "region": [[float(v) for v in pair] for pair in source.region],
            "clock": float(source.clock),
            "covariance": [[float(v) for v in row] for row in source.covariance],
            "misfit": float(source.misfit),
        },
        "long_record": _packed(source.long_record),
        "notes": _notes_out(source.notes),
    }


def _effect(effect) -> dict:
    key = effect.spec.key if isinstance(effect, Effect) else type(effect).__name__
    if key not in EFFECTS:
        raise BadInput(f"cannot save the model: {key} has no place in model files; only rows of the catalogue have")
    return {"name": key, **EFFECTS[key].describe(effect)}


def _packed(long: LongRecord | None) -> dict | None:
    if long is None:
        return None
    # bytes as text: as JSON numbers the long record would be most of the file
    voltage, displacement = (base64.b64encode(b).decode("ascii") for b in (long.voltage, long.displacement))
    return {"dt": long.dt, "step": long.step, "rest": long.rest, "voltage": voltage, "displacement": displacement}


def _unpacked(stored: dict | None) -> LongRecord | None:
    if stored is None:
        return None
    series = (base64.b64decode(stored[k], validate=True) for k in ("voltage", "displacement"))
    return LongRecord(float(stored["dt"]), int(stored["step"]), bool(stored["rest"]), *series)


def _named(registry: dict[str, Part], part) -> dict:
    for name, kind in registry.items():
        if type(part) is kind.cls:  # a subclass of the user's own would be read back as its parent
            return {"name": name, **kind.describe(part)}
    known = ", ".join(registry) or "none yet"
    raise BadInput(f"cannot save the model: {type(part).__name__} has no place in model files (known: {known})")


def _part(registry: dict[str, Part], described: dict):
    settings = dict(described)
    name = settings.pop("name")
    if name not in registry:
        raise BadInput(f"holds a part {str(name)[:40]!r} this pitp_jax does not know; update pitp_jax")
    for key, value in settings.items():
        # the one setting that is a word: an adapted encoder stands around a plain one
        if key == "of" and value in ("constant", "compact", "paper"):
            continue
        # True is an int to Python and would be a size of 1
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or (isinstance(value, int) and not 0 <= value <= LARGEST)
        ):
            raise ValueError(f"{name}: {key} = {str(value)[:40]}")
    return registry[name].build(**settings)


def build(header: dict) -> Model:
    """Build the model the header describes; its leaves are placeholders."""
    source, output, scales = header["provenance"], header["output"], header["scales"]
    notes = header["notes"] if isinstance(header["notes"], str) else json.dumps(header["notes"])
    known = source if "misfit" in source else _from_notes(notes, header["order"])  # files older than the field
    low, high = source["voltage_range"]
    provenance = Provenance(
        dt=float(source["dt"]),
        displacement_unit=str(source["displacement_unit"]),
        voltage_unit=str(source["voltage_unit"]),
        voltage_range=(float(low), float(high)),
        slew=float(source["slew"]),
        region=tuple((float(a), float(b)) for a, b in source["region"]),
        notes=notes,
        covariance=tuple(tuple(map(float, row)) for row in known["covariance"]),
        misfit=float(known["misfit"]),
        long_record=_unpacked(header.get("long_record")),
        clock=float(source.get("clock", 0.0)),
    )
    if header["hold"] not in ("foh", "zoh", "bandlimited") or not 1 <= int(header["substeps"]) <= LARGEST:
        raise ValueError(f"hold {header['hold']!r}, substeps {header['substeps']!r}")
    model = Model(
        coefficients=jnp.zeros((len(scales["state"]),)),
        input_map=_part(INPUT_MAPS, header["input_map"]),
        encoder=_part(ENCODERS, header["encoder"]),
        memory=_part(MEMORIES, header["memory"]),
        output=Output(float(output["offset"]), float(output["polarity"])),
        scales=Scales(scales["state"], scales["force"], scales["sections"]),
        hold=header["hold"],
        substeps=int(header["substeps"]),
        provenance=provenance,
        drive=_part(DRIVES, header["drive"]),
        effects=tuple(_part(EFFECTS, effect) for effect in header["effects"]),
    )
    # run once, as shapes: parts that do not fit each other would fail only in the first rollout
    tokens, _ = model.tokens(jnp.zeros((model.order + model.memory.size,)))
    if tokens.shape != (model.order + 1,) or model.order != header["order"]:
        raise ValueError(f"{tokens.shape[0]} tokens for order {header['order']}")
    return model


def _from_notes(notes: str, order: int) -> dict:
    """Read covariance and misfit of files that were written when these stood in the notes alone."""
    try:
        values = json.loads(notes)
    except ValueError:
        values = {}
    # of a trained model they no longer hold: an encoder stands beside the nominal
    identified = values.get("identification", {}) if isinstance(values, dict) and "training" not in values else {}
    row = next((row for row in identified.get("orders", []) if row.get("order") == order), {})
    covariance, noise = np.zeros((0, 0)), identified.get("noise_std")
    if "correlation" in row:
        relative = np.asarray(row["stderr"], float) / np.asarray(row["coefficients"], float)  # d ln a = da / a
        covariance = np.asarray(row["correlation"], float) * np.outer(relative, relative)
    misfit = max(row["rms"] / noise, 1.0) if "rms" in row and noise else math.inf
    return {"covariance": covariance.tolist(), "misfit": misfit}


def _notes_out(notes: str):
    """Write notes as readable values where reading them back gives the same text, else as the text itself."""
    try:
        values = json.loads(notes)
    except ValueError:
        return notes
    # text that would come back changed is kept to the letter
    return values if isinstance(values, dict) and json.dumps(decode(encode(values))) == notes else notes


def encode(value: Any) -> Any:
    """Write a float that is not finite as {"float": "inf"}, which JSON has no number for, and a tuple as a list."""
    if isinstance(value, dict):
        return {k: encode(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [encode(v) for v in value]
    return {"float": str(value)} if isinstance(value, float) and not math.isfinite(value) else value


def decode(value: Any) -> Any:
    """Invert `encode`, but for tuples."""
    if isinstance(value, dict):
        if value.keys() == {"float"} and value["float"] in ("inf", "-inf", "nan"):
            return float(value["float"])
        return {k: decode(v) for k, v in value.items()}
    return [decode(v) for v in value] if isinstance(value, list) else value
