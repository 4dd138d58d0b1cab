"""What each token may see, where it stops seeing, and the identified model at zero; a line per encoder in `make`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pitp_jax.method.model.encoder import CompactEncoder, ConstantEncoder, PaperEncoder, fast_memories
from pitp_jax.method.model.programs import jit

KEY = jax.random.key(5)
ORDERS = (1, 2, 3)
MEMORIES = 4
CASES = [(kind, n) for kind in ("compact", "frugal") for n in ORDERS] + [
    ("constant", 2),
    ("compact without offset", 2),
    ("paper", 2),
]


@pytest.fixture(scope="module")
def make(shake):
    """fn(kind, order): a fresh encoder, and one with random weights."""

    made = {}

    def both(kind, order, bounds=None):
        if bounds is not None:
            return fresh_and_pushed(kind, order, bounds)
        if (kind, order) not in made:
            made[kind, order] = fresh_and_pushed(kind, order, None)
        return made[kind, order]

    def fresh_and_pushed(kind, order, bounds):
        if kind == "constant":
            return ConstantEncoder(order + 2), ConstantEncoder(order + 2)
        if kind == "paper":
            fresh = PaperEncoder(order + MEMORIES, order + 1, key=KEY, width=6)
            return fresh, shake(fresh, 0.7, order)
        kinds = {"offset": kind != "compact without offset", "frugal": kind == "frugal"}
        fresh = CompactEncoder(order, MEMORIES, width=6, **kinds, bounds=bounds, key=KEY)
        return fresh, shake(fresh, 0.7, order)

    return both


@eqx.filter_jit
def logits_of(encoder, features):
    """Of a batch."""
    return jax.vmap(encoder)(features)


@eqx.filter_jit
def _slopes(encoder, features):
    return jax.vmap(jax.jacfwd(encoder))(features)


def slopes(encoder, features):
    """Logits by features for a batch, shape (batch, n + 2, n + K)."""
    return np.asarray(_slopes(encoder, features))


def points(order, count=8, reach=1.0, seed=0):
    drawn = np.random.default_rng(seed).standard_normal((count, order + MEMORIES))
    return jnp.asarray(reach * drawn, jnp.float32)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "order"), CASES)
def test_a_fresh_encoder_is_exactly_the_nominal(make, linear, kind, order):
    fresh, pushed = make(kind, order)
    model = linear(order)
    read = jit(lambda m, f: jax.vmap(m.tokens)(f))
    nominal, _ = read(model, points(order, 3, 3.0))
    for encoder in (fresh, pushed.scaled(0.0)):
        tokens, offset = read(eqx.tree_at(lambda m: m.encoder, model, encoder), points(order, 3, 3.0))
        np.testing.assert_array_equal(tokens, nominal)
        np.testing.assert_array_equal(offset, np.zeros(3))


@pytest.mark.parametrize(
    ("kind", "order"),
    [
        pytest.param(*case, marks=[pytest.mark.slow] * (case[1] != 2 or case[0] == "paper"))
        for case in CASES
        if case[0] != "frugal"
    ],
)
def test_scaled_scales_the_logits(make, kind, order):
    _, encoder = make(kind, order)
    logits = logits_of(encoder, points(order, 3))
    assert logits.shape == (3, order + 2)
    np.testing.assert_allclose(logits_of(encoder.scaled(0.4), points(order, 3)), 0.4 * logits, rtol=2e-5, atol=1e-6)
    assert kind == "constant" or float(jnp.abs(logits).max()) > 0.05


@pytest.mark.parametrize("kind", ["compact", "frugal"])
@pytest.mark.parametrize("order", ORDERS)
def test_the_spring_sees_the_displacement_only(make, kind, order):
    """Sigma_0 and sigma_n: neither velocity nor memory, so neither can pump energy."""
    _, encoder = make(kind, order)
    by = slopes(encoder, points(order))[:, [0, order]]
    assert (by[..., 1:] == 0).all()
    assert (by[..., 0] != 0).all()


@pytest.mark.parametrize("order", [2, 3])
def test_damping_sees_the_state_and_every_memory(make, order):
    _, encoder = make("compact", order)
    assert (np.abs(slopes(encoder, points(order))[:, 1:order]).max(0) > 1e-4).all()


@pytest.mark.parametrize("order", ORDERS)
def test_the_offset_sees_the_displacement_and_the_past(make, order):
    """No velocity; the two slowest memories by a weight that is quadratic in x alone, never through the net."""
    _, encoder = make("compact", order)
    by = slopes(encoder, points(order))[:, -1]
    assert (by[:, 1:order] == 0).all()
    assert (np.abs(by[:, [0, *range(order, order + MEMORIES)]]).max(0) > 1e-4).all()
    f = points(order, 1, seed=1)[0]
    slow = jnp.arange(order + MEMORIES) >= order + fast_memories(MEMORIES)
    low, middle, high = logits_of(encoder, f + jnp.asarray([[-1.0], [0.0], [1.0]]) * slow)[:, -1]
    assert float(low + high - 2 * middle) == pytest.approx(0, abs=2e-6)  # linear in them
    assert abs(float(high - low)) > 1e-2


@pytest.mark.parametrize("order", ORDERS)
def test_a_frugal_encoder_knows_the_past_by_weights_alone(make, order):
    """Damping is blind to it; the offset is linear in every memory."""
    _, encoder = make("frugal", order)
    by = slopes(encoder, points(order))
    assert (by[:, 1:order, order:] == 0).all()
    assert (np.abs(by[:, 1:order, :order]).max(0) > 1e-4).all()
    f, past = points(order, 1)[0], jnp.arange(order + MEMORIES) >= order
    low, middle, high = logits_of(encoder, f + jnp.asarray([[-1.0], [0.0], [1.0]]) * past)[:, -1]
    assert float(low + high - 2 * middle) == pytest.approx(0, abs=1e-5 * float(jnp.abs(high - low)))


@pytest.mark.parametrize("order", ORDERS)
def test_what_tokens_share_divides_the_drive(make, linear, order):
    """Another coupling c: all tokens and the offset by exp(sum c_k x^k) of it; so is the force any state needs."""
    _, encoder = make("frugal", order)
    other = eqx.tree_at(lambda e: e.coupling, encoder, encoder.coupling + jnp.asarray([0.4, -0.2, 0.1]))
    at = points(order, 5)
    read = eqx.filter_jit(lambda e: jax.vmap(eqx.tree_at(lambda m: m.encoder, linear(order), e).tokens)(at))
    (tokens, offset), (more, further) = read(encoder), read(other)
    factor = np.exp(0.4 * at[:, 0] - 0.2 * at[:, 0] ** 2 + 0.1 * at[:, 0] ** 3)
    np.testing.assert_allclose(more, factor[:, None] * tokens, rtol=1e-5)
    np.testing.assert_allclose(further, factor * offset, rtol=1e-5)


def test_without_an_offset_there_is_none(make):
    _, encoder = make("compact without offset", 2)
    assert encoder.past is None and encoder.fading.size == 0
    assert (np.asarray(logits_of(encoder, points(2)))[:, -1] == 0).all()


@pytest.mark.parametrize("order", [pytest.param(n, marks=[pytest.mark.slow] * (n != 2)) for n in ORDERS])
def test_outside_the_bounds_tokens_stay(make, order):
    """Each feature on its own is held at the nearer bound: value, and a slope of zero."""
    low, high = -0.5 - 0.1 * np.arange(order + MEMORIES), 0.8 + 0.1 * np.arange(order + MEMORIES)
    fresh, encoder = make("compact", order, np.stack([low, high]))
    np.testing.assert_allclose(fresh.bounds, [low, high], rtol=1e-6)
    f = points(order, 12, 2.0)
    inside = jnp.clip(f, jnp.asarray(low, jnp.float32), jnp.asarray(high, jnp.float32))
    np.testing.assert_array_equal(logits_of(encoder, f), logits_of(encoder, inside))
    outside = np.asarray(f != inside)
    assert 0.2 < outside.mean() < 0.8
    assert (slopes(encoder, f).swapaxes(1, 2)[outside] == 0).all()
    far, farther = logits_of(encoder, jnp.asarray([[1e2], [1e4]]) * jnp.ones(order + MEMORIES))
    np.testing.assert_array_equal(far, farther)
    unbounded = make("compact", order)[1]
    assert float(jnp.abs(logits_of(unbounded, 1e2 * jnp.ones((1, order + MEMORIES))) - far).max()) > 10


def test_no_gradient_reaches_the_bounds(make):
    _, encoder = make("compact", 2, np.stack([-0.1 * np.ones(6), 0.1 * np.ones(6)]))
    slope = eqx.filter_jit(eqx.filter_grad(lambda e: jnp.sum(e(jnp.ones(6)))))(encoder)
    assert jax.tree.leaves(slope.bounds) == []
    assert float(jnp.abs(slope.spring_poly).max()) > 0


@pytest.mark.parametrize(("memories", "fast"), [(0, 0), (1, 0), (2, 0), (3, 1), (5, 3)])
def test_the_two_slowest_memories_are_kept_from_the_net(memories, fast):
    assert fast_memories(memories) == fast
    encoder = CompactEncoder(2, memories, width=4, key=KEY)
    assert encoder.past is not None and encoder.past.hidden.in_features == 1 + fast
    assert jax.eval_shape(encoder, jnp.ones(2 + memories)).shape == (4,)


def test_a_hardening_spring_is_a_polynomial(make):
    """Logits of sigma_0 are x^2 where training says so, anywhere within the bounds: no saturation."""
    fresh, _ = make("compact", 2)
    cubic = eqx.tree_at(lambda e: e.spring_poly, fresh, fresh.spring_poly.at[0, 1].set(0.25))
    for x in (-3.0, 0.5, 20.0):
        assert float(cubic(jnp.zeros(6).at[0].set(x))[0]) == pytest.approx(0.25 * x**2, rel=1e-6)


def test_only_hidden_layers_draw_numbers():
    """Weight and bias of three hidden layers; an output layer of zeros would compile four more programs."""
    traced = jax.make_jaxpr(lambda key: jax.tree.leaves(CompactEncoder(2, MEMORIES, width=4, key=key))[0])(KEY)
    encoder = CompactEncoder(2, MEMORIES, width=4, key=KEY)
    assert sum(e.params.get("name") == "_uniform" for e in traced.eqns) == 6
    assert not np.asarray(encoder.spring.readout.weight).any()
    given = eqx.nn.Linear(1, 4, key=jax.random.split(jax.random.split(KEY, 3)[0])[0])
    np.testing.assert_array_equal(encoder.spring.hidden.weight, given.weight)


def test_dropout_needs_a_key(make):
    _, encoder = make("paper", 2)
    f = jnp.ones(6)
    logits = eqx.filter_jit(lambda key: encoder(f, key=key))
    first, second = (np.asarray(logits(jax.random.key(k))) for k in (1, 2))
    assert not np.array_equal(first, second)
    np.testing.assert_array_equal(logits(None), logits(None))


def test_corrections_of_a_remainder_fade_outside_the_trained_region(shake):
    """Exactly the plain encoder inside, exactly the nominal beyond twice the region, monotonous between."""
    bounds = np.array([[-2.0, -4.0, -1e6], [2.0, 4.0, 1e6]])
    plain, held = (
        shake(CompactEncoder(2, 1, width=4, frugal=True, remainder=r, bounds=bounds, key=KEY), 0.5, 0)
        for r in (False, True)
    )
    # inside; halfway in both coordinates, s = 1/2 each; outside in one
    points = jnp.array([[0.9, -1.8, 0.3], [1.5, 3.0, 0.3], [0.2, 4.1, 0.3]])
    whole, faded = (np.asarray(eqx.filter_jit(jax.vmap(e))(points)) for e in (plain, held))
    np.testing.assert_allclose(faded, np.array([[1.0], [0.25], [0.0]]) * whole, rtol=1e-5)
    assert (np.abs(whole).max(1) > 0.01).all()
