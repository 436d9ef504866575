"""Samples that are missing: every observer coasts over them and goes on."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM
from test_battery import DT, OBSERVERS, VARIANTS, T, log

import aslo_jax as aslo

MOTOR = PrescribedPMSM(resistance=0.9, inductance=3e-3, magnet_flux=0.05, pole_pairs=4)
RELATION = MOTOR.relation()
BAD = 100
HOLES = {  # rows of u, rows of y
    "an output": ([], [BAD]),
    "an input": ([BAD], []),
    "both": ([BAD], [BAD, BAD + 1]),
    "several": ([], list(range(BAD, BAD + 5))),
    "the first": ([], [0, 1]),
    "every second": ([], list(range(1, 160, 2))),
}
ROWS = 200


def spoilt(u, y, hole, value=np.nan):
    """Signals of which one entry of some rows is not finite, and where a sample lacks one:
    u of an interval belongs to the row at its end."""
    u, y = np.array(u), np.array(y)
    rows = HOLES[hole]
    missing = np.zeros(len(y), bool)
    for signal, bad, later in ((u, rows[0], 1), (y, rows[1], 0)):
        for k in bad:
            signal[(k, *(0,) * (signal.ndim - 1))] = value
            missing[k + later] = True
    return u, y, missing


def each(estimate):
    return jax.tree.leaves(estimate, is_leaf=lambda e: isinstance(e, aslo.Estimate))


@pytest.fixture(
    params=[
        pytest.param(n, marks=pytest.mark.slow if n in VARIANTS else ()) for n in OBSERVERS
    ],
    scope="module",
)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def coasted(name):
    """Runs over every hole at once, and one over none."""
    u, y, _ = (np.asarray(x)[:ROWS] for x in log(name))
    runs = [spoilt(u, y, hole, v) for v in (np.nan, np.inf) for hole in HOLES]
    runs.append((u, y, np.zeros(ROWS, bool)))
    us, ys, missing = (np.stack(x) for x in zip(*runs, strict=True))

    @eqx.filter_jit
    def run(observer, us, ys):
        one = lambda u, y: aslo.replay(observer, T[:ROWS], u, y, missing="coast")
        return jax.vmap(one)(us, ys)

    return run(OBSERVERS[name], us, ys), missing


def test_a_missing_sample_is_flagged_and_never_nan(coasted):
    estimate, missing = coasted
    for e in each(estimate):
        assert np.isfinite(e.value).all() and np.isfinite(e.certificate).all()
        assert e.coasting[missing].all()


def test_nan_and_infinity_are_missing_alike(coasted):
    estimate, _ = coasted
    for e in each(estimate):
        n = len(HOLES)
        np.testing.assert_array_equal(e.value[:n], e.value[n : 2 * n])


def test_the_estimate_is_near_that_without_holes_again(name, coasted):
    estimate, _ = coasted
    for e in each(estimate):
        whole = e.value[-1]
        scale = np.abs(whole).max(axis=0) + 1e-9
        for k, hole in enumerate(HOLES):
            if hole == "every second" or "open loop" in name:
                continue
            late = np.abs(e.value[k, -20:] - whole[-20:]).max(axis=0) / scale
            slow = ("paper", "guess", "Luenberger", "Kalman", "FO", "asymptotic", "phase")
            bound = 0.1 if any(word in name for word in (*slow, "differ")) else 0.03
            bound = 0.2 if name == "bearing" else bound  # 95 rows are 3 time constants
            assert (late < bound).all(), (hole, late)


def test_without_holes_nothing_changes(name, coasted):
    estimate, _ = coasted
    u, y, _ = (x[:ROWS] for x in log(name))
    plain = aslo.replay(OBSERVERS[name], T[:ROWS], u, y)
    for a, b in zip(each(plain), each(estimate), strict=True):
        scale = np.abs(a.value).max()
        np.testing.assert_allclose(b.value[-1], a.value, atol=1e-9 * scale, rtol=1e-9)
        np.testing.assert_array_equal(b.coasting[-1], a.coasting)


def motor_log(rows=400, dt=1e-3, noise=0.0):
    t = jnp.arange(rows) * dt
    row = lambda t: (MOTOR.mean_voltage(t, t + dt), MOTOR.current(t), MOTOR.flux(t))
    u, y, flux = map(np.asarray, jax.vmap(row)(t))
    return np.asarray(t), u, y + noise * np.random.default_rng(4).normal(size=y.shape), flux


def observer(**settings):
    return aslo.AlgebraicObserver(RELATION, aslo.LowPass(25.0), **settings)


@pytest.mark.parametrize("engine", ["scan", "fused"])
@pytest.mark.parametrize("hole", HOLES)
def test_step_is_replay(hole, engine):
    """Also where the state is left amid a hole and taken up again."""
    t, u, y, _ = motor_log(ROWS)
    u, y, _ = spoilt(u, y, hole)
    made = aslo.Asymptotic(observer(guard=aslo.Guard(1e-3)), 30.0)
    whole = aslo.replay(made, t, u, y, missing="coast", engine=engine, substeps=2)
    state, step = made.init(y[0], u[0]), eqx.filter_jit(made.step)
    for k in range(1, ROWS):
        state, now = step(state, u[k - 1], y[k], t[k] - t[k - 1], substeps=2)
        if k > 20:  # before, the rows of least squares are rounding
            np.testing.assert_allclose(now.value, whole.value[k], rtol=1e-9, atol=1e-13)
        assert bool(now.coasting) == bool(whole.coasting[k])
    cut = BAD + 1
    first, state = aslo.replay(
        made, t[:cut], u[:cut], y[:cut], missing="coast", return_state=True, substeps=2
    )
    rest = [x[cut - 1 :] for x in (t, u, y)]
    if hole == "every second":
        return
    # What is left of the log begins with the row that the state was left at.
    second = aslo.replay(
        made, *rest, missing="coast", state=state, engine=engine, substeps=2
    )
    joined = np.concatenate([first.value, second.value[1:]])
    np.testing.assert_allclose(joined[20:], whole.value[20:], rtol=1e-9, atol=1e-13)


def test_uneven_intervals():
    t, *_ = motor_log()
    t = t + 1e-4 * np.sin(np.arange(t.size))
    y = np.asarray(jax.vmap(MOTOR.current)(t))
    u = np.asarray(jax.vmap(MOTOR.mean_voltage)(t, np.append(t[1:], t[-1] + 1e-3)))
    y = np.where((np.arange(t.size) // 3 == 70)[:, None], np.nan, y)
    estimates = [
        aslo.replay(observer(), t, u, y, missing="coast", engine=engine).value
        for engine in ("scan", "fused")
    ]
    np.testing.assert_allclose(*estimates, rtol=1e-9)
    error = np.linalg.norm(estimates[0] - jax.vmap(MOTOR.flux)(t), axis=1) / 0.05
    assert error[150:].max() < 5e-3  # a hole of 0.03 rad


def test_rows_hold_through_a_hole_where_the_derivative_is_known():
    """The velocity of a chain of integrators is known from its force alone: with the exact
    start the rows of every completion hold through a hole, but for the interval at its
    end: its slope, the mean one of the hole and so up to 0.4 m/s off, counts for 1 in 200
    rows and enters by the 8e-3 that the filter moves in a row."""
    dt, rows = 1e-3, 600
    t = np.arange(rows) * dt
    u = (np.sin(3 * (t + dt)) - np.sin(3 * t)) / 3 / dt
    y = 0.1 + 0.4 * t + (1 - np.cos(3 * t)) / 9
    lost = np.where((t >= 0.2) & (t < 0.4), np.nan, y)
    for completion in (aslo.Repeat(), aslo.LeastSquares()):
        made = aslo.AlgebraicObserver(
            aslo.plants.IntegratorChain(2).relation(), aslo.LowPass(8.0), completion
        )
        found = aslo.replay(made, t, u, lost, missing="coast").value
        whole = aslo.replay(made, t, u, y).value
        np.testing.assert_allclose(found[20:], whole[20:], atol=2e-5)


@pytest.mark.parametrize("guard", [None, aslo.Guard(1e-3)])
def test_the_estimate_converges_at_the_rate_of_the_filter(guard):
    """One input that is missing leaves the error of the one held in its place, which decays
    as the filter does, over F[1], to which the hole does no more than 1 %."""
    dt, rate, bad = 1e-3, 8.0, 300
    t = np.arange(700) * dt
    u = np.where(np.arange(700) < bad, 1.0, -1.0)
    velocity = np.concatenate([[0.2], 0.2 + np.cumsum(u * dt)[:-1]])
    y = np.concatenate([[0.0], np.cumsum(velocity * dt + u * dt**2 / 2)[:-1]])
    lost = u.copy()
    lost[bad] = np.nan
    made = aslo.AlgebraicObserver(
        aslo.plants.IntegratorChain(2).relation(),
        aslo.LowPass(rate),
        aslo.Repeat(),
        guard=guard,
    )
    whole = aslo.replay(made, t, u, y).value[:, 0]
    error = aslo.replay(made, t, lost, y, missing="coast").value[:, 0] - whole
    at_once = (u[bad - 1] - u[bad]) * dt
    np.testing.assert_allclose(error[bad + 1], at_once, rtol=0.02)
    after = np.arange(1, 300)
    settled = lambda k: 1.0 - np.exp(-rate * dt * k)
    left = np.exp(-rate * dt * after) * settled(bad + 1) / settled(bad + 1 + after)
    np.testing.assert_allclose(error[bad + 1 + after], error[bad + 1] * left, rtol=0.01)


def test_a_hole_is_no_worse_than_held_samples_under_noise():
    t, u, y, flux = motor_log(1000, noise=0.01)
    held, lost = y.copy(), y.copy()
    for k in range(200, 900, 20):
        held[k : k + 2], lost[k : k + 2] = y[k - 1], np.nan
    rms = lambda e: np.sqrt(np.mean((np.asarray(e.value)[200:] - flux[200:]) ** 2))
    made = observer(guard=aslo.Guard(1e-3))
    coasted = rms(aslo.replay(made, t, u, lost, missing="coast"))
    assert coasted < 1.2 * rms(aslo.replay(made, t, u, held))
    assert coasted < 1.5 * rms(aslo.replay(made, t, u, y))


@pytest.mark.parametrize("hole", ["an output", "an input", "the first"])
def test_gradients_are_finite_both_ways(hole):
    t, u, y, _ = motor_log(160, noise=0.01)  # without it no rate matters
    u, y, _ = spoilt(u, y, hole)

    def loss(rate, y):
        made = aslo.AlgebraicObserver(RELATION, aslo.LowPass(rate))
        value = aslo.replay(aslo.Asymptotic(made, 30.0), t, u, y, missing="coast").value
        return jnp.sum(value[120:] ** 2)

    rate = jnp.asarray(25.0)
    backward, by_y = jax.jit(jax.grad(loss, (0, 1)))(rate, jnp.asarray(y))
    forward = jax.jit(jax.jacfwd(loss))(rate, jnp.asarray(y))
    np.testing.assert_allclose(backward, forward, rtol=1e-8)
    step = 1e-4
    slope = (loss(rate + step, y) - loss(rate - step, y)) / (2 * step)
    np.testing.assert_allclose(forward, slope, rtol=1e-4)
    assert np.isfinite(by_y).all() and (by_y[~np.isfinite(y)] == 0).all()


def test_an_unwrapped_angle_goes_on_after_a_hole():
    t = np.arange(400) * DT
    angle = 0.3 + 25.0 * t
    y = (angle + np.pi) % (2 * np.pi) - np.pi
    lost = np.stack([y], axis=1)
    lost[180:200] = np.nan  # turns by 1.25 rad
    made = aslo.Unwrapped(aslo.HighGain(60.0), (True,))
    found = aslo.replay(made, t, 0 * lost, lost, missing="coast").value[:, 0]
    np.testing.assert_allclose(found[150:], 25.0, rtol=1e-3)


def test_replay_refuses_by_default_and_names_the_row():
    t, u, y, _ = motor_log(50)
    y[17, 1] = np.nan
    with pytest.raises(ValueError, match=r"`y` must be finite, but row 17 holds"):
        aslo.replay(observer(), t, u, y)
    with pytest.raises(ValueError, match="Argument `missing` must be"):
        aslo.replay(observer(), t, u, y, missing="drop")


def test_interpolation_is_linear():
    t, u, y, _ = motor_log(120)
    t = t + 2e-4 * np.sin(np.arange(t.size))
    line = lambda t: np.stack([0.5 + t, 2.0 - 3.0 * t], axis=1)
    y, lost = line(t), line(t)
    lost[[30, 31, 32, 60], [0, 0, 0, 1]] = np.nan
    lost[:2], lost[-3:] = np.inf, np.nan
    ends = y.copy()
    ends[:2], ends[-3:] = y[2], y[-4]
    made = observer()
    expected = aslo.replay(made, t, u, ends).value
    found = aslo.replay(made, t, u, lost, missing="interpolate").value
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    traced = jax.jit(lambda y: aslo.replay(made, t, u, y, missing="interpolate").value)
    np.testing.assert_allclose(traced(lost), expected, rtol=1e-9)
    lost[:, 1] = np.nan
    with pytest.raises(ValueError, match="finite entry in every column"):
        aslo.replay(made, t, u, lost, missing="interpolate")


CHAIN = 20.0 * (np.diag([1.0, 1.0], -1) - np.eye(3))
FILTERS = {
    "low-pass": aslo.LowPass(20.0),
    "second order": aslo.filters.second_order(20.0),
    "three poles": aslo.LinearFilter(CHAIN, [20.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
}


@pytest.mark.parametrize("filter", FILTERS.values(), ids=FILTERS)
@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("rows", [5, 30, 120])
def test_a_long_hole_is_flagged_until_the_filter_has_forgotten_it(rows, both, filter):
    """Over 1 rad without y, or without u and y, the error is of the size of the flux."""
    t, u, y, flux = map(np.array, motor_log(1500))
    lost = slice(400, 400 + rows)
    y[lost] = np.nan
    if both:
        u[lost] = np.nan
    squares = aslo.LeastSquares(forgetting=aslo.LowPass(20.0))
    made = aslo.AlgebraicObserver(RELATION, filter, squares, guard=aslo.Guard(1e-3))
    found = aslo.replay(made, t, u, y, missing="coast", engine="fused")
    error = np.linalg.norm(found.value - flux, axis=1) / np.linalg.norm(flux, axis=1)
    after = np.arange(t.size) >= lost.stop
    trusted = after & ~np.asarray(found.coasting)
    assert error[trusted].max() < 0.2
    assert trusted[-100:].all()
    assert trusted[lost.stop + 1] == (rows == 5)
    if rows == 120:
        assert error[after].max() > 0.5


@pytest.mark.parametrize("lost", ["both", "u", "y"])
def test_a_kalman_filter_takes_nothing_for_known_of_inputs_that_are_held(lost):
    """Over a hole in which the flux turns by up to 5 rad. Its estimate is then known anew
    by what is measured after it; as if inputs were known it would be off by 170 %."""
    t, u, y, flux = map(np.array, motor_log(2400))
    random = np.random.default_rng(11)
    y, u = (x + 0.01 * random.normal(size=x.shape) for x in (y, u))
    made = aslo.ExtendedKalman.of_pmsm(RELATION, 1e-7, 100.0, 1e-7)
    plain = aslo.replay(made, t, u, y)
    for rows in (2, 40, 120):
        hole = slice(1600, 1600 + rows)
        us, ys = u.copy(), y.copy()
        for name, signal in (("u", us), ("y", ys)):
            if lost in (name, "both"):
                signal[hole] = np.nan
        found = aslo.replay(made, t, us, ys, missing="coast")
        error = np.linalg.norm(found.value - flux, axis=1) / np.linalg.norm(flux, axis=1)
        coasting = np.asarray(found.coasting)
        assert coasting[hole.start + 1 : hole.stop].all()
        assert not coasting[hole.stop + 30 :].any()
        trusted = ~coasting
        trusted[: hole.start] = False
        assert error[trusted].max() < 0.15
        np.testing.assert_array_equal(found.coasting[: hole.start], plain.coasting[:1600])
        if lost != "y" and rows == 120:
            assert coasting[hole.stop + 1]
    np.testing.assert_allclose(found.value[:1600], plain.value[:1600], rtol=1e-9)


def test_a_log_goes_on_while_the_last_hole_is_still_doubted():
    """Without a hole of its own, and without a word: flagged as in one piece."""
    t = 1e-3 * np.arange(240)
    y = np.stack([np.cos(9.0 * t), 1.7 * np.sin(9.0 * t)], axis=1)
    u = 3.0 * y + np.array([0.2, -0.1])
    y[20:90] = np.nan
    relation = aslo.plants.FluxRelation(2.3, 0.08)
    filter = aslo.filters.second_order(60.0)
    forgetting = aslo.LeastSquares(aslo.LowPass(50.0))
    observer = aslo.AlgebraicObserver(relation, filter, forgetting)
    whole = aslo.replay(observer, t, u, y, missing="coast")
    cut = 94
    first = slice(cut + 1)
    _, state = aslo.replay(
        observer, t[first], u[first], y[first], missing="coast", return_state=True
    )
    assert np.all(np.asarray(state.gap.weight) == 1.0)
    assert np.all(np.asarray(state.gap.doubt) > 0.0)
    rest = aslo.replay(observer, t[cut:], u[cut:], y[cut:], state=state)
    np.testing.assert_array_equal(rest.coasting, whole.coasting[cut:])
    np.testing.assert_allclose(rest.value, whole.value[cut:], rtol=1e-12)
    assert rest.coasting[1] and not rest.coasting[-1]


@pytest.mark.parametrize("engine", ["scan", "fused"])
@pytest.mark.parametrize("there", [True, False])
def test_a_state_without_a_memory_of_samples_is_as_one_from_init(there, engine):
    """Such as one of continuous time: only the first row tells whether it is missing."""
    t, u, y, _ = motor_log(30)
    made = observer(guard=None)
    state = made.init(y[0], u[0])
    assert state.gap is not None
    y[0] = y[0] if there else np.nan
    bare = aslo.ObserverState(state.states, state.y)
    found, expected = (
        aslo.replay(made, t, u, y, missing="coast", state=each, engine=engine)
        for each in (bare, state)
    )
    assert bool(found.coasting[0]) != there
    assert not found.coasting[1:].any()
    np.testing.assert_array_equal(found.coasting, expected.coasting)
    np.testing.assert_allclose(found.value, expected.value, rtol=1e-12)


def test_a_state_may_be_traced():
    """What is left of a log then goes on as from a concrete one: whether samples are
    missing before it is not known while tracing."""
    t, u, y, _ = motor_log(40)
    u = np.where((np.arange(40) == 19)[:, None], np.nan, u)
    made = observer(guard=None)
    _, state = aslo.replay(made, t[:21], u[:21], y[:21], missing="coast", return_state=True)
    assert state.gap.weight == 0.0
    run = lambda state: aslo.replay(made, t[20:], u[20:], y[20:], state=state)
    found, expected = jax.jit(run)(state), run(state)
    np.testing.assert_allclose(found.value, expected.value, rtol=1e-12)
    np.testing.assert_array_equal(found.coasting, expected.coasting)
