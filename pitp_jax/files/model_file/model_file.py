"""Save and load model files; nothing in a file is ever run as code.

    line 1    pitp_jax model 2                  magic and version
    line 2    sha256 <digest of all that follows>
    then      {                                 readable JSON, one part per line: what every part is, its
              }                                 sizes, domain and origin, shape and dtype of every leaf
    then      the leaves, each as .npy bytes    no pickle

A part is rebuilt from a closed list of names, as shapes only, and then filled with the stored leaves. So a file can
only choose parts of this package and set their numbers. Equinox's `tree_serialise_leaves` would keep neither the names
of the leaves nor float64 ones in a session without it.
"""

import hashlib
import io
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ...common.errors import BadInput, cleaned
from ...method.model.constants import ConstantArray, constant_array
from ...method.model.fitted import Fitted, fitted_of
from ...method.model.model import Model
from ...method.model.own_encoder import own_module
from ...method.model.programs import on_device
from ..containers.guard import file_bytes
from ..containers.refusal import about
from ..recordings.writing import write_bytes_atomic
from .parts import build, decode, describe, encode, origin_of
from .plausible import header_problems, leaf_problems, refuse

VERSION = 2
_MAGIC = b"pitp_jax model "
_DTYPES = {"float16": np.dtype("<f2"), "float32": np.dtype("<f4"), "float64": np.dtype("<f8")}


def save(path: str | os.PathLike, model: Model | Fitted) -> None:
    """Write a model to a file, completely or not at all.

    Args:
        path: the file, of any name (usually .pitp); an existing one is replaced, its folder must exist.
        model: a `Fitted`, or a bare `Model`, whose origin is empty; leaves keep their dtype (float16, 32 or 64).

    Raises:
        BadInput: numbers that are not finite, a part that this format does not know (an effect), or an unwritable file.

    Examples:
        >>> pitp.save(folder / "model.pitp", model)
    """
    body = _body(fitted_of(model))
    write_bytes_atomic(path, _MAGIC + b"%d\nsha256 " % VERSION + _sum(body) + b"\n" + body)


def digest(model: Model | Fitted) -> str:
    """Return the SHA-256 that the second line of the model's file would hold.

    Raises:
        BadInput: as `save`.
    """
    return _sum(_body(fitted_of(model))).decode()


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a model file, which is that of its model.

    Raises:
        BadInput: not a model file, or damaged.
    """
    return _sum(_checked_bytes(path)).decode()


def lineage_of(fitted: Fitted) -> list[dict]:
    """Return the lineage of a model as its file holds it: every parent by its digest."""
    return [{k: _known(v) if k == "parent" else v for k, v in entry.items()} for entry in fitted.origin.lineage]


def _known(parent: Fitted | str | None) -> str | None:
    try:
        return digest(parent) if isinstance(parent, Fitted) else parent
    except BadInput:  # a user's own part, which no file can hold
        return None


def _sum(body: bytes) -> bytes:
    return hashlib.sha256(body).hexdigest().encode()


def _body(fitted: Fitted) -> bytes:
    """Return the bytes of a model file after the digest: header and arrays."""
    header, model = describe(fitted), _stored(fitted.model)
    header["origin"]["lineage"] = lineage_of(fitted)
    # as `load` will build it, so that a model that could not be read back is refused here
    skeleton = _stored(_skeleton(header, own_module(fitted.model.encoder)))
    arrays = [(name, np.asarray(leaf)) for name, leaf in _leaves(model, eqx.is_array)]
    for name, array in arrays:
        if array.dtype.name not in _DTYPES:
            raise BadInput(f"cannot save the model: {name} is {array.dtype}; use one of {', '.join(_DTYPES)}")
    # a part whose arrays were changed by hand: its sizes no longer match their shapes
    if [(name, leaf.shape) for name, leaf in _leaves(skeleton, _is_shape)] != [(n, array.shape) for n, array in arrays]:
        raise BadInput("cannot save the model: its arrays do not match its parts")
    header["leaves"] = [[name, array.dtype.name, list(array.shape)] for name, array in arrays]
    if problems := header_problems(header) + leaf_problems(*map(list, zip(*arrays, strict=True))):
        raise BadInput(f"cannot save the model, because `load` would refuse it: {'; '.join(problems[:8])}")
    lines = ",\n".join(f"{json.dumps(k)}: {json.dumps(encode(v), allow_nan=False)}" for k, v in header.items())
    body = io.BytesIO()
    body.write(b"{\n" + lines.encode("utf-8") + b"\n}\n")
    for _, array in arrays:
        # little-endian and in C order, so that the same model has the same bytes and digest on every machine
        plain = np.asarray(array, _DTYPES[array.dtype.name], order="C")
        np.lib.format.write_array(body, plain, version=(1, 0), allow_pickle=False)
    return body.getvalue()


def load(path: str | os.PathLike, *, encoder: eqx.Module | None = None) -> Fitted:
    """Read a model from a file; no code from the file is run.

    Args:
        path: a file that `save` wrote.
        encoder: for a model with your own encoder, a module of the same class and sizes. Only its arrays are replaced
            by the stored ones.

    Returns:
        a `Fitted`: the model and its origin, equal to those that were saved.

    Raises:
        BadInput: missing, a folder, not a model file, from a newer version, damaged, or an encoder is missing or does
            not fit.

    Examples:
        >>> pitp.save(folder / "model.pitp", model)
        >>> pitp.load(folder / "model.pitp").order
        2
    """
    with about(Path(path)):
        try:
            body = _checked_bytes(Path(path))
            # latin-1 has a character for every byte, so `end` is also a place in the bytes; the JSON itself is ASCII
            reader = json.JSONDecoder(object_hook=decode, parse_constant=_refuse)
            header, end = reader.raw_decode(body.decode("latin-1"))
            refuse(header_problems(header))  # before any part is built from it
            model = _filled(_skeleton(header, encoder), header["leaves"], memoryview(body)[end + 1 :])
            return Fitted(model, origin_of(header))
        except BadInput:
            raise
        except Exception as error:  # an intact digest over contents that no version of `save` writes
            reason = cleaned(" ".join(f"{type(error).__name__}: {error}".split())[:120])
            if encoder is not None:
                name = type(encoder).__name__
                raise BadInput(
                    f"{name} does not match the stored encoder ({reason}); give an encoder of the same sizes"
                ) from None
            raise BadInput(f"not a usable model file ({reason}); write it again with pitp") from None


def is_model_file(path: str | os.PathLike) -> bool:
    """Return whether a file starts as a model file does; the rest may be damaged."""
    with open(path, "rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def _checked_bytes(path: Path) -> bytes:
    """Read all bytes after the digest; refuse the file if the digest does not match."""
    _check_version(file_bytes(path, 64))  # before the rest, because another kind of file may be large
    known, _, body = file_bytes(path).partition(b"\n")[2].partition(b"\n")
    if known != b"sha256 " + _sum(body):
        raise BadInput("damaged or incomplete model file (its checksum does not match); copy or write it again")
    return body


def _check_version(begin: bytes) -> None:
    # without a line end, the first bytes only resemble a model file
    line, end, _ = begin.partition(b"\n")
    version = line.removeprefix(_MAGIC)
    if not line.startswith(_MAGIC) or not end or not version.isdigit():
        raise BadInput("is not a pitp_jax model file; write one with `pitp identify` or `pitp fit`")
    if int(version[:12]) != VERSION:
        raise BadInput(
            f"model file of version {version.decode()[:12]}, this pitp_jax reads version {VERSION}; update pitp_jax or "
            "write the model again"
        )


def _skeleton(header: dict, own: eqx.Module | None) -> Model:
    """Build the model of a header with shapes instead of arrays, so that no memory is allocated.

    Constants (scales, domain, sensor offset) are in the header.
    """
    return eqx.filter_eval_shape(lambda: build(header, own))


def _stored(model: Model) -> Model:
    """Replace constant arrays by plain arrays, because a file stores them among its arrays."""
    return jax.tree.map(
        lambda part: np.asarray(part, np.float32) if _is_constant_array(part) else part,
        model, is_leaf=_is_constant_array,
    )  # fmt: skip


def _is_constant_array(part) -> bool:
    return isinstance(part, ConstantArray)


def _leaves(model: Model, kind: Callable) -> list[tuple[str, Any]]:
    """Return the leaves of a kind, by name."""
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(model, kind))
    return [(jax.tree_util.keystr(place), leaf) for place, leaf in leaves]


def _refuse(literal: str):
    raise ValueError(f"{literal} is not JSON")


def _filled(skeleton: Model, leaves: list, data: memoryview) -> Model:
    """Fill a model of shapes with the stored arrays and constant arrays."""
    filled = _fill(_stored(skeleton), leaves, data)
    return jax.tree.map(lambda part, leaf: constant_array(leaf) if _is_constant_array(part) else leaf,
                        skeleton, filled, is_leaf=lambda part: _is_constant_array(part) or _is_shape(part))  # fmt: skip


def _fill(skeleton: Model, leaves: list, data: memoryview) -> Model:
    """Read the stored arrays into a model of shapes; refuse arrays of other shapes."""
    places = _leaves(skeleton, _is_shape)
    if [name for name, _ in places] != [name for name, _, _ in leaves]:
        raise ValueError("its leaves are not those of its parts")
    stream, arrays = io.BytesIO(data), []
    for (_, place), (name, dtype, shape) in zip(places, leaves, strict=True):
        if np.lib.format.read_magic(stream) != (1, 0):
            raise ValueError(f"{name}: unknown npy version")
        stored, fortran, kind = np.lib.format.read_array_header_1_0(stream)
        # an object dtype, whose bytes would be a pickle, is not in `_DTYPES`
        if fortran or kind != _DTYPES[dtype] or stored != tuple(shape) or stored != place.shape:
            raise ValueError(f"{name}: {kind} {stored} where {dtype} {place.shape} belongs")
        plain = np.frombuffer(stream.read(math.prod(stored) * kind.itemsize), kind).reshape(stored)
        with jax.enable_x64(True):  # otherwise float64 leaves would come back as float32
            arrays.append(on_device(plain))
    refuse(leaf_problems([name for name, _, _ in leaves], [np.asarray(array) for array in arrays]))
    if stream.read(1):  # trailing bytes could mean something to another reader
        raise ValueError("more bytes than leaves")
    treedef = jax.tree_util.tree_structure(eqx.filter(skeleton, _is_shape))
    return eqx.combine(jax.tree_util.tree_unflatten(treedef, arrays), eqx.filter(skeleton, _is_shape, inverse=True))


def _is_shape(leaf) -> bool:
    return isinstance(leaf, jax.ShapeDtypeStruct | np.ndarray)
