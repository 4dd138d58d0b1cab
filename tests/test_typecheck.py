"""The suite's own checks of shapes: a call like an earlier one is not checked again, anything else is."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import typecheck
from jaxtyping import Float, TypeCheckError


@pytest.fixture
def checked():
    def cut(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], parts: list[int]) -> Float[np.ndarray, " n"]:
        return x[: int(y[0])]

    return typecheck.remembering(cut, typechecker=typecheck.check)


ONE, TWO = np.full(3, 3.0), np.full(4, 4.0)


def test_other_shapes_dtypes_types_and_contents_are_checked(checked):
    for good in (ONE, TWO, ONE, TWO):
        assert len(checked(good, good, [])) == len(good)
    for wrong in ((ONE, TWO, []), (ONE, ONE.astype(int), []), (ONE, [3.0] * 3, []), (ONE, ONE, ["a"]), (ONE, ONE, 1)):
        with pytest.raises(TypeCheckError):
            checked(*wrong)
    with pytest.raises(TypeCheckError):
        checked(ONE, ONE, ["a"] * 40)


def test_another_result_of_a_call_like_an_earlier_one_is_checked(checked):
    checked(ONE, ONE, [])
    for _ in range(2):
        with pytest.raises(TypeCheckError, match="return"):
            checked(ONE, ONE - 1, [])
    assert len(checked(ONE, ONE + 1, [])) == 3


def test_a_call_like_an_earlier_one_costs_no_check():
    seen = []

    def plain(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return x

    def watched(value, hint):
        seen.append(value)
        return typecheck.check(value, hint)

    checked = typecheck.remembering(plain, typechecker=watched)
    for good in (ONE, ONE + 1, TWO, ONE, TWO):
        checked(good)
    assert len(seen) == 4  # arguments and result of two shapes


def test_traced_arrays_are_checked():
    def added(x: Float[jax.Array, " n"], y: Float[jax.Array, " n"]) -> Float[jax.Array, " n"]:
        return x + y

    checked, (one, other) = typecheck.remembering(added, typechecker=typecheck.check), (jnp.ones(1), jnp.ones(2))
    assert jax.eval_shape(checked, one, one).shape == (1,)
    with pytest.raises(TypeCheckError):
        jax.eval_shape(checked, one, other)


def test_an_inner_function_is_checked_in_every_definition_and_runs_as_defined():
    def define(factor):
        def scaled(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
            return factor * x

        return typecheck.remembering(scaled, typechecker=typecheck.check)

    assert [define(factor)(ONE)[0] for factor in (1.0, 2.0, 3.0)] == [3.0, 6.0, 9.0]
    with pytest.raises(TypeCheckError, match="return"):
        define(np.ones((2, 1)))(ONE)
    with pytest.raises(TypeCheckError, match="parameters"):
        define(1.0)([3.0])


def test_the_fields_of_a_dataclass_are_checked():
    @dataclass(frozen=True)
    class Pair:
        x: Float[np.ndarray, " n"]
        y: Float[np.ndarray, " n"]

    kind = typecheck.remembering(Pair, typechecker=typecheck.check)
    for _ in range(2):
        assert kind(ONE, ONE).y is ONE
        with pytest.raises(TypeCheckError):
            kind(ONE, TWO)


def test_every_item_of_a_starred_argument_and_a_forward_reference_is_checked():
    def joined(*parts: Float[np.ndarray, " n"], size: "int | None" = None, **more: Float[np.ndarray, " n"]) -> int:
        return len(parts) + len(more) if size is None else "all" if size is True else size  # pyright: ignore

    checked = typecheck.remembering(joined, typechecker=typecheck.check)
    assert checked(ONE, ONE + 1, other=ONE) == 3 and checked(size=7) == 7
    for parts, options in (((ONE, TWO), {}), ((ONE,), {"other": TWO}), ((ONE, 1.0), {}), ((), {"size": "7"})):
        with pytest.raises(TypeCheckError, match="parameters"):
            checked(*parts, **options)
    with pytest.raises(TypeCheckError, match="return"):
        checked(size=True)
