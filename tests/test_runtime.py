"""Runs are never fatal, and their arguments are refused by name, whatever the engine."""

import sys
import threading
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from iterations import GAINS, Iteration, last, rotated, runner, started, turned

from aslo_jax.engines import NotFusible, Runner, run_batch
from aslo_jax.engines._fused import program
from aslo_jax.engines._runtime.threads import Run

pytest.importorskip("llvmlite")


# ---- arguments ---------------------------------------------------------------------------

BOTH = pytest.mark.parametrize("engine", ["fused", "scan"])


@BOTH
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(threads=0), "`threads` must be at least 1, but got 0"),
        (dict(threads=-1), "`threads` must be at least 1, but got -1"),
        (dict(threads=True), "`threads` must be a whole number, but got True"),
        (dict(block=0), "`block` must be at least 1, but got 0"),
        (dict(steps=True), "`steps` must be a whole number, but got True"),
        (dict(steps=0), "both at least 1, but got steps = 0"),
        (dict(steps=-4, every=2), "both at least 1, but got steps = -4"),
        (dict(steps=4, every=0), "both at least 1, but got steps = 4, every = 0"),
        (dict(steps=6, every=4), "`every` must divide `steps`"),
    ],
)
def test_numbers_that_are_none_are_refused_by_name(engine, change, message):
    with pytest.raises(ValueError, match=message):
        runner(engine=engine, **change)


def pair(sample):
    return sample["a"], sample["b"]


def drift(z, sample):
    return z[0] + 1e-3 * sample["b"], z[1]


PAIR = {
    "a": jax.ShapeDtypeStruct((), np.float64),
    "b": jax.ShapeDtypeStruct((), np.float64),
}
A, B = np.arange(5.0), np.arange(5.0) + 100.0


@pytest.fixture(scope="module")
def pairs():
    kinds = dict(step=drift, begin=pair, like=PAIR, steps=2)
    return {engine: runner(engine=engine, **kinds) for engine in ("fused", "scan")}


@BOTH
@pytest.mark.parametrize(
    ("samples", "message"),
    [
        (
            {"a": np.stack([A, -A], 1), "b": B},
            r"`parameters\['a'\]` must have the shape \(N\)",
        ),
        ({"a": A, "z": B}, "`parameters` must have the structure of `like`"),
        ({"a": A}, "`parameters` must have the structure of `like`"),
        ((A, B), "`parameters` must have the structure of `like`"),
        ({"a": A, "b": list(B)}, "`parameters` must have the structure of `like`"),
        ({"a": A, "b": B[:3]}, "`parameters` must have one leading axis of common length"),
        ({"a": 1.0, "b": 2.0}, "`parameters` must have one leading axis of common length"),
        ({"a": A, "b": B + 0j}, r"`parameters\['b'\]` must have the type float64"),
        ({"a": A, "b": np.full(5, 2**53 + 1)}, "holds exactly, but got 9007199254740993"),
        (
            {"a": A, "b": np.full(5, "x")},
            r"`parameters\['b'\]` must be an array of numbers",
        ),
        ({"a": A, "b": "x"}, r"`parameters\['b'\]` must be an array of numbers"),
    ],
)
def test_samples_unlike_the_one_of_the_runner_are_refused(pairs, engine, samples, message):
    with pytest.raises(ValueError, match="Argument .*" + message):
        pairs[engine](samples)


@BOTH
def test_samples_of_other_layouts_and_types_are_read_for_what_they_are(pairs, engine):
    expected = A + 2e-3 * B
    wide = np.stack([B, -B], 1)
    for samples in (
        {"b": B, "a": A},
        {"a": A.astype(">f8"), "b": B.astype(">i2")},
        {"a": A[::-1][::-1], "b": wide[:, 0]},
        {"a": A.astype(np.float32), "b": jnp.asarray(B, int)},
        {"a": A, "b": np.asfortranarray(wide)[:, 0]},
    ):
        np.testing.assert_allclose(last(pairs[engine](samples)), expected, rtol=1e-12)
    flags = runner(
        engine=engine,
        steps=1,
        like=np.array([1, 2], np.uint8),
        begin=lambda s: (s[0], s[1]),
        step=lambda z, s: (z[0] + s[1], z[1]),
    )
    found = flags(np.array([[1, 2], [3, 250]]))
    np.testing.assert_array_equal(last(found), [3, 253])
    assert last(found).dtype == np.uint8
    for wrong in (256, -1):
        with pytest.raises(ValueError, match=f"exactly, but got {wrong}"):
            flags(np.array([[1, 2], [3, wrong]]))
    with pytest.raises(ValueError, match="must have the type uint8"):
        flags(np.array([[1.0, 2.0]]))


@BOTH
def test_debugging_of_nans_reaches_both_engines(engine):
    run = runner(engine=engine, steps=1)
    bad = np.array([np.nan, 1.0])
    assert np.isnan(last(run(bad))[0])
    with jax.debug_nans(True), pytest.raises(FloatingPointError, match="nan"):
        run(bad)


# ---- threads -----------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, np.int64(3), 1000, None])
def test_any_number_of_threads_gives_the_same(threads):
    steps = 20_000  # enough for several threads
    found = last(runner(steps, threads=threads)(GAINS))
    np.testing.assert_allclose(found, turned(GAINS, steps), rtol=1e-9, atol=1e-12)


def test_runners_from_several_threads():
    steps = 4_000
    runners = [runner(steps, threads=n) for n in (1, 2, 3)]
    found: dict[int, list] = {k: [] for k in range(6)}

    def repeat(k):
        for _ in range(5):
            found[k].append(last(runners[k % 3](GAINS)))

    threads = [threading.Thread(target=repeat, args=(k,)) for k in found]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    expected = last(runners[0](GAINS))
    np.testing.assert_allclose(expected, turned(GAINS, steps), rtol=1e-10)
    for each in found.values():
        assert len(each) == 5
        for got in each:
            np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("brief", [True, False])
def test_an_error_in_a_thread_reaches_the_caller_and_ends_the_others(brief):
    done = []

    def work(span, limit):
        done.append(span)
        if span[0] == 3:
            raise MemoryError("in a thread")

    run = Run(work, [(k, k + 1) for k in range(10_000)], 1)
    with pytest.raises(MemoryError, match="in a thread"):
        run.by(3, brief)
    assert (3, 4) in done and len(done) < 10_000
    done.clear()
    Run(lambda span, limit: done.append(span), [(k, k + 1) for k in range(9)], 1).by(
        3, brief
    )
    assert sorted(done) == [(k, k + 1) for k in range(9)]


def test_a_run_without_further_threads(monkeypatch):
    """Where the system gives none."""

    def none(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", none)
    done = []
    spans = [(k, k + 1) for k in range(9)]
    Run(lambda span, limit: done.append(span), spans, 1).by(4, False)
    assert sorted(done) == spans


# ---- the other engine --------------------------------------------------------------------


def broken(*_, **__):
    raise KeyError("unknown")


@pytest.mark.parametrize("where", ["flatten", "optimised", "chosen", "Kernel"])
@pytest.mark.parametrize("way", [lambda f: f, jax.jit], ids=["called", "jit"])
def test_whatever_fails_the_other_engine_runs(monkeypatch, where, way):
    """With a warning at the user's line, that of this file."""
    monkeypatch.setattr(program, where, broken)

    make = lambda sample: Iteration(sample, rotated, started)

    def made_and_called():
        run = Runner(make, 1.0, 200, record=lambda r: r.x)
        return run, way(lambda x: run(x).record[0][:, -1])(GAINS)

    with pytest.warns(UserWarning, match=r"KeyError.*please report") as caught:
        run, found = made_and_called()
    assert [str(w.filename) for w in caught] == [__file__]
    np.testing.assert_allclose(found, turned(GAINS, 200), rtol=1e-12)
    assert run.engine == "scan"
    with pytest.raises(NotFusible, match=r'KeyError.*please report.*engine="scan"'):
        runner()(GAINS)


def test_the_line_of_the_warning(monkeypatch):
    monkeypatch.setattr(program, "flatten", broken)
    make = lambda sample: Iteration(sample, rotated, started)
    with pytest.warns(UserWarning, match="please report") as caught:
        run_batch(make, GAINS, 2)
    line = sys._getframe().f_lineno - 1
    assert (caught[0].filename, caught[0].lineno) == (__file__, line)


@pytest.mark.parametrize("engine", ["auto", "fused", "scan"])
def test_errors_of_the_experiment_are_raised_as_they_are(engine):
    def step(z, sample):
        raise LookupError("of the user")

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(LookupError, match=r"^of the user"):
            runner(engine=engine, step=step)(GAINS)


# ---- derivatives -------------------------------------------------------------------------


def test_derivatives_that_a_fused_run_does_not_have():
    run = runner(50)
    f = lambda g: jnp.sum(run(g * GAINS).record[0])
    reverse = 'jax.jvp or jax.jacfwd, or engine="scan"'
    for ask in (
        lambda: jax.grad(f)(1.0),
        lambda: jax.grad(jax.jit(f))(1.0),
        lambda: jax.jit(jax.grad(f))(1.0),
        lambda: jax.vjp(f, 1.0),
        lambda: jax.linearize(f, 1.0),
        lambda: jax.vmap(jax.grad(f))(jnp.ones(2)),
        lambda: jax.hessian(f)(1.0),
    ):
        with pytest.raises(NotImplementedError, match=reverse):
            ask()
    forward = jax.jacfwd(f)
    for ask in (
        lambda: jax.jacfwd(forward)(1.0),
        lambda: jax.jacfwd(jax.jit(forward))(1.0),
        lambda: jax.jacrev(forward)(1.0),
    ):
        with pytest.raises(NotImplementedError, match=r'first derivatives only.*"scan"'):
            ask()
    # Known tangents within what is differentiated in something else.
    scaled = jax.grad(lambda c: c * jax.jvp(f, (1.0,), (1.0,))[1])(2.0)
    slow = runner(50, engine="scan")
    expected = jax.grad(lambda g: jnp.sum(slow(g * GAINS).record[0]))(1.0)
    np.testing.assert_allclose(forward(1.0), expected, rtol=1e-10)
    np.testing.assert_allclose(scaled, expected, rtol=1e-10)


def test_derivatives_by_the_other_engine(monkeypatch):
    """Where those of the fused one cannot be compiled."""
    from aslo_jax.engines._fused import tangents

    run, refused = runner(50, engine="auto"), runner(50)
    slow = runner(50, engine="scan")
    derivative = lambda r: jax.jacfwd(lambda g: r(g * GAINS).record[0][:, -1])(1.0)
    monkeypatch.setattr(tangents, "flatten", broken)
    with pytest.raises(KeyError, match="unknown"):
        derivative(refused)
    with pytest.warns(UserWarning, match="please report"):
        found = derivative(run)
    np.testing.assert_allclose(found, derivative(slow), rtol=1e-12)
    assert np.ptp(found) > 0.1
