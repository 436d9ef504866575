"""A loop with a costly start: `lax.cond` on a condition of the state, beside a choice by
`where`, which computes both in every step, and beside each of the two alone."""

import math
from collections.abc import Callable
from typing import Any

from .results import save
from .timing import interleaved, load

LANES, STEPS, SHARE, TERMS = 8192, 2_000, 0.05, 100
RUNS = 7
MOST, LEAST = 1.15, 2.0  # bounds: of the time over that of the parts, of `where` over it


def observers() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Of a state, the costly step, four operations for each term of a series, and the
    plain one, a filter of order 12 driven by an oscillator."""
    import jax.numpy as jnp

    def costly(state, x):
        a, b, *rest = state
        value = a
        for j in range(TERMS):
            value = 0.9 * value * b + x / (10.0 + j) - 0.01 * value * a
        return value, 0.5 * b + 0.1 * a, *(0.9 * r + 0.1 * value for r in rest)

    def plain(state, x):
        a, b, *rest = state
        after = [a + 0.01 * b, b - 0.01 * jnp.sin(a)]
        for j, r in enumerate(rest):
            after.append(r + 0.05 * (1.0 + 0.1 * j) * (after[-1] - r * (1.0 + 0.1 * x)))
        return tuple(after)

    return costly, plain


def programs() -> dict[str, Any]:
    """Loops over the step and a counter, each a function of the first values and of how
    many steps are costly."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from aslo_jax.engines._fused.program import Bodies, Program
    from aslo_jax.engines._runtime.host import widths

    costly, plain = observers()

    def branched(state, x, starts):
        return jax.lax.cond(starts, costly, plain, state, x)

    def chosen(state, x, starts):
        pair = costly(state, x), plain(state, x)
        return jax.tree.map(lambda a, b: jnp.where(starts, a, b), *pair)

    def of(step):
        def advance(k, carry, inputs):
            (state, count), (x, until) = carry, inputs["lane"]
            return (step(state, x, count < until), count + 1.0), None

        def begin(inputs):
            x, _ = inputs["lane"]
            return ((x, 0.3 * x, *(0.0 * x for _ in range(12))), 0.0 * x), None

        real = jax.ShapeDtypeStruct((), np.float64)
        bodies = Bodies(begin, advance, lambda carry, inputs: carry[0])
        return Program.of(bodies, {"lane": (real, real)}, widths())

    steps = {
        "cond": branched,
        "where": chosen,
        "costly": lambda state, x, starts: costly(state, x),
        "plain": lambda state, x, starts: plain(state, x),
    }
    return {name: of(step) for name, step in steps.items()}


def main() -> list[str]:
    """Print the figures; return what does not hold."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    x = np.random.default_rng(0).uniform(-1.0, 1.0, LANES)
    starts = {
        "all at once": np.full(LANES, math.floor(SHARE * STEPS)),
        # Neighbours disagree in nearly all of these steps.
        "each at its own time": np.floor(2 * SHARE * STEPS * np.linspace(0, 1, LANES)),
        "at random": np.floor(
            2 * SHARE * STEPS * np.random.default_rng(1).uniform(size=LANES)
        ),
    }
    made, failures, figures = programs(), [], {}
    print(
        f"A start of {SHARE:.0%} of {STEPS} steps with {4 * TERMS} operations more, "
        f"{LANES} lanes, one thread ({load()}); cond beside its parts, where beside cond"
    )
    for name, until in starts.items():
        lane = {"lane": (x, until.astype(np.float64))}
        runs = {
            kind: lambda p=p, lane=lane: p(lane, LANES, STEPS, every=STEPS, threads=1)
            for kind, p in made.items()
        }
        seconds, values = interleaved(runs, RUNS)
        for a, b in zip(values["cond"][1], values["where"][1], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
        parts = SHARE * seconds["costly"] + (1.0 - SHARE) * seconds["plain"]
        over, gain = seconds["cond"] / parts, seconds["where"] / seconds["cond"]
        figures[name] = {"seconds": seconds, "over its parts": over, "gain": gain}
        print(
            f"  {name:<22}{over:>6.2f}{gain:>7.2f}   "
            + ", ".join(f"{kind} {1e3 * s:.0f} ms" for kind, s in seconds.items())
        )
    save("switching", figures)
    first = figures["all at once"]
    if first["over its parts"] > MOST:
        failures.append(
            f"A loop with a costly start takes {first['over its parts']:.2f} times its "
            f"parts, more than {MOST:g}."
        )
    if first["gain"] < LEAST:
        failures.append(
            f"A loop with a costly start is {first['gain']:.2f} times as fast as one that "
            f"chooses, less than {LEAST:g}."
        )
    return failures
