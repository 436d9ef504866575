"""Observers derived from models: exact on motions integrated to 1e-12, with the figures of
the theory; what cannot be derived is refused, by its line."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from accurate import integrated
from derivable import CASES, CHANGED
from derivable_case import Case, stacked

import aslo_jax as aslo
from aslo_jax._derive.lifted import lower
from aslo_jax.derivation import derive

COMPLETIONS = {"repeat": aslo.Repeat, "least-squares": aslo.LeastSquares}


def _start(given):
    case, observer = given
    s = jnp.asarray(case.start, float)
    _, y, u = case.of(jnp.zeros(()), s)
    return s, observer.init(y, u).states


def _rate(given, t, states):
    case, observer = given
    s, inner = states
    _, y, u = case.of(t, s)
    rates = observer.vector_field(t, aslo.ObserverState(inner, y), u, y).states
    return case.slope(t, s), rates


def _record(given, t, states):
    case, observer = given
    s, inner = states
    x, y, u = case.of(t, s)
    return x, y, observer.estimate(t, aslo.ObserverState(inner, y), u, y)


def run(case: Case, found):
    """The states, and the estimate of the relation's x, from 10 ms on."""
    observer = aslo.AlgebraicObserver(
        found.relation,
        aslo.LowPass(case.cutoff),
        COMPLETIONS[case.completion](),
        guard=None,
    )
    early = np.linspace(0.01, 0.1, 10)
    ts = np.unique(np.concatenate([early, np.linspace(0.1, case.horizon, 30)]))
    ts = ts[ts <= case.horizon]
    return ts, *integrated(_start, _rate, _record, (case, observer), jnp.asarray(ts))


@pytest.mark.parametrize("name", [*CASES, *CHANGED])
def test_the_relation_is_exact(name):
    case = (CASES | CHANGED)[name]()
    found = derive(case.model)
    ts, x, y, estimate = run(case, found)
    truth = np.asarray(found.lift(x, y))
    late = ts >= case.since
    error = np.abs(np.asarray(estimate.value) - truth) / np.abs(truth).max(axis=0)
    assert error[late].max() < 10 * case.figure
    names = list(case.model.ranges)
    places = [names.index(name) for name in found.states]
    decoded = np.asarray(found.decode(jnp.asarray(truth), y))
    if not found.notes:
        np.testing.assert_allclose(decoded, np.asarray(x)[:, places], rtol=1e-9, atol=1e-9)


def test_one_derivation_takes_less_than_a_few_thousand_operations():
    """Not a time, which depends on the machine: what a time is made of."""
    assert len(lower(CASES["cuk"]().model).graph.nodes) < 100


@pytest.mark.parametrize("completion", COMPLETIONS)
def test_a_motor_takes_the_operations_of_one_written_by_hand(monkeypatch, completion):
    """In the fused engine; and it gives the same estimates."""
    pytest.importorskip("llvmlite")
    from aslo_jax.engines._fused import replay as module

    counted, kept = [], module.kept

    def counting(key, make):
        program = kept(key, make)
        counted.append(program.operations)
        return program

    monkeypatch.setattr(module, "kept", counting)
    by_hand = aslo.plants.FluxRelation(0.7, 0.004, 0.06)
    derived = derive(CASES["pmsm"]().model).relation
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(2, 300, 2))
    t = 1e-4 * np.arange(300)
    values = []
    for relation in (by_hand, derived):
        observer = aslo.AlgebraicObserver(
            relation, aslo.LowPass(20.0), COMPLETIONS[completion]()
        )
        values.append(aslo.replay(observer, t, u, y, engine="fused").value)
    np.testing.assert_allclose(values[1], values[0], rtol=1e-6, atol=1e-9)
    assert counted[1] <= 1.05 * counted[0]


def test_parameters_stay_parameters():
    """The gradient of the relation is that of one derived for other values."""
    case = CASES["pmsm"]()
    relation = derive(case.model).relation
    u, y = jnp.array([1.0, 2.0]), jnp.array([0.3, -0.4])

    def drift(R):
        other = dataclasses.replace(
            relation, parameters=relation.parameters | {"resistance": R}
        )
        return other(u, y).z

    np.testing.assert_allclose(drift(0.9), u - 0.9 * y, rtol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(drift)(0.7), -y, rtol=1e-14)


def test_the_slowest_filter_of_a_boost_converter():
    """Twice R/L for least squares."""
    assert derive(CASES["boost"]().model).slowest == pytest.approx(2 * 0.35 / 1.7e-3)


def test_a_certificate_with_a_matrix_that_varies_is_at_most_one():
    case = CASES["boost"]()._replace(completion="least-squares")
    _, _, _, estimate = run(case, derive(case.model))
    certificate = np.asarray(estimate.certificate)
    assert np.all(certificate <= 1.0 + 1e-9) and certificate[-1] > 1e-3


def test_states_coast_along_the_model():
    """The observer gives the states; what is not certified follows their rates."""
    case = CASES["unicycle"]()
    found = derive(case.model)
    assert found.states == ("heading",) and "period" in found.notes["heading"]
    observer = found.observer(aslo.LowPass(5.0), initial=jnp.array([0.7]))
    t = 1e-2 * np.arange(300)
    u = np.stack([np.zeros(300), 0.5 * np.ones(300)], axis=1)  # at rest, turning
    estimate = aslo.replay(observer, t, u, np.zeros((300, 2)))
    assert np.asarray(estimate.coasting).all()
    np.testing.assert_allclose(estimate.value[:, 0], 0.7 + 0.5 * t, atol=1e-9)


@pytest.mark.parametrize("gain", [None, 30.0])
def test_the_observer_finds_the_states_of_a_sampled_log(gain):
    case = CASES["dc_motor_from_current"]()
    found = derive(case.model)
    t = np.linspace(0.0, 0.5, 5001)
    plant = found.plant()
    ts, h = jnp.asarray(t), t[1]

    def step(s, t):
        u = stacked(case.drive(t + 0.5 * h))
        f = lambda s: plant.drift(s, u)
        a = f(s)
        b = f(s + 0.5 * h * a)
        c = f(s + 0.5 * h * b)
        d = f(s + h * c)
        return s + h / 6 * (a + 2 * b + 2 * c + d), (s, u)

    _, (s, u) = jax.lax.scan(step, jnp.asarray(case.start, float), ts)
    guard = aslo.Guard(threshold=1e-9)
    observer = found.observer(aslo.LowPass(50.0), gain=gain, guard=guard)
    estimate = aslo.replay(observer, t, np.asarray(u), np.asarray(s[:, 3:]))
    error = np.abs(np.asarray(estimate.value)[-1] / np.asarray(s)[-1, :3] - 1.0)
    assert error.max() < 1e-3


def test_a_quotient_is_worth_nothing_where_it_is_of_zeros():
    """A gain, from what it multiplies, which swings through zero: there the estimate coasts
    and is not certified by what is known of its parts."""
    found = derive(
        aslo.Model(
            lambda x, y, u: [3.0 * x[1], -3.0 * x[0], 0.0],
            lambda x, y, u: [x[0], x[0] * x[2]],
            states={"x": (-2, 2), "v": (-2, 2), "gain": (1, 3)},
            outputs={"y": (-2, 2), "z": (-4, 4)},
        )
    )
    assert {"x*gain", "v*gain"} <= set(found.lifted) and "gain" not in found.lifted
    t = 1e-3 * np.arange(4000)
    y = np.stack([1.1 * np.sin(3 * t), 2.2 * np.sin(3 * t)], axis=1) / 3.0
    y = y + 1e-4 * np.random.default_rng(0).standard_normal(y.shape)
    guard = aslo.Guard(threshold=1e-2)
    observer = found.observer(aslo.LowPass(20.0), guard=guard)
    estimate = aslo.replay(observer, t, np.zeros((4000, 0)), y)
    late, coasting = t > 1.0, np.asarray(estimate.coasting)
    error = np.abs(np.asarray(estimate.value)[:, 2] - 2.0)
    assert 0.01 < coasting[late].mean() < 0.5
    assert error[late].max() < 0.1
    alone = found.observer(aslo.LowPass(20.0), guard=None)
    error = np.abs(
        np.asarray(aslo.replay(alone, t, np.zeros((4000, 0)), y).value)[:, 2] - 2
    )
    assert error[late].max() > 0.2


def test_a_mechanical_system_has_the_rule_of_its_structure(capsys, tmp_path):
    """The same observer, with the same operations, and its machine."""
    system = aslo.plants.BallBeam(length=1.2)
    found = derive(system)
    assert found.states == ("qdot1", "qdot2") and "q2', then q1'" in str(found)
    by_rule = aslo.velocity_observer(system, aslo.LowPass(9.0))
    same = jax.tree.map(np.array_equal, found.observer(aslo.LowPass(9.0)), by_rule)
    assert all(jax.tree.leaves(same))
    inertia = lambda q: 1.5 + jnp.sin(q)
    with pytest.raises(aslo.StructureError, match="depends on q1"):
        derive(aslo.plants.MechanicalSystem(inertia, position=[0.0, 0.0]))
    with pytest.raises(ValueError, match="must be left out"):
        derive(CASES["buck"]().model, region=([0.0], [1.0]))


def test_momenta_hold_for_other_parameters_and_everywhere():
    """The inertia that a model divides by is the integrating factor, in closed form: its
    parameters stay free, and no range limits it."""
    model = aslo.Model(
        lambda x, y, u, p: [
            y[0] * x[1] ** 2 - p["g"] * jnp.sin(y[1]),
            (u[0] - 2 * y[0] * x[0] * x[1] - p["g"] * y[0] * jnp.cos(y[1]))
            / (p["L"] ** 2 + y[0] ** 2),
        ],
        lambda x, y, u: x,
        states={"ball": (-1, 1), "beam": (-1, 1)},
        outputs={"q1": (-0.5, 0.5), "q2": (-0.5, 0.5)},
        inputs={"torque": (-5, 5)},
        parameters={"L": 1.2, "g": 9.81},
    )
    found = derive(model)
    assert found.lifted == ("ball", "beam~", "beam~*beam~")
    assert set(found.relation.parameters) == {"L", "g"}
    other = dataclasses.replace(
        found.relation, parameters=found.relation.parameters | {"L": jnp.asarray(2.0)}
    )
    u, y, v = jnp.array([0.7]), jnp.array([3.0, 0.4]), jnp.array([0.3, -0.8])
    momentum = (4.0 + y[0] ** 2) * v[1]
    X = jnp.stack([v[0], momentum, momentum**2])
    terms = other(u, y)
    torque = u[0] - 9.81 * y[0] * jnp.cos(y[1])
    expected = [y[0] * v[1] ** 2 - 9.81 * jnp.sin(y[1]), torque, 2 * momentum * torque]
    np.testing.assert_allclose(terms.A @ X + terms.z, expected, rtol=1e-9)
    weights = np.asarray(terms.s) / np.asarray(y)
    np.testing.assert_allclose(terms.C @ X - terms.d, weights * v, rtol=1e-9)


def test_a_factor_that_the_model_does_not_have_is_a_series():
    """`x' = -cos(y) x y'`: exp(sin y) x does not change. Beyond its range it is no number."""
    found = derive(
        aslo.Model(
            lambda x, y, u: [-jnp.cos(y[0]) * x[0] ** 2],
            lambda x, y, u: [x[0]],
            states={"x": (0.5, 2.0)},
            outputs={"y": (-2.0, 2.0)},
        )
    )
    assert found.lifted == ("x~",) and not found.proved
    y = jnp.array([[1.7], [-0.4]])
    lifted = found.lift(jnp.ones((2, 1)), y)[:, 0]
    ratio = np.exp(np.sin(1.7) - np.sin(-0.4))
    assert lifted[0] / lifted[1] == pytest.approx(ratio, rel=1e-12)
    terms = found.relation(jnp.zeros(0), y[0])
    assert terms.A is None and float(terms.z[0]) == 0.0
    assert np.isnan(found.relation(jnp.zeros(0), jnp.array([2.6])).c).all()
