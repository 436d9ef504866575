"""The clock of a processor while it computes, and the share of it that a kernel uses."""

import time
from typing import Any

# Products of whole numbers; cycles of each on every x86-64 since 2008.
CHAIN, LATENCY = 400, 3
ROUNDS = 200_000
# Each product needs the one before it.
TEXT = (
    "define void @kernel("
    "i64 %seed, i64 %n, i64 %a, ptr %b, i64 %c, ptr %out, ptr %d) {\n"
    "entry:\n  br label %loop\nloop:\n"
    "  %k = phi i64 [ 0, %entry ], [ %next, %loop ]\n"
    f"  %x0 = phi i64 [ %seed, %entry ], [ %x{CHAIN}, %loop ]\n"
    + "".join(f"  %x{k + 1} = mul i64 %x{k}, %x{k}\n" for k in range(CHAIN))
    + "  %next = add i64 %k, 1\n  %more = icmp slt i64 %next, %n\n"
    "  br i1 %more, label %loop, label %done\ndone:\n"
    f"  store i64 %x{CHAIN}, ptr %out\n  ret void\n}}\n"
)


def hertz() -> float:
    """By a chain of products, the fastest of some runs."""
    import ctypes

    from aslo_jax.engines._runtime.host import compiled

    run, out = compiled(TEXT), ctypes.c_int64()
    best = float("inf")
    for _ in range(3):
        start = time.perf_counter()
        run(3, ROUNDS, 0, None, 0, ctypes.addressof(out), None)
        best = min(best, time.perf_counter() - start)
    return CHAIN * ROUNDS * LATENCY / best


def share(step: Any, speed: float, clock: float) -> float:
    """Of the products that a processor can make, those of a step that it takes so many
    times a second for each lane."""
    from aslo_jax.engines._backend.cost import PRODUCTS

    made = (e.instruction for e in step.usual.events)
    products = sum(x is not None and x.op in PRODUCTS for x in made)
    return products / step.target.products / step.width * speed / clock
