"""One set of equations run three ways, against a naive loop anyone can check by eye."""

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax._realise import Interval
from aslo_jax.realise import Flow, Pass


class Example(aslo.AbstractObserver):
    """Nested filters, a product, a state of its own, pF and F[1]."""

    rate: float | jax.Array = 3.0

    def equations(self, F, u, y):
        F = F.using(aslo.LowPass(self.rate))
        a = F(y, "a")
        b = F.scope("inner")(a * u)
        v = F.state("v", y + 1.0, lambda v: -0.5 * v + a)
        value = jnp.stack([F.p(y, "p"), b, v, F.one("one")])
        return aslo.Estimate(value, jnp.ones(()), jnp.asarray(False))


def test_states_are_named_scoped_and_started():
    state = Example().init(jnp.asarray(2.0), jnp.asarray(5.0))
    assert sorted(state.states) == ["a", "inner.state1", "one", "p", "v"]
    started = {name: float(value) for name, value in state.states.items()}
    assert started == {"a": 0.0, "inner.state1": 0.0, "one": 0.0, "p": 2.0, "v": 3.0}


def test_paper_start_has_settled_ones_and_zero_states():
    class Paper(aslo.AbstractObserver):
        def equations(self, F, u, y):
            F = F.using(aslo.LowPass(3.0), "paper")
            return aslo.Estimate(
                jnp.stack([F.p(y, "p"), F.one()]), jnp.ones(()), jnp.asarray(False)
            )

    state = Paper().init(jnp.asarray(2.0))
    assert list(state.states) == ["p"] and state.states["p"] == 0.0
    value = Paper().estimate(jnp.zeros(()), state, 0.0, jnp.asarray(2.0)).value
    np.testing.assert_array_equal(value, [6.0, 1.0])


def test_flow_gives_every_derivative():
    y, u = jnp.asarray(0.7), jnp.asarray(-1.2)
    states = dict(
        zip(["a", "inner.state1", "v", "p", "one"], jnp.arange(1.0, 6.0), strict=True)
    )
    flow = Flow(states)
    Example().equations(Pass(flow), u, y)
    expected = {
        "a": 3 * (y - 1.0),
        "inner.state1": 3 * (1.0 * u - 2.0),
        "v": -0.5 * 3.0 + 1.0,
        "p": 3 * (y - 4.0),
        "one": 3 * (1.0 - 5.0),
    }
    assert flow.rates.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(flow.rates[name], value, rtol=1e-14)


def naive(us, ys, h, rate=3.0):
    """Both ends of every interval with its own input, inner filters first."""
    x = rate * h
    decay = np.exp(-x)
    p = -np.expm1(-x) / x
    left, right = p - decay, 1 - p
    a, b, one, f, v = 0.0, 0.0, 0.0, ys[0], ys[0] + 1.0
    rows = []
    for u, y0, y1 in zip(us[:-1], ys[:-1], ys[1:], strict=True):
        a1 = decay * a + left * y0 + right * y1
        b1 = decay * b + left * a * u + right * a1 * u
        f1 = decay * f + left * y0 + right * y1
        one1 = decay * one + (left + right)
        slope = -0.5 * v + a
        v1 = v + h / 2 * (slope + (-0.5 * (v + h * slope) + a1))
        a, b, one, f, v = a1, b1, one1, f1, v1
        rows.append([rate * (y1 - f), b, v, one])
    return np.array(rows)


def test_sampling_equals_a_naive_loop():
    rng = np.random.default_rng(5)
    us, ys = rng.normal(size=(2, 60))
    t = np.arange(60) * 0.07
    got = aslo.replay(Example(), t, us, ys).value[1:]
    np.testing.assert_allclose(got, naive(us, ys, 0.07), rtol=1e-12, atol=1e-14)


def test_substeps_equal_a_finer_log_with_interpolated_outputs():
    rng = np.random.default_rng(6)
    us, ys = rng.normal(size=(2, 40))
    t = np.arange(40) * 0.07
    fine_t = np.arange(39 * 4 + 1) * (0.07 / 4)
    fine_y, fine_u = np.interp(fine_t, t, ys), np.repeat(us, 4)[: fine_t.size]
    coarse = aslo.replay(Example(), t, us, ys, substeps=4).value
    fine = aslo.replay(Example(), fine_t, fine_u, fine_y).value
    np.testing.assert_allclose(coarse, fine[::4], rtol=1e-12, atol=1e-13)


def test_a_filter_is_discretised_once_and_outside_the_scan():
    """Coefficients depend on parameters only: no exponential inside the loop."""
    t = np.arange(20) * 0.07

    def run(y):
        return aslo.replay(Example(), t, jnp.zeros(20), y).value

    def scans(jaxpr):
        for equation in jaxpr.eqns:
            if equation.primitive.name == "scan":
                yield equation
            elif "jaxpr" in equation.params:
                yield from scans(equation.params["jaxpr"].jaxpr)

    (scan,) = scans(jax.make_jaxpr(run)(jnp.zeros(20)).jaxpr)
    inside = {e.primitive.name for e in scan.params["jaxpr"].eqns}
    assert not inside & {"exp", "expm1", "exp2"}
    assert {"mul", "add"} <= inside


def test_replaying_again_does_not_trace_again():
    traces = []

    class Counting(Example):
        def equations(self, F, u, y):
            traces.append(1)
            return super().equations(F, u, y)

    t = np.arange(20) * 0.07
    for rate in (3.0, 4.0):
        aslo.replay(Counting(jnp.asarray(rate)), t, jnp.ones(20), jnp.ones(20))
        first = len(traces)
        aslo.replay(Counting(jnp.asarray(rate)), t, jnp.zeros(20), jnp.ones(20))
        assert len(traces) == first
    # Compiled once for both rates: start twice, the estimate, both ends of an interval.
    assert first <= 10


def test_a_pass_knows_what_is_missing():
    """Where nothing can be, everything counts and every correction is trusted; what is
    measured stands back for what is predicted where a sample is missing or doubted."""
    y, predicted = jnp.asarray(3.0), jnp.asarray(-2.0)
    yes, no = jnp.asarray(True), jnp.asarray(False)
    plain = Pass(Flow({}), aslo.LowPass(5.0))
    assert plain.certain and not plain.missing and not plain.blind
    assert plain.weight == plain.trust == 1.0
    assert plain.measured(y, predicted) == y
    assert plain.inject(y) == 15.0
    for missing in (yes, no):
        interval = Interval(missing, jnp.asarray(0.25), None, missing)
        partly = Pass(Flow({}), aslo.LowPass(5.0), interval=interval)
        assert not partly.certain and partly.missing == partly.blind == missing
        assert partly.weight == 0.25 and partly.trust == 1.0 - missing
        assert partly.measured(y, predicted) == jnp.where(missing, predicted, y)
        assert partly.inject(y) == 0.25 * 15.0
        assert partly.using(aslo.LowPass(5.0), "paper").inject(y) == 15.0
        doubted = plain.doubting(missing)
        assert not doubted.certain and not doubted.blind and doubted.weight == 1.0
        assert doubted.missing == missing and doubted.inject(y) == 15.0
        assert doubted.measured(y, predicted) == jnp.where(missing, predicted, y)
    both = plain.doubting(yes).doubting(no)
    assert both.missing and both.trust == 0.0
