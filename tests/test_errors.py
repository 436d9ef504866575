"""What is refused, and what the message says."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo

OBSERVER = aslo.AlgebraicObserver(
    aslo.plants.IntegratorChain(2).relation(), aslo.LowPass(5.0)
)
T = np.arange(50) * 0.01
U, Y = np.cos(T), np.sin(T)


def replaced(signal, row, value):
    signal = signal.copy()
    signal[row] = value
    return signal


CASES = {
    "nan in y": (dict(y=replaced(Y, 17, np.nan)), r"`y` must be finite, but row 17 .* nan"),
    "infinite u": (dict(u=replaced(U, 3, np.inf)), r"`u` must be finite, but row 3 .* inf"),
    "nan in t": (dict(t=replaced(T, 9, np.nan)), r"`t` must be finite, but t\[9\] = nan"),
    "time repeats": (
        dict(t=replaced(T, 20, T[19])),
        r"strictly increasing, but t\[20\] = 0\.19 s follows 0\.19 s; sort the log",
    ),
    "time runs backwards": (dict(t=T[::-1].copy()), r"strictly increasing, but t\[1\]"),
    "gap": (
        dict(t=np.where(np.arange(50) > 30, T + 1.0, T), max_gap=0.05),
        r"gap longer than `max_gap` = 0\.05 s, but t\[31\] = 1\.31 s follows 0\.3 s; split",
    ),
    "u too short": (dict(u=U[:-1]), r"`u` must have one row for each of the 50 instants"),
    "y scalar": (dict(y=np.float64(1.0)), r"`y` must have one row .* got shape \(\)"),
    "t matrix": (dict(t=T[:, None]), r"`t` must be a vector .* got shape \(50, 1\)"),
    "one row": (dict(t=T[:1], u=U[:1], y=Y[:1]), r"at least two instants, but got shape"),
    "substeps": (
        dict(substeps=0),
        r"`substeps` must be an integer of at least 1, but got 0",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_bad_log_is_refused_with_its_row(case):
    change, message = CASES[case]
    with pytest.raises(ValueError, match=message):
        aslo.replay(OBSERVER, **(dict(t=T, u=U, y=Y) | change))


def test_a_row_of_a_matrix_is_named_with_its_column():
    motor = aslo.AlgebraicObserver(aslo.plants.FluxRelation(8.0, 0.04), aslo.LowPass(5.0))
    y = np.stack([Y, Y], 1)
    y[11, 1] = np.nan
    with pytest.raises(ValueError, match=r"row 11 holds y\[11, 1\] = nan"):
        aslo.replay(motor, T, np.stack([U, U], 1), y)


TRACED = {
    "nan in y": "`y` must be finite",
    "time repeats": "`t` must be finite and strictly increasing",
    "nan in t": "`t` must be finite and strictly increasing",
    "gap": "no gap longer than `max_gap` = 0.05 s",
}


@pytest.mark.parametrize("case", TRACED)
def test_a_traced_log_is_refused_at_run_time(case):
    change, _ = CASES[case]
    settings = dict(t=T, u=U, y=Y) | change
    gap = settings.pop("max_gap", None)
    run = eqx.filter_jit(lambda t, u, y: aslo.replay(OBSERVER, t, u, y, max_gap=gap))
    with pytest.raises(eqx.EquinoxRuntimeError, match=TRACED[case]):
        jax.block_until_ready(run(*map(jnp.asarray, settings.values())))


def test_a_batch_is_refused_when_one_member_is_bad():
    ys = jnp.stack([Y, replaced(Y, 17, np.nan)])
    run = eqx.filter_jit(jax.vmap(lambda y: aslo.replay(OBSERVER, T, U, y).value))
    assert jnp.isfinite(run(jnp.stack([Y, 2 * Y]))).all()
    with pytest.raises(eqx.EquinoxRuntimeError, match="`y` must be finite"):
        jax.block_until_ready(run(ys))


def test_observers_refuse_what_does_not_fit():
    relation = aslo.plants.IntegratorChain(4).relation()
    with pytest.raises(ValueError, match=r'`start` must be "exact" or "paper", but got'):
        aslo.AlgebraicObserver(relation, aslo.LowPass(5.0), start="Exact")
    few = aslo.AlgebraicObserver(
        relation, aslo.LowPass(5.0), aslo.FilterBank([aslo.LowPass(2.0)])
    )
    with pytest.raises(ValueError, match=r"at least n - 1 = 2 filters .* but got 1"):
        few.init(jnp.zeros(()), jnp.zeros(()))
    second = aslo.AlgebraicObserver(relation, aslo.filters.second_order(3.0))
    with pytest.raises(ValueError, match="`forgetting` must be a `LowPass`"):
        second.init(jnp.zeros(()), jnp.zeros(()))
    with pytest.raises(ValueError, match=r"`initial` must have the shape \(3,\).*\(2,\)"):
        aslo.AlgebraicObserver(relation, aslo.LowPass(5.0), initial=[1.0, 2.0]).init(
            jnp.zeros(())
        )
    with pytest.raises(ValueError, match=r"`dt` must be positive and finite \(s\)"):
        OBSERVER.step(OBSERVER.init(jnp.zeros(())), jnp.zeros(()), jnp.zeros(()), 0.0)
    with pytest.raises(ValueError, match="`gain` must be positive"):
        aslo.Asymptotic(few, -1.0)
    with pytest.raises(ValueError, match="`bandwidth` must be positive"):
        aslo.PhaseLockedLoop(0.0)
    with pytest.raises(ValueError, match=r"`gain` must have shape \(n - p, p\)"):
        aslo.ReducedLuenberger(jnp.eye(2, k=1), jnp.ones((2, 1)), jnp.ones((2, 2)))
    with pytest.raises(ValueError, match=r"A22 - gain A12.*stable"):
        aslo.ReducedLuenberger(jnp.eye(2, k=1), jnp.ones((2, 1)), -jnp.ones((1, 1)))


def test_names_of_states_must_be_unique():
    class Twice(aslo.AbstractObserver):
        def equations(self, F, u, y):
            F = F.using(aslo.LowPass(1.0))
            return F(y, "same") + F(u, "same")

    with pytest.raises(ValueError, match="the state `same` is defined twice"):
        Twice().init(jnp.zeros(()), jnp.zeros(()))


def test_a_pass_without_a_filter_says_so():
    class Bare(aslo.AbstractObserver):
        def equations(self, F, u, y):
            return F(y)

    with pytest.raises(ValueError, match=r"No filter is bound .* `F\.using`"):
        Bare().init(jnp.zeros(()))
