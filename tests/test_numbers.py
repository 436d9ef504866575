"""Scalars of the fused engine beside XLA's: every type, where both are defined by the
language of neither: by zero, out of range, infinite."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax._frontend.lower import NotFusible, flatten
from aslo_jax._frontend.structural import known
from aslo_jax._ir.graph import Graph
from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")
SIGNED = ["int8", "int16", "int32", "int64"]
UNSIGNED = ["uint8", "uint16", "uint32", "uint64"]


def stepped(function, *arguments):
    """By the engine, within a step of its loop, one lane for each entry."""
    kinds = tuple(jax.ShapeDtypeStruct((), x.dtype) for x in arguments)
    bodies = Bodies(
        lambda inputs: ((), None),
        lambda k, carry, inputs: ((), function(*inputs["lane log"])),
        lambda carry, inputs: (),
    )
    program = Program.of(bodies, {"lane log": kinds}, (8,))
    columns = tuple(x[:, None] for x in arguments)
    record, _ = program({"lane log": columns}, arguments[0].size, 1)
    return jax.tree.map(lambda x: x[:, 0], record)


def folded(function, *arguments):
    """Of constants, which the graph of a loop has instead of operations on them."""
    constants = [jnp.asarray(x) for x in arguments]
    closed, shapes = jax.make_jaxpr(lambda: function(*constants), return_shape=True)()
    graph = Graph()
    leaves = [known(graph, value) for value in flatten(graph, closed, [])]
    return jax.tree.unflatten(jax.tree.structure(shapes), leaves)


def pairs(x, y):
    return [a.ravel() for a in np.meshgrid(x, y)]


def whole(dtype):
    """Pairs of numbers of a type, its bounds, zero and the widths of shifts among them."""
    bounds, bits = np.iinfo(dtype), 8 * np.dtype(dtype).itemsize
    some = {bounds.min, bounds.max, bounds.min + 1, 0, 1, 2, 7, bits - 1, bits, 100, 53}
    if bounds.min < 0:
        some |= {-1, -2, -7, -100}
    some = np.array(sorted(some), dtype)
    return pairs(some, some)


def of_whole_numbers(x, y):
    return {
        "div": jax.lax.div(x, y),
        "rem": jax.lax.rem(x, y),
        "//": x // y,
        "%": x % y,
        "guarded": jnp.where(y > 0, x // y, 0),
        "by a constant": (x // 7, x % 10, jax.lax.div(x, x.dtype.type(0))),
        "left": jax.lax.shift_left(x, y),
        "right": jax.lax.shift_right_logical(x, y),
        "right with the sign": jax.lax.shift_right_arithmetic(x, y),
        "by constants": [x << n for n in (0, 3, 8 * x.dtype.itemsize)],
        "bits": (jax.lax.population_count(x), jax.lax.clz(x), ~x, jnp.sign(x)),
        "power": (x**3, jnp.square(x), jnp.abs(x), -x),
        "order": (jnp.maximum(x, y), jnp.minimum(x, y), jnp.clip(x, y, y + 1), x < y),
        "narrower": [x.astype(t) for t in ("int8", "uint8", "int16", "uint32", "bool")],
        "wider": [x.astype(t) for t in ("int64", "uint64", "float32", "float64")],
    }


def same(found, expected):
    for (path, ours), theirs in zip(
        jax.tree.leaves_with_path(found), jax.tree.leaves(expected), strict=True
    ):
        theirs = np.asarray(theirs)
        assert ours.dtype == theirs.dtype, path
        np.testing.assert_array_equal(ours, theirs, jax.tree_util.keystr(path))


@pytest.mark.parametrize("dtype", SIGNED + UNSIGNED)
def test_whole_numbers_are_those_of_xla(dtype):
    x, y = whole(dtype)
    expected = jax.jit(of_whole_numbers)(x, y)
    same(stepped(of_whole_numbers, x, y), expected)
    same(folded(of_whole_numbers, x, y), expected)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_conversions_of_real_numbers_saturate(dtype):
    """As those of XLA: the least or the largest number out of range, zero for none."""
    powers = [2.0**n for n in (7, 8, 15, 16, 31, 32, 53, 63, 64)]
    some = [0.4, 0.5, 3.7, 255.9, 1e30, np.inf, *powers, *(p - 1 for p in powers)]
    x = np.array([0.0, *some, *(-s for s in some), np.nan], dtype)
    kinds = [*SIGNED, *UNSIGNED, "bool", "float32", "float64"]
    convert = lambda x: {kind: x.astype(kind) for kind in kinds}
    expected = jax.jit(convert)(x)
    assert expected["int8"][-1] == 0 and expected["uint8"].max() == 255
    same(stepped(convert, x), expected)
    same(folded(convert, x), expected)
    # The entry of a table at a place far beyond its ends.
    table = jnp.arange(8.0)
    read = lambda x: table[jnp.clip(x.astype(jnp.int32), 0, 7)]
    same(stepped(read, x), jax.jit(read)(x))


def test_constants_are_exact():
    x, y = np.array([2**53 + 1, -(2**63), 2**63 - 1]), np.array([1, 3, -2])
    expected = [2**53 + 1, -(2**63) // 3 + 1, -(2**62) + 1]
    assert folded(jax.lax.div, x, y).tolist() == expected


SPECIAL = [0.0, 1.0, 0.5, 1.5, 2.0, 2.5, 3.0, 1e-3, 6.0, 30.0, 88.0, 104.0, 709.0, 746.0]
SPECIAL += [1e3, 1e8, 1e20, 3e38, 1e-20, 1e-37, np.inf]


def special(dtype):
    with np.errstate(over="ignore"):
        return np.array([*SPECIAL, *(-x for x in SPECIAL), np.nan], dtype)


def of_real_numbers(x, y):
    exponents = (0.5, -0.5, 3.0, -3.0, 17.0, 1e30, np.inf, -np.inf, np.nan)
    power = lambda k: jax.lax.pow(x, jnp.full_like(x, k))
    return {
        "pow": jax.lax.pow(x, y),
        "constant powers": [power(k) for k in exponents],
        "integer powers": [jax.lax.integer_pow(x, k) for k in (-3, -2, -1, 0, 1, 2, 3)],
        "atan2": jax.lax.atan2(x, y),
        "quotient": (x / y, x / 3.0, x / np.inf, y / 1e-30),
        "largest": (jax.lax.max(x, y), jax.lax.max(x, jnp.full_like(x, np.nan))),
        "least": (jax.lax.min(x, y), jax.lax.min(jnp.full_like(x, np.nan), x)),
        "clamp": (jnp.clip(x, -1.0, 2.0), jax.lax.clamp(-y, x, y)),
        "sign": (jnp.sign(x), jnp.isfinite(x), jnp.isnan(x), jnp.isinf(x)),
        "whole": [f(x) for f in (jnp.floor, jnp.ceil, jnp.round, jnp.trunc)],
        "away": jax.lax.round(x, jax.lax.RoundingMethod.AWAY_FROM_ZERO),
        "roots": (jnp.sqrt(x), jax.lax.rsqrt(x), jax.lax.cbrt(x)),
        "exp": [f(x) for f in (jnp.exp, jnp.exp2, jnp.expm1, jax.nn.sigmoid)],
        "log": (jnp.log(x), jnp.log1p(x), jnp.log2(x)),
        "hyperbolic": [f(x) for f in (jnp.sinh, jnp.cosh, jnp.tanh)],
        "inverse": [f(x) for f in (jnp.arcsinh, jnp.arccosh, jnp.arctanh)],
        "circular": [f(x) for f in (jnp.arcsin, jnp.arccos, jnp.arctan)],
        "error": (jax.lax.erf(x), jax.lax.erfc(x), jax.lax.erf_inv(x)),
        "neighbour": jax.lax.nextafter(x, y),
        "of two": (jnp.hypot(x, y), jnp.logaddexp(x, y), jnp.copysign(x, y)),
    }


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_functions_of_special_values_are_those_of_xla(dtype):
    """Infinite and undefined alike, and finite as near as XLA's own errors are."""
    x, y = pairs(*[special(dtype)] * 2)
    found, expected = stepped(of_real_numbers, x, y), jax.jit(of_real_numbers)(x, y)
    tiny = np.finfo(dtype).tiny  # XLA has no smaller numbers
    places = jax.tree.leaves_with_path(found)
    for (path, ours), theirs in zip(places, jax.tree.leaves(expected), strict=True):
        settings = {"atol": tiny, "err_msg": jax.tree_util.keystr(path)}
        rtol = 2e-5 if dtype == "float32" else 1e-12
        np.testing.assert_allclose(ours, theirs, rtol=rtol, **settings)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_constant_factors_are_one(dtype):
    """Nothing overflows between them, as in XLA of JAX 0.10; in that of 0.12 it does."""
    x, y = pairs(*[special(dtype)] * 2)
    found = stepped(lambda x, y: {"rescaled": x * 1e30 * 1e-20 * 1e-10}, x, y)["rescaled"]
    np.testing.assert_allclose(found, x, rtol=1e-6, atol=np.finfo(dtype).tiny)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_circular_functions_of_huge_angles_are_bounded(dtype):
    """And stay those of one angle, given or computed."""
    largest, rng = float(np.finfo(dtype).max), np.random.default_rng(3)
    x = np.array([0.3, 1e8, 1e15, 1e16, 1e20, 1e30, 3e38, largest / 4])
    x = np.concatenate([x, -x, rng.uniform(1e15, 1e25, 500), [np.inf, np.nan]])

    def function(x):
        computed = x * 1.1
        return [(jnp.sin(a), jnp.cos(a)) for a in (x, computed, computed + 1.0)]

    for sine, cosine in stepped(function, x.astype(dtype)):
        assert np.isnan(sine[-2:]).all() and np.isnan(cosine[-2:]).all()
        assert (np.abs(sine[:-2]) <= 1.0).all() and (np.abs(cosine[:-2]) <= 1.0).all()
        square = sine[:-2] ** 2 + cosine[:-2] ** 2
        np.testing.assert_allclose(square, 1.0, rtol=10 * np.finfo(dtype).eps)


def test_remainders_of_huge_quotients_are_exact_or_in_range():
    x = np.array([1e20, 1e25, -1e25, 3e38, 1e300, np.inf, 1.0, 1.0, 5.0, -5.0, 1e31])
    y = np.array([0.7, 0.3, -0.7, 0.1, 0.7, 0.7, 0.0, np.inf, np.nan, 3.0, 2.0 * np.pi])
    exact = np.abs(x) < 1e32
    found, modulus = stepped(lambda x, y: (jax.lax.rem(x, y), x % y), x, y)
    with np.errstate(invalid="ignore"):
        expected = np.fmod(x, y), np.mod(x, y)
    np.testing.assert_array_equal(found[exact], expected[0][exact])
    np.testing.assert_array_equal(modulus[exact], expected[1][exact])
    assert (found[[3, 4]] == 0.0).all() and np.isnan(found[5])


HALVES = ["float16", "bfloat16", "complex64", "complex128", "int4", "float8_e4m3fn"]


@pytest.mark.parametrize("kind", HALVES)
def test_other_types_are_refused_by_name_where_they_are_used(kind):
    def function(x):
        return jnp.real(x.astype(kind) * 2).astype(x.dtype)

    with pytest.raises(NotFusible, match=rf"test_numbers\.py:\d+.* type {kind}"):
        stepped(function, np.ones(3))
    # Of constants they are what JAX makes of them.
    same(stepped(lambda x: x + function(jnp.ones(())), np.ones(3)), np.full(3, 3.0))


def carrying(value):
    """A loop whose state holds a value."""
    bodies = Bodies(
        lambda inputs: (value(), None),
        lambda k, carry, inputs: (carry, None),
        lambda carry, inputs: (),
    )
    return Program.of(bodies, {"lane": jax.ShapeDtypeStruct((), np.float64)}, (8,))


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (lambda: jnp.zeros((), jnp.float16), "float16"),
        (lambda: jnp.zeros((), jnp.bfloat16), "bfloat16"),
        (lambda: jnp.zeros((), complex), "complex128"),
        (lambda: jax.random.key(0), "key<fry>"),
    ],
)
def test_other_types_are_refused_in_a_state(value, kind):
    with pytest.raises(NotFusible, match=rf"type {kind}, as the state of the loop has"):
        carrying(value)


def test_other_types_are_refused_in_samples_results_and_what_is_closed_over():
    x = np.ones(3)
    with pytest.raises(NotFusible, match="type float16, as the samples or the logs have"):
        stepped(lambda x: x, x.astype(np.float16))
    with pytest.raises(NotFusible, match="type bfloat16, as a result has"):
        stepped(lambda x: jnp.zeros((), jnp.bfloat16), x)
    key = jax.random.key(0)
    with pytest.raises(NotFusible, match="type key<fry>"):
        stepped(lambda x: x + jax.random.uniform(key), x)
    with pytest.raises(NotFusible, match="leaves 8 bits of the exponent and 7 of the"):
        stepped(lambda x: jax.lax.reduce_precision(x, 8, 7), x)
