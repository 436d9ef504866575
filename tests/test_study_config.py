"""Files of studies: what they describe, and what is refused."""

import copy
import tomllib
from importlib.resources import files

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax.machines._modelled import PLANTS
from aslo_jax.study._config import NAMES, ConfigurationError, configure, read_configuration
from aslo_jax.study._spread import Sampler, names_of

FOLDER = files("aslo_jax.study") / "configs"

SMALL = """
title = "A small study"
interval = 0.01
horizon = 0.5
every = 10

[machine]
kind = "double_integrator"

[control]
kind = "open_loop"
signal = { kind = "wave", amplitude = 1.0, frequency = 2.0 }

[observers.ASLO]
kind = "aslo"
cutoff = 5.0

[[sensor]]
kind = "bias"
offset = 0.0

[[sensor]]
kind = "noise"
deviation = 0.01

[spread.speed]
where = "initial.1"
distribution = "normal"
mean = 0.0
deviation = 1.0

[spread.bias]
where = "sensor.parts.0.offset"
distribution = "uniform"
low = -0.1
high = 0.1

[metrics.rms]
kind = "rms"
after = 0.1

[metrics.settling]
kind = "settling"
tolerance = 0.1
"""


def test_every_ready_made_study_has_a_name():
    assert {f"{name}.toml" for name in NAMES} == {f.name for f in FOLDER.iterdir()}


# Of those whose plants are models, made alike, the drone stands for the others.
STEPPED = [
    pytest.param(name, marks=pytest.mark.slow if name in {*PLANTS} - {"drone"} else ())
    for name in NAMES
]


@pytest.mark.parametrize("name", STEPPED)
def test_ready_made_studies_step(name):
    """They can be read, every spread names something, and a step of a sample keeps all
    shapes and types; what is estimated has the shape of what is hidden."""
    found = read_configuration(name)
    sampler = Sampler(found.experiment, found.spread, 0, 4)
    assert sampler.names, "a study without a spread"
    values = sampler.values(0, 4)
    assert np.isfinite(values).all()
    sample = jax.tree.map(lambda x: x[0], sampler(np.arange(4), values))

    def two(sample):
        experiment = sampler.make(sample)
        carry, first = experiment.init()
        return (
            carry,
            first,
            *experiment.advance(jnp.asarray(0), carry, experiment.prepare(carry)),
        )

    shapes = lambda tree: [(x.shape, x.dtype) for x in jax.tree.leaves(tree)]
    carry, first, after, record = jax.eval_shape(two, sample)
    assert shapes(carry) == shapes(after)
    assert shapes(first) == shapes(record)
    hidden = record.hidden.shape
    assert hidden == (len(found.entries),)
    assert {e.value.shape for e in record.estimates.values()} == {hidden}
    assert found.scale is None or found.scale.shape == hidden
    spread = {f"parameter_{name}" for name in names_of(found.spread)}
    assert (
        {*found.metrics, "error"} <= set(found.units) <= {*found.metrics, "error", *spread}
    )


def test_mismatch_is_of_the_plant_alone():
    """A spread of the plant leaves observers and controller at the nominal values."""
    found = read_configuration("pmsm")
    sampler = Sampler(found.experiment, found.spread, 0, 4)
    values = sampler.values(0, 4)
    sample = jax.tree.map(lambda x: x[1], sampler(np.arange(4), values))
    made = sampler.make(sample)
    assert float(made.plant.resistance) != 8.875
    assert float(made.observers["ASLO"].relation.resistance) == 8.875
    assert float(made.controller.motor.resistance) == 8.875


def test_a_file_is_what_it_says():
    found = configure(tomllib.loads(SMALL))
    e = found.experiment
    assert (found.steps, found.every, found.entries) == (50, 10, ("speed",))
    assert found.units == {"rms": "m/s", "settling": "s", "error": "m/s"}
    assert float(e.controller.signal(jnp.asarray(0.3))) == pytest.approx(np.sin(0.6))
    assert float(e.observers["ASLO"].filter.rate) == 5.0
    assert e.sensor.parts[1].stream == 1
    assert found.content["machine"]["position"] == 0.0  # with the defaults


def test_the_lifted_filter_of_a_motor():
    table = {
        "kind": "lifted_kalman",
        "output_deviation": [0.01, 0.02],
        "input_deviation": 0.1,
        "prior": 0.5,
    }
    whole = tomllib.loads((FOLDER / "pmsm.toml").read_text("utf-8"))
    found = configure(whole | {"observers": {"Lifted": table}}).experiment.observers
    lifted = found["Lifted"]
    np.testing.assert_allclose(lifted.output_deviation, [0.01, 0.02])
    assert float(lifted.prior) == 0.5 and float(lifted.guard.threshold) == 0.9


def test_the_adaptive_filter_of_a_motor():
    table = {
        "kind": "adaptive",
        "output_deviation": 0.01,
        "input_deviation": 0.1,
        "parameters": ["resistance", "inductance"],
        "deviations": [0.2, 0.05],
        "drift": 0.01,
    }
    whole = tomllib.loads((FOLDER / "pmsm.toml").read_text("utf-8"))
    found = configure(whole | {"observers": {"A": table}}).experiment.observers["A"]
    assert found.parameters == ("resistance", "inductance") and found.bank == 11
    np.testing.assert_allclose(found.deviations, [0.2, 0.05])
    assert float(found.drift) == 0.01 and float(found.hold) == 0.03
    wrong = table | {"parameters": ["resistance", "gap"]}
    with pytest.raises(ValueError, match="`gap` is none of FluxRelation"):
        configure(whole | {"observers": {"A": wrong}}).experiment.observers["A"]


def test_the_kalman_filters_of_a_mechanism():
    noise = {"output_deviation": 1e-4, "input_deviation": [0.1, 0.2]}
    known = noise | {"kind": "lifted_kalman", "prior": 2.0, "force_deviation": 0.5}
    unknown = noise | {
        "kind": "adaptive",
        "parameters": ["m2", "push"],
        "deviations": [0.3, 0.1],
        "drift": 0.01,
    }
    whole = tomllib.loads((FOLDER / "robotic_leg.toml").read_text("utf-8"))
    built = lambda table, whole=whole: configure(
        whole | {"observers": {"A": table}}
    ).experiment.observers["A"]
    found = built(known)
    assert float(found.system.m1) == 2.0 and float(found.prior) == 2.0
    assert float(found.force_deviation) == 0.5 and float(found.guard.threshold) == 0.9
    np.testing.assert_allclose(found.input_deviation, [0.1, 0.2])
    found = built(unknown)
    assert found.parameters == ("m2", "push") and len(found.drift) == 2
    np.testing.assert_allclose(found.deviations, [0.3, 0.1])
    motor = tomllib.loads((FOLDER / "pmsm.toml").read_text("utf-8"))
    for wrong, of, message in (
        (unknown | {"parameters": ["m2", "gap"]}, whole, "`gap` is none of RoboticLeg"),
        (unknown | {"bank": 5}, whole, "`bank` has no effect"),
        (known, motor, "`force_deviation` has no effect"),
    ):
        with pytest.raises(ValueError, match=message):
            built(wrong, of)


def test_a_rate_that_follows_the_speed():
    rate = {"per_speed": 1.4, "low": 3.0, "high": 150.0}
    table = {"kind": "aslo", "cutoff": rate, "forgetting": {"per_speed": 0.2}}
    whole = tomllib.loads((FOLDER / "pmsm.toml").read_text("utf-8"))
    built = lambda whole, **keys: configure(
        whole | {"observers": {"A": table | keys}}
    ).experiment.observers["A"]
    found = built(whole)
    schedule = found.filter.rate
    assert [float(x) for x in schedule.limits] == [3.0, 150.0]
    assert float(schedule.per_speed) == 1.4 and float(schedule.bandwidth) == 60.0
    turning = schedule.vector(None, jnp.array([1.0, 2.0]), jnp.array([0.3, 0.4]))
    np.testing.assert_allclose(turning, [0.3 - 40.03e-3, 0.4 - 2 * 40.03e-3])
    assert float(found.completion.forgetting.rate.per_speed) == 0.2
    for wrong, message in (
        ({"cutoff": {"per_speed": -1.0}}, "observers.A.cutoff"),
        ({"cutoff": {"low": 9.0, "high": 4.0}}, "`low` of a rate must be at most `high`"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            built(whole, **wrong)
    with pytest.raises(ConfigurationError, match="needs the flux of a round motor"):
        built(tomllib.loads(SMALL), forgetting=5.0)


def test_signals_of_several_entries():
    found = read_configuration("robotic_leg")
    wanted = found.experiment.controller.reference(jnp.asarray(0.5))
    np.testing.assert_allclose(wanted, [1.0 + 0.2 * np.sin(0.5), 0.6 * np.sin(0.65)])


CHANGES = {
    "a key that is missing": (
        {"interval": None},
        "`interval`, between samples in time (s), is missing: it must be a positive finite",
    ),
    "a table that is missing": ({"observers": None}, "`observers`, the observers, is miss"),
    "an unknown key": (
        {"observers.ASLO.cutof": 1.0},
        "unknown key `observers.ASLO.cutof` (did you mean `cutoff`? allowed: kind, cutoff,",
    ),
    "out of range": (
        {"observers.ASLO.cutoff": -1.0},
        "`observers.ASLO.cutoff`, cutoff of the filter (rad/s), must be a positive finite "
        "number, or { per_speed = 1.0, low = 2.0, high = 300.0 } for a rate that follows "
        "the speed, but is -1.0",
    ),
    "a number out of range": (
        {"interval": -1.0},
        "must be greater than 0, but is -1.0",
    ),
    "a wrong type": (
        {"horizon": "long"},
        "`horizon`, how long a trajectory is (s), must be a number, but is 'long'",
    ),
    "a wrong kind": (
        {"observers.ASLO.kind": "also"},
        '`observers.ASLO.kind` must be one of "aslo", "a-aslo", "fo1",',
    ),
    "no kind": ({"machine.kind": None}, '`machine.kind` is missing: it must be one of "do'),
    "an observer of another machine": (
        {"observers.ASLO": {"kind": "fo2", "gain": 1000.0}},
        '`observers.ASLO.kind`, "fo2", is for "pmsm", but `machine.kind` is '
        '"double_integrator"',
    ),
    "a key without effect": (
        {"observers.ASLO.velocity_cutoff": 50.0},
        "`observers.ASLO`: `velocity_cutoff` has no effect on this observer of this mach",
    ),
    "a key that another one switches off": (
        {"observers.ASLO.completion": "repeat", "observers.ASLO.forgetting": 3.0},
        "`observers.ASLO`: `forgetting` has no effect on this observer",
    ),
    "a metric of another machine": (
        {"metrics.rms": {"kind": "angle"}},
        '`metrics.rms.kind`, "angle", is for "pmsm"',
    ),
    "a disturbance in the wrong place": (
        {"sensor": [{"kind": "lag", "tau": 0.1}]},
        '`sensor.0.kind`, "lag", is for actuator only',
    ),
    "a distribution": (
        {"spread.speed.distribution": "gaussian"},
        '`spread.speed.distribution` must be one of "normal", "uniform", "log-normal",',
    ),
    "limits that are crossed": ({"spread.bias.low": 0.2}, "`high` must be above `low`"),
    "a choice": ({"design": "grid"}, '`design`, the design, must be "iid" or "lhs" or "so'),
    "a horizon": ({"horizon": 0.505}, "`horizon` must be a whole number of intervals of 0"),
    "a decimation": ({"every": 7}, "`every` must divide the 50 samples of the horizon, bu"),
    "a key beside one that is called like its kind": (
        {"sensor": [{"kind": "delay", "delay": 1.0, "longest": 10**9}]},
        "`sensor.0.longest`, the most that a spread gives, in samples, must be a whole "
        "number from 1 to 256, but is 1000000000",
    ),
    "a delay": (
        {"sensor": [{"kind": "delay", "delay": 1e9}]},
        "`sensor.0.delay`, in samples, must be a number from 0 to 256, but is 1000000000.0",
    ),
    "deviations of two entries": (
        {"sensor": [{"kind": "bias", "offset": 0}, {"kind": "noise", "deviation": [1, 2]}]},
        "`sensor.1` must suit its signal, which has one number",
    ),
    "offsets that the input has not": (
        {"actuator": [{"kind": "bias", "offset": [0.1, 0.2]}]}, "`actuator.0` must suit its"
    ),
    "no ranges": (
        {"sensor": [{"kind": "encoder", "bits": 12, "ranges": []}]},
        "`sensor.0.ranges`, what each spans, a length (m) or 0 of `angles` a turn, must be "
        "a list of positive finite numbers, one for each entry of the signal, but is []",
    ),
    "bits": (
        {"sensor": [{"kind": "encoder", "bits": 10_000, "ranges": [1.0]}]},
        "`sensor.0.bits`, of every encoder, must be a whole number from 1 to 52, but is 1",
    ),
    "an endless horizon": (
        {"horizon": 1e308},
        "`horizon` must be at most 1e+09 intervals, 1e+07 s, but is 1e+308",
    ),
    "errors that no memory holds": (
        {"horizon": 1e6, "every": 1},
        "`every` must be at least 1000, to keep at most 100000 errors of the 100000000",
    ),
    "steps of the plant": (
        {"plant_steps": 10**9}, "must be a whole number from 1 to 100, but is 1000000000"
    ),
    "a title that moves the cursor": ({"title": "a\x1b[2Jb"}, "`title` must be text that"),
    "a metric called as a coordinate": (
        {"metrics.time": {"kind": "final"}},
        "`metrics.time` would be stored under the name of `time` of every study",
    ),
    "a metric called as what is kept": ({"metrics.error": {"kind": "final"}}, "of `error`"),
    "a metric called as a parameter": (
        {"metrics.parameter_speed": {"kind": "final"}},
        "`spread.speed` would be stored under the name of `metrics.parameter_speed`",
    ),
    "metrics that differ in their case": (
        {"metrics.RMS": {"kind": "final"}},
        "`metrics.RMS` would be stored under the name of `metrics.rms`",
    ),
    "a metric without a name": ({"metrics": {"": {"kind": "final"}}}, "but it is ''"),
    "a metric that leaves the store": (
        {"metrics": {"../../etc": {"kind": "final"}}}, "without / \\ ., spaces at its ends"
    ),
    "a metric called as a file": (
        {"metrics": {"zarr.json": {"kind": "final"}}}, "but it has '.'"
    ),
    "a long name": ({"metrics": {"x" * 300: {"kind": "final"}}}, "but it has 300"),
    "an observer with a line end": (
        {"observers": {"a\nb": {"kind": "aslo", "cutoff": 1.0}}}, "but it has '\\n'"
    ),
    "a scale": ({"scale": [1.0, 2.0]}, "`scale` must hold 1 numbers, for speed, but is"),
}  # fmt: skip


def changed(changes):
    content = copy.deepcopy(tomllib.loads(SMALL))
    for path, value in changes.items():
        *way, last = path.split(".")
        table = content
        for name in way:
            table = table[name]
        if value is None:
            del table[last]
        else:
            table[last] = value
    return content


@pytest.mark.parametrize("name", CHANGES)
def test_refused_files(name):
    changes, message = CHANGES[name]
    with pytest.raises(ConfigurationError) as caught:
        configure(changed(changes))
    assert message in str(caught.value)


def test_refused_paths(tmp_path):
    with pytest.raises(FileNotFoundError, match="ready-made study; those are double_integ"):
        read_configuration("pmsn")
    path = tmp_path / "study.toml"
    path.write_text("title =")
    with pytest.raises(ConfigurationError, match="not valid TOML"):
        read_configuration(path)
    path.write_text(SMALL.replace('kind = "aslo"', ""))
    with pytest.raises(
        ConfigurationError, match=r"study.toml: `observers.ASLO.kind` is mis"
    ):
        read_configuration(path)
