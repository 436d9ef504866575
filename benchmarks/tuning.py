"""Tuning: the paper's gains against tuned ones for every machine of section 3, how lambda
goes with speed and noise, which optimiser needs the fewest runs, and how long a fit takes.

`python -m benchmarks tuning` prints the tables of docs/tuning.md; `--quick` leaves out the
choice of lambda, the longest one.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

SAMPLES, FRESH = 64, 256
GRADIENT, SECONDS = 4.0, 120.0  # bounds: of a gradient in runs, of 200 iterations
ITERATIONS, BATCH, STEPS = 200, 1000, 10_000
SPEEDS, NOISES = (2.0, 5.0, 12.0, 30.0), (3e-3, 10e-3, 30e-3)  # rad/s; A


def monte_carlo(case, samples: int = SAMPLES, steps: int | None = None):
    """The mean square of the relative error of a case, over a batch."""
    from aslo_jax.tune import losses

    from .section3 import NAME

    metric = losses.MeanSquare(NAME, case.after, case.scale)
    length = case.steps if steps is None else steps
    return losses.MonteCarlo(case.place, metric, samples=samples, steps=length)


def fitted(case, start=(5.0, 5.0), samples: int = SAMPLES, **settings: Any):
    """The two gains of a case, tuned from `start` (rad/s)."""
    import jax.numpy as jnp

    from aslo_jax import tune

    settings = dict(where=lambda g: g, bounds=(0.3, 2000.0), steps=40) | settings
    return tune.fit(jnp.array(start), monte_carlo(case, samples), **settings)


def plants() -> list[dict[str, Any]]:
    """The rms error on fresh samples with the paper's gains and with tuned ones."""
    import jax
    import jax.numpy as jnp

    import aslo_jax as aslo

    from .section3 import CASES, PAPER

    rows = []
    for name, make in CASES.items():
        case = make()
        found = fitted(case)
        unseen = monte_carlo(case, FRESH)
        pair = jnp.stack([jnp.full(2, PAPER), jnp.asarray(found.parameters)])
        costs = jax.jit(jax.vmap(lambda g: unseen(g, aslo.random.key(1))))(pair)  # noqa: B023
        paper, tuned = np.sqrt(np.asarray(costs))
        rows.append(
            {
                "plant": name,
                "gains": found.parameters.tolist(),
                "paper": float(paper),
                "tuned": float(tuned),
                "stopped": found.stopped,
                "iterations": len(found.history.loss) - 1,
            }
        )
        row = rows[-1]
        print(
            f"  {name:<14}{row['gains'][0]:>10.3g}{row['gains'][1]:>10.3g}{paper:>10.3%}"
            f"{tuned:>10.3%}{paper / tuned:>8.3g}   {row['stopped']}, {row['iterations']}",
            flush=True,
        )
    return rows


def choice() -> list[tuple[float, float, float, float, float]]:
    """Speed (rad/s), noise (A), tuned lambda and gamma (rad/s), and the relative rms error
    on fresh samples, for the unloaded PMSM."""
    import jax.numpy as jnp

    from .section3 import pmsm

    rows = []
    for speed in SPEEDS:
        for noise in NOISES:
            case = pmsm(speed, noise, lambda t: jnp.zeros_like(t))
            found = fitted(case, (5 * speed, 5 * speed), samples=32)
            rows.append((speed, noise, *found.parameters, found.validation**0.5))
            print("  " + "".join(f"{x:>12.4g}" for x in rows[-1]), flush=True)
    return rows


def rule(rows) -> np.ndarray:
    """c, a and b of `lambda = c we^a sigma^b`, we in rad/s (electrical), sigma in A."""
    speed, noise, rate = np.array(rows)[:, :3].T
    terms = np.stack([np.ones_like(speed), np.log(5.0 * speed), np.log(noise)], axis=1)
    c, a, b = np.linalg.lstsq(terms, np.log(rate), rcond=None)[0]
    return np.array([np.exp(c), a, b])


def optimisers() -> list[tuple[str, int, float]]:
    """Runs of the batch until its loss is within 0.1 % of the least one found, and the
    excess at the end, for the PMSM from the paper's gains."""
    import jax
    import jax.numpy as jnp
    import optax

    from aslo_jax import tune

    from .section3 import stepper

    loss, seen = monte_carlo(stepper(), 16, 2_500), []

    def counted(gains, key):
        value = loss(gains, key)
        jax.debug.callback(lambda v: seen.append(float(v)), jax.lax.stop_gradient(value))
        return value

    schedule = optax.cosine_decay_schedule(0.5, 60)
    contenders = {
        "L-BFGS": None,
        "Adam, 0.1": optax.adam(0.1),
        "Adam, 0.3": optax.adam(0.3),
        "Adam, cosine from 0.5": optax.adam(schedule),
        "gradient, 0.3": optax.sgd(0.3),
    }
    traces = {}
    for name, optimiser in contenders.items():
        seen.clear()
        tune.fit(
            jnp.array([5.0, 5.0]),
            counted,
            where=lambda g: g,
            optimiser=optimiser,
            steps=60,
            patience=60,
            mode="forward",
        )
        jax.effects_barrier()
        traces[name] = np.array(seen)
    least = min(t.min() for t in traces.values())
    rows = []
    for name, trace in traces.items():
        near = np.flatnonzero(trace <= 1.001 * least)
        count = int(near[0]) + 1 if near.size else -1
        rows.append((name, count, float(trace.min() / least - 1)))
        print(f"  {name:<24}{count:>6}{rows[-1][2]:>12.1e}", flush=True)
    return rows


def gradient(steps: int = 1_000, runs: int = 7) -> dict[str, float]:
    """Seconds of one run of a thousand samples, and with the gradient in two gains."""
    import jax
    import jax.numpy as jnp

    import aslo_jax as aslo
    from aslo_jax.tune.gradients import slope

    from . import timing
    from .section3 import pmsm

    loss = monte_carlo(pmsm(), BATCH, steps)
    value = jax.jit(lambda g, key: loss(g, key))
    both = slope(lambda g, key: loss(g, key), "forward")
    arguments = jnp.array([5.0, 5.0]), aslo.random.key(0)
    work: dict[str, Callable] = {
        "run": lambda: jax.block_until_ready(value(*arguments)),
        "gradient": lambda: jax.block_until_ready(both(*arguments)),
    }
    start = time.process_time()
    for each in work.values():
        each()
    compiled = time.process_time() - start
    seconds, _ = timing.interleaved(work, runs)
    return {**seconds, "compile": compiled, "steps": steps}


def main(quick: bool = False) -> list[str]:
    """Print the tables; return what does not hold."""
    import jax

    jax.config.update("jax_enable_x64", True)
    failures = []
    found = gradient()
    ratio = found["gradient"] / found["run"]
    whole = found["gradient"] * STEPS / found["steps"] * ITERATIONS
    speed = BATCH * found["steps"] / found["gradient"] / 1e6
    from .timing import load

    print(f"Value and gradient in two gains, PMSM, {BATCH:,} samples; {load()}")
    print(f"  {speed:.1f} M steps of a trajectory per second, {ratio:.2f} runs each")
    print(
        f"  {ITERATIONS} iterations of {STEPS:,} steps: {whole:.0f} s (at most {SECONDS:g})"
    )
    if not ratio <= GRADIENT:
        failures.append(f"A gradient takes {ratio:.2f} runs, more than {GRADIENT:g}.")
    if not whole <= SECONDS:
        failures.append(f"{ITERATIONS} iterations take {whole:.0f} s, not {SECONDS:g} s.")
    print("Runs until the loss is within 0.1 % of the least, and the excess at the end")
    optimisers()
    print("Relative rms error on unseen samples: gains (rad/s), paper's, tuned, factor")
    rows = plants()
    for row in rows:
        if not row["tuned"] < row["paper"]:
            failures.append(f"Tuned gains are no better for the {row['plant']}.")
    if not quick:
        print("Speed (rad/s), noise (A), lambda, gamma (rad/s), relative rms error")
        c, a, b = rule(choice())
        print(f"  lambda = {c:.3g} we^{a:.3f} sigma^{b:.3f}")
    return failures
