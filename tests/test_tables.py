"""Estimates and simulations as tables: every number in the column of its name."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo

T = jnp.array([0.0, 0.1, 0.3])
VALUE = jnp.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]])
ESTIMATE = aslo.Estimate(VALUE, jnp.array([0.0, 0.5, 0.7]), jnp.array([True, False, False]))
NAMES = ("flux_alpha", "flux_beta")


def test_an_estimate_as_a_table():
    table = ESTIMATE.to_dataframe(T, names=NAMES, units={"flux_alpha": "Wb"})
    assert list(table.columns) == [*NAMES, "certificate", "coasting"]
    assert table.index.name == "t"
    np.testing.assert_array_equal(table.index, T)
    np.testing.assert_array_equal(table[list(NAMES)], VALUE)
    np.testing.assert_array_equal(table.certificate, ESTIMATE.certificate)
    assert table.coasting.tolist() == [True, False, False]
    assert table.attrs["units"]["flux_alpha"] == "Wb"
    assert list(ESTIMATE.to_dataframe(T).columns[:2]) == ["value_0", "value_1"]


def test_an_estimate_as_a_dataset():
    found = ESTIMATE.to_xarray(T, names=NAMES, units=dict.fromkeys(NAMES, "Wb"))
    assert found.flux_beta.attrs == {"units": "Wb"}
    assert found.t.attrs == {"units": "s"}
    assert found.certificate.attrs["units"] == "1"
    np.testing.assert_array_equal(found.flux_beta.sel(t=0.3), 6.0)
    assert found.coasting.dtype == bool
    assert "units" not in ESTIMATE.to_xarray(T).value_0.attrs


@pytest.fixture(scope="module")
def simulation():
    motor = aslo.plants.PMSM(
        resistance=1.5, inductance=8e-3, magnet_flux=0.1, pole_pairs=3, inertia=1e-4
    )
    observer = aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(50.0))
    turn = lambda t: 20.0 * jnp.stack([jnp.cos(60.0 * t), jnp.sin(60.0 * t)])
    observers = {"ASLO": observer, "A-ASLO": aslo.Asymptotic(observer, 20.0)}
    ts = jnp.linspace(0.0, 0.1, 6)
    return aslo.simulate(motor, turn, observers, t1=0.1, ts=ts)


def test_a_simulation_as_a_table(simulation):
    table = simulation.to_dataframe(names=NAMES, units={"u": "V", "flux_alpha": "Wb"})
    np.testing.assert_array_equal(table.index, simulation.t)
    for k, name in enumerate(NAMES):
        np.testing.assert_array_equal(table[name], simulation.hidden[:, k])
        np.testing.assert_array_equal(table[f"u_{k}"], simulation.u[:, k])
        np.testing.assert_array_equal(table[f"y_{k}"], simulation.y[:, k])
        for observer, estimate in simulation.estimates.items():
            column = table[f"{observer}.{name}"]
            np.testing.assert_array_equal(column, estimate.value[:, k])
            certificate = table[f"{observer}.certificate"]
            np.testing.assert_array_equal(certificate, estimate.certificate)
    units = table.attrs["units"]
    assert units["u_1"] == "V" and units["A-ASLO.flux_alpha"] == "Wb"
    assert units["ASLO.coasting"] == "1" and "y_0" not in units
    states = [name for name in table.columns if name.startswith("x")]
    assert len(states) == sum(
        leaf.reshape(6, -1).shape[1] for leaf in jax.tree.leaves(simulation.x)
    )
    found = simulation.to_xarray(names=NAMES, units={"u": "V"})
    assert sorted(found.data_vars) == sorted(table.columns)
    assert found["u_0"].attrs["units"] == "V"
    np.testing.assert_array_equal(found["ASLO.flux_beta"], table["ASLO.flux_beta"])
    assert "hidden_1" in simulation.to_dataframe().columns


def test_trees_have_columns_by_name():
    simulation = aslo.Simulation(
        T, {"torque": T, "voltage": VALUE}, 2.0 * T, (T, VALUE), VALUE, {}, {}
    )
    columns = list(simulation.to_dataframe().columns)
    assert columns == [
        *("u.torque", "u.voltage_0", "u.voltage_1", "y", "x.0", "x.1_0", "x.1_1"),
        *("hidden_0", "hidden_1"),
    ]


def test_what_does_not_fit_is_refused(simulation):
    with pytest.raises(ValueError, match=r"`t` must have the shape \(3,\)"):
        ESTIMATE.to_dataframe(T[1:])
    with pytest.raises(ValueError, match="`names` must hold 2 different names"):
        ESTIMATE.to_xarray(T, names=("a", "a"))
    with pytest.raises(ValueError, match="must not hold certificate, which another column"):
        ESTIMATE.to_dataframe(T, names=("certificate", "b"))
    with pytest.raises(ValueError, match="must not hold u_0"):
        simulation.to_dataframe(names=("u_0", "b"))
    with pytest.raises(ValueError, match="`units` must name columns, but flux is none"):
        ESTIMATE.to_dataframe(T, units={"flux": "Wb"})
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), simulation)
    with pytest.raises(ValueError, match=r"must be a single one.*x\[0\]"):
        batch.to_dataframe()


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_a_missing_package_is_named_with_its_extra(monkeypatch, package):
    monkeypatch.setitem(sys.modules, package, None)
    convert = ESTIMATE.to_dataframe if package == "pandas" else ESTIMATE.to_xarray
    with pytest.raises(ImportError, match=rf'`{package}` .*"aslo_jax\[study\]"'):
        convert(T)
