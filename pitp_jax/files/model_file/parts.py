"""List the parts that a model file may hold, and convert a model to plain values and back.

    describe(model)  ->  header of JSON values        encode: a float that is not finite -> {"float": "inf"}
    build(header)    ->  a model whose leaves are placeholders of the right shapes

A part belongs to a file only by its line in one of five registries: input maps, encoders, memories, drives, effects.
"""

import base64
import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...common.errors import BadInput, cleaned
from ...method.effects import CATALOGUE
from ...method.effects.effect import Effect
from ...method.effects.found_term import TERM
from ...method.model.domain import Domain
from ...method.model.drive import DirectDrive, ElectrodeLag
from ...method.model.encoder import AdaptedEncoder, CompactEncoder, ConstantEncoder, PaperEncoder
from ...method.model.fitted import Fitted
from ...method.model.input_map import LinearInput, SquareInput
from ...method.model.memory import ElapsedTime, FadingMemory, NoMemory, RingingMemory
from ...method.model.model import Model, Output, Scales
from ...method.model.origin import Origin, OutOfFold
from ...method.model.own_encoder import OwnEncoder
from ...method.signal.excited import Table
from ...method.signal.long_record import LongRecord


def _nothing(part) -> dict:
    return {}


@dataclass(frozen=True)
class Part:
    """How a model file stores one kind of part: its class, the numbers that rebuild it, and a constructor.

    Attributes:
        cls: the class; a part is stored under this name only if its type is exactly this.
        build: keyword arguments to a part with the same leaves' shapes; called abstractly.
        describe: part to keyword arguments of `build`, JSON values only; by default none.
    """

    cls: type
    build: Callable[..., Any]
    describe: Callable[[Any], dict] = _nothing


def _compact_sizes(encoder: CompactEncoder) -> dict:
    return {
        "order": encoder.order,
        "memories": encoder.bounds.shape[1] - encoder.order,
        "width": encoder.spring.readout.in_features,
        "offset": int(encoder.offset),
        "frugal": int(encoder.frugal),
        **({"remainder": 1} if encoder.remainder else {}),
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


INPUT_MAPS = {
    "square": Part(SquareInput, SquareInput),
    "linear": Part(LinearInput, LinearInput),
}
ENCODERS = {
    "constant": Part(ConstantEncoder, ConstantEncoder, lambda e: {"outputs": e.outputs}),
    "compact": Part(
        CompactEncoder,
        lambda offset, frugal=0, remainder=0, **k: CompactEncoder(
            **k, offset=bool(offset), frugal=bool(frugal), remainder=bool(remainder), key=jax.random.key(0)
        ),
        _compact_sizes,
    ),
    "paper": Part(PaperEncoder, lambda **k: PaperEncoder(**k, key=jax.random.key(0)), _paper_sizes),
    # its module is not rebuilt from the file, which could then choose the code that runs; the caller supplies it
    "own": Part(OwnEncoder, OwnEncoder, lambda e: {"module": type(e.module).__name__}),
}


def _adapted_sizes(encoder: AdaptedEncoder) -> dict:
    """Return the inner encoder's name and sizes with those of the adaptation, in one flat dict."""
    # `name` is the adaptation's own, so the inner encoder's stands under `of`
    inner = _named(ENCODERS, encoder.inner)
    return {"lags": len(encoder.creep), "of": inner.pop("name"), **inner}


def _adapted(lags: int, of: str, **sizes) -> AdaptedEncoder:
    inner = ENCODERS[of].build(**sizes)
    return AdaptedEncoder(inner, jnp.zeros(()), jnp.zeros((lags,)), jnp.zeros((2,)), np.zeros(3))


ENCODERS["adapted"] = Part(AdaptedEncoder, _adapted, _adapted_sizes)
MEMORIES = {
    "none": Part(NoMemory, NoMemory),
    "elapsed": Part(ElapsedTime, ElapsedTime, lambda m: {"horizon": float(m.horizon)}),
    "fading": Part(FadingMemory, lambda size: FadingMemory(jnp.zeros((size,))), lambda m: {"size": m.size}),
    "ringing": Part(
        RingingMemory,
        lambda lags: RingingMemory(jnp.zeros(()), jnp.zeros(()), jnp.zeros((lags,))),
        lambda m: {"lags": m.size - 2},
    ),
}
DRIVES = {
    "direct": Part(DirectDrive, DirectDrive),
    "electrode_lag": Part(ElectrodeLag, lambda: ElectrodeLag(jnp.zeros(()))),
}
EFFECTS = {spec.key: Part(Effect, spec.neutral) for spec in (*CATALOGUE, TERM)}


def describe(fitted: Fitted) -> dict:
    """Convert a model without its arrays, and its origin, to plain values."""
    model, origin = fitted.model, fitted.origin
    return {
        "order": model.order,
        "hold": model.hold,
        "substeps": int(model.substeps),
        "input_map": _named(INPUT_MAPS, model.input_map),
        "encoder": _named(ENCODERS, model.encoder),
        "memory": _named(MEMORIES, model.memory),
        "drive": _named(DRIVES, model.drive),
        "effects": [_effect(e) for e in model.effects],
        "output": _numbers(model.output),
        "scales": _numbers(model.scales),
        "domain": _numbers(model.domain),
        "origin": {
            **{name: value for name, value in vars(origin).items() if name != "long_record"},
            "covariance": origin.covariance.tolist(),
            **{name: float(getattr(origin, name)) for name in ("misfit", "noise", "level")},
            "out_of_fold": origin.out_of_fold and vars(origin.out_of_fold),
        },
        "long_record": _packed(origin.long_record),
    }


def _effect(effect) -> dict:
    key = effect.spec.key if isinstance(effect, Effect) else type(effect).__name__
    if key not in EFFECTS:
        raise BadInput(f"cannot save the model: {key} is not an effect of the catalogue")
    return {"name": key}


def _numbers(part: Output | Scales | Domain) -> dict:
    """Convert the fields of a part to numbers, in the order of the class, so that files keep their bytes."""
    return {field.name: np.asarray(getattr(part, field.name)).tolist() for field in fields(part)}


def _packed(long: LongRecord | None) -> dict | None:
    if long is None:
        return None
    # bytes as text, because JSON numbers of the long record would be most of the file
    series = {name: getattr(long, name).astype("<f4").tobytes() for name in ("voltage", "displacement")}
    texts = {name: base64.b64encode(data).decode("ascii") for name, data in series.items()}
    return {"dt": long.dt, "step": long.step, "rest": long.rest, **texts}


def unpacked(stored: dict | None) -> LongRecord | None:
    """Restore the long record from a header, where its series are little-endian float32 in base 64."""
    if stored is None:
        return None
    data = (base64.b64decode(stored[k], validate=True) for k in ("voltage", "displacement"))
    series = (np.frombuffer(values, "<f4") for values in data)
    return LongRecord(float(stored["dt"]), int(stored["step"]), bool(stored["rest"]), *series)


def _named(registry: dict[str, Part], part) -> dict:
    for name, kind in registry.items():
        if type(part) is kind.cls:  # a user's subclass would be read back as its parent
            return {"name": name, **kind.describe(part)}
    known = ", ".join(registry) or "none yet"
    raise BadInput(
        f"cannot save the model: a {type(part).__name__} cannot be stored in a model file (known parts: {known})"
    )


def _part(registry: dict[str, Part], described: dict):
    settings = dict(described)
    name = settings.pop("name")
    if name not in registry:
        raise BadInput(
            f"holds {str(name)[:40]!r}, which this pitp_jax does not know; update it, or make the model again from the "
            "recordings"
        )
    return registry[name].build(**settings)


def _bands(stored: dict | None) -> OutOfFold | None:
    if stored is None:
        return None
    edges, error, output = (tuple(map(float, stored[name])) for name in ("edges_hz", "error", "output"))
    return OutOfFold(edges, error, output)


def origin_of(header: dict) -> Origin:
    """Restore the origin from a header, with control characters removed from its texts."""
    stored = _each(lambda one: cleaned(one) if isinstance(one, str) else one, header["origin"])
    origin = Origin(
        displacement_unit=str(stored["displacement_unit"]),
        voltage_unit=str(stored["voltage_unit"]),
        covariance=np.asarray(stored["covariance"], float).reshape(2 * (len(stored["covariance"]),)),
        stderr=tuple(map(float, stored["stderr"])),
        misfit=float(stored["misfit"]),
        noise=float(stored["noise"]),
        level=float(stored["level"]),
        out_of_fold=_bands(stored["out_of_fold"]),
        remarks=tuple(map(str, stored["remarks"])),
        identified_on=tuple(map(str, stored["identified_on"])),
        excited_input=_table(stored, "excited_input"),
        excited_output=_table(stored, "excited_output"),
        errors=_table(stored, "errors"),
        long_record=unpacked(header["long_record"]),
        training=None if stored["training"] is None else dict(stored["training"]),
        adapted=tuple(map(dict, stored["adapted"])),
        lineage=tuple(map(dict, stored["lineage"])),
    )
    # a diagnosis of 0.2.0 kept the standard errors of the nominal in a model of another order
    same = len(origin.stderr) in (0, header["order"] + 1)
    return origin if same else origin.of_other_coefficients()


def _table(stored: dict, name: str) -> Table:
    """Restore a table with a row of three numbers for every frequency; empty for files without one."""
    return tuple((float(hz), float(amplitude), float(value)) for hz, amplitude, value in stored.get(name, ()))


def _each(change: Callable[[Any], Any], value: Any) -> Any:
    """Apply a change to every key and entry of a nested value; tuples become lists."""
    if isinstance(value, dict):
        return {change(key): _each(change, entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_each(change, entry) for entry in value]
    return change(value)


def _encoder(described: dict, own: Any) -> Any:
    """Build an encoder from its description; `own`: the user's module, if the model has one."""
    # only the name of the user's class is in the file, never its code
    settings = dict(described)
    module = settings.pop("module", None)
    if module is not None and own is None:
        name = cleaned(module)[:40]
        raise BadInput(f"holds an encoder of your own ({name}): give pitp.load(FILE, encoder={name}(...)) in Python")
    if module is None and own is not None:
        raise BadInput("holds no encoder of your own; load it without `encoder`")
    if own is not None:
        settings["module"] = own
    return _part(ENCODERS, settings)


def build(header: dict, own: Any = None) -> Model:
    """Build the model of a header with placeholder arrays; `own`: the user's module in its encoder."""
    scales, noise = header["scales"], float(header["origin"]["noise"])  # files of 0.2.0 hold it there only
    model = Model(
        coefficients=jnp.zeros((len(scales["state"]),)),
        input_map=_part(INPUT_MAPS, header["input_map"]),
        encoder=_encoder(header["encoder"], own),
        memory=_part(MEMORIES, header["memory"]),
        output=Output(**header["output"]),
        scales=Scales(**scales),
        hold=header["hold"],
        substeps=int(header["substeps"]),
        domain=Domain(**{"noise": noise if np.isfinite(noise) else 0.0, **header["domain"]}),
        drive=_part(DRIVES, header["drive"]),
        effects=tuple(_part(EFFECTS, effect) for effect in header["effects"]),
    )
    # run once, as shapes, because mismatched parts would otherwise fail only in the first rollout
    tokens, _ = model.tokens(jnp.zeros((model.order + model.memory.size,)))
    if tokens.shape != (model.order + 1,) or model.order != header["order"]:
        raise ValueError(f"{tokens.shape[0]} tokens for order {header['order']}")
    return model


def encode(value: Any) -> Any:
    """Convert a value for JSON: a float that is not finite becomes {"float": "inf"}, a tuple becomes a list."""
    return _each(lambda v: {"float": str(v)} if isinstance(v, float) and not math.isfinite(v) else v, value)


def decode(entry: dict[str, Any]) -> Any:
    """Convert a dict of JSON back to the float that `encode` converted; any other dict stays as it is."""
    infinite = entry.keys() == {"float"} and entry["float"] in ("inf", "-inf", "nan")
    return float(entry["float"]) if infinite else entry
