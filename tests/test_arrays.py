"""Indices, sorting, running sums, interpolation and factorisations as JAX has them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy as jsp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.engines import NotFusible, run_batch
from aslo_jax.engines._fused.program import Bodies, Program
from aslo_jax.filters import second_order

pytest.importorskip("llvmlite")
RNG = np.random.default_rng(5)


def fused(functions, inputs):
    """What functions of one lane give for every lane, all in one kernel."""
    kinds = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape[1:], x.dtype), inputs)
    bodies = Bodies(
        lambda given: ((), None),
        lambda k, carry, given: ((), None),
        lambda carry, given: {n: f(*given["lane"]) for n, f in functions.items()},
    )
    program = Program.of(bodies, {"lane": kinds}, (8,))
    return program({"lane": inputs}, len(jax.tree.leaves(inputs)[0]), 1)[1]


def check(functions, inputs, rtol=2e-14):
    """Right to `rtol` of the largest finite entry; both are returned, by name."""
    found = fused(functions, inputs)
    expected = jax.jit(
        lambda *inputs: {n: jax.vmap(f)(*inputs) for n, f in functions.items()}
    )(*inputs)
    for name in functions:
        pairs = zip(*map(jax.tree.leaves, (found[name], expected[name])), strict=True)
        for a, b in pairs:
            assert a.shape == b.shape and a.dtype == b.dtype, name
            scale = np.max(np.abs(b), where=np.isfinite(b), initial=1.0)
            np.testing.assert_allclose(a, b, rtol, rtol * scale, err_msg=name)
    return {name: (found[name], expected[name]) for name in functions}


M = RNG.normal(size=(3, 4))
PLACES = np.array(
    [[0, 0], [1, 3], [5, 1], [5, 9], [-1, 2], [2, -2], [-7, 2], [1, -9], [-8, 40], [2, 4]]
)
VECTORS = RNG.normal(size=(len(PLACES), 4))
LOG = RNG.normal(size=(9, 20))
WORDS = RNG.integers(-9, 9, (3, 4))

READS = {
    "two axes": lambda x, p: (M * x)[p[0], p[1]],
    "slice of two axes": lambda x, p: jax.lax.dynamic_slice(M * x, (p[0], p[1]), (1, 2)),
    "small index": lambda x, p: jax.lax.dynamic_slice(
        jnp.cumsum(jnp.tile(x, 50)), (p[0].astype(jnp.int8),), (2,)
    ),
    "row": lambda x, p: (M * x)[p[0]],
    "column": lambda x, p: (M * x)[:, p[1]],
    "vector": lambda x, p: x[p],
    "rows": lambda x, p: (M * x)[p],
    "pairs": lambda x, p: (M * x)[p, p[::-1]],
    "outer": lambda x, p: (M * x)[p[:, None], p[None, :]],
    "filled": lambda x, p: x.at[p].get(mode="fill"),
    "filled with": lambda x, p: (M * x).at[p[0]].get(mode="fill", fill_value=7.0),
    "filled whole": lambda x, p: (WORDS + p[0]).at[:, p[1]].get(mode="fill"),
    "filled flags": lambda x, p: (x > 0).at[p].get(mode="fill"),
    "clipped": lambda x, p: x.at[p].get(mode="clip"),
    "promised": lambda x, p: x.at[p].get(mode="promise_in_bounds"),
    "take": lambda x, p: (jnp.take(x, p), jnp.take(M * x, p, 1, mode="wrap")),
    "take along": lambda x, p: jnp.take_along_axis(M * x, p[None, :] + 0 * WORDS[:, :1], 1),
    "choose": lambda x, p: jnp.choose(p, [x[:2], x[1:3], x[2:]], mode="clip"),
    "roll": lambda x, p: (jnp.roll(x, p[0]), jnp.roll(M * x, p[0], 1)),
    "flip": lambda x, p: jnp.flip(x)[p[0]],
    "select_n": lambda x, p: jax.lax.select_n(jnp.clip(p[0], 0, 2), x, 2 * x, -x),
    "mapped": lambda x, p: jax.vmap(lambda row, k: row[k])((M * x)[:2], p),
    "table": lambda x, p: (jnp.asarray(LOG)[p[0], p[1]], jnp.asarray(LOG)[p[0], 3:5]),
    "switch": lambda x, p: jax.lax.switch(p[0], [jnp.sin, jnp.cos, jnp.exp], x),
    "unravel": lambda x, p: jnp.stack(jnp.unravel_index(p[0] % 12, (3, 4))),
}
WRITES = {
    "set": lambda x, p: x.at[p[0]].set(9.0),
    "set both": lambda x, p: x.at[p].set(jnp.array([8.0, 9.0])),
    "set row": lambda x, p: (M * x).at[p[0]].set(x),
    "set entry": lambda x, p: (M * x).at[p[0], p[1]].set(5.0),
    "add": lambda x, p: x.at[p].add(x[:2]),
    "add twice": lambda x, p: x.at[jnp.stack([p[0], p[0], 1])].add(x[:3]),
    "multiply": lambda x, p: x.at[p].multiply(3.0),
    "least": lambda x, p: x.at[p].min(-0.5),
    "largest": lambda x, p: (M * x).at[:, p[1]].max(0.5),
    "apply": lambda x, p: x.at[p[0]].apply(jnp.sin),
    "clipped": lambda x, p: x.at[p].add(1.0, mode="clip"),
    "dropped": lambda x, p: x.at[p].set(1.0, mode="drop"),
    "slice": lambda x, p: jax.lax.dynamic_update_slice(
        M * x, jnp.outer(x[:2], x[:2]), (p[0], p[1])
    ),
    "mapped": lambda x, p: jax.vmap(lambda row, k: row.at[k].set(4.0))((M * x)[:2], p),
    "counted": lambda x, p: jnp.bincount(p % 4, length=4),
}


def test_reads_at_indices_that_vary():
    check(READS, (VECTORS, PLACES))


def test_writes_at_indices_that_vary():
    check(WRITES, (VECTORS, PLACES))


ODD = np.array(
    [
        [0.3, -1.2, 2.0, 0.7, -0.1],
        [2.0, 1.0, 2.0, 1.0, 1.0],
        [np.nan, 1.0, -np.inf, 3.0, np.inf],
        [1.0, np.nan, 0.5, np.nan, 4.0],
        [np.inf, np.inf, -np.inf, 0.0, -np.inf],
        [-3.0, -2.0, 0.0, 5.0, 6.0],
    ]
)
WHOLE = np.array([[3, 1, 2], [1, 1, 0], [-5, 7, -5], [0, 0, 0], [2, 9, 9], [-1, -2, -3]])
XP = np.array([-2.0, -0.5, 0.5, 0.5, 3.0])
FP = np.array([1.0, -2.0, 4.0, 0.5, 7.0])


def running(name, axis=0, reverse=False):
    return lambda x, n: getattr(jax.lax, name)(x, axis, reverse)


def places(x, v, method):
    sides = (jnp.searchsorted(x, v, side, method=method) for side in ("left", "right"))
    return jnp.stack([*sides])


ORDERED = {
    "sort": lambda x, n: (jnp.sort(x), jnp.sort(n), jnp.sort(x, descending=True)),
    "matrix": lambda x, n: jnp.sort(jnp.stack([x, x[::-1], -x]), axis=0),
    "long": lambda x, n: jnp.sort(jnp.concatenate([x, 2 * x, -x, x + 0.1])),
    "argsort": lambda x, n: (jnp.argsort(x), jnp.argsort(n), jnp.argsort(-n)),
    "lexsort": lambda x, n: jnp.lexsort((x[:3], n)),
    "several": lambda x, n: jax.lax.sort((n, x[:3], x[1:4]), num_keys=2),
    "median": lambda x, n: (jnp.median(x), jnp.nanmedian(x), jnp.median(x[:4])),
    "percentile": lambda x, n: jnp.percentile(x, jnp.array([0.0, 33.0, 100.0])),
    "top": lambda x, n: jax.lax.top_k(n, 2),
    "flags": lambda x, n: (jnp.sort(x > 0.5), jnp.argmax(x > 0.5), jnp.argmin(x < 1)),
    "places": lambda x, n: (jnp.argmax(x), jnp.argmin(x), jnp.argmax(n), jnp.argmin(n)),
    "interp": lambda x, n: jnp.interp(x, XP, FP),
    "interp of": lambda x, n: jnp.interp(0.4, XP + n[0], FP * n[1], left=3.0),
    "searched": lambda x, n: places(jnp.asarray(XP), x, "scan"),
    "unrolled": lambda x, n: places(jnp.asarray(XP), x, "scan_unrolled"),
    "by sort": lambda x, n: places(jnp.asarray(XP), x, "sort"),
    "compared": lambda x, n: places(XP + n[0], x, "compare_all"),
    "digitize": lambda x, n: (jnp.digitize(x, XP), jnp.digitize(x, XP[::-1], right=True)),
    "piecewise": lambda x, n: jnp.piecewise(
        x, [x < 0, x > 1], [jnp.sin, lambda y: y**2, 0.5]
    ),
    "where": lambda x, n: jnp.where(x > 0, x, -1.0),
    "histogram": lambda x, n: jnp.histogram(n, bins=3, range=(-4.0, 8.0))[0],
}
RUNNING = {
    "cumsum of numbers": lambda x, n: jnp.cumsum(jnp.stack([x[0], x[1]])),
    **{
        f"{name} {reverse}": running(name, reverse=reverse)
        for name in ("cumsum", "cumprod", "cummax", "cummin", "cumlogsumexp")
        for reverse in (False, True)
    },
    "along": lambda x, n: jax.lax.cumsum(jnp.outer(x, jnp.ones(2)), 1, reverse=True),
    "cube": lambda x, n: jax.lax.cumprod(x[:4].reshape(1, 2, 2), 2),
    "whole": lambda x, n: (jnp.cumsum(n), jnp.cumprod(n), jax.lax.cummax(n)),
    "extremes": lambda x, n: (x.max(), x.min(), n.max(), n.min(), jnp.ptp(n)),
    "none": lambda x, n: (jnp.max(x[:0], initial=-1.0), jnp.sum(x[:0]), jnp.prod(n[:0])),
    "bits": lambda x, n: (
        jnp.bitwise_xor.reduce(n),
        jnp.bitwise_and.reduce(n),
        jnp.bitwise_or.reduce(n),
    ),
    "reduced": lambda x, n: jax.lax.reduce(
        n, 3, lambda a, b: jnp.minimum(jnp.abs(a), jnp.abs(b)), (0,)
    ),
    "windows": lambda x, n: (
        jax.lax.reduce_window(x, -jnp.inf, jax.lax.max, (2,), (1,), "SAME"),
        jax.lax.reduce_window(n, 0, jax.lax.add, (2,), (2,), "VALID"),
    ),
    "convolve": lambda x, n: jnp.convolve(n.astype(float), jnp.array([1.0, 2.0, -0.5])),
    "correlate": lambda x, n: jnp.correlate(n * 1.0, jnp.array([1.0, 2.0]), "same"),
    "differences": lambda x, n: (jnp.diff(n), jnp.gradient(n * 1.0), jnp.trapezoid(n)),
}


def test_order():
    check(ORDERED, (ODD, WHOLE))


def test_running_and_reduced():
    check(RUNNING, (ODD, WHOLE))


def systems(n, count=8):
    """Matrices of every kind: with a zero in front, nearly singular, badly scaled."""
    A = RNG.normal(size=(count, n, n))
    A[0, 0, 0] = 0.0
    A[1] = np.eye(n)[::-1] + 1e-3 * A[1]
    A[2, 0] = 1e-9 * A[2, 0]
    if n > 1:
        A[3, 1] = A[3, 0] + 1e-6 * A[3, 1]
        A[4, :, 0] *= 1e6
    return A


def lower(A):
    return jnp.tril(A) + 4 * jnp.eye(len(A))


def gram(A):
    """A positive definite matrix of moderate condition."""
    return A @ A.T / (A**2).sum() + jnp.eye(len(A))


LINEAR = {
    "solve": lambda A, b: jnp.linalg.solve(A, b),
    "solve many": lambda A, b: jnp.linalg.solve(A, jnp.outer(b, b[:2])),
    "inverse": lambda A, b: jnp.linalg.inv(A),
    "det": lambda A, b: jnp.linalg.det(A),
    "slogdet": lambda A, b: tuple(jnp.linalg.slogdet(A)),
    "lu": lambda A, b: jsp.linalg.lu(A),
    "wide lu": lambda A, b: jsp.linalg.lu(A[:2]),
    "lu solve": lambda A, b: jsp.linalg.lu_solve(jsp.linalg.lu_factor(A), b, trans=1),
    "cholesky": lambda A, b: jnp.linalg.cholesky(gram(A)),
    "upper": lambda A, b: jnp.linalg.cholesky(gram(A), upper=True),
    "not definite": lambda A, b: jnp.linalg.cholesky(A + A.T),
    "triangular": lambda A, b: (
        jsp.linalg.solve_triangular(lower(A), b, lower=True),
        jsp.linalg.solve_triangular(lower(A), b, lower=True, trans=1),
        jsp.linalg.solve_triangular(lower(A).T, b, unit_diagonal=True),
    ),
    "cho_solve": lambda A, b: jsp.linalg.cho_solve((lower(A), True), b),
    "positive": lambda A, b: jsp.linalg.solve(gram(A), b, assume_a="pos"),
    "power": lambda A, b: jnp.linalg.matrix_power(A, 3),
    "mapped": lambda A, b: jax.vmap(jnp.linalg.solve)(
        jnp.stack([A, A.T]), jnp.stack([b, -b])
    ),
    "derivative": lambda A, b: (
        jax.jvp(jnp.linalg.solve, (lower(A), b), (A, b))[1],
        jax.jvp(jnp.linalg.inv, (lower(A),), (A,))[1],
        jax.jvp(jnp.linalg.det, (lower(A),), (A,))[1],
        jax.jvp(lambda L: jnp.linalg.slogdet(L)[1], (lower(A),), (A,))[1],
        jax.jvp(jnp.linalg.cholesky, (gram(A),), (A + A.T,))[1],
    ),
    "gradient": lambda A, b: jax.grad(lambda L: jnp.linalg.solve(L, b)[0])(lower(A)),
}


def test_linear_algebra():
    """Nearly singular ones, of condition 1e6 to 1e9, lose as many digits in LAPACK."""
    A, b = systems(3), RNG.normal(size=(8, 3))
    found = check(LINEAR, (A, b), rtol=1e-9)
    for name, tree in found.items():
        for a, b in zip(*map(jax.tree.leaves, tree), strict=True):
            np.testing.assert_allclose(a[5:], b[5:], 1e-12, 1e-12, err_msg=name)


def test_factors_before_what_is_not_a_number():
    """The rows of a factor above an entry that is not a number are those without it, and
    those of LAPACK; of the others, nothing from its column on."""
    A = np.stack([gram(x) for x in RNG.normal(size=(3, 4, 4))])
    expected = np.linalg.cholesky(A)
    for k, (i, j) in enumerate([(3, 1), (2, 2), (0, 0)]):
        A[k, i, j] = np.nan
        expected[k, i, j:] = np.nan
        expected[k, i + 1 :, i:] = np.nan
    expected = np.tril(expected)
    function = lambda A: jax.lax.linalg.cholesky(A, symmetrize_input=False)
    found = fused({"L": function}, (A,))["L"]
    np.testing.assert_allclose(found, expected, 1e-12, 1e-12)


def test_systems_of_one_row():
    names = ("solve", "inverse", "det", "slogdet", "cholesky", "triangular")
    inputs = systems(1), RNG.normal(size=(8, 1))
    check({name: LINEAR[name] for name in names}, inputs, rtol=1e-12)


def test_the_largest_systems():
    """Of six rows; permutations of them exactly."""
    A, b = systems(6), RNG.normal(size=(8, 6))
    shuffled = np.stack([np.eye(6)[RNG.permutation(6)] * (k + 1.0) for k in range(8)])
    functions = {k: LINEAR[k] for k in ("solve", "det", "lu")}
    check(functions, (A[5:], b[5:]), rtol=1e-12)
    check(functions, (shuffled, b), rtol=1e-15)


def test_singular_matrices():
    """What LAPACK gives: a determinant of zero, and no solution."""
    A = np.stack([np.ones((4, 4)), np.zeros((4, 4)), np.arange(16.0).reshape(4, 4)])
    A[2, 2:] = A[2, :2]
    functions = {
        "det": jnp.linalg.det,
        "slogdet": lambda A: tuple(jnp.linalg.slogdet(A)),
        "definite": jnp.linalg.cholesky,
    }
    check(functions, (A,), rtol=1e-12)
    found = fused({"x": lambda A: jnp.linalg.solve(A, jnp.ones(4))}, (A[:2],))["x"]
    assert not np.isfinite(found).all(axis=1).any()


class Coil(aslo.plants.AbstractPlant):
    """A coil and a capacitor, whose voltage is measured: `i' = u - v - R i`, `v' = i`."""

    resistance: jax.Array

    def initial(self):
        return jnp.array([0.5, 3.0])

    def vector_field(self, t, x, u):
        return jnp.stack([u - x[1] - self.resistance * x[0], x[0]])

    def output(self, x):
        return x[1]

    def hidden(self, x):
        return x[:1]


class Current(eqx.Module):
    plant: Coil

    def __call__(self, u, y):
        rate = -self.plant.resistance[None, None]
        return aslo.Rate(jnp.ones(1), s=y, d=0.0 * y, z=(u - y)[None], A=rate)


def coil(sample, filter=None):
    resistance, rate = sample
    plant = Coil(resistance)
    filter = aslo.LowPass(rate) if filter is None else filter
    forgetting = aslo.LeastSquares(aslo.LowPass(rate))
    observer = aslo.AlgebraicObserver(Current(plant), filter, forgetting)
    command = aslo.control.OpenLoop(jnp.cos)
    return aslo.Experiment(plant, command, {"current": observer}, 1e-2)


SAMPLES = np.array([0.3, 0.5, 2.0]), np.array([3.0, 10.0, 40.0])


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_relation_with_a_rate_of_its_own_that_varies(order):
    """Its matrix exponential is compiled, and the systems that its start solves."""
    of_order = {1: None, 2: lambda rate: second_order(rate, 0.7)}[order]

    def make(sample):
        return coil(sample, None if of_order is None else of_order(sample[1]))

    keep = lambda r: (r.estimates["current"].value, r.hidden)
    runs = [
        run_batch(make, SAMPLES, 300, record=keep, every=50, engine=engine).record
        for engine in ("fused", "scan")
    ]
    for a, b in zip(*runs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11)
    value, true = runs[0]
    np.testing.assert_allclose(value[:, -1], true[:, -1], atol=1e-3)


def test_a_refusal_within_the_library_names_the_line_of_the_user():
    poles = jnp.arange(1.0, 8.0)

    def make(sample):
        A = -jnp.diag(poles) * sample[1] + jnp.eye(7, k=1)
        filter = aslo.LinearFilter(A, jnp.ones(7), jnp.ones(7))
        return coil(sample, filter)

    with pytest.raises(NotFusible, match=r"7 by 7, larger than 6 by 6") as caught:
        run_batch(make, SAMPLES, 10, engine="fused")
    message = str(caught.value)
    assert "`jnp.linalg.solve` (primitive `lu`) of " + __file__ in message
    assert "filters.py" not in message and "relations.py" not in message
