"""Plants that are models where plants and models are taken: in `derive`, in studies, in the
fused engine, in descriptions of machines; and what is refused."""

import copy
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import plants
from aslo_jax._studies import ready_made
from aslo_jax.derivation import model_of
from aslo_jax.machines import studies
from aslo_jax.machines._derived_study import load_model
from aslo_jax.machines._modelled import PLANTS
from aslo_jax.observers import Luenberger
from aslo_jax.study._config import ConfigurationError, configure


def test_the_same_plant_is_derived_once():
    found = aslo.derive(plants.Drone(drag=0.7))
    assert aslo.derive(plants.Drone(drag=0.7)) is found
    other = aslo.derive(plants.Drone(drag=0.8))
    assert other is not found
    assert float(other.relation.parameters["drag"]) == 0.8
    assert "wind" not in other.relation.parameters and other.states == ("speed", "wind")


def test_a_model_has_the_plant_s_names_units_and_other_ranges():
    model = model_of(plants.Boost(source=48.0), {"voltage": (40, 200)})
    assert dict(model.outputs) == {"voltage": (40, 200)}
    assert dict(model.states) == {"current": (0.0, 6.0)}
    assert model.unknown == ("load",) and model.known["source"] == 48.0
    assert model.unit("load") == "S" and model.unit("inductance") == "H"
    assert model.h is None and model.g is not None
    with pytest.raises(ValueError, match="`ranges` must be by the names current, voltage"):
        model_of(plants.Boost(), {"load": (0, 1)})


def test_a_traced_plant_is_refused():
    with pytest.raises(ValueError, match="must have numbers for parameters, but they are"):
        jax.jit(lambda drag: aslo.derive(plants.Drone(drag=drag)).slowest)(0.3)


def test_parameters_are_checked_by_their_sign():
    plants.DCMotor(load=-0.1, friction=0.0)
    with pytest.raises(ValueError, match=r"`inductance` must be positive and finite \(H\)"):
        plants.Buck(inductance=0.0)
    with pytest.raises(ValueError, match="`load`"):
        plants.Buck(load=-1.0)


@pytest.mark.parametrize("kind", PLANTS)
def test_a_kind_has_the_numbers_of_its_plant(kind):
    study, plant = studies()[kind], PLANTS[kind]()
    table = study.machine.model_validate({"kind": kind})
    joined = table.model_copy(update=dict(study.acting()))
    made = study.plant(joined)
    assert type(made) is type(plant)
    for ours, theirs in zip(jax.tree.leaves(made), jax.tree.leaves(plant), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(study.start(made, joined), plant.initial())
    assert study.entries == tuple(plant.hidden_units())


def content(name, **observer):
    found = tomllib.loads(ready_made(name))
    found["observers"] = {"it": observer}
    return found


@pytest.mark.parametrize(
    ("name", "observer", "message"),
    [
        ("buck", {"kind": "aslo", "cutoff": 900.0}, "`cutoff` must be above 1000 rad/s"),
        (
            "buck",
            {"kind": "aslo", "cutoff": 900.0, "forgetting": 1000.0},
            "`forgetting` must be above 1000 rad/s",
        ),
        (
            "pmsm",
            {"kind": "kalman", "process": 1.0, "measurement": 1e-6, "drift": 1.0},
            "`drift` has no effect on this observer",
        ),
        (
            "pmsm",
            {"kind": "kalman", "process": 1.0, "measurement": [1e-6, 1e-6]},
            "`measurement` must be one number for this machine",
        ),
        ("drone", {"kind": "fo3", "cutoff": 1.0, "gain": 1.0}, "fo3"),
    ],
)
def test_what_does_not_suit_a_plant_is_refused(name, observer, message):
    with pytest.raises(ConfigurationError, match=message):
        configure(content(name, **observer))


def test_a_filter_just_fast_enough_is_taken():
    """Half of it where the information has a rate of its own."""
    found = {"kind": "aslo", "cutoff": 510.0, "forgetting": 1010.0}
    configure(content("buck", **found))
    configure(content("buck", kind="aslo", cutoff=510.0, completion="repeat"))


def test_control_must_suit_the_inputs():
    without = copy.deepcopy(tomllib.loads(ready_made("lorenz")))
    without["control"] = {"kind": "open_loop", "signal": {"kind": "wave"}}
    with pytest.raises(ConfigurationError, match='"open_loop", is for'):
        configure(without)


def test_a_description_may_name_a_plant(tmp_path):
    model = load_model("aslo_jax.plants:Drone", Path())
    assert tuple(model.states) == ("speed",)
    (tmp_path / "ours.py").write_text(
        "import aslo_jax\nheavy = aslo_jax.plants.Drone(mass=7.0)\n"
    )
    assert load_model("ours:heavy", tmp_path).known["mass"] == 7.0


@pytest.mark.slow
def test_the_fused_engine_gives_what_scan_gives():
    pytest.importorskip("llvmlite")
    plant, h = plants.Levitation(), 2e-4
    found = aslo.derive(plant)
    observers = {
        "derived": found.observer(aslo.LowPass(200.0), guard=aslo.Guard(1e-6)),
        "kalman": aslo.ExtendedKalman.of_plant(plant, 0.1, 0.1, jnp.array([1e-12, 1e-9])),
        "copy": Luenberger.of_plant(plant, 300.0),
    }

    def experiment(start):
        ripple = lambda t: jnp.stack([4.95 + 0.5 * jnp.sin(300.0 * t)])
        first = plant.initial() * jnp.array([start, 1.0, 1.0])
        return aslo.Experiment(plant, ripple, observers, h, initial=first)

    starts = jnp.array([0.98, 1.03])
    last = lambda record: jnp.stack([record.estimates[n].value for n in observers])
    both = [
        aslo.run_batch(experiment, starts, 100, record=last, every=100, engine=engine)
        for engine in ("fused", "scan")
    ]
    fused, scan = (np.asarray(each.record) for each in both)
    np.testing.assert_allclose(fused, scan, rtol=1e-9, atol=1e-12)
    assert np.ptp(scan[:, -1], axis=0).min() > 0  # each start its own
