"""Spreads: distributions, designs, and the leaves that they set."""

import cloudpickle
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import aslo_jax as aslo
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.study import (
    Correlated,
    Discrete,
    LogNormal,
    Normal,
    Parameter,
    Spread,
    Uniform,
)
from aslo_jax.study._designs import make_design
from aslo_jax.study._leaves import Layout
from aslo_jax.study._possible import refuse_impossible
from aslo_jax.study._spread import Sampler

N = 4096
RELATION = aslo.plants.PMSM.bmp0701f().flux_relation()
ASLO = aslo.AlgebraicObserver(RELATION, aslo.LowPass(50.0))


def supply(t):
    return jnp.stack([jnp.cos(t), jnp.sin(t)])


EXPERIMENT = aslo.Experiment(
    aslo.plants.PMSM.bmp0701f(),
    OpenLoop(supply),
    {"ASLO": ASLO, "A-ASLO": aslo.Asymptotic(ASLO, 20.0)},
    1e-3,
    sensor=SampledNoise(jnp.array([0.01, 0.02]), 1e-3, aslo.random.key(0)),
    input_sensor=SampledNoise(0.1, 1e-3, aslo.random.key(0), 1),
)


def sampler(design="iid", samples=N, seed=3, **parameters):
    return Sampler(EXPERIMENT, Spread(parameters, design), seed, samples)


LAWS = {
    "normal": (Normal(2.0, 0.3), scipy.stats.norm(2.0, 0.3)),
    "uniform": (Uniform(-1.0, 3.0), scipy.stats.uniform(-1.0, 4.0)),
    "log-normal": (LogNormal(2.0, 0.3), scipy.stats.lognorm(0.3, scale=2.0)),
}


@pytest.mark.parametrize("design", ["iid", "lhs", "sobol"])
@pytest.mark.parametrize("law", LAWS)
def test_samples_have_their_distribution(law, design):
    """By the test of Kolmogorov and Smirnov, which a wrong parameter fails at this size."""
    distribution, expected = LAWS[law]
    x = sampler(design, x=("plant.resistance", distribution)).values(0, N)[:, 0]
    assert scipy.stats.kstest(x, expected.cdf).pvalue > 1e-3
    if design != "iid":
        # Stratified: the mean is right to far below its standard error.
        assert abs(x.mean() - expected.mean()) < 0.1 * expected.std() / np.sqrt(N)


def test_discrete_values_have_their_weights():
    law = Discrete((1.0, 5.0, 2.0), (1.0, 2.0, 5.0))
    x = sampler(x=("plant.resistance", law)).values(0, N)[:, 0]
    counts = [np.sum(x == v) for v in law.values]
    assert sum(counts) == N
    expected = np.array([1.0, 2.0, 5.0]) / 8.0 * N
    assert scipy.stats.chisquare(counts, expected).pvalue > 1e-3
    even = sampler(x=("plant.resistance", Discrete((1.0, 2.0)))).values(0, N)
    assert abs(np.mean(even == 1.0) - 0.5) < 4 * 0.5 / np.sqrt(N)


def test_correlated_numbers_have_their_covariance():
    correlation = [[1.0, 0.8, 0.0], [0.8, 1.0, -0.3], [0.0, -0.3, 1.0]]
    law = Correlated.of([1.0, 2.0, 3.0], [0.1, 0.2, 0.3], correlation)
    where = ["plant.resistance", "plant.inductance", "plant.inertia"]
    drawn = sampler(x=Parameter(where, law, names=("R", "L", "J")))
    assert drawn.names == ["R", "L", "J"]
    x = drawn.values(0, N)
    # Six standard errors of a correlation, 1/sqrt(N), and of a mean.
    np.testing.assert_allclose(np.corrcoef(x.T), correlation, atol=6 / np.sqrt(N))
    error = np.abs(x.mean(axis=0) - [1.0, 2.0, 3.0])
    assert (error < 6 * np.array([0.1, 0.2, 0.3]) / np.sqrt(N)).all()


@pytest.mark.parametrize("design", ["iid", "lhs", "sobol"])
def test_samples_do_not_depend_on_chunks(design):
    """Nor, but for the hypercube, on how many there are, on the order in which they are
    asked for, or on what else is spread."""
    parameters = {
        "a": ("plant.resistance", Normal(1.0, 0.1)),
        "b": ("plant.inertia", LogNormal(1.0, 0.5)),
    }
    whole = sampler(design, 1000, **parameters).values(0, 1000)
    pieces = sampler(design, 1000, **parameters)
    edges = [(512, 768), (0, 256), (256, 512), (768, 1000)]
    found = {edge: pieces.values(*edge) for edge in edges}
    for (first, last), piece in found.items():
        np.testing.assert_array_equal(piece, whole[first:last])
    assert len(np.unique(whole[:, 0])) == 1000
    other = sampler(design, 1000, seed=4, **parameters).values(0, 1000)
    assert (other != whole).mean() > 0.99
    if design != "lhs":
        more = sampler(design, 2000, **parameters).values(0, 1000)
        np.testing.assert_array_equal(more, whole)
    if design == "iid":
        alone = sampler(design, 1000, b=parameters["b"]).values(0, 1000)
        np.testing.assert_array_equal(alone[:, 0], whole[:, 1])
        assert abs(np.corrcoef(whole.T)[0, 1]) < 4 / np.sqrt(1000)


def test_points_are_inside_of_the_unit_cube():
    for kind in ("iid", "lhs", "sobol"):
        u = make_design(kind, ["a", "b"], 0, 512)(0, 512)
        assert (u > 0).all()
        assert (u < 1).all()


def made(values, **parameters):
    drawn = sampler(**parameters)
    sample = drawn(np.array([7]), np.array([values]))
    return drawn.make(jax.tree.map(lambda x: x[0], sample))


def test_paths_set_leaves():
    experiment = made(
        [9.0, 60.0, 1.1, 0.5, 0.03],
        R=("plant.resistance", Normal(9.0, 1.0)),
        rate=("observers.*.filter.rate", Normal(50.0, 1.0)),
        inductance=Parameter("observers.ASLO.relation.inductance", Normal(1.0, 0.1), True),
        flux=("initial.flux.1", Normal(0.0, 1.0)),
        noise=("sensor.deviation.1", Uniform(0.0, 1.0)),
    )
    motor = EXPERIMENT.plant
    assert float(experiment.plant.resistance) == 9.0
    assert float(experiment.observers["ASLO"].relation.resistance) == motor.resistance
    for inner in (experiment.observers["ASLO"], experiment.observers["A-ASLO"].observer):
        assert float(inner.filter.rate) == 60.0
    inductance = float(experiment.observers["ASLO"].relation.inductance)
    assert inductance == pytest.approx(1.1 * 40.03e-3, rel=1e-12)
    inner = experiment.observers["A-ASLO"].observer
    assert float(inner.relation.inductance) == 40.03e-3
    assert experiment.initial.flux.tolist() == [float(motor.magnet_flux), 0.5]
    assert experiment.sensor.deviation.tolist() == [0.01, 0.03]


def test_functions_set_leaves():
    experiment = made(
        [9.0, 0.5, 0.3],
        R=(lambda e: (e.plant.resistance, e.plant.friction), Normal(9.0, 1.0)),
        flux=(lambda e: e.initial.flux[1], Normal(0.0, 1.0)),
        noise=(lambda e: e.sensor.deviation, Uniform(0.0, 1.0)),
    )
    assert float(experiment.plant.friction) == 9.0
    assert float(experiment.plant.resistance) == 9.0
    assert float(experiment.initial.flux[1]) == 0.5
    assert experiment.sensor.deviation.tolist() == [0.3, 0.3]


def test_default_start_is_that_of_the_varied_plant():
    spread = {"m": ("plant.magnet_flux", Normal(0.3, 0.01))}
    assert made([0.25], **spread).initial is None
    both = spread | {"speed": ("initial.speed", Normal(0.0, 1.0))}
    experiment = made([0.25, 4.0], **both)
    assert experiment.initial.flux.tolist() == [0.25, 0.0]
    assert float(experiment.initial.speed) == 4.0


def test_keys_depend_on_study_sample_and_part():
    drawn, other = sampler(), sampler(seed=4)
    index = np.arange(3)
    none = np.empty((3, 0))
    keys = [np.asarray(k) for s in (drawn, other) for k in s(index, none)["keys"]]
    assert len(keys) == 4  # two parts, two studies
    words = {tuple(word) for key in keys for word in key.tolist()}
    # The two noises share a key, and differ by their streams.
    assert len(words) == 6
    again = sampler(samples=10)(np.array([2]), np.empty((1, 0)))["keys"]
    np.testing.assert_array_equal(again[0][0], keys[0][2])


@pytest.mark.parametrize(
    ("spread", "message"),
    [
        (dict(x=("plant.resistence", Normal(1.0, 1.0))), "Did you mean `plant.resistance`"),
        (dict(x=("plant.rubbish", Normal(1.0, 1.0))), "`observers.ASLO.filter.rate`"),
        (
            dict(x=("initial.flux.2", Normal(1.0, 1.0))),
            r"whose shape is \(2,\), but got .*2",
        ),
        (
            dict(x=("controller.signal", Normal(1.0, 1.0))),
            "`controller.signal` is a function",
        ),
        (dict(x=("sensor.key", Normal(1.0, 1.0))), "`sensor.key` is of the type uint32"),
        (dict(x=(lambda e: e.plant, Normal(1.0, 1.0))), "must return leaves.*but got PMSM"),
        (
            dict(
                x=("plant.resistance", Normal(1.0, 1.0)),
                y=("*.resistance", Normal(1.0, 1.0)),
            ),
            "`x` and `y` both set `plant.resistance`",
        ),
        (
            dict(x=("plant.resistance", Correlated((1.0, 2.0), ((1.0, 0.0), (0.0, 1.0))))),
            "an item for each of the 2 numbers of Correlated, but has 1",
        ),
    ],
)
def test_refused_spreads(spread, message):
    with pytest.raises(ValueError, match=message):
        sampler(**spread)


@pytest.mark.parametrize(
    ("where", "law", "relative", "impossible", "said"),
    [
        ("plant.resistance", Normal(1.0, 0.6), True, lambda x: x <= 0, "resistance"),
        ("observers.*.filter.rate", Uniform(-1.0, 3.0), False, lambda x: x <= 0, "rate"),
        ("sensor.deviation.1", Normal(0.1, 0.1), False, lambda x: x < 0, "deviation"),
        ("plant.inertia", Discrete((1.0, 0.0, -2.0)), True, lambda x: x <= 0, "inertia"),
    ],
)
def test_impossible_parameters_are_counted(where, law, relative, impossible, said):
    """Of the samples that would be run: the count is that of the numbers themselves."""
    drawn = sampler(x=Parameter(where, law, relative))
    count = int(impossible(drawn.values(0, N)).sum())
    assert 0 < count < N
    with pytest.raises(ValueError, match=rf"`spread.x` .* {count} of {N} .*`{said}` must"):
        refuse_impossible(drawn, N)


def test_every_sample_impossible():
    drawn = sampler(x=Parameter("plant.resistance", Normal(-9.0, 0.1), True))
    with pytest.raises(ValueError, match=rf"in {N} of {N} samples \(100 %\)"):
        refuse_impossible(drawn, N)


def test_possible_parameters_pass():
    """What may have any sign may have it; a resistance within its bounds passes, too."""
    bounded = Normal(1.0, 0.6, low=0.2)
    drawn = sampler(
        x=Parameter("plant.resistance", bounded, True),
        y=("initial.flux", Normal(0.0, 1.0)),
        z=("initial.angle", Normal(0.0, 1.0)),
    )
    refuse_impossible(drawn, N)


def test_a_truncated_normal_distribution():
    """By the test of Kolmogorov and Smirnov; no number is outside."""
    x = sampler(x=("plant.resistance", Normal(2.0, 0.5, 1.8, 2.9))).values(0, N)[:, 0]
    assert x.min() >= 1.8 and x.max() <= 2.9
    expected = scipy.stats.norm(2.0, 0.5)
    whole = expected.cdf(2.9) - expected.cdf(1.8)
    law = lambda at: (expected.cdf(at) - expected.cdf(1.8)) / whole
    assert scipy.stats.kstest(x, law).pvalue > 0.01


@pytest.mark.parametrize("design", ["iid", "lhs", "sobol"])
def test_a_design_sent_to_another_process_is_the_same(design):
    drawn = sampler(design, x=("plant.resistance", Uniform(1.0, 2.0)))
    drawn.values(0, 512)
    copy = cloudpickle.loads(cloudpickle.dumps(drawn.design))
    np.testing.assert_array_equal(copy(256, 1024), drawn.design(256, 1024))
    assert len(cloudpickle.dumps(drawn.design)) < 1000


def test_all_paths_are_listed():
    assert "observers.A-ASLO.observer.filter.rate" in Layout(EXPERIMENT).real()
    assert "controller.signal" not in Layout(EXPERIMENT).real()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Normal(1.0, 0.0), "`deviation` must be positive and finite, but got 0.0"),
        (lambda: Uniform(1.0, 1.0), "`high` must be above `low`"),
        (lambda: LogNormal(-1.0, 1.0), "`median` must be positive"),
        (lambda: Discrete(()), "at least one value"),
        (lambda: Discrete((1.0, 2.0), (1.0,)), "a weight for each of the 2 values"),
        (lambda: Correlated((0.0, 0.0), ((1.0, 2.0), (2.0, 1.0))), "positive definite"),
        (lambda: Spread({}, "grid"), '`design` must be "iid" or "lhs" or "sobol"'),
    ],
)
def test_refused_distributions(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_path_that_is_not_there_names_its_spread():
    with pytest.raises(ValueError, match=r"`spread.x`: .* no `plant.resistanze`"):
        sampler(x=("plant.resistanze", Normal(1.0, 0.1)))
