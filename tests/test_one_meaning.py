"""Keys, metrics and numbers mean the same wherever they are asked for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import random, study, tune
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import Maximum, RMSError, SettlingTime
from aslo_jax.study import Normal, Spread

PLANT = aslo.plants.IntegratorChain()
H, STEPS = 0.02, 30


def observer(rate):
    return aslo.AlgebraicObserver(PLANT.relation(), aslo.LowPass(rate))


def experiment(key=None, **observers):
    return aslo.Experiment(
        PLANT,
        jnp.cos,
        observers or {"slow": observer(3.0), "fast": observer(9.0)},
        H,
        sensor=SampledNoise(0.1, H, random.key(0) if key is None else key),
        initial=jnp.array([0.3, -0.2]),
    )


# ---- keys ------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_keys_of_jax_are_keys(seed):
    own = random.key(seed)
    for key in (jax.random.key(seed), jax.random.PRNGKey(seed)):
        assert random.seed_of(key) == seed
        np.testing.assert_array_equal(random.as_key(key), own)
        ours, theirs = (experiment(k).run(STEPS).y for k in (own, key))
        np.testing.assert_array_equal(ours, theirs)


def test_a_key_that_was_split_is_no_small_seed():
    key = jax.random.split(jax.random.key(3))[1]
    assert random.seed_of(key) >= 2**32
    np.testing.assert_array_equal(random.key(random.seed_of(key)), random.as_key(key))


@pytest.mark.parametrize("seed", [3, np.int64(3), jnp.asarray(3), 3.0])
def test_a_seed_is_no_key(seed):
    fit = lambda: tune.fit(jnp.ones(()), lambda x, key: x * x, where=lambda x: x, key=seed)
    for use in (lambda: SampledNoise(0.1, H, seed), lambda: random.seed_of(seed), fit):
        with pytest.raises(ValueError, match=r"`key` must be a key .* which is a seed"):
            use()


def test_keys_among_the_parameters_of_a_batch():
    """Typed keys are those that a user of JAX splits; both engines take them."""
    keys = jax.random.split(jax.random.key(1), 3)
    run = lambda keys, engine: aslo.run_batch(
        experiment, keys, STEPS, metrics={"rms": RMSError("fast")}, engine=engine
    ).metrics["rms"]
    expected = run(jax.random.key_data(keys), "scan")
    assert len(set(np.ravel(expected))) == 3
    np.testing.assert_array_equal(run(keys, "scan"), expected)
    np.testing.assert_allclose(run(keys, "fused"), expected, rtol=1e-12)


# ---- metrics ---------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["fused", "scan"])
def test_a_class_of_metrics_is_one_for_each_observer(engine):
    run = lambda metrics: (
        aslo.run_batch(
            experiment, random.key(5)[None], STEPS, metrics=metrics, engine=engine
        ).metrics
    )
    found = run({"each": RMSError, "late": lambda name: RMSError(name, after=0.3)})
    for name in ("slow", "fast"):
        one = run({"a": RMSError(name), "b": RMSError(name, after=0.3)})
        # Two programs, whose last bits may differ.
        np.testing.assert_allclose(found["each"][name], one["a"], rtol=1e-14)
        np.testing.assert_allclose(found["late"][name], one["b"], rtol=1e-14)
    assert found["each"].keys() == {"slow", "fast"}


def test_a_study_takes_classes_and_instances():
    settings = dict(samples=4, key=jax.random.key(2), steps=STEPS, engine="scan")
    spread = Spread({"start": ("initial.1", Normal(0.0, 1.0))})
    metrics = {
        "each": RMSError,
        "like": RMSError("slow"),
        "all": Maximum(lambda record: record.hidden),
    }
    found = study.run(experiment(), spread, metrics=metrics, **settings)
    np.testing.assert_array_equal(found["each"], found["like"])
    assert np.ptp(found["each"].values, axis=1).min() > 0
    assert np.ptp(found["all"].values, axis=1).max() == 0


def test_a_loss_takes_classes_and_instances():
    place = lambda tree, key: experiment(key, one=observer(tree))
    metric = lambda name: RMSError(name, norm=True)
    losses = [
        tune.losses.MonteCarlo(place, each, samples=3, steps=STEPS, engine="scan")
        for each in (metric, metric("one"))
    ]
    one, other = (float(loss(jnp.asarray(4.0), random.key(1))) for loss in losses)
    assert one == other > 0
    several = tune.losses.MonteCarlo(lambda t, k: experiment(k), metric, 3, STEPS)
    with pytest.raises(ValueError, match=r"names its observer .* \['fast', 'slow'\]"):
        several(jnp.asarray(4.0), random.key(1))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (SettlingTime, r"`SettlingTime\('fast'\)` fails: .*'tolerance'.*SettlingTime\(obs"),
        (len, "`metrics` must be a metric, or a function .* but got 4"),
    ],
)
def test_what_makes_no_metric_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        aslo.run_batch(experiment, random.key(5)[None], STEPS, metrics={"x": make})


# ---- old spellings ---------------------------------------------------------------------


def test_old_spellings_are_refused_by_name():
    square = lambda x, key: x * x
    with pytest.raises(TypeError, match="'steps'"):
        tune.fit(jnp.ones(()), square, where=lambda x: x, steps=3)
    with pytest.raises(TypeError, match="'seed'"):
        study.run(
            experiment(), {}, samples=4, seed=1, key=jax.random.key(1), metrics={}, steps=5
        )
    with pytest.raises(TypeError, match="'samples'"):
        aslo.run_batch(experiment, None, STEPS, samples=random.key(5)[None])
