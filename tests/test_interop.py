"""Round trips with python-control and SciPy."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from compiled_c import error

import aslo_jax as aslo
from aslo_jax import interop

control = pytest.importorskip("control")
A = np.array([[0.0, 1.0, 0.2], [-4.0, -0.5, 1.0], [0.3, -2.0, -1.5]])
B = np.array([[0.1], [1.0], [0.4]])
C = np.array([[1.0, 0.0, 0.0]])


INTERVAL = 2.0**-7  # of which every multiple is exact, as are their differences


def signals(rows=300):
    t = INTERVAL * np.arange(rows)
    return t, np.sin(3 * t)[:, None], np.cos(2 * t + 0.3)[:, None]


@pytest.mark.parametrize("kind", ["algebraic", "kalman"])
def test_an_observer_in_python_control_is_replay(kind):
    t, u, y = signals()
    if kind == "kalman":
        observer, u_, y_ = interop.kalman(control.ss(A, B, C, 0), 2.0, 0.1), u, y
    else:
        motor = aslo.plants.PMSM(8.875, 40.03e-3, 0.2086, 5, 60e-6)
        observer = aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(20.0))
        u_, y_ = np.hstack([u, 2 * y]), np.hstack([y, u])
    system = interop.to_nlsys(observer, interval=INTERVAL, u=u_[0], y=y_[0])
    found = control.input_output_response(system, t, np.hstack([u_, y_]).T, 0).outputs
    expected = aslo.replay(observer, t, u_, y_)
    n = expected.value.shape[1]
    # A certificate of 4e-4, as there is, magnifies rounding 2,000 times.
    assert error(found[:n].T, np.asarray(expected.value)) < 1e-11
    np.testing.assert_allclose(found[n], expected.certificate, rtol=1e-11)
    np.testing.assert_array_equal(found[n + 1] > 0.5, expected.coasting)
    assert system.input_labels[-1] == f"y{y_.shape[1] - 1}"


@pytest.mark.parametrize("make", [control.ss, scipy.signal.StateSpace])
def test_designs_have_the_poles_and_gains_of_the_other_tool(make):
    system = make(A, B, C, np.zeros((1, 1)))
    filter = interop.kalman(system, 2.0, 0.1)
    gain, _, poles = control.lqe(A, B, C, 2.0, 0.1)
    np.testing.assert_allclose(filter.gain, gain, rtol=1e-9)
    back = interop.to_control(filter)
    np.testing.assert_allclose(np.sort(back.poles()), np.sort(poles), rtol=1e-9)
    reduced = interop.luenberger(system, [-3.0, -7.0])
    poles = np.linalg.eigvals(interop.to_scipy(reduced).A)
    np.testing.assert_allclose(np.sort(poles), [-7.0, -3.0], rtol=1e-9)
    own = interop.plant(system)
    for name in "ABC":
        np.testing.assert_array_equal(
            getattr(own, name), getattr(interop.to_control(own), name)
        )


def test_a_reduced_observer_follows_the_states():
    """Of the plant, by the transfer function from u to the estimate."""
    reduced = interop.luenberger(control.ss(A, B, C, 0), [-3.0, -7.0])
    observer, s = interop.to_control(reduced), 1.7j
    x = np.linalg.solve(s * np.eye(3) - A, B)
    given = np.vstack([np.ones((1, 1)), C @ x])
    np.testing.assert_allclose(observer(s) @ given, x[1:], rtol=1e-9)


def test_a_filter_has_its_transfer_function():
    law = aslo.LinearFilter(
        jnp.array([[-3.0, 10.0], [-10.0, -3.0]]),
        jnp.array([0.0, 1.0]),
        jnp.array([2.0, 0.5]),
    )
    s = 4.0j
    expected = (20 + 0.5 * (s + 3)) / ((s + 3) ** 2 + 100)
    np.testing.assert_allclose(interop.to_control(law)(s), expected, rtol=1e-12)


def test_what_is_refused():
    for system, said in (
        (control.ss(A, B, C, 1), "feed-through"),
        (control.ss(A, B, C, 0, 0.1), "continuous time"),
        (3.0, "StateSpace"),
    ):
        with pytest.raises(ValueError, match=said):
            interop.plant(system)
    with pytest.raises(ValueError, match="first of its states"):
        interop.luenberger(control.ss(A, B, 2 * C, 0), [-3.0, -7.0])
    with pytest.raises(ValueError, match="must be a `SteadyStateKalman`"):
        interop.to_control(aslo.LowPass(3.0))


def test_several_estimates_at_once_are_refused():
    relation = aslo.plants.FluxRelation(2.0, 3e-3, 0.1)
    one = aslo.AlgebraicObserver(relation, aslo.LowPass(20.0))
    both = aslo.SideBySide({"a": one, "b": one})
    with pytest.raises(ValueError, match="must have one vector as its estimate"):
        interop.to_nlsys(both, interval=1e-3, u=np.zeros(2), y=np.zeros(2))
