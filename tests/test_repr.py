"""What is printed of a module shows its values."""

import jax
import jax.numpy as jnp
import pytest

import aslo_jax as aslo

MOTOR = aslo.plants.PMSM(
    resistance=3.25, inductance=0.02, magnet_flux=0.1, pole_pairs=4, inertia=2e-4
)
LOG = jnp.ones((3, 2))
OBSERVER = aslo.AlgebraicObserver(MOTOR.flux_relation(), aslo.LowPass(12.0))


class Keyed(aslo.control.AbstractController):
    key: jax.Array

    def init(self, fed): ...
    def vector_field(self, t, state, fed): ...
    def __call__(self, t, state, fed): ...


def test_values_are_shown():
    text = repr(MOTOR)
    assert text.startswith("PMSM(") and "f64" not in text
    for part in ("resistance=3.25", "inductance=0.02", "pole_pairs=4", "inertia=0.0002"):
        assert part in text
    assert "filter=LowPass(rate=12.0)" in repr(OBSERVER)
    experiment = aslo.Experiment(MOTOR, lambda t: jnp.zeros(2), {"A": OBSERVER}, 0.25)
    assert "interval=0.25" in repr(experiment) and "rate=12.0" in repr(experiment)


def test_arrays_are_abbreviated():
    value = jnp.arange(1000.0).reshape(500, 2)
    text = repr(aslo.Estimate(value, jnp.ones(500), jnp.zeros(500, bool)))
    assert "[[ 0., 1.], [ 2., 3.]" in text and "..., [994., 995.]" in text
    assert len(text) < 400


def test_what_is_traced_has_its_type():
    seen = []

    def look(rate):
        seen.append(repr(aslo.LowPass(rate)))
        return rate

    jax.jit(look)(2.0)
    jax.grad(look)(2.0)
    assert seen[0] == "LowPass(rate=f64[])" and "f64[]" in seen[1]
    assert "key<fry>[]" in repr(Keyed(jax.random.key(0)))


def test_a_runner_tells_what_it_runs():
    make = lambda x: aslo.Experiment(MOTOR, lambda t: x * jnp.ones(2), {"A": OBSERVER}, 0.1)
    metrics = {"rms": aslo.metrics.RMSError}
    runner = aslo.Runner(make, jnp.zeros(()), 6, metrics=metrics, engine="scan")
    assert repr(runner) == "Runner(like=f64[], steps=6, metrics=['rms'], engine='scan')"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: aslo.replay(MOTOR, jnp.arange(3.0), LOG, LOG), "PMSM"),
        (lambda: aslo.Asymptotic(OBSERVER, gain="fast"), "number.*'fast'"),
    ],
)
def test_what_does_not_fit_is_refused_at_once(make, message):
    with pytest.raises((ValueError, TypeError), match=message):
        make()
