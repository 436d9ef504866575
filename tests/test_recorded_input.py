"""Inputs from a log in continuous time: steps end at their samples, in both engines."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.control import RecordedInput

PLANT = aslo.plants.IntegratorChain(2)
T = np.array([0.0, 0.11, 0.37, 0.5, 0.83])
U = np.array([1.0, -3.0, 0.7, 2.2, -1.4])
TS = np.array([0.0, 0.05, 0.11, 0.4, 0.83, 1.0])


def speed(t, hold):
    """The integral of the input (m/s), by the pieces that it is made of."""
    ends = np.append(T[t > T], t)
    if hold == "zero":
        return float(np.sum(U[: len(ends) - 1] * np.diff(ends)))
    values = np.interp(ends, T, U)
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * np.diff(ends)))


def run(hold, engine, **settings):
    given: dict[str, Any] = dict(t1=1.0, ts=TS, rtol=1e-3, atol=1e-3, engine=engine)
    return aslo.simulate(PLANT, RecordedInput(T, U, hold), {}, **(given | settings))


@pytest.mark.parametrize("hold", ["zero", "linear"])
@pytest.mark.parametrize("engine", ["diffrax", "fused"])
def test_no_step_crosses_a_sample(hold, engine):
    """Between samples the solution is a polynomial, which a step gets to rounding whatever
    the tolerance is; a step across a jump would not."""
    if engine == "fused":
        pytest.importorskip("llvmlite")
    found = run(hold, engine)
    wanted = [speed(t, hold) for t in TS]
    np.testing.assert_allclose(found.x[:, 1], wanted, atol=2e-15)
    held = U[[0, 0, 1, 2, 4, 4]] if hold == "zero" else np.interp(TS, T, U)
    np.testing.assert_allclose(found.u, held, atol=1e-14)


def test_between_and_beyond_samples():
    zero, linear = RecordedInput(T, U), RecordedInput(T, U, "linear")
    t = np.linspace(-0.3, 1.2, 161)
    at = lambda signal: jax.vmap(signal)(jnp.asarray(t))
    last = np.clip(np.searchsorted(T, t, side="right") - 1, 0, None)
    np.testing.assert_array_equal(at(zero), U[last])
    np.testing.assert_allclose(at(linear), np.interp(t, T, U), atol=1e-15)
    two = RecordedInput(T, np.stack([U, -2.0 * U], axis=1))
    np.testing.assert_array_equal(two(jnp.asarray(0.4)), [0.7, -1.4])
    one = RecordedInput(T[:1], U[:1], "linear")
    assert one(jnp.asarray(3.0)) == 1.0
    assert repr(two) == "RecordedInput(t=f64[5], u=f64[5, 2], hold='zero')"


@pytest.mark.slow
def test_a_batch_takes_it():
    pytest.importorskip("llvmlite")

    def make(position):
        first = jnp.stack([position, 0.0 * position])
        how: dict[str, Any] = dict(interval=0.25, initial=first, rtol=1e-3, atol=1e-3)
        return aslo.ContinuousExperiment(PLANT, RecordedInput(T, U), {}, **how)

    record = lambda r: r.x
    found = aslo.run_batch(make, jnp.array([0.0, 2.0]), 4, record=record, engine="fused")
    wanted = speed(1.0, "zero")
    np.testing.assert_allclose(found.record[:, -1, 1], wanted, atol=2e-15)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((T[::-1], U), "strictly increasing"),
        ((T, U[1:]), r"must have shape \(5,\) or \(5, m\)"),
        ((T, U * np.nan), "must be finite"),
        ((T, U, "cubic"), "`hold`"),
    ],
)
def test_what_is_no_record_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        RecordedInput(*given)
