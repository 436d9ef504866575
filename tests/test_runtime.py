"""Runs are never fatal: interrupted, failing, forked, left behind at exit; and their
arguments are refused by name, whatever the engine."""

import os
import pickle
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax.engines import NotFusible, Runner, run_batch
from aslo_jax.engines._fused import program
from aslo_jax.engines._runtime.threads import Run
from aslo_jax.experiment import Record

pytest.importorskip("llvmlite")
HERE = Path(__file__).parent


class Iteration(eqx.Module):
    """As a user may write an experiment: x[k+1] = step(x[k], sample)."""

    sample: Any
    step: Callable = eqx.field(static=True)
    begin: Callable = eqx.field(static=True)

    def init(self):
        start = self.begin(self.sample)
        return start, recorded(start)

    def prepare(self, carry):
        return None

    def advance(self, k, carry, prepared):
        after = self.step(carry, self.sample)
        return after, recorded(after)


def recorded(z):
    nothing = jnp.zeros(())
    return Record(nothing, z, jnp.zeros(1), nothing, nothing, {})


def rotated(z, gain):
    return z[0] - 1e-3 * z[1], z[1] + gain * 1e-3 * z[0]


def started(gain):
    return gain, 0.0 * gain


def runner(steps=200, engine="fused", step=rotated, begin=started, like=1.0, **settings):
    make = lambda sample: Iteration(sample, step, begin)
    settings = dict(every=steps, record=lambda r: r.x) | settings
    return Runner(make, like, steps, engine=engine, **settings)


def last(found):
    return np.asarray(found.record[0])[:, -1]


GAINS = np.linspace(-1.0, 1.0, 37)


def turned(gains, steps):
    """By powers of the matrix of a step."""
    step = np.stack(
        [
            np.stack([np.ones_like(gains), -1e-3 * np.ones_like(gains)], -1),
            np.stack([1e-3 * gains, np.ones_like(gains)], -1),
        ],
        1,
    )
    return np.linalg.matrix_power(step, steps)[:, 0, 0] * gains


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


# ---- other processes and signals ---------------------------------------------------------


def ended(script):
    """What a process prints that ends by itself."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    start = "import jax\njax.config.update('jax_enable_x64', True)\n"
    done = subprocess.run(
        [sys.executable, "-c", start + script],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, (done.returncode, done.stdout, done.stderr)
    return done.stdout.split()


INTERRUPTED = """
import gc, os, signal, sys, threading, time
import numpy as np
from test_runtime import GAINS, last, runner, turned

# Annotations are not checked in this process, so that these reach the checks of their own.
for change in (dict(threads=1.5), dict(threads="2"), dict(steps=4.0), dict(every=2.0)):
    for engine in ("fused", "scan"):
        ((name, value),) = change.items()
        try:
            runner(engine=engine, **change)
        except ValueError as error:
            expected = f"Argument `{name}` must be a whole number, but got {value!r}."
            assert str(error) == expected, error
            print(name)

few = runner(100)
few(GAINS)
for threads, lanes in ((1, 8), (1, 100_000), (3, 100_000)):
    endless = runner(10**10, threads=threads)
    endless._fused.program.compile()
    x = np.linspace(-1.0, 1.0, lanes)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    begun = time.monotonic()
    try:
        endless(x)
    except KeyboardInterrupt:
        print(time.monotonic() - begun)
    timer.join()
    # What was written to may hold something else from now on.
    del x
    gc.collect()
    held = [np.full(3 * lanes, 7.0) for _ in range(4)]
    time.sleep(0.1)
    assert all((h == 7.0).all() for h in held)
    assert [t.name for t in threading.enumerate()] == ["MainThread"]
    np.testing.assert_allclose(last(few(GAINS)), turned(GAINS, 100), rtol=1e-10)
# And at exit one is left behind.
threading.Thread(target=endless, args=(np.ones(100_000),), daemon=True).start()
time.sleep(0.2)
assert len(threading.enumerate()) > 2
"""


def test_interrupted_and_left_behind():
    """By Ctrl-C, with one thread and several, one block of lanes and many, of a run that
    would take minutes; and at exit, in a thread that nobody waits for."""
    words = ended(INTERRUPTED)
    assert words[:8] == [n for n in ("threads", "threads", "steps", "every") for _ in "ab"]
    assert len(words) == 11 and all(0.2 < float(s) < 5.0 for s in words[8:])


FORKED = """
import os, sys, threading, warnings
import numpy as np
from test_runtime import GAINS, last, runner, turned
from aslo_jax.engines._fused import program

warnings.filterwarnings("ignore", message=".*fork")
few = runner(20_000, threads=3)
inputs, lanes = {"lane": [GAINS]}, len(GAINS)
expected = turned(GAINS, 20_000)

def run():
    # Without JAX, which a forked process cannot use.
    record, _ = few._fused.program(inputs, lanes, 20_000, every=20_000, threads=3)
    np.testing.assert_allclose(record[0][:, -1], expected, rtol=1e-9, atol=1e-12)

few(GAINS)
again = runner(20_000, threads=2)  # another thread compiles meanwhile
thread = threading.Thread(target=again._fused.program.compile)
thread.start()
child = os.fork()
run()
if child == 0:
    again._fused.program.compile()
    os.write(1, b"child ")
    os._exit(0)
thread.join()
assert os.waitpid(child, 0)[1] == 0
print("parent")
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_forked():
    assert ended(FORKED) == ["child", "parent"]


def test_sent_to_another_process():
    """The loop of a runner, which is compiled there."""
    made = pickle.loads(pickle.dumps(runner()._fused.program))
    record, _ = made({"lane": [GAINS]}, len(GAINS), 200, every=200)
    np.testing.assert_allclose(record[0][:, -1], turned(GAINS, 200), rtol=1e-10)


def test_derivatives_are_not_sent_to_another_process():
    sent = pickle.loads(pickle.dumps(runner()))
    np.testing.assert_allclose(last(sent(GAINS)), turned(GAINS, 200), rtol=1e-10)
    with pytest.raises(NotImplementedError, match="sent to another process has values"):
        jax.jvp(lambda x: sent(x).record[0], (GAINS,), (GAINS,))


@pytest.mark.parametrize("lanes", [0, 3])
def test_no_batches_of_lanes(lanes):
    """Further axes may be empty, of values and of tangents, as with the other engine."""
    x, none = jnp.ones(lanes), jnp.ones((0, lanes))
    for run in (runner(), runner(engine="scan")):
        values = lambda x, run=run: run(x).record[0]
        pushed = lambda x, rate, f=values: jax.jvp(f, (x,), (rate,))
        assert jax.vmap(values)(none).shape == (0, lanes, 2)
        _, tangent = jax.vmap(pushed)(none, none)
        assert tangent.shape == (0, lanes, 2)
        _, tangent = jax.vmap(pushed, (None, 0))(x, none)
        assert tangent.shape == (0, lanes, 2)


class Counted(Iteration):
    """What is recorded at t = 0 is of another kind than later: `begun(sample)`."""

    begun: Callable = eqx.field(static=True)

    def init(self):
        return self.begin(self.sample), recorded(self.begun(self.sample))

    def advance(self, k, carry, prepared):
        after = self.step(carry, self.sample)
        return after, recorded(after[0])


def counted_run(begun, engine):
    make = lambda sample: Counted(sample, rotated, started, begun)
    return Runner(make, 1.0, 3, record=lambda r: r.x, every=1, engine=engine)(GAINS)


@pytest.mark.parametrize("begun", [jnp.int32, jnp.float32, lambda x: x > 0])
def test_records_of_other_types_at_the_start(begun):
    """Left to the other engine, which finds a type for both."""
    with pytest.raises(NotFusible, match=r"records of the same types.* at t = 0 has"):
        counted_run(begun, "fused")
    with pytest.warns(UserWarning, match="records of the same types"):
        found = np.asarray(counted_run(begun, "auto").record)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found[:, 0], np.asarray(begun(GAINS), np.float64))
    np.testing.assert_allclose(found[:, 3], turned(GAINS, 3), rtol=1e-12)


def test_records_of_plain_numbers_at_the_start():
    for engine in ("fused", "scan"):
        found = np.asarray(counted_run(lambda x: 0.25, engine).record)
        np.testing.assert_array_equal(found[:, 0], 0.25)
        np.testing.assert_allclose(found[:, 3], turned(GAINS, 3), rtol=1e-12)


def test_a_state_that_changes_its_type():
    """A whole number to begin with is real for the other engine."""
    begin, step = lambda x: (0, x), lambda z, x: (z[0] + 0.5 * x, z[1])
    with pytest.raises(NotFusible, match=r"keeps its shapes and types, but .*'int64'"):
        runner(begin=begin, step=step)
    with pytest.warns(UserWarning, match="keeps its shapes and types"):
        run = runner(4, engine="auto", begin=begin, step=step)
    np.testing.assert_allclose(last(run(GAINS)), 2.0 * GAINS, rtol=1e-12)


@pytest.mark.parametrize(
    "begun",
    [lambda x: x[None], lambda x: {"a": x}, lambda x: None],
    ids=["shape", "tree", "none"],
)
@pytest.mark.parametrize("engine", ["auto", "fused", "scan"])
def test_records_of_other_shapes_at_the_start(begun, engine):
    with pytest.raises((TypeError, ValueError), match=r"different|None"):
        counted_run(begun, engine)


# ---- the other engine --------------------------------------------------------------------


def broken(*_, **__):
    raise KeyError("unknown")


@pytest.mark.parametrize("where", ["flatten", "optimised", "chosen", "Kernel"])
@pytest.mark.parametrize("way", [lambda f: f, jax.jit], ids=["called", "jit"])
def test_whatever_fails_the_other_engine_runs(monkeypatch, where, way):
    """With a warning at the user's line, that of this file."""
    monkeypatch.setattr(program, where, broken)

    def made_and_called():
        run = runner(engine="auto")
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
