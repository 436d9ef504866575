"""What makes no sense as a value is refused by name: text, vectors in the place of numbers,
states of another observer, first states of another plant, parts in each other's place."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import Bias
from aslo_jax.engines import Runner
from aslo_jax.metrics import Mean, RMSError, SettlingTime

MOTOR = aslo.plants.PMSM(
    resistance=1.7, inductance=6e-3, magnet_flux=0.09, pole_pairs=3, inertia=2e-4
)
RELATION, LAW = MOTOR.flux_relation(), aslo.LowPass(30.0)
FLUX = aslo.AlgebraicObserver(RELATION, LAW, aslo.Repeat())
CHAIN = aslo.plants.IntegratorChain(2)
SPEED = aslo.AlgebraicObserver(CHAIN.relation(), LAW)
T, U, Y = 1e-3 * np.arange(6), np.ones((6, 2)), np.full((6, 2), 0.5)
DRIVE = OpenLoop(lambda t: jnp.stack([jnp.cos(t), jnp.sin(t)]))


@pytest.fixture(autouse=True)
def as_users_meet_them(monkeypatch):
    """Without the checks of annotations, which tests run with."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


def loop(**changes):
    parts = dict(plant=MOTOR, controller=DRIVE, observers={"a": FLUX}, interval=1e-3)
    return aslo.Experiment(**(parts | changes))


def refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.parametrize(
    "value", ["20", True, 1 + 2j, None, {"rate": 2.0}, np.array(["2"]), np.array(1j)]
)
def test_what_is_no_number(value):
    refused(lambda: aslo.LowPass(value), "`rate` must hold real numbers, but got")


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda x: aslo.Guard(x), "threshold"),
        (lambda x: SettlingTime("a", x), "tolerance"),
        (lambda x: RMSError("a", x), "after"),
        (lambda x: aslo.PhaseLockedLoop(x), "bandwidth"),
        (lambda x: loop(interval=x), "interval"),
        (lambda x: aslo.Asymptotic(FLUX, 9.0, initial=x), "initial"),
    ],
)
def test_arrays_of_other_axes(make, name):
    axes = (2, 2) if name == "initial" else (2,)
    refused(lambda: make(np.ones(axes)), rf"`{name}` must be a (number|vector), but got an")
    # A batch is made by a transformation, in which each is a number.
    rates = jax.vmap(lambda rate: aslo.Guard(rate).threshold)(jnp.array([0.1, 0.2]))
    assert rates.shape == (2,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(t=T + 0j), r"`t` must hold instants \(s\), real numbers, but got complex128"),
        (dict(t=T.astype(str)), "`t` must hold instants"),
        (dict(t=np.arange(6).astype("M8[s]")), r"`t` must .* got datetime64\[s\]"),
        (dict(u=U.astype(str)), "`u` must hold real numbers, but got <U"),
        (dict(y=Y.astype(object)), "`y` must hold real numbers, but got object"),
        (dict(y=None), r"`y` must have the shape \(2,\) .* but got None"),
        (dict(max_gap="1"), r"`max_gap` must be a number \(s\), but got '1'"),
        (dict(max_gap=np.nan), "`max_gap` must be positive"),
        (dict(substeps=True), "`substeps` must be an integer of at least 1, but got True"),
        (dict(substeps=10**9), "`substeps` must be at most 1000, but got 1000000000"),
        (dict(state=3), "`state` must be a state of this observer, .* but got 3"),
    ],
)
def test_arguments_of_a_replay(change, message):
    refused(lambda: aslo.replay(**(dict(observer=FLUX, t=T, u=U, y=Y) | change)), message)


@pytest.mark.parametrize("engine", ["scan", "fused"])
@pytest.mark.parametrize(
    ("other", "message"),
    [
        (aslo.AlgebraicObserver(RELATION, aslo.filters.second_order(30.0), aslo.Repeat()),
         r"whose `row.one` has the shape \(\), but it holds"),
        (aslo.AlgebraicObserver(RELATION, LAW, aslo.Repeat(), None), "has no .*guard.mem"),
        (aslo.Asymptotic(FLUX, 9.0), "which has `row.one`, but it holds"),
        (SPEED, "must be a state of this observer"),
    ],
)  # fmt: skip
def test_states_of_other_observers(engine, other, message):
    """Also those that have every name of this one's."""
    if engine == "fused":
        pytest.importorskip("llvmlite")
    y = jnp.asarray(Y[0]) if other is not SPEED else jnp.zeros(())
    state = other.init(y)
    ours = FLUX if "has no" not in message else aslo.AlgebraicObserver(
        RELATION, LAW, aslo.Repeat(), None
    )  # fmt: skip
    state = FLUX.init(y) if ours is not FLUX else state
    refused(lambda: aslo.replay(ours, T, U, Y, state=state, engine=engine), message)
    if other is not SPEED:
        refused(lambda: ours.step(state, U[0], Y[0], 1e-3), message)
    else:
        named = r"`state` .* for a `y` of shape \(2,\), but it holds one of shape \(\)"
        refused(lambda: ours.step(state, U[0], Y[0], 1e-3), named)


def test_intervals_of_a_step():
    state = FLUX.init(Y[0])
    for dt in (np.array([1e-3, 2e-3]), "1e-3", None):
        refused(
            lambda dt=dt: FLUX.step(state, U[0], Y[0], dt), r"`dt` must be a number \(s"
        )


@pytest.mark.parametrize("initial", [np.ones(3), np.ones(1)])
def test_a_guess_of_another_width(initial):
    observer = aslo.Asymptotic(FLUX, 9.0, initial=initial)
    refused(lambda: aslo.replay(observer, T, U, Y), r"`initial` must have the shape \(2,\)")
    refused(lambda: aslo.Asymptotic(FLUX, 9.0, initial=1.0), "`initial` must be a vector")


@pytest.mark.parametrize("place", ["actuator", "sensor", "input_sensor"])
@pytest.mark.parametrize("part", [0.1, Bias, lambda s: s])
def test_what_is_no_disturbance(place, part):
    message = f"`{place}` must be a disturbance, but got"
    refused(lambda: loop(**{place: part}), message)
    call = lambda: aslo.simulate(MOTOR, DRIVE, {"a": FLUX}, t1=0.01, **{place: part})
    refused(call, message)


@pytest.mark.parametrize("initial", [np.ones(3), np.ones(()), (1.0, 2.0)])
def test_a_first_state_of_another_plant(initial):
    push, message = (
        (lambda t: jnp.cos(t)),
        r"`initial` must be a state of the `Integ.* \(2,\)",
    )
    experiment = aslo.Experiment(CHAIN, push, {"a": SPEED}, 1e-3, initial=initial)
    refused(lambda: experiment.run(2), message)
    call = lambda: aslo.simulate(CHAIN, push, {"a": SPEED}, t1=0.01, initial=initial)
    refused(call, message)


def test_classes_and_numbers_in_the_place_of_parts():
    refused(lambda: loop(controller=OpenLoop), "`controller` must be a controller")
    refused(lambda: loop(observers={1: FLUX}), "`observers` must be observers by name")
    refused(lambda: loop().run(True), "`steps` must be a whole number, but got True")
    refused(lambda: loop().run(2.0), "`steps` must be a whole number")
    simulate = lambda **more: aslo.simulate(MOTOR, DRIVE, {"a": FLUX}, **more)
    refused(lambda: simulate(t1="1"), r"`t1` must be a number \(s\)")
    refused(lambda: simulate(t1=0.01, dt0="1"), r"`dt0` must be a number \(s\)")
    refused(
        lambda: simulate(t1=0.01, solver=aslo.RungeKutta4), "`solver` must be a solver of"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(metrics=RMSError("a")), "`metrics` must be metrics by name, a dictionary"),
        (dict(metrics=[RMSError("a")]), "`metrics` must be metrics by name, a dictionary"),
        (dict(record=3), "`record` must be a function, but got 3"),
        (dict(make=loop()), "`make` must be a function from a sample to an experiment"),
    ],
)
def test_arguments_of_a_batch(change, message):
    arguments = dict(make=lambda rate: loop(), like=1.0, steps=2, engine="scan")
    refused(lambda: Runner(**(arguments | change)), message)


def test_arguments_of_metrics():
    refused(lambda: RMSError(3), "`observer` must be the name of an observer")
    refused(lambda: Mean(3.0), "`function` must be a function, but got 3.0")
