"""Logs through the fused engine: the estimates of the scan, for one log and for many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM

import aslo_jax as aslo
from aslo_jax.engines import NotFusible
from aslo_jax.engines._fused import kept
from aslo_jax.engines._fused.program import Program

pytest.importorskip("llvmlite")
MOTION = PrescribedPMSM()
T = np.arange(801) * 1e-3


def log(t):
    t = jnp.asarray(t)
    ends = jnp.append(t[1:], t[-1] + 1e-3)
    u = jax.vmap(MOTION.mean_voltage)(t, ends)
    return u, jax.vmap(MOTION.current)(t)


def observer(rate=30.0):
    flux = aslo.AlgebraicObserver(MOTION.relation(), aslo.LowPass(rate))
    return aslo.Asymptotic(flux, 20.0)


def same(a, b, precision=1e-9):
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.shape == y.shape and x.dtype == y.dtype
        np.testing.assert_allclose(x, y, rtol=precision, atol=1e-12)


UNEVEN = np.cumsum(1e-3 * (1 + 0.5 * np.sin(np.arange(801.0) ** 2)))


@pytest.mark.parametrize("t", [T, UNEVEN], ids=["even", "uneven"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_one_log(t, substeps):
    u, y = log(t)
    settings = dict(substeps=substeps, return_state=True)
    a = aslo.replay(observer(), t, u, y, engine="fused", **settings)
    b = aslo.replay(observer(), t, u, y, engine="scan", **settings)
    assert jax.tree.structure(a) == jax.tree.structure(b)
    same(a, b)


def test_a_log_in_two_pieces():
    u, y = log(T)
    run = lambda k, **s: aslo.replay(observer(), T[k], u[k], y[k], engine="fused", **s)
    first, state = run(slice(0, 401), return_state=True)
    second = run(slice(400, None), state=state)
    whole = run(slice(None))
    same(first.value, whole.value[:401], 1e-12)
    same(second.value[1:], whole.value[401:], 1e-12)


def test_many_logs_and_observers_beside_each_other():
    u, y = log(T)
    scale = jnp.linspace(0.95, 1.05, 5)
    us, ys = scale[:, None, None] * u, scale[:, None, None] * y

    def one(engine):
        return lambda u, y, rate: aslo.replay(observer(rate), T, u, y, engine=engine)

    rates = 30.0 * scale
    a = jax.vmap(one("fused"))(us, ys, rates)
    b = jax.vmap(one("scan"))(us, ys, rates)
    same(a, b)
    shared = jax.jit(jax.vmap(one("fused"), (0, None, None)))(us, y, 30.0)
    same(shared.value[2], one("fused")(u, y, 30.0).value, 1e-10)


def test_the_engine_that_is_asked_for_runs_what_is_traced():
    """The machine code of `"fused"` stands in the traced program; `"auto"` scans there."""
    u, y = log(T[:40])

    def calls(engine):
        run = lambda u, y: aslo.replay(observer(), T[:40], u, y, engine=engine).value
        return str(jax.make_jaxpr(run)(u, y)).count("pure_callback")

    # The checks of the log are calls, too.
    assert calls("fused") > calls("scan") == calls("auto")


def test_what_does_not_fit_is_refused():
    u, y = log(T)
    with pytest.raises(ValueError, match='`engine` must be "auto", "fused" or "scan"'):
        aslo.replay(observer(), T, u, y, engine="warp")

    class Spectrum(aslo.AbstractObserver):
        def equations(self, F, u, y):
            values = jnp.linalg.eigvalsh(jnp.diag(y))
            return aslo.Estimate(values, jnp.ones(()), jnp.asarray(False))

    named = r"`jnp\.linalg\.eigvalsh` .* of .*test_fused_replay\.py:\d+"
    with pytest.raises(NotFusible, match=named):
        aslo.replay(Spectrum(), T, u, y, engine="fused")


def test_equal_observers_share_a_program_and_others_do_not(monkeypatch):
    """Numbers of an observer are inputs of its programs, that of the start and that of the
    loop; what it is made of is not."""
    kept._cached.cache_clear()  # another test may have such an observer
    made = []
    plain = Program.of
    monkeypatch.setattr(Program, "of", lambda *a: made.append(a) or plain(*a))
    t, (u, y) = T[:45], log(T[:45])

    def programs(rate, **choice):
        flux = aslo.AlgebraicObserver(MOTION.relation(), aslo.LowPass(rate), **choice)
        run = lambda engine: aslo.replay(flux, t, u, y, engine=engine)
        same(run("fused"), run("scan"))
        return len(made)

    assert programs(17.5) == 2 and programs(43.0) == 2
    assert programs(17.5, start="paper") == 4 and programs(43.0, start="paper") == 4
    assert programs(43.0) == 4
