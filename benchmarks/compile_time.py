"""How long the fused engine takes to trace and compile large loops: a network whose weights
are others for each lane, which must also run several times as fast as by `scan`, and many
observers side by side."""

import time
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.engines import Runner

from . import loops, timing

BOUNDS = {32: 4.0, 64: 10.0}  # seconds of a processor, by the units of two layers
FASTER = 5.0  # times `scan`, with the most units
LANES, STEPS, RUNS = 1024, 400, 3
OBSERVERS = 50
CHAIN = aslo.plants.IntegratorChain(2)


def weights(units: int) -> dict[str, np.ndarray]:
    """Of each lane, with a leading axis of lanes."""
    draw = np.random.default_rng(0).normal
    return {
        "in": draw(size=(LANES, units)),
        "hidden": draw(size=(LANES, units, units)) / units**0.5,
        "out": draw(size=(LANES, units)) / units**0.5,
    }


def driven(w: Any) -> aslo.Experiment:
    """A chain of integrators whose input a network makes of the time (s)."""

    def command(t):
        first = jnp.tanh(w["in"] * jnp.cos(9.0 * t))
        return w["out"] @ jnp.tanh(w["hidden"] @ first)

    start = jnp.array([0.2, 1.0])
    return aslo.Experiment(CHAIN, aslo.control.OpenLoop(command), {}, 1e-2, initial=start)


def network(units: int, engine: Literal["fused", "scan"]):
    """A run of all lanes, traced; it compiles in its first call."""
    batch = weights(units)
    like = jax.tree.map(lambda a: jax.ShapeDtypeStruct(a.shape[1:], a.dtype), batch)
    keep = lambda record: record.x
    run = Runner(driven, like, STEPS, record=keep, every=STEPS, engine=engine)
    return lambda: np.asarray(run(batch).record)


def _first(make) -> float:
    """Seconds of the processor until a run has been made and done once."""
    start = time.process_time()
    make()()
    return time.process_time() - start


def main() -> list[str]:
    """Print the seconds; return what does not hold."""
    jax.config.update("jax_enable_x64", True)
    from . import motor_loop  # makes its arrays in double precision

    failures = []
    print(f"Time of a processor to trace, compile and run once ({timing.load()})")
    for units, bound in BOUNDS.items():
        seconds = _first(lambda: network(units, "fused"))  # noqa: B023
        print(f"  network, 2 x {units} units{seconds:8.2f} s   (bound {bound} s)")
        if seconds > bound:
            failures.append(f"A network of {units} units takes {seconds:.1f} s.")
    observed = lambda: loops.Sampled(
        motor_loop.LOOP, "fused", motor_loop.samples(8), 100, count=OBSERVERS
    )
    print(f"  {OBSERVERS} observers{_first(observed):16.2f} s")
    units = max(BOUNDS)
    engines: tuple[Literal["fused", "scan"], ...] = ("scan", "fused")
    contenders = {engine: network(units, engine) for engine in engines}
    seconds, found = timing.interleaved(contenders, RUNS)
    np.testing.assert_allclose(found["fused"], found["scan"], rtol=1e-11, atol=1e-12)
    times = seconds["scan"] / seconds["fused"]
    print(f"  {units} units run {times:.1f} times as fast as scan (bound {FASTER})")
    if times < FASTER:
        failures.append(f"A network of {units} units runs {times:.1f} times scan.")
    return failures
