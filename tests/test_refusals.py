"""What is refused by name when it is made or called: signals that would broadcast, parts
that are none. Each of these gave an estimate, or an error far from its cause."""

import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.engines import Runner
from aslo_jax.metrics import CoastingFraction, RMSError

MOTOR = aslo.plants.PMSM(
    resistance=1.7, inductance=6e-3, magnet_flux=0.09, pole_pairs=3, inertia=2e-4
)
LAW = aslo.LowPass(30.0)
ALGEBRAIC = aslo.AlgebraicObserver(MOTOR.flux_relation(), LAW)
OBSERVERS = {
    "algebraic": ALGEBRAIC,
    "asymptotic": aslo.Asymptotic(ALGEBRAIC, 20.0),
    "side by side": aslo.SideBySide({"one": ALGEBRAIC}),
    "FO1": aslo.FO1(MOTOR.flux_relation(), LAW, 10.0),
    "FO2": aslo.FO2(MOTOR.flux_relation(), 10.0),
    "FO3": aslo.FO3(MOTOR.flux_relation(), LAW, 10.0),
    "open loop": aslo.OpenLoopIntegrator(MOTOR.flux_relation()),
    "Kalman": aslo.ExtendedKalman.of_pmsm(MOTOR.flux_relation(), 1e-3, 1.0, 1e-6),
}
T = 1e-3 * np.arange(6)
TWO, ONE, THREE = (np.ones((6, n)) for n in (2, 1, 3))


@pytest.mark.parametrize("observer", OBSERVERS.values(), ids=OBSERVERS)
@pytest.mark.parametrize(
    ("name", "u", "y"),
    [
        ("u", ONE, TWO),
        ("u", THREE, TWO),
        ("u", ONE[:, 0], TWO),
        ("y", TWO, ONE),
        ("y", TWO, THREE),
        ("y", TWO, ONE[:, 0]),
        ("y", THREE, THREE),
    ],
)
def test_a_log_of_another_width(observer, name, u, y):
    shape = {"u": u, "y": y}[name].shape[1:]
    with pytest.raises(ValueError, match=rf"`{name}` must have the shape \(2,\)") as caught:
        aslo.replay(observer, T, u, y)
    assert f"but got {shape}" in str(caught.value)


@pytest.mark.parametrize("observer", OBSERVERS.values(), ids=OBSERVERS)
def test_signals_of_another_width_in_a_loop(observer):
    state = observer.init(TWO[0])
    for u, y in ((ONE, TWO), (TWO, ONE)):
        with pytest.raises(ValueError, match=r"must have the shape \(2,\)"):
            observer.step(state, u[0], y[0], 1e-3)
    with pytest.raises(ValueError, match=r"`y` must have the shape \(2,\)"):
        observer.init(THREE[0])


def test_an_input_of_another_width_in_a_simulation_or_an_experiment():
    three = lambda t: jnp.zeros(3)
    observers = {"ASLO": ALGEBRAIC}
    with pytest.raises(ValueError, match=r"`u` must have the shape \(2,\)"):
        aslo.simulate(MOTOR, three, observers, t1=0.01)
    with pytest.raises(ValueError, match=r"`u` must have the shape \(2,\)"):
        aslo.Experiment(MOTOR, three, observers, 1e-4).run(3)


def test_positions_and_forces_of_another_number():
    leg = aslo.plants.RoboticLeg(m1=1.0, m2=0.6)
    observer = aslo.velocity_observer(leg, aslo.LowPass(50.0))
    n = len(observer.init(jnp.ones(leg.output(leg.initial()).shape)).y)
    with pytest.raises(ValueError, match=rf"`y` must have the shape \({n},\)"):
        aslo.replay(observer, T, np.ones((6, n)), np.ones((6, n + 1)))
    with pytest.raises(ValueError, match="`u` must have the shape"):
        aslo.replay(observer, T, np.ones((6, 7)), np.ones((6, n)))


def test_matrices_say_the_width_of_their_signals():
    A, B, C = [[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]]
    kalman = aslo.SteadyStateKalman.design(A, B, C, 1.0, 1e-3)
    luenberger = aslo.ReducedLuenberger(A, B, [[3.0]])
    for observer in (kalman, luenberger):
        with pytest.raises(ValueError, match=r"`y` must have the shape \(1,\)"):
            aslo.replay(observer, T, ONE[:, 0], TWO)
        with pytest.raises(ValueError, match=r"`u` must have the shape \(1,\)"):
            aslo.replay(observer, T, TWO, ONE[:, 0])
        one, same = (aslo.replay(observer, T, ONE, y).value for y in (ONE, ONE[:, 0]))
        np.testing.assert_array_equal(one, same)


def test_an_angle_is_a_number():
    with pytest.raises(ValueError, match=r"`y` must have the shape \(\)"):
        aslo.replay(aslo.PhaseLockedLoop(50.0), T, TWO, TWO)


@pytest.mark.parametrize(
    ("signal", "message"),
    [
        (TWO + 0j, "`u` must be real, but got complex128"),
        (TWO.tolist(), "`u` must hold arrays, .* `np.asarray`"),
        ([TWO[:, 0], TWO[:, 1]], r"`u` must have the shape \(2,\) .* got a tree"),
    ],
    ids=["complex", "list", "list of columns"],
)
def test_signals_that_are_no_arrays_of_real_numbers(signal, message):
    with pytest.raises(ValueError, match=message):
        aslo.replay(ALGEBRAIC, T, signal, TWO)


def test_complex_signals_in_a_step():
    state = ALGEBRAIC.init(TWO[0])
    with pytest.raises(ValueError, match="`y` must be real"):
        ALGEBRAIC.step(state, TWO[0], TWO[0] + 1j, 1e-3)


ZERO = lambda t: jnp.zeros(2)
# What makes a thing, and what its refusal says.
PARTS = {
    "aslo.AlgebraicObserver(relation, 20.0)": (
        "Argument `filter` must be a filter such as `LowPass(20.0)`, but got 20.0."
    ),
    "aslo.AlgebraicObserver(3.0, law)": (
        "Argument `relation` must be a relation, `relation(u, y)`, but got 3.0."
    ),
    "aslo.AlgebraicObserver(relation, law, law)": (
        "Argument `completion` must be a completion, but got a `LowPass`."
    ),
    "aslo.AlgebraicObserver(relation, law, guard=1e-3)": (
        "Argument `guard` must be a `Guard` or `None`, but got 0.001."
    ),
    "aslo.FO1(relation, 20.0, 1.0)": (
        "Argument `filter` must be a filter such as `LowPass(20.0)`, but got 20.0."
    ),
    "aslo.LowPass([20.0, 30.0])": (
        "Argument `rate` must be a number (rad/s), but got an array of shape (2,); make "
        "one filter for each rate, by `jax.vmap` or in a `FilterBank`."
    ),
    "aslo.replay(own, time, one, two)": (
        "The term `d` of a relation must have the shape () beside a `z` of shape (2,), but "
        "`<lambda>` gives (2,); check the shapes of `u` and `y`."
    ),
    "aslo.replay(own, time, two, one)": (
        "The term `z` of a relation must have the shape (n,) of the state, but `<lambda>` "
        "gives (2, 2); check the shapes of `u` and `y`."
    ),
    "aslo.FilterBank(law)": (
        "Argument `filters` must be a list of filters, but got a `LowPass`."
    ),
    "aslo.FilterBank([law, 3.0])": ("Argument `filters[1]` must be a filter, but got 3.0."),
    "aslo.Asymptotic(law, 3.0)": (
        "Argument `observer` must be an `AlgebraicObserver`, but got a `LowPass`."
    ),
    "aslo.Experiment(motor, zero, {'ASLO': motor}, 1e-4)": (
        "Argument `observers['ASLO']` must be an observer, but got a `PMSM`."
    ),
    "aslo.Experiment(law, zero, {}, 1e-4)": (
        "Argument `plant` must be a plant, but got a `LowPass`."
    ),
    "aslo.Experiment(motor, motor, {}, 1e-4)": (
        "Argument `controller` must be a controller, or a function of time (s) for an open "
        "loop, but got a `PMSM`."
    ),
    "aslo.simulate(motor, zero, {'ASLO': law}, t1=0.1)": (
        "Argument `observers['ASLO']` must be an observer, but got a `LowPass`."
    ),
    "aslo.SideBySide({'a': 1.0})": (
        "Argument `observers['a']` must be an observer, but got 1.0."
    ),
}
REFUSED = """
import json, sys
import jax.numpy as jnp, numpy as np
import aslo_jax as aslo
linear = lambda u, y: aslo.Linear(jnp.array([1.0, 0.5]), y, jnp.stack([u, -u]))
motor = aslo.plants.PMSM.bmp0701f()
names = dict(
    aslo=aslo, motor=motor, relation=motor.flux_relation(), law=aslo.LowPass(30.0),
    zero=lambda t: [0.0, 0.0], time=1e-3 * np.arange(6), one=np.ones(6),
    two=np.ones((6, 2)), own=aslo.AlgebraicObserver(linear, aslo.LowPass(30.0)),
)
found = {}
for text in json.load(sys.stdin):
    try:
        eval(text, names)
    except ValueError as error:
        found[text] = str(error)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def refusals():
    """In a process of its own, as users meet them: here annotations are checked first."""
    run = subprocess.run(
        [sys.executable, "-c", REFUSED],
        input=json.dumps(list(PARTS)),
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(run.stdout)


@pytest.mark.parametrize("text", PARTS)
def test_parts_of_another_kind(text, refusals):
    assert refusals[text] == PARTS[text]


def test_a_function_of_time_is_a_controller():
    run = lambda controller: aslo.Experiment(MOTOR, controller, {}, 1e-4).run(5)
    voltage = lambda t: jnp.stack([1.0 + t, -2.0 * t])
    plain, wrapped = run(voltage), run(aslo.control.OpenLoop(voltage))
    np.testing.assert_array_equal(plain.y, wrapped.y)
    assert np.abs(plain.y[-1]).max() > 1e-2


@pytest.mark.parametrize("metric", [RMSError("A-ASLO"), CoastingFraction("A-ASLO")])
@pytest.mark.parametrize("engine", ["scan", "auto"])
def test_a_metric_of_an_observer_that_is_not_there(metric, engine):
    make = lambda s: aslo.Experiment(MOTOR, ZERO, {"ASLO": ALGEBRAIC}, 1e-4)
    like = jax.ShapeDtypeStruct((), np.float64)
    with pytest.raises(ValueError, match=r"one of \['ASLO'\], .* but got 'A-ASLO'"):
        Runner(make, like, 5, metrics={"m": metric}, engine=engine)


def test_the_state_of_another_observer():
    other = aslo.FO2(MOTOR.flux_relation(), 10.0).init(TWO[0])
    with pytest.raises(ValueError, match=r"must be a state of this observer, .* has"):
        ALGEBRAIC.step(other, TWO[0], TWO[0], 1e-3)
    with pytest.raises(ValueError, match="`state` must be a state of this observer"):
        aslo.replay(ALGEBRAIC, T, TWO, TWO, state=other)


def test_batches_of_filters_are_made_by_vmap():
    """A rate that is mapped over is a number to each."""
    rates = jnp.array([20.0, 30.0])
    decay = jax.vmap(lambda r: aslo.LowPass(r).discretise(0.1).decay)(rates)
    np.testing.assert_allclose(decay, np.exp(-0.1 * rates), rtol=1e-14)
