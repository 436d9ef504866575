"""The descent: why it ends, what it visits, its bounds, and what it refuses."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from aslo_jax import tune
from aslo_jax.tune._coordinates import Coordinates

ITSELF = dict(where=lambda x: x)


def bowl(x, key):
    """Its least value, 1, is at 2."""
    return 1.0 + jnp.log(x / 2.0) ** 2


def test_traced_once():
    calls = []

    def loss(x, key):
        calls.append(1)
        return bowl(x, key)

    counts = []
    for steps in (2, 30):
        calls.clear()
        optimiser = optax.adam(0.1)
        tune.fit(jnp.array(9.0), loss, optimiser=optimiser, iterations=steps, **ITSELF)
        counts.append(len(calls))
    assert counts[0] == counts[1] <= 3


def test_why_a_descent_ends():
    sgd = lambda rate, **kw: tune.fit(
        jnp.array(9.0), bowl, optimiser=optax.sgd(rate), **(ITSELF | kw)
    )
    found = sgd(2.0)
    assert found.stopped == "converged"
    np.testing.assert_allclose(found.parameters, 2.0, rtol=1e-3)
    assert found.history.gradient_norm[-1] <= 1e-4 * found.loss
    assert sgd(0.4, iterations=2).stopped == "iteration limit"
    assert sgd(1e-9, patience=3).stopped == "no improvement"
    assert len(sgd(1e-9, patience=3).history.loss) == 4
    broken = lambda x, key: jnp.where(x < 5.0, jnp.nan, bowl(x, key))
    found = tune.fit(jnp.array(9.0), broken, optimiser=optax.sgd(1.0), **ITSELF)
    assert found.stopped == "not finite"
    assert found.parameters[0] == pytest.approx(9.0)  # the last one that was finite


def test_history_is_what_was_visited():
    found = tune.fit(jnp.array(9.0), bowl, optimiser=optax.sgd(0.2), iterations=6, **ITSELF)
    loss, x = found.history.loss, found.history.parameters[:, 0]
    np.testing.assert_allclose(loss, bowl(x, None), rtol=1e-12)
    np.testing.assert_allclose(
        found.history.gradient_norm, np.abs(2 * np.log(x / 2)), rtol=1e-10
    )
    # A step of sgd in log x, of the loss in units of the first one.
    slope = 2 * np.log(x / 2)
    np.testing.assert_allclose(np.diff(np.log(x)), -0.2 * slope[:-1] / loss[0], rtol=1e-9)
    assert "iteration limit after 6 iterations" in str(found)


def test_several_starts_find_the_lower_of_two_minima():
    def loss(x, key):
        q = jnp.log(x)
        return 0.1 * q**2 - jnp.exp(-8 * (q + 1.5) ** 2) + 1.5

    settings = dict(where=lambda x: x, optimiser=optax.adam(0.1), bounds=(0.05, 20.0))
    one = tune.fit(jnp.array(9.0), loss, **settings)
    many = tune.fit(jnp.array(9.0), loss, starts=5, **settings)
    assert one.parameters[0] == pytest.approx(1.0, rel=0.1)
    assert many.parameters[0] == pytest.approx(np.exp(-1.5), rel=0.1)
    assert len(many.histories) == 5 and many.best > 0
    assert many.histories[0].loss[0] == many.initial_loss == one.initial_loss


def test_bounds_hold():
    settings = dict(optimiser=optax.adam(0.3), iterations=60, **ITSELF)
    for bounds, expected in [((3.0, 20.0), 3.0), ((3.0, None), 3.0), ((None, 1.5), 1.5)]:
        start = jnp.array(1.2 if bounds[0] is None else 9.0)
        found = tune.fit(start, bowl, bounds=bounds, **settings)
        x = found.history.parameters
        assert (x >= (bounds[0] or 0.0)).all() and (x <= (bounds[1] or np.inf)).all()
        assert found.parameters[0] == pytest.approx(expected, rel=0.02)


def test_coordinates_there_and_back():
    tree = {"a": jnp.array([2.0, 30.0]), "b": jnp.array(-4.0), "c": jnp.array(0.0)}
    where = lambda t: (t["a"], t["b"], t["c"])
    bounds = [(1.0, 100.0), (None, 5.0), None]
    coordinates = Coordinates(tree, where, bounds, "auto")
    np.testing.assert_array_equal(coordinates.log, [True, True, False, False])
    z = coordinates.inverse(coordinates.start)
    np.testing.assert_allclose(coordinates.values(jnp.asarray(z)), coordinates.start)
    placed = coordinates.placed(jnp.asarray(z))
    np.testing.assert_allclose(placed["a"], tree["a"])
    # In the middle of two bounds, z is the logarithm.
    middle = Coordinates(jnp.array(10.0), lambda x: x, (1.0, 100.0), "auto")
    slope = jax.jacfwd(lambda z: jnp.log(middle.values(z)))(
        jnp.asarray(middle.inverse(middle.start))
    )
    np.testing.assert_allclose(slope, [[1.0]])


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("`bounds` must have the start between them", dict(bounds=(10.0, 20.0))),
        ("`bounds` must give a pair for each of the 1", dict(bounds=[(1.0, 20.0), None])),
        ("`bounds` must give two bounds", dict(scale="linear", starts=2)),
        ("`scale` must be", dict(scale="logarithmic")),
        ("`mode` must be", dict(mode="backward")),
        ("`starts`, `iterations` and `patience` must be at least 1", dict(iterations=0)),
        ("`where` must select leaves of real numbers", dict(where=lambda x: jnp.array(1))),
    ],
)
def test_refusals(message, change):
    settings = ITSELF | change
    with pytest.raises(ValueError, match=message):
        tune.fit(jnp.array(9.0), bowl, **settings)


def test_a_loss_must_be_a_number():
    with pytest.raises(ValueError, match=r"`loss` must return a scalar, but got .*\(2,\)"):
        tune.fit(jnp.ones(2), lambda x, key: x, **ITSELF)
    with pytest.raises(ValueError, match='`scale` must not be "log"'):
        tune.fit(jnp.array(-1.0), bowl, scale="log", **ITSELF)


def test_progress_bar(capsys):
    settings = dict(optimiser=optax.sgd(0.1), iterations=3, progress=True, **ITSELF)
    tune.fit(jnp.array(9.0), bowl, **settings)
    assert "loss" in capsys.readouterr().err
