"""Functions of small arrays as graphs: what every primitive does, against JAX itself."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax._frontend.elementwise import ELEMENTWISE
from aslo_jax._frontend.lower import flatten
from aslo_jax._frontend.origin import origin
from aslo_jax._ir.graph import Graph
from aslo_jax.engines import NotFusible
from aslo_jax.engines._fused.program import Bodies, Program

pytest.importorskip("llvmlite")
A = jnp.arange(12.0).reshape(3, 4) / 7 - 0.6
B = jnp.sin(jnp.arange(12.0)).reshape(4, 3)
V = jnp.array([0.3, -1.2, 2.0, 0.7])


def fused(function, *arguments):
    """The function on one lane."""
    kinds = tuple(jax.ShapeDtypeStruct(x.shape, x.dtype) for x in arguments)
    bodies = Bodies(
        lambda inputs: ((), None),
        lambda k, carry, inputs: ((), None),
        lambda carry, inputs: function(*inputs["lane"]),
    )
    program = Program.of(bodies, {"lane": kinds}, (8,))
    _, found = program({"lane": tuple(x[None] for x in arguments)}, 1, 1)
    return jax.tree.map(lambda x: x[0], found)


def rolled(x):
    def body(carry, row):
        carry = 0.5 * carry + row
        return carry, carry[0] * row

    return jax.lax.scan(body, jnp.zeros(4), x, reverse=True)


def looped(x):
    return jax.lax.fori_loop(0, 5, lambda i, c: c * 0.9 + i, x)


def counted(x):
    return jax.lax.while_loop(lambda c: c[0] < 4, lambda c: (c[0] + 1, c[1] * 1.5), (0, x))


MLP = eqx.nn.MLP(4, 2, 8, 2, key=jax.random.key(0))
KEY = aslo.random.key(3)


@jax.custom_jvp
def doubled(x):
    return 2.0 * x


doubled.defjvp(lambda p, t: (doubled(*p), 2.0 * t[0]))

FUNCTIONS = {
    "indexing": lambda A: (A[1], A[:, 2], A[-1, ::2], A[::-1], A[1:, :-1]),
    "known gather": lambda A: A[jnp.array([2, 0]), jnp.array([1, 3])],
    "set": lambda A: A.at[1, 2].set(5.0).at[0].set(A[2]),
    "add at": lambda A: A.at[jnp.array([0, 0, 2]), jnp.array([1, 1, 3])].add(0.5),
    "stacking": lambda A: (jnp.stack([A[0], A[1]], 1), jnp.concatenate([A, A], 1)),
    "shapes": lambda A: (A.reshape(2, 6), A.T, A[None, :, None], jnp.ravel(A)),
    "padding": lambda A: jnp.pad(A, ((1, 0), (2, 1)), constant_values=9.0),
    "interior padding": lambda A: jax.lax.pad(A, 0.5, ((1, -1, 1), (0, 2, 2))),
    "rolling": lambda A: (jnp.roll(A, 1, 1), jnp.flip(A, 0), jnp.tile(A[0], 2)),
    "reductions": lambda A: (A.sum(0), A.max(), A.min(1), A.mean(), A.prod(1), A.std()),
    "logic": lambda A: (jnp.any(A > 1), jnp.all(A > -1, 1), ~(A > 0), A[0] != A[1]),
    "places": lambda A: (jnp.argmax(A, 1), jnp.argmin(A.ravel())),
    "running": lambda A: (jnp.cumsum(A, 1), jnp.cumprod(A, 0), jax.lax.cummax(A, 1)),
    "products": lambda A: (A @ B, A.T @ A, V @ B, jnp.einsum("ij,kj->ik", A, A)),
    "outer": lambda A: (jnp.outer(A[0], A[1]), jnp.diag(V), jnp.trace(A[:, :3])),
    "batched": lambda A: jax.vmap(lambda row: row @ B)(A),
    "norm": lambda A: jnp.linalg.norm(A, axis=1),
    "cross": lambda A: jnp.cross(A[0, :3], A[1, :3]),
    "where": lambda A: jnp.where(A > 0, A, -2 * A),
    "scan": rolled,
    "loop": lambda A: looped(A[0]),
    "while": lambda A: counted(A[0])[1],
    "cond": lambda A: jax.lax.cond(A[0, 0] > 0, lambda: A + 1, lambda: A - 1),
    "switch": lambda A: jax.lax.switch((3 * A[1, 1]).astype(int), [jnp.sin, jnp.cos], A),
    "varying index": lambda A: A[0][(A[0, 0] + 2.6).astype(int)],
    "jit": lambda A: jax.jit(lambda x: x * 2 + 1)(A),
    "remat": lambda A: jax.checkpoint(lambda x: jnp.sin(x) * x)(A),
    "custom derivative": lambda A: doubled(A),
    "gradient": lambda A: jax.grad(lambda x: jnp.sum(jnp.tanh(x) ** 2))(A),
    "jacobian": lambda A: jax.jacfwd(lambda x: jnp.stack([x[0] * x[1], jnp.exp(x[2])]))(
        A[0]
    ),
    "network": lambda A: MLP(A[0]),
    "numbers": lambda A: aslo.random.normal(KEY, (A[0, 0] + 5).astype(int), 1, (3,)),
    "interpolation": lambda A: jnp.polyval(V, A),
    "sorting a pair": lambda A: (jnp.minimum(A[0], A[1]), jnp.maximum(A[0], A[1])),
    "types": lambda A: ((10 * A).astype(jnp.int32) // 3, A.astype(jnp.float32) * 2),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_is_what_jax_makes_of_it(name):
    function = FUNCTIONS[name]
    expected, found = function(A), fused(function, A)
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
        precision = 1e-6 if a.dtype == jnp.float32 else 2e-14
        np.testing.assert_allclose(b, a, rtol=precision, atol=precision)


def dynamic_while(x):
    return jax.lax.while_loop(lambda c: c[0] < 3.0, lambda c: c * 1.5 + 1.0, x)


REFUSED = {
    "jnp.linalg.solve": ("lu", lambda A: jnp.linalg.solve(jnp.tile(A[:, :3], (3, 3)), V9)),
    "jnp.linalg.eigvalsh": ("eigh", lambda A: jnp.linalg.eigvalsh(A[:, :3])),
    "jnp.linalg.qr": ("", lambda A: jnp.linalg.qr(A)),
    "jax.lax.while_loop": ("while", lambda A: dynamic_while(jnp.abs(A[0]) + 0.1)),
    "jax.lax.fori_loop": (
        "while",
        lambda A: jax.lax.fori_loop(0, A[0, 0].astype(int), lambda k, x: 2 * x, A),
    ),
    "jnp.sort": ("sort", lambda A: jnp.sort(jnp.tile(A.ravel(), 20))),
    "jnp.median": ("sort", lambda A: jnp.median(jnp.tile(A.ravel(), 20))),
    "jnp.fft.fft": ("convert_element_type", lambda A: jnp.abs(jnp.fft.fft(A[0]))),
    "jax.lax.scan": (
        "scan",
        lambda A: jax.lax.scan(lambda c, _: (c + A[0, 0], None), 0.0, length=5000)[0],
    ),
    "jax.pure_callback": ("pure_callback", lambda A: jax.pure_callback(np.sin, A, A)),
    "jax.debug.callback": ("debug_callback", lambda A: (jax.debug.callback(id, A), A)[1]),
    "eqx.error_if": ("", lambda A: eqx.error_if(A, A > 1e9, "too large")),
}
V9 = jnp.arange(9.0)


@pytest.mark.parametrize("again", [False, True])
@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_compiled_is_refused_by_name_and_line(name, again):
    """The public function that the user called, the primitive, and the user's own line,
    though JAX remembers what it has traced in another one."""
    primitive, function = REFUSED[name]
    if again and name != "jnp.fft.fft":
        jax.make_jaxpr(function)(A)
    with pytest.raises(NotFusible) as caught:
        fused(lambda A: function(1.0 * A), A)
    message = str(caught.value)
    assert f"cannot compile `{name}` (primitive `{primitive}" in message
    assert 'engine="scan"' in message and "aslo_jax" not in message.replace(__file__, "")
    file, _, line = message.partition(" of ")[2].partition(": ")[0].rpartition(":")
    assert file == __file__
    source = Path(__file__).read_text().splitlines()
    assert name in source[int(line) - 1]


def test_a_line_is_that_of_the_call_at_hand():
    """JAX keeps the body of `jnp.sort` from the first call, with the line of that call."""

    def first(A):
        return jnp.sort(jnp.tile(A.ravel(), 30))

    def second(A):
        return jnp.sort(jnp.tile(A.ravel(), 30))  # the second

    for function in (first, second):
        with pytest.raises(NotFusible) as caught:
            fused(function, A)
        line = str(caught.value).partition(" of ")[2].partition(": ")[0].rpartition(":")[2]
        found = Path(__file__).read_text().splitlines()[int(line) - 1]
        assert found.endswith("# the second") == (function is second)


def test_what_fails_within_a_rule_is_a_refusal(monkeypatch):
    def broken(*arguments):
        raise KeyError("float7")

    monkeypatch.setitem(ELEMENTWISE, "sin", broken)
    with pytest.raises(
        NotFusible, match=r"test_flatten\.py:\d+.*KeyError.*float7"
    ) as caught:
        fused(lambda A: jnp.sin(A), A)
    assert isinstance(caught.value.__cause__, KeyError)


def test_where_a_failure_comes_from():
    """Frames by hand, innermost first: of JAX, of this library, of a user."""
    root = Path(jax.__file__).parent
    ours = Path(aslo.__file__).parent
    lax = ("sort", str(root / "_src" / "lax" / "lax.py"), 3)
    numpy = ("sort", str(root / "_src" / "numpy" / "sorting.py"), 5)
    library = ("flow", str(ours / "filters.py"), 7)
    theirs = ("control", str(Path("somewhere") / "mine.py"), 11)
    mine = str(Path("somewhere") / "mine.py") + ":11"
    assert origin([lax, numpy, theirs]) == (mine, "jnp.sort", False)
    assert origin([lax, numpy, library, theirs]) == (mine, "jnp.sort", False)
    assert origin([lax, library]) == (f"{library[1]}:7", "jax.lax.sort", True)
    assert origin([lax, numpy]) == ("", "jnp.sort", True)
    typed = ("<module>", "<stdin>", 1)
    assert origin([lax, ("f", "<string>", 2), typed]) == (
        "<stdin>:1",
        "jax.lax.sort",
        False,
    )
    assert origin([]) == ("", "", True)


def test_equal_operations_are_kept_once_and_constants_folded():
    graph = Graph()
    x = graph.input(np.float64, ("lane", 0))
    one, two = graph.const(1.0, float), graph.const(2.0, float)
    assert graph.op("add", x, two) == graph.op("add", two, x)
    assert graph.value(graph.op("mul", two, two)) == 4.0
    assert graph.op("mul", x, one) == x == graph.op("add", x, graph.const(0.0, float))
    assert graph.op("neg", graph.op("neg", x)) == x
    assert graph.select(graph.const(True, bool), x, one) == x
    # Zero times a number that may be infinite is not zero.
    assert graph.value(graph.op("mul", x, graph.const(0.0, float))) is None
    assert graph.const(0.0, float) != graph.const(-0.0, float)


def test_dead_code_is_left_out():
    def advance(k, carry, inputs):
        unused = jnp.exp(jnp.sin(carry) ** 2)
        del unused
        return carry + inputs["lane"] ** 3, None

    bodies = Bodies(lambda i: (i["lane"], None), advance, lambda carry, i: carry)
    kind = jax.ShapeDtypeStruct((), np.float64)
    program = Program.of(bodies, {"lane": kind}, (8,))
    assert program.operations == 1  # the cube is computed once, before the loop
    _, found = program({"lane": np.array([2.0, -1.0])}, 2, 5)
    np.testing.assert_array_equal(found, [42.0, -6.0])


SIGNS = {
    "(-a) b": (lambda a, b: -a * b, lambda a, b: -(a * b)),
    "a (-b)": (lambda a, b: a * -b, lambda a, b: -(a * b)),
    "(-a) (-b)": (lambda a, b: -a * -b, lambda a, b: a * b),
    "(-a) / b": (lambda a, b: -a / b, lambda a, b: -(a / b)),
    "a / (-b)": (lambda a, b: a / -b, lambda a, b: -(a / b)),
    "(-a) + b": (lambda a, b: -a + b, lambda a, b: b - a),
    "a + (-b)": (lambda a, b: a + -b, lambda a, b: a - b),
    "(-a) + (-b)": (lambda a, b: -a + -b, lambda a, b: -(a + b)),
    "(-a) - b": (lambda a, b: -a - b, lambda a, b: -(a + b)),
    "a - (-b)": (lambda a, b: a - -b, lambda a, b: a + b),
    "(-a) - (-b)": (lambda a, b: -a - -b, lambda a, b: b - a),
    "-(a - b)": (lambda a, b: -(a - b), lambda a, b: b - a),
}


@pytest.mark.parametrize("name", SIGNS)
def test_signs_are_a_part_of_another_operation(name):
    """The same nodes, and the same numbers to the last bit."""
    graph, kinds = Graph(), (jax.ShapeDtypeStruct((), np.float64),) * 2
    inputs = [np.asarray(graph.input(np.float64, ("lane", k))) for k in range(2)]
    first, second = (
        flatten(graph, jax.make_jaxpr(f)(*kinds), inputs)[0] for f in SIGNS[name]
    )
    assert first == second
    a, b = 1.3, -0.7
    assert SIGNS[name][0](a, b) == SIGNS[name][1](a, b)


@pytest.mark.parametrize("dtype", [np.int32, np.uint32, np.int64])
@pytest.mark.parametrize("amount", [0, 5, 31, 40, 64, -1])
def test_constants_are_shifted_as_jax_shifts_them(dtype, amount):
    graph = Graph()
    value = np.array(0x90000001, np.uint64).astype(dtype)
    by = np.array(amount).astype(dtype)
    for op, shift in {
        "shl": jax.lax.shift_left,
        "lshr": jax.lax.shift_right_logical,
        "ashr": jax.lax.shift_right_arithmetic,
    }.items():
        folded = graph.op(op, graph.const(value, dtype), graph.const(by, dtype))
        assert graph.value(folded) == shift(jnp.asarray(value), jnp.asarray(by)), op
