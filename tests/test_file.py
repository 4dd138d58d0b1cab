"""Model files: exact round trips, and nothing but an untouched file of this format is accepted."""

import hashlib
import json
import pickle
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from origins import assert_same_origin

from pitp_jax.common.errors import BadInput
from pitp_jax.files.model_file import model_file, parts
from pitp_jax.method.effects import lookup
from pitp_jax.method.effects.effect import Effect
from pitp_jax.method.model.domain import Domain
from pitp_jax.method.model.drive import ElectrodeLag
from pitp_jax.method.model.encoder import AbstractEncoder, CompactEncoder, ConstantEncoder, PaperEncoder
from pitp_jax.method.model.fitted import Fitted
from pitp_jax.method.model.input_map import LinearInput, SquareInput
from pitp_jax.method.model.memory import ElapsedTime, FadingMemory, NoMemory, RingingMemory
from pitp_jax.method.model.model import Model, Output, Scales
from pitp_jax.method.model.origin import Origin, OutOfFold
from pitp_jax.method.signal.long_record import LongRecord

KEY = jax.random.key(3)
SECTIONS = (1.5, 0.1, 20.0, 3e-7, 1 / 3, 1e12)
BOUNDS = np.array([[-0.5, -2.0], [1.5, 3.0]])
DOMAIN = Domain(1e-3, (0.0, 6e3), region=((-1.0, 1.0), (-0.5, float("inf"))), clock=3.0)  # the slew stays infinite
LONG = LongRecord(1e-3, 2, True, np.arange(70, dtype="<f4"), np.full(70, np.nan, "<f4"))
STEP = {"step": "fit", "versions": {"jax": "1"}, "parent": None, "records": [{"name": "Zürich", "sha256": "0"}]}
ORIGIN = Origin(
    "mm", "kV", np.diag([1.0, 2.0, 1 / 3]), (0.1, float("inf"), 0.2), 1.5, 2e-6, 0.25,
    OutOfFold((1.0, 2.0, 4.0), (1e-6, 2e-6), (0.1, 0.2)), ("a0 is open",), ("sweep", "Zürich"), LONG,
    {"history": [{"error": float("inf")}]}, ({"records": ["a"], "changed": {}},), (STEP, STEP),
)  # fmt: skip


def model(order=2, encoder=None, memory=None, dtype=jnp.float32, origin=ORIGIN, **changes):
    made = Model(
        coefficients=jnp.asarray(np.arange(1.0, order + 2) / 3, dtype),
        input_map=changes.pop("input_map", SquareInput()),
        encoder=encoder or ConstantEncoder(order + 2),
        memory=memory or NoMemory(),
        output=Output(1.25e-5, -1.0),
        scales=Scales(tuple(0.1**i for i in range(order + 1)), 3.6e7, SECTIONS[:order] if order > 2 else ()),
        **{"hold": "zoh", "substeps": 3, "domain": DOMAIN, **changes},
    )
    if len(origin.stderr) not in (0, order + 1):  # standard errors of another order are not restored
        origin = origin.of_other_coefficients()
    return Fitted(made, origin)


def noisy(part):
    """Every weight different, so that a swap of two leaves shows."""
    leaves, tree = jax.tree.flatten(part)
    filled = [
        leaf + jax.random.normal(jax.random.fold_in(KEY, i), leaf.shape) if eqx.is_array(leaf) else leaf
        for i, leaf in enumerate(leaves)
    ]
    return jax.tree.unflatten(tree, filled)


CASES = {
    "nominal": lambda: model(),
    "order 1": lambda: model(1),
    "order 6": lambda: model(6),
    "bandlimited": lambda: model(hold="bandlimited"),
    "linear input": lambda: model(input_map=LinearInput(), hold="foh"),
    "compact": lambda: model(
        encoder=noisy(CompactEncoder(2, 3, width=8, key=KEY)), memory=FadingMemory(jnp.arange(3.0))
    ),
    "ringing": lambda: model(
        encoder=noisy(CompactEncoder(2, 4, width=8, key=KEY)),
        memory=RingingMemory(jnp.float32(6.0), jnp.float32(-3.0), jnp.arange(2.0)),
    ),
    "compact without offset": lambda: model(encoder=noisy(CompactEncoder(2, 0, width=4, offset=False, key=KEY))),
    "compact order 1": lambda: model(1, encoder=noisy(CompactEncoder(1, 0, width=4, key=KEY))),
    "paper": lambda: model(
        encoder=noisy(PaperEncoder(3, 3, width=4, depth=1, dropout=0.25, key=KEY)), memory=ElapsedTime(10.0)
    ),
    "compact order 3": lambda: model(3, encoder=noisy(CompactEncoder(3, 1, width=4, key=KEY)), memory=ElapsedTime(2.0)),
    "frugal": lambda: model(
        encoder=noisy(CompactEncoder(2, 3, width=8, frugal=True, key=KEY)), memory=FadingMemory(jnp.arange(3.0))
    ),
    "compact bounded": lambda: model(encoder=noisy(CompactEncoder(2, 0, width=4, bounds=BOUNDS, key=KEY))),
    "electrode lag": lambda: model(drive=ElectrodeLag(jnp.float32(-6.25))),
    "electrode lag, order 4, compact": lambda: model(
        4, drive=noisy(ElectrodeLag(jnp.float32(-6.25))), encoder=noisy(CompactEncoder(4, 0, width=4, key=KEY))
    ),
    "no origin": lambda: model(origin=Origin(), domain=Domain(1.0)),
}


def assert_same(left, right):
    assert jax.tree.structure(left) == jax.tree.structure(right)  # static fields
    for a, b in zip(jax.tree.leaves(left), jax.tree.leaves(right), strict=True):
        assert np.asarray(a).dtype == np.asarray(b).dtype
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_round_trip_is_exact(tmp_path, case):
    path, saved = tmp_path / "model", CASES[case]()
    model_file.save(path, saved)
    loaded = model_file.load(path)
    assert_same(saved, loaded)
    assert_same_origin(loaded.origin, saved.origin)
    model_file.save(tmp_path / "again", loaded)
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


@pytest.mark.parametrize("dtype", ["float16", "float32", "float64"])
def test_dtype_is_kept_whatever_the_session_uses(tmp_path, dtype):
    with jax.enable_x64(True):
        saved = model(dtype=dtype)
    model_file.save(tmp_path / "m", saved)
    loaded = model_file.load(tmp_path / "m")
    assert loaded.coefficients.dtype == dtype
    assert_same(saved, loaded)


def test_header_is_readable_json_without_infinities(tmp_path):
    model_file.save(tmp_path / "m", model())
    magic, digest, rest = (tmp_path / "m").read_bytes().split(b"\n", 2)
    assert magic == b"pitp_jax model 2"
    assert digest.startswith(b"sha256 ")

    def refuse(name):
        raise AssertionError(name)

    header = json.JSONDecoder(parse_constant=refuse).raw_decode(rest.decode("latin-1"))[0]
    assert header["origin"]["identified_on"] == ["sweep", "Zürich"]
    assert header["domain"]["slew"] == {"float": "inf"}
    assert header["leaves"] == [[".coefficients", "float32", [3]]]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    path = tmp_path_factory.mktemp("stored") / "m"
    model_file.save(path, CASES["compact"]())
    return path, path.read_bytes()


def refused(path, data):
    broken = path.with_name("broken")
    broken.write_bytes(data)
    with pytest.raises(BadInput) as caught:
        model_file.load(broken)
    assert "\n" not in str(caught.value)
    assert str(broken) in str(caught.value)
    return str(caught.value)


@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_any_flipped_bit_is_refused(stored, data):
    path, content = stored
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    broken = bytearray(content)
    broken[bit // 8] ^= 1 << bit % 8
    refused(path, bytes(broken))


def test_every_bit_of_the_first_lines_matters(stored):
    path, content = stored
    for bit in range(8 * 130):
        broken = bytearray(content)
        broken[bit // 8] ^= 1 << bit % 8
        refused(path, bytes(broken))


@given(share=st.floats(0, 1, exclude_max=True))
@settings(max_examples=60, deadline=None)
def test_truncated_is_refused(stored, share):
    path, content = stored
    refused(path, content[: int(share * len(content))])


def test_longer_is_refused(stored):
    path, content = stored
    refused(path, content + b"\n")


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("code from a file was run",))


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        b"time_s,voltage_V,displacement_m\n0,0,0\n",
        b"\x93NUMPY\x01\x00",
        b"\x00" * 10_000,
        b"x" * 100_000,
        pickle.dumps(Bomb()),
        b"pitp_jax model \n",
        b"pitp_jax model one\n",
        b"pitp_jax model 1",
        b"pitp_jax model 1\n",
        b"pitp_jax model 2\n" + pickle.dumps(Bomb()),
    ],
)
def test_foreign_files_are_refused(stored, content):
    refused(stored[0], content)


def test_newer_version_says_so(stored):
    path, content = stored
    assert "version 3" in refused(path, content.replace(b"model 2\n", b"model 3\n", 1))
    assert "version 12" in refused(path, content.replace(b"model 2\n", b"model 12\n", 1))


def test_a_file_of_version_1_is_to_be_written_again(stored):
    path, content = stored
    assert "write the model again" in refused(path, content.replace(b"model 2\n", b"model 1\n", 1))


def resealed(content, change):
    """A file with a changed header or body and the right digest, as a forger would make it."""
    magic, _, rest = content.split(b"\n", 2)
    rest = change(rest)
    return magic + b"\nsha256 " + hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"name": "compact"', b'"name": "os.system"'),
        (b'"name": "compact"', b'"name": "paper"'),
        (b'"width": 8', b'"width": 4'),
        (b'"width": 8', b'"width": 99999999999'),
        (b'"width": 8', b'"width": -8'),
        (b'"width": 8', b'"width": "8"'),
        (b'"width": 8', b'"width": 8, "extra": 1'),
        (b'"hold": "zoh"', b'"hold": "xxx"'),
        (b'"substeps": 3', b'"substeps": 0'),
        (b'"order": 2,\n', b'"order": 3,\n'),
        (b'"force": 36000000.0', b'"force": NaN'),
        (b'"effects": []', b'"effects": [{"name": "creep"}]'),
        (b"'<f4'", b"'|O4'"),
        (b"'fortran_order': False", b"'fortran_order': True "),
        (b"{\n", b"[" * 5000 + b"{\n"),
        (b'"leaves"', b'"leafs"'),
        (b'"scales"', b'"scale"'),
    ],
)
def test_sealed_nonsense_is_refused(stored, old, new):
    path, content = stored
    assert old in content
    refused(path, resealed(content, lambda rest: rest.replace(old, new, 1)))


STRANGE = [
    {"identified_on": [5]},
    {"training": {"records": [5]}},
    {"training": {"seconds": "x"}},
    {"training": {"history": ["x"]}},
    {"adapted": [{"changed": {"gain": {"factor": 1.0, "ci95": None}}}]},
    {"adapted": [{"changed": {"gain": {"factor": "x", "ci95": [0.0, 1.0]}}}]},
    {"lineage": [{"versions": "jax 1"}]},
    {"lineage": [{"records": [{"name": "a"}]}]},
]


@pytest.mark.parametrize("strange", STRANGE, ids=str)
def test_a_history_of_another_shape_is_no_usable_model_file(stored, strange):
    """Otherwise `info` would end in an error of the program."""

    def change(rest):
        header, end = json.JSONDecoder().raw_decode(rest.decode("latin-1"))
        header["origin"] |= strange
        return json.dumps(header).encode("latin-1") + rest[end:]

    refused(stored[0], resealed(stored[1], change))


def test_nothing_in_a_model_file_is_obeyed_by_a_terminal(tmp_path):
    name = "a\x1b]0;title\x07\nverdict: explained\x1b[2J"
    origin = replace(ORIGIN, identified_on=(name,), training={"records": [name], "history": [{name: 1.0}]})
    model_file.save(tmp_path / "m.pitp", model(origin=origin))
    read = model_file.load(tmp_path / "m.pitp").origin
    assert read.training is not None
    assert not {"\x1b", "\x07", "\n"} & set(f"{''.join(read.identified_on)}{''.join(read.training['records'])}")
    assert list(read.training["history"][0]) == [read.identified_on[0]] == ["a_]0;title__verdict: explained_[2J"]


def test_sealed_object_array_is_not_unpickled(stored):
    path, content = stored
    refused(path, resealed(content, lambda rest: rest[: rest.index(b"\x93NUMPY")] + pickle.dumps(Bomb())))


def test_sealed_extra_bytes_are_refused(stored):
    refused(stored[0], resealed(stored[1], lambda rest: rest + b"\0"))


def test_missing_folder_and_unwritable(tmp_path):
    with pytest.raises(BadInput, match="No such file"):
        model_file.load(tmp_path / "absent")
    with pytest.raises(BadInput, match="not a regular file"):
        model_file.load(tmp_path)
    with pytest.raises(BadInput, match="embedded null"):
        model_file.load("a\0b")
    with pytest.raises(BadInput, match="cannot write"):
        model_file.save(tmp_path / "absent" / "m", model())


TOMORROW = replace(lookup("drag"), form="of tomorrow")


class Foreign(AbstractEncoder):
    def __call__(self, features, *, key=None):
        return jnp.zeros(4)

    def scaled(self, factor):
        return self


def test_unknown_parts_are_not_saved(tmp_path):
    with pytest.raises(BadInput, match="a Foreign cannot be stored"):
        model_file.save(tmp_path / "m", eqx.tree_at(lambda m: m.encoder, model(), Foreign()))
    with pytest.raises(BadInput, match="drag: of tomorrow is not an effect of the catalogue"):
        model_file.save(tmp_path / "m", model(effects=(TOMORROW(1.0),)))
    with pytest.raises(BadInput, match="int32"):
        model_file.save(tmp_path / "m", eqx.tree_at(lambda m: m.coefficients, model(), jnp.zeros(3, jnp.int32)))
    with pytest.raises(BadInput, match="do not match its parts"):
        model_file.save(tmp_path / "m", eqx.tree_at(lambda m: m.coefficients, model(), jnp.zeros(5)))
    assert not list(tmp_path.iterdir())


def test_an_effect_needs_one_line(tmp_path, monkeypatch):
    line = parts.Part(Effect, TOMORROW.neutral)
    monkeypatch.setitem(parts.EFFECTS, TOMORROW.key, line)
    saved = model(effects=(TOMORROW(2.0), TOMORROW(5.0)))
    model_file.save(tmp_path / "m", saved)
    assert_same(saved, model_file.load(tmp_path / "m"))


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        (b'"dt": 0.001', b'"dt": 0.0', "dt"),
        (b'"dt": 0.001', b'"dt": -0.001', "dt"),
        (b'"dt": 0.001', b'"dt": {"float": "nan"}', "dt"),
        (b'"polarity": -1.0', b'"polarity": 0.0', "polarity"),
        (b'"offset": 1.25e-05', b'"offset": {"float": "inf"}', "offset"),
        (b'"force": 36000000.0', b'"force": 0.0', "force"),
        (b'"state": [1.0, ', b'"state": [0.0, ', "state"),
        (b'"voltage_range": [0.0, ', b'"voltage_range": [9e9, ', "voltage range"),
        (b'"displacement_unit": "mm"', b'"displacement_unit": "furlong"', "unit"),
        (b'"memories": 3', b'"memories": 4000', "memories"),
    ],
)
def test_numbers_that_make_no_model_are_refused(stored, old, new, word):
    path, content = stored
    assert old in content
    assert word in refused(path, resealed(content, lambda rest: rest.replace(old, new, 1)))


@pytest.mark.parametrize(("last", "problem"), [(np.nan, "not finite"), (0.0, "highest coefficient")])
def test_weights_that_make_no_model_are_refused(last, problem, tmp_path, monkeypatch):
    odd = eqx.tree_at(lambda m: m.coefficients, model(), jnp.asarray([1.0, 1.0, last]))
    with pytest.raises(BadInput, match=problem):
        model_file.save(tmp_path / "m", odd)
    assert not (tmp_path / "m").exists()
    with monkeypatch.context() as stranger:
        stranger.setattr(model_file, "leaf_problems", lambda names, arrays: [])
        model_file.save(tmp_path / "m", odd)
    with pytest.raises(BadInput, match=problem):
        model_file.load(tmp_path / "m")


def test_a_hundred_thousand_effects_are_refused_before_any_is_built(stored, monkeypatch):
    path, content = stored
    many = b", ".join([b'{"name": "coulomb_friction"}'] * 100_000)
    data = resealed(content, lambda rest: rest.replace(b'"effects": []', b'"effects": [' + many + b"]", 1))
    monkeypatch.setattr(parts, "_part", None)  # whoever builds a part fails
    assert "100000 effects" in refused(path, data)
