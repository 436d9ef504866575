"""Runs that are interrupted, forked, sent away, or left behind at exit."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from iterations import GAINS, last, runner, turned

pytest.importorskip("llvmlite")

HERE = Path(__file__).parent


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
from iterations import GAINS, last, runner, turned

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
from iterations import GAINS, last, runner, turned
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
