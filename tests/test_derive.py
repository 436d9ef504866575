"""Observers derived from models: exact on motions integrated to 1e-12, with the figures of
the theory; what cannot be derived is refused, by its line."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from accurate import integrated
from derivable import CASES, CHANGED, Case

import aslo_jax as aslo
from aslo_jax._derive.decoding import lifted_states
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


@pytest.mark.parametrize("name", CASES)
def test_the_relation_is_exact(name):
    case = CASES[name]()
    found = derive(case.model)
    ts, x, y, estimate = run(case, found)
    truth = np.asarray(found.lift(x))
    late = ts >= case.since
    error = np.abs(np.asarray(estimate.value) - truth) / np.abs(truth).max(axis=0)
    print(name, error[late].max(), case.figure)
    assert error[late].max() < 10 * case.figure
    names = list(case.model.ranges)
    places = [names.index(name) for name in found.states]
    decoded = np.asarray(found.decode(jnp.asarray(truth)))
    if not found.notes:
        np.testing.assert_allclose(decoded, np.asarray(x)[:, places], rtol=1e-9, atol=1e-9)
