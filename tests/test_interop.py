"""Round trips with python-control and SciPy."""

import subprocess
import sys

import jax
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


FILTERS = {
    "low pass": (aslo.LowPass(7.0), lambda s: 7 / (s + 7)),
    "second order": (
        aslo.filters.second_order(3.0, 0.4),
        lambda s: 9 / (s**2 + 2.4 * s + 9),
    ),
    "with feedthrough": (
        aslo.LinearFilter(jnp.array([[-3.0]]), jnp.ones(1), jnp.array([2.0]), 0.5),
        lambda s: 0.5 + 2 / (s + 3),
    ),
    "of two states": (
        aslo.LinearFilter(
            jnp.array([[-3.0, 10.0], [-10.0, -3.0]]),
            jnp.array([0.0, 1.0]),
            jnp.array([2.0, 0.5]),
        ),
        lambda s: (20 + 0.5 * (s + 3)) / ((s + 3) ** 2 + 100),
    ),
}


@pytest.mark.parametrize("name", FILTERS)
def test_the_bode_plot_of_a_filter_is_that_of_its_transfer_function(name):
    law, expected = FILTERS[name]
    omega = np.geomspace(0.1, 100.0, 40)
    found = control.frequency_response(interop.to_control(law), omega)
    assert (found.input_labels, found.output_labels) == (["s"], ["filtered"])
    gain = expected(1j * omega)
    np.testing.assert_allclose(found.magnitude, np.abs(gain), rtol=1e-9)
    np.testing.assert_allclose(np.exp(1j * found.phase), gain / np.abs(gain), rtol=1e-9)


class Leaking(aslo.AbstractObserver):
    """Of a user's own: a state that another one does not see is no part of the system."""

    rate: jax.Array

    def equations(self, F, u, y):
        clock = F.state("clock", jnp.zeros(()), lambda x: jnp.ones(()))
        x = F.state("x", jnp.zeros(2), lambda x: -self.rate * x + jnp.flip(y) + 2.0 * u)
        return aslo.Estimate(jnp.array([3.0, 1.0]) * x, clock, clock > 1.0)


def test_linear_observers_have_transfer_functions():
    s = 3.0j
    u, y = np.zeros(1), np.zeros(1)
    gain = interop.to_control(aslo.observers.HighGain(40.0), u=u, y=y)
    expected = 1600 * s / (s + 40) ** 2
    np.testing.assert_allclose(gain(s), [[0.0, expected]], rtol=1e-9)
    np.testing.assert_allclose(gain.poles(), -40.0, rtol=1e-6)  # a double one
    loop = aslo.PhaseLockedLoop(40.0, wraps=False)
    loop = interop.to_control(loop, u=u, y=np.zeros(()))
    both = np.array([[80 * s + 1600], [1600 * s]]) / (s + 40) ** 2
    np.testing.assert_allclose(loop(s)[:, 1:], both, rtol=1e-9)
    own = interop.to_control(Leaking(jnp.array(5.0)), u=np.zeros(2), y=np.zeros(2))
    assert own.nstates == 2
    assert own.input_labels == ["u0", "u1", "y0", "y1"]
    expected = np.array([[6, 0, 0, 3], [0, 2, 1, 0]]) / (s + 5)
    np.testing.assert_allclose(own(s), expected, rtol=1e-9)
    flux = aslo.observers.OpenLoopIntegrator(aslo.plants.FluxRelation(2.0, 3e-3))
    flux = interop.to_control(flux, u=np.zeros(2), y=np.zeros(2))
    expected = np.hstack([np.eye(2), -2.0 * np.eye(2)]) / s
    np.testing.assert_allclose(flux(s), expected, rtol=1e-9)


def test_a_sampled_observer_is_its_system_under_first_order_hold():
    """A filtered derivative, by SciPy's own integration of the same matrices."""
    observer = aslo.observers.FilteredDerivative(aslo.filters.second_order(9.0))
    t, u, y = signals()
    y = y - y[0]  # from rest, as the system begins
    system = interop.to_scipy(observer, u=u[0], y=y[0])
    _, expected, _ = scipy.signal.lsim(system, np.hstack([u, y]), t)
    found = aslo.replay(observer, t, u, y)
    assert error(np.asarray(found.value), expected.reshape(-1, 1)) < 1e-11


class Bent(aslo.AbstractObserver):
    """Linear at zero, and wherever one would look."""

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(2), lambda x: jnp.where(x > 1e9, 0.0, y - x))
        return aslo.Estimate(x, jnp.ones(()), x[0] > 0.0)


class Shifted(aslo.AbstractObserver):
    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(2), lambda x: y - x + 1e-3)
        return aslo.Estimate(x, jnp.ones(()), x[0] > 0.0)


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
    vectors = dict(u=np.zeros(2), y=np.zeros(2))
    for module, given, said in (
        (3.0, {}, "must be an observer, a filter or a `LinearPlant`"),
        (aslo.LowPass(lambda t, u, y: 3.0 + t), {}, "constant rate"),
        (aslo.observers.HighGain(40.0), {}, "`u` must be given"),
        (aslo.PhaseLockedLoop(4.0), dict(u=np.zeros(1), y=0.0), "products or conditions"),
        (Bent(), vectors, "Bent is not: in its equations are products"),
        (Shifted(), vectors, "Shifted does not stay at zero"),
    ):
        with pytest.raises(ValueError, match=said):
            interop.to_control(module, **given)


def test_no_other_tool_is_imported_before_it_is_used():
    tools = ("control", "gym_electric_motor", "motulator", "rosbags", "scipy.signal")
    code = f"import sys, aslo_jax.interop; print(set({tools!r}) & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("set()\n", "")


def test_several_estimates_at_once_are_refused():
    relation = aslo.plants.FluxRelation(2.0, 3e-3, 0.1)
    one = aslo.AlgebraicObserver(relation, aslo.LowPass(20.0))
    both = aslo.SideBySide({"a": one, "b": one})
    with pytest.raises(ValueError, match="must have one vector as its estimate"):
        interop.to_nlsys(both, interval=1e-3, u=np.zeros(2), y=np.zeros(2))
