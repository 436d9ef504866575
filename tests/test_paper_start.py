"""With the paper's start the library has the paper's transients, corrected."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo

TS = jnp.linspace(0.0, 4.0, 81)
TIGHT = dict(
    solver=diffrax.Dopri8(),
    stepsize_controller=diffrax.ClipStepSizeController(
        diffrax.PIDController(rtol=1e-12, atol=1e-14), step_ts=TS
    ),
)


def printed(rate):
    plant = aslo.plants.IntegratorChain(2)
    return aslo.AlgebraicObserver(
        plant.relation(), aslo.LowPass(rate), aslo.Repeat(), guard=None, start="paper"
    )


def run(observers, x0, u=lambda t: jnp.cos(0.02 * t)):
    plant = aslo.plants.IntegratorChain(2)
    x0 = jnp.asarray(x0)
    settings = dict(t1=4.0, ts=TS, initial=x0, **TIGHT)
    return jax.jit(lambda: aslo.simulate(plant, u, observers, **settings))()


def test_transient_has_the_corrected_sign():
    # O1 prints (1 + exp(-lam t)) x2(0); with y(0) the error is (lam y(0) - x2(0)) e^-lt.
    solution = run({"ASLO": printed(3.0)}, [0.0, 0.1], u=lambda t: 0.0 * t)
    value = solution.estimates["ASLO"].value[:, 0]
    np.testing.assert_allclose(value, (1 - jnp.exp(-3.0 * TS)) * 0.1, atol=1e-10)
    assert jnp.abs(value - (1 + jnp.exp(-3.0 * TS)) * 0.1).max() > 0.19
    error = run({"ASLO": printed(3.0)}, [0.25, 0.1]).error("ASLO")[:, 0]
    np.testing.assert_allclose(error, (3 * 0.25 - 0.1) * jnp.exp(-3.0 * TS), atol=1e-10)


def test_luenberger_is_the_same_transfer_function():
    luenberger = aslo.ReducedLuenberger.of_chain(2, 3.0)
    observers = {"ASLO": printed(3.0), "Luenberger": luenberger}
    solution = run(observers, [0.25, 0.1], u=lambda t: jnp.sin(5 * t) + t)
    ours, theirs = (solution.estimates[name].value for name in observers)
    np.testing.assert_allclose(ours, theirs, atol=1e-10)
    assert jnp.abs(solution.error("ASLO")[0]).max() > 0.6  # not both zero


@pytest.mark.parametrize(("gain", "rate"), [(2.0, 7.0), (7.0, 2.0)])
def test_asymptotic_rate_is_the_slower_of_gain_and_filter(gain, rate):
    observer = aslo.Asymptotic(printed(rate), gain, initial=jnp.zeros(1))
    error = run({"A": observer}, [0.0, 0.1]).error("A")[:, 0]
    # e' = -gain e + gain e_alg, e_alg = -0.1 exp(-rate t), e(0) = -0.1
    forced = gain * (jnp.exp(-rate * TS) - jnp.exp(-gain * TS)) / (gain - rate)
    np.testing.assert_allclose(error, -0.1 * (jnp.exp(-gain * TS) + forced), atol=1e-10)
    late = jnp.log(jnp.abs(error[60] / error[70])) / (TS[70] - TS[60])
    np.testing.assert_allclose(late, min(gain, rate), rtol=1e-3)


def test_asymptotic_rate_is_the_gain_with_the_exact_start():
    plant = aslo.plants.IntegratorChain(2)
    inner = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(2.0))
    observer = aslo.Asymptotic(inner, 7.0, initial=jnp.zeros(1))
    error = run({"A": observer}, [0.4, 0.1]).error("A")[:, 0]
    np.testing.assert_allclose(error, -0.1 * jnp.exp(-7.0 * TS), atol=2e-5)


def test_asymptotic_forgets_its_start_at_the_first_certified_instant():
    plant = aslo.plants.IntegratorChain(2)
    inner = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(2.0))
    observers = {"forgets": aslo.Asymptotic(inner, 7.0)}
    error = run(observers, [0.4, 0.1]).error("forgets")[1:, 0]
    np.testing.assert_allclose(error, 0, atol=1e-10)


def naive_chain(u, y, t):
    """The signals of O3 at lambda = 1, filtered one by one from zero, SciPy at 1e-12."""
    import scipy.integrate

    def rate(time, w):
        y1, y2, y3, u1, u2, u3 = w
        return [
            y(time) - y1,  # F[y]
            (y(time) - y1) - y2,  # F[pF[y]]
            ((y(time) - y1) - y2) - y3,
            u(time) - u1,
            u1 - u2,
            u2 - u3,
        ]

    solution = scipy.integrate.solve_ivp(
        rate, (0, t[-1]), np.zeros(6), "DOP853", t, rtol=1e-12, atol=1e-13
    ).y
    y1, y2, y3, u1, u2, u3 = solution
    w1y = y(t) - y1
    w2y = w1y - y2
    w3y = w2y - y3
    return w1y, w2y, w3y, u1, u2, u3


def test_fourth_order_chain_has_the_corrected_formulas():
    t = np.linspace(0, 30, 601)
    x0 = np.array([0.3, 0.1, -0.2, 0.5])

    def u(t):
        return np.sin(1.3 * t)

    def y(t):
        a = 1.3
        # The fourfold integral of u, from x0.
        c = [x0[0], x0[1] + 1 / a**3, x0[2] / 2, (x0[3] + 1 / a) / 6]
        shift = -1 / a**3
        return (
            c[0]
            + (x0[1] + shift) * t
            + x0[2] * t**2 / 2
            + (x0[3] + 1 / a) * t**3 / 6
            + np.sin(a * t) / a**4
        )

    def hidden(t):
        a = 1.3
        x4 = x0[3] + (1 - np.cos(a * t)) / a
        x3 = x0[2] + (x0[3] + 1 / a) * t - np.sin(a * t) / a**2
        x2 = (
            x0[1] - 1 / a**3 + x0[2] * t + (x0[3] + 1 / a) * t**2 / 2 + np.cos(a * t) / a**3
        )
        return x2, x3, x4

    w1y, w2y, w3y, u1, u2, u3 = naive_chain(u, y, t)
    x4 = w3y + u3 + u2 + u1
    x3 = w2y + 2 * x4 - 2 * u1 - u2
    x2 = w1y + x3 - x4 + u1
    late = t > 25
    for formula, truth in zip((x2, x3, x4), hidden(t), strict=True):
        np.testing.assert_allclose(formula[late], truth[late], atol=2e-6)
    printed_x4 = w3y + u3 + u2 + u2
    printed_x3 = w2y + 2 * x4 - u2
    rms = [
        np.sqrt(np.mean((a - b)[late] ** 2))
        for a, b in ((printed_x4, hidden(t)[2]), (printed_x3, hidden(t)[1]))
    ]
    np.testing.assert_allclose(rms, [0.35, 0.86], rtol=0.06)
    # The library's own chain with the paper's start is that observer.
    plant = aslo.plants.IntegratorChain(4)
    observer = aslo.AlgebraicObserver(
        plant.relation(), aslo.LowPass(1.0), aslo.Repeat(), guard=None, start="paper"
    )
    solution = aslo.simulate(
        plant,
        lambda t: jnp.sin(1.3 * t),
        {"ASLO": observer},
        t1=30.0,
        ts=jnp.asarray(t),
        initial=jnp.asarray(x0),
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-13),
    )
    value = solution.estimates["ASLO"].value
    np.testing.assert_allclose(value.T[:, 1:], np.stack([x2, x3, x4])[:, 1:], atol=1e-7)
