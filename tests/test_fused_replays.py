"""Many logs by observers that a function makes: those of `replay`, one by one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo

pytest.importorskip("llvmlite")

from aslo_jax.engines._fused.replays import Replays

RNG = np.random.default_rng(5)
LANES, ROWS, INTERVAL = 5, 40, 1e-2
U = RNG.normal(size=(LANES, ROWS))
Y = np.cumsum(RNG.normal(size=(LANES, ROWS)), axis=1)
RATES = {"fast": np.linspace(4.0, 30.0, LANES), "slow": np.linspace(0.5, 3.0, LANES)}


def make(sample, y):
    """An ASLO whose rate is that of a lane, and one that begins where its log does."""
    plant = aslo.plants.IntegratorChain(2)
    exact, printed = (
        aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(sample[name]), start=start)
        for name, start in (("fast", "exact"), ("slow", "paper"))
    )
    started = aslo.Asymptotic(exact, sample["slow"], initial=jnp.stack([y]))
    return aslo.SideBySide({"ASLO": exact, "printed": printed, "started": started})


def kept(estimates):
    return {name: (e.value, e.certificate) for name, e in estimates.items()}


def test_logs_beside_each_other_are_those_of_one():
    run = Replays(make, kept, INTERVAL)
    found = run(RATES, U, Y)
    assert found["ASLO"][0].shape == (LANES, ROWS, 1)
    assert found["ASLO"][1].shape == (LANES, ROWS)
    t = INTERVAL * np.arange(ROWS)
    for k in range(LANES):
        observer = make({name: each[k] for name, each in RATES.items()}, Y[k, 0])
        wanted = kept(aslo.replay(observer, t, U[k], Y[k]))
        one = jax.tree.map(lambda x, k=k: x[k], found)
        # To rounding, where the guard lets little of it through.
        jax.tree.map(
            lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9),
            one,
            wanted,
        )
    # A lane does not depend on others, nor on how many there are.
    alone = run({name: each[3:4] for name, each in RATES.items()}, U[3:4], Y[3:4])
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[3], b[0]), found, alone)
