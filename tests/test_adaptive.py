"""The Kalman filter with unknown parameters: a plain NumPy loop, the lifted filter where
they are known, motors whose parameters are wrong, records that do not tell them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo

R, L, M = 1.3, 7.1e-3, 0.093  # ohm, H, Wb
CURRENT, VOLTAGE, H = 15e-3, 0.08, 2e-4  # A, V, s
WRONG = [(0.0, 0.0), (0.2, 0.03), (-0.2, 0.03), (0.2, -0.03), (-0.2, -0.03)]


def turning(t):
    """Speed and torque current of a motor that turns slowly under a load that swings."""
    return 30.0 + 12.0 * np.sin(4.0 * t), 1.5 + 0.7 * np.sin(9.0 * t)


def kicked(t):
    """A burst of current and of speed, of which the parameters are told."""
    since = np.clip(t - 0.05, 0.0, None)
    burst = np.exp(-since / 15e-3) - np.exp(-since / 4e-3)
    return turning(t)[0] + 900.0 * burst, 0.2 + 10.0 * burst


def steady(t):
    return 60.0 + 0.0 * t, 0.9 + 0.0 * t


def record(motion, seconds, seed):
    """t, u and y with noise, and the flux; electrical speed, currents linear in between."""
    rng = np.random.default_rng(seed)
    t = 0.5 * H * np.arange(2 * round(seconds / H) + 1)
    w, q = motion(t)
    angle = rng.uniform(0, 2 * np.pi)
    angle = angle + np.append(0.0, np.cumsum(0.25 * H * (w[1:] + w[:-1])))
    d_axis = np.stack([np.cos(angle), np.sin(angle)], 1)
    q_axis = np.stack([-np.sin(angle), np.cos(angle)], 1)
    y = q[:, None] * q_axis - 0.2 * d_axis
    flux = (L * y + M * d_axis)[::2]
    u = np.diff(flux, axis=0) / H + R / 6 * (y[:-2:2] + 4 * y[1::2] + y[2::2])
    u, y = np.append(u, u[-1:], axis=0), y[::2]
    u = u + VOLTAGE * rng.standard_normal(u.shape)
    return t[::2], u, y + CURRENT * rng.standard_normal(y.shape), flux


def observer(wrong=(0.0, 0.0), **settings):
    relation = aslo.plants.FluxRelation(R * (1 + wrong[0]), L, M * (1 + wrong[1]))
    return aslo.Adaptive(relation, CURRENT, VOLTAGE, **settings)


@eqx.filter_jit
@eqx.filter_vmap(in_axes=(0, None, 0, 0))
def replayed(wrong, t, u, y):
    return aslo.replay(observer(wrong), t, u, y)


def many(motion, seconds, seeds):
    """Every wrong parameter with each of its own seeds."""
    wrong = jnp.repeat(jnp.asarray(WRONG), seeds, axis=0)
    logs = [record(motion, seconds, k) for k in range(len(wrong))]
    t, u, y, flux = (np.stack(x) for x in zip(*logs, strict=True))
    return replayed(wrong, t[0], u, y), flux


def flux_claims(found, flux, of):
    """The squared error in units of the covariance, over the size of x."""
    e, P = (found.value - flux)[:, of], found.covariance[:, of]
    return float(jnp.mean(jnp.sum(e * jnp.linalg.solve(P, e[..., None])[..., 0], -1)) / 2)


@pytest.fixture(scope="module")
def varied():
    return many(turning, 2.0, 2)


@pytest.fixture(scope="module")
def constant():
    return many(steady, 2.0, 2)


def test_it_finds_the_parameters_and_knows_how_well(varied):
    found, flux = varied
    assert not found.coasting[:, -1].any() and not found.held[:, -1].any()
    truth = np.array([R, M])
    P = jnp.diagonal(found.parameter_covariance[:, -1], axis1=1, axis2=2)
    off = (found.parameters[:, -1] - truth) / jnp.sqrt(P)
    assert jnp.abs(off).max() < 4.5 and jnp.mean(off**2) < 2.5
    assert jnp.all(jnp.sqrt(P) < np.array([5e-3, 2e-3]) * truth)
    assert 0.5 < flux_claims(found, flux, slice(5000, None, 20)) < 2.0


@pytest.mark.slow
def test_what_a_transient_tells_is_claimed_as_it_is():
    """Where the current changes faster than it is smoothed for the slopes: slopes that lag
    tell what the samples do not, by 20 times in the squared errors of the parameters."""
    found, flux = many(kicked, 0.24, 8)
    late = slice(900, None, 20)
    assert not found.coasting[:, late].any()
    P = jnp.diagonal(found.parameter_covariance[:, -1], axis1=1, axis2=2)
    off = (found.parameters[:, -1] - np.array([R, M])) / jnp.sqrt(P)
    assert jnp.all(jnp.sqrt(P).mean(0) < np.array([0.03, 0.005]) * np.array([R, M]))
    claims = jnp.mean(off**2, axis=0)
    assert jnp.all((claims > 0.5) & (claims < 1.6))  # 40 runs: 1 +- 0.22
    assert 0.7 < flux_claims(found, flux, late) < 1.4


def test_nothing_is_claimed_before_it_is_known(varied, constant):
    for found, flux in (varied, constant):
        assert found.coasting[:, 0].all() and jnp.all(found.certificate[:, 0] == 0)
        error = jnp.linalg.norm(found.value - flux, axis=-1)
        claimed = jnp.sqrt(jnp.trace(found.covariance, axis1=2, axis2=3))
        wrong = ~found.coasting & (error > 5 * claimed)
        assert wrong[:, 500:].mean() < 1e-3


def test_at_constant_speed_the_resistance_is_not_believed(constant):
    found, _ = constant
    known = jnp.sqrt(found.parameter_covariance[:, -1, 0, 0]) / R
    assert jnp.all((known > 0.03) | found.coasting[:, -1])
    assert jnp.all(found.held[:, -1] | found.coasting[:, -1])
    off = jnp.abs(found.parameters[:, -1] / np.array([R, M]) - 1.0)
    assert off[:, 1].max() < 0.06


def braked(t):
    """A motor that turns and stops, with 0.9 A."""
    return 60.0 * np.clip((0.7 - t) / 0.2, 0.0, 1.0), 0.9 + 0.5 * np.exp(-t / 0.05)


def test_it_is_flagged_once_it_is_not_known_to_the_tolerance():
    """At rest what is not known grows."""
    t, u, y, _ = record(braked, 1.3, 4)
    found = aslo.replay(observer(bank=5, tolerance=0.02), t, u, y)
    # The deviation of the flux of the magnet, over what it is.
    claimed = np.sqrt(np.trace(found.covariance, axis1=1, axis2=2))
    size = np.linalg.norm(found.value - L * y, axis=1)
    turning, rest = slice(1500, 2500), slice(3500, None)
    assert not found.coasting[turning].any()
    np.testing.assert_array_equal(found.coasting[rest], (claimed > 0.02 * size)[rest])
    assert not found.coasting[rest][0] and found.coasting[-1]


def plain(mean, P, smooth, ahead, angle, u, y0, y1, h):
    """One filter over one sample, with the geometry of a magnet by hand: the radius of
    `x - L y` is the magnet flux. The state is x and the relative errors of R and m; the
    current in slopes turns on as the magnet has turned before."""
    x, r, m = mean[:2], R * (1 + mean[2]), M * (1 + mean[3])
    x = x + h * (u - 0.5 * r * (y0 + y1))
    F = np.eye(4)
    F[:2, 2] = -h * R * ahead
    P = F @ P @ F.T
    half = -0.5 * h * r * CURRENT
    P[:2, :2] += ((h * VOLTAGE) ** 2 + half**2) * np.eye(2)
    along = x - L * ahead
    after = np.arctan2(*-along[::-1])
    along = along / np.linalg.norm(along)
    noise = L * CURRENT
    slope = np.array([*along, 0.0, -M]) / noise
    q = x - L * y1
    bent = (np.eye(2) - np.outer(along, along)) @ P[:2, :2] / (noise * m)
    surprise = (np.linalg.norm(q) - m) / noise - 0.5 * noise / m
    surprise -= 0.5 * np.trace(bent)
    Pa = P @ slope - half * np.array([*along, 0.0, 0.0])
    S = slope @ P @ slope - 2 * half * slope[:2] @ along + 1 + 0.5 * np.trace(bent @ bent)
    K = Pa / S
    told = half * slope[:2] - along
    mean = np.array([*x, *mean[2:]]) - K * surprise
    mean[:2] -= half * told * surprise / S
    # After the sample, with the part of its noise that the next interval will have.
    W = np.vstack([np.eye(2), np.zeros((2, 2))]) * half
    cross = W @ (W - np.outer(K, told)).T
    P = P - S * np.outer(K, K) + cross + cross.T
    P = P + W @ (np.eye(2) - np.outer(told, told) / S) @ W.T
    c, s = np.cos(after - angle), np.sin(after - angle)
    turn = np.array([[c, -s], [s, c]])
    smooth = turn @ smooth
    away = np.mean(((y1 - smooth) / CURRENT) ** 2)
    smooth = smooth + max(50.0 * h, 1 - 8 / away) * (y1 - smooth)
    return mean, P, smooth, turn @ smooth, after


def test_one_filter_equals_a_plain_loop():
    t, u, y, _ = record(turning, 1.4, 3)
    found, state = aslo.replay(observer(), t, u, y, return_state=True)
    _, middle = aslo.replay(observer(), t[:-400], u[:-400], y[:-400], return_state=True)
    belief = middle.states["belief"]
    assert belief.merged and not belief.held
    one = jax.tree.map(np.asarray, belief.one)
    angle = np.arctan2(*one.direction[::-1])
    now = [one.mean, one.covariance, one.smooth, one.ahead, angle]
    for k in range(t.size - 400, t.size):
        now = plain(*now, u[k - 1], y[k - 1], y[k], H)
    last = state.states["belief"].one
    # The distance is that of a circle to the third order.
    np.testing.assert_allclose(last.mean[:2], now[0][:2], rtol=0, atol=5e-9 * M)
    np.testing.assert_allclose(last.mean[2:], now[0][2:], rtol=0, atol=1e-7)
    scale = np.sqrt(np.diag(now[1]))
    scaled = np.asarray(last.covariance) / np.outer(scale, scale)
    np.testing.assert_allclose(scaled, now[1] / np.outer(scale, scale), atol=1e-7)
    np.testing.assert_allclose(found.value[-1], now[0][:2], rtol=0, atol=5e-9 * M)
    np.testing.assert_allclose(found.parameters[-1], [R, M] * (1 + now[0][2:]), rtol=1e-7)
    deviations = np.sqrt(np.diag(found.parameter_covariance[-1])) / [R, M]
    np.testing.assert_allclose(deviations, scale[2:], rtol=1e-6)


def test_with_known_parameters_it_is_as_good_as_the_lifted_filter():
    t, u, y, flux = record(turning, 1.4, 3)
    ours = aslo.replay(observer(deviations=(1e-5, 1e-5)), t, u, y)
    lifted = aslo.Lifted(aslo.plants.FluxRelation(R, L, M), CURRENT, VOLTAGE)
    theirs = aslo.replay(lifted, t, u, y)
    late = slice(4000, None)
    size = lambda e: float(np.sqrt(np.mean(np.sum(np.square(e[late]), axis=1))))
    assert size(ours.value - theirs.value) < 0.5 * size(theirs.value - flux)
    assert size(ours.value - flux) < 1.15 * size(theirs.value - flux)
    claim = lambda e: jnp.trace(e.covariance[late], axis1=1, axis2=2).mean()
    assert claim(ours) < 1.1 * claim(theirs)


@pytest.mark.slow
def test_steps_are_a_replay_and_samples_may_be_missing():
    t, u, y, _ = record(turning, 0.4, 5)
    ours = observer(bank=5)
    whole = aslo.replay(ours, t, u, y)
    _, state = aslo.replay(ours, t[:1000], u[:1000], y[:1000], return_state=True)
    rest = aslo.replay(ours, t[999:], u[999:], y[999:], state=state)
    np.testing.assert_allclose(rest.value[1:], whole.value[1000:], atol=1e-12)
    step = eqx.filter_jit(lambda s, u, y: ours.step(s, u, y, H))
    for k in range(1000, 1005):
        state, estimate = step(state, jnp.asarray(u[k - 1]), jnp.asarray(y[k]))
        np.testing.assert_allclose(estimate.value, whole.value[k], atol=1e-12)
        np.testing.assert_allclose(estimate.parameters, whole.parameters[k], rtol=1e-9)
    before = estimate
    for k in range(1005, 1025):
        state, estimate = step(state, jnp.asarray(u[k - 1]), jnp.full(2, jnp.nan))
        assert estimate.coasting
    np.testing.assert_array_equal(estimate.parameters, before.parameters)
    assert jnp.trace(estimate.covariance) > jnp.trace(before.covariance)
    state, estimate = step(state, jnp.asarray(u[1024]), jnp.asarray(y[1025]))
    assert jnp.linalg.norm(estimate.value - whole.value[1025]) < 0.02 * M


@pytest.mark.slow
def test_the_fused_engine_does_the_same():
    pytest.importorskip("llvmlite")
    t, u, y, _ = record(turning, 1.3, 6)
    ours = observer((0.05, 0.01), bank=3, deviations=(0.04, 0.02))
    scan, fused = (aslo.replay(ours, t, u, y, engine=e) for e in ("scan", "fused"))
    assert not scan.coasting[-1]
    np.testing.assert_array_equal(scan.coasting, fused.coasting)
    np.testing.assert_allclose(fused.value, scan.value, rtol=0, atol=1e-9 * M)
    np.testing.assert_allclose(fused.parameters, scan.parameters, rtol=1e-8)


@pytest.mark.slow
def test_single_precision_stays_single_and_close():
    t, u, y, _ = record(turning, 1.2, 9)
    single = lambda tree: jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), tree)
    double = aslo.replay(observer(bank=5), t, u, y)
    found = aslo.replay(single(observer(bank=5)), jnp.asarray(t), single(u), single(y))
    assert all(x.dtype in (jnp.float32, bool) for x in jax.tree.leaves(found))
    assert not found.coasting[-1]
    np.testing.assert_allclose(found.value[-1], double.value[-1], atol=2e-3 * M)
    np.testing.assert_allclose(found.parameters[-1], double.parameters[-1], rtol=2e-3)


def test_a_drift_keeps_a_parameter_open():
    t, u, y, _ = record(turning, 1.3, 7)
    claims = []
    for drift in (0.0, 0.05):
        found = aslo.replay(observer(drift=drift, bank=5), t, u, y)
        claims.append(float(found.parameter_covariance[-1, 0, 0]) ** 0.5 / R)
    assert claims[1] > 2 * claims[0] and claims[1] < 0.05


@pytest.mark.slow
def test_what_it_finds_is_differentiable():
    t, u, y, _ = record(steady, 0.1, 8)

    def at_the_end(s):
        relation = aslo.plants.FluxRelation(R, L, M)
        found = aslo.Adaptive(relation, s, VOLTAGE, bank=3, tolerance=0.1)
        estimate = aslo.replay(found, t, u, y)
        return jnp.append(estimate.value[-1], estimate.parameters[-1]), estimate.coasting[
            -1
        ]

    of = jax.jit(lambda s: jax.jvp(at_the_end, (s,), (jnp.ones(()),)))
    # Between the instants at which a start would change.
    (_, coasting), (slope, _) = of(jnp.asarray(CURRENT))
    step = 1e-6 * CURRENT
    (up, _), _ = of(jnp.asarray(CURRENT + step))
    (down, _), _ = of(jnp.asarray(CURRENT - step))
    assert not coasting and jnp.abs(slope).min() > 0
    np.testing.assert_allclose(slope, (up - down) / (2 * step), rtol=1e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"parameters": ("resistence", "magnet_flux")}, "`resistence` is none of FluxRel"),
        ({"parameters": ("resistance", "resistance")}, "each once"),
        ({"deviations": (0.1,)}, "must be one for each"),
        ({"deviations": (0.4, 0.02)}, "must be below 0.333"),
        ({"deviations": (0.1, -0.02)}, "`deviations` must be positive"),
        ({"bank": 2}, "`bank` must be an integer of at least 3"),
        ({"hold": 0.0}, "`hold` must be positive"),
        ({"tolerance": 0.0}, "`tolerance` must be positive"),
    ],
)
def test_what_it_refuses(settings, message):
    with pytest.raises(ValueError, match=message):
        observer(**settings)


def test_what_relations_it_refuses():
    chain = aslo.plants.IntegratorChain(2).relation()
    with pytest.raises(ValueError, match=r"must name numbers that the relation has"):
        aslo.Adaptive(chain, 1e-3, 1e-2)
    with pytest.raises(ValueError, match="`magnet_flux` is; give it"):
        aslo.Adaptive(aslo.plants.FluxRelation(R, L), CURRENT, VOLTAGE)
    ours, y = observer(), jnp.zeros(2)
    with pytest.raises(ValueError, match="is an observer of samples"):
        ours.vector_field(jnp.zeros(()), None, y, y)

    class Known(eqx.Module):
        gain: float = 2.0

        def __call__(self, u, y):
            return aslo.Linear(c=jnp.ones(1), d=self.gain * y, z=jnp.ones(1) * u)

    known = aslo.Adaptive(Known(), 1e-3, 1e-2, ("gain",), (0.1,))
    with pytest.raises(ValueError, match="must return one `Quadratic` row"):
        known.init(jnp.zeros(()))


@pytest.mark.slow
def test_its_covariance_is_that_of_its_error_over_many_seeds():
    found, flux = many(turning, 2.0, 40)
    assert not found.coasting[:, -1].any()
    late = slice(5000, None, 50)
    assert 0.7 < flux_claims(found, flux, late) < 1.4
    P = jnp.diagonal(found.parameter_covariance[:, -1], axis1=1, axis2=2)
    off = (found.parameters[:, -1] - np.array([R, M])) / jnp.sqrt(P)
    assert jnp.all((jnp.mean(off**2, axis=0) > 0.7) & (jnp.mean(off**2, axis=0) < 1.4))


@pytest.mark.parametrize("rows", [40, 900])
def test_after_a_hole_its_deviations_hold_where_it_is_not_flagged(rows):
    """A twentieth of a turn and more than one; it starts again, and comes back."""
    t, u, y, flux = record(turning, 1.8, 11)
    first = round(1.3 / H)
    u, y = u.copy(), y.copy()
    u[first : first + rows] = y[first : first + rows] = np.nan
    found = aslo.replay(observer(bank=5), t, u, y, missing="coast")
    after = slice(first + rows, None)
    trusted = ~np.asarray(found.coasting)[after]
    assert np.asarray(found.coasting)[first + 1 : first + rows].all()
    assert trusted[-200:].all()
    error = (np.asarray(found.value) - flux)[after][trusted]
    claim = np.trace(found.covariance, axis1=1, axis2=2)[after][trusted]
    assert np.max(np.sum(error**2, axis=1) / claim) < 16.0
