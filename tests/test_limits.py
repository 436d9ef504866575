"""The figures of docs/limits.md, to twice their value."""

import resource

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from benchmarks import soak

L, M = 4e-3, 0.09
X, W = np.polynomial.legendre.leggauss(8)


def motor(interval, turn, dtype=np.float64, rows=4000):
    """A record of a motor that turns by `turn` rad a sample, whose resistance is such that
    voltages only scale with the interval."""
    R, speed = 1.3e-4 / interval, turn / interval
    angle = lambda t: speed * t + 0.3 * np.sin(0.11 * speed * t)
    circle = lambda a: np.stack([np.cos(a), np.sin(a)], axis=-1)
    current = lambda t: (3.0 + np.sin(0.07 * speed * t))[:, None] * circle(angle(t) + 1.9)
    flux = lambda t: M * circle(angle(t)) + L * current(t)
    t = interval * np.arange(rows + 1)
    middles = t[:-1] + 0.5 * interval
    mean = sum(
        0.5 * w * current(middles + 0.5 * interval * x) for x, w in zip(X, W, strict=True)
    )
    u = R * mean + np.diff(flux(t), axis=0) / interval
    t = t[:-1]
    return R, t.astype(dtype), u.astype(dtype), current(t).astype(dtype), flux(t)


def replayed(interval, turn, rate, completion, dtype, substeps=1):
    """The error over the magnet's flux of the second half, and the estimate there; `rate`:
    times the interval."""
    R, t, u, y, flux = motor(interval, turn, dtype)
    observer = aslo.AlgebraicObserver(
        aslo.plants.PMSM(R, L, M, 3, 1e-3).flux_relation(),
        aslo.LowPass(rate / interval),
        completion,
    )
    observer = jax.tree.map(
        lambda x: jnp.asarray(x, dtype) if eqx.is_array(x) else x, observer
    )
    found = aslo.replay(observer, t, u, y, substeps=substeps)
    assert found.value.dtype == dtype
    error = np.linalg.norm(np.asarray(found.value, float) - flux, axis=1) / M
    late = slice(t.size // 2, None)
    return error[late], jax.tree.map(lambda x: np.asarray(x)[late], found)


def guarded(interval, turn, rate, completion, dtype):
    error, found = replayed(interval, turn, rate, completion, dtype)
    return error, found.coasting


def error_and_certificate(interval, turn, rate, dtype=np.float64, substeps=1):
    """The largest error, and the certificate."""
    error, found = replayed(interval, turn, rate, aslo.LeastSquares(), dtype, substeps)
    return error.max(), float(np.median(found.certificate))


@pytest.mark.parametrize(
    ("turn", "rate", "error", "certificate"),
    [
        (0.01, 0.006, 5e-6, 0.57),
        (0.1, 0.06, 5e-5, 0.62),
        (0.3, 0.18, 1.5e-4, 0.64),
        (1.0, 0.6, 5e-4, 0.68),
        (0.03, 1e-9, 1.5e-5, 0.84),
        (0.03, 1e-3, 1.5e-5, 0.84),
        (0.03, 0.01, 1.5e-5, 0.75),
        (0.03, 0.1, 1.5e-5, 0.07),
        (0.03, 0.5, 1.5e-5, 4.5e-4),
        (0.03, 2.0, 1.5e-5, 3.7e-6),
        (0.03, 50.0, 1.5e-5, 3e-10),
    ],
)
def test_errors_of_sampling(turn, rate, error, certificate):
    found, sure = error_and_certificate(1e-4, turn, rate)
    assert 0.5 * error < found < 2.0 * error
    assert 0.5 * certificate < sure < 2.0 * certificate
    # That of R i as a line between samples: its curvature, a twelfth of what it moves.
    assert found < 1.1 * turn / 12 * 1.3e-4 * 4.0 / M


def test_substeps_add_what_the_line_of_y_is_wrong_by():
    found, _ = error_and_certificate(1e-4, 0.03, 0.5, substeps=4)
    assert 0.5 * 1.5e-4 < found < 2.0 * 1.5e-4


@pytest.mark.parametrize("completion", [aslo.LeastSquares(), aslo.Repeat()])
def test_the_certificate_is_that_of_every_frame(completion):
    """Turned axes change nothing. A current along one axis at standstill, with noise on the
    other, is no signal, though that axis holds nothing larger than its noise."""
    rng = np.random.default_rng(0)
    R, L, rows = 1.3, 4e-3, 3000
    t = 1e-4 * np.arange(rows)
    y = np.stack([2.0 + 0.5 * np.sin(300.0 * t), 1e-4 * rng.standard_normal(rows)], axis=1)
    u = R * y + np.gradient(L * y, t, axis=0)
    observer = aslo.AlgebraicObserver(
        aslo.plants.FluxRelation(R, L), aslo.LowPass(100.0), completion
    )
    seen = []
    for angle in (0.0, 0.3, 1.1):
        c, s = np.cos(angle), np.sin(angle)
        turned = np.array([[c, s], [-s, c]])
        seen.append(aslo.replay(observer, t, u @ turned, y @ turned).certificate[100:])
    np.testing.assert_allclose(seen[0], seen[1], rtol=1e-6)
    np.testing.assert_allclose(seen[0], seen[2], rtol=1e-6)
    assert np.max(seen[0]) < 1e-4


@pytest.mark.parametrize("completion", [aslo.LeastSquares(), aslo.Repeat()])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_whatever_is_certified_is_right(completion, dtype):
    """By the guard as it comes, however a rate, a speed and an interval are chosen."""
    seen = 0
    for rate in (1e-9, 1e-6, 1e-3, 0.03, 0.5, 2.0, 50.0):
        for turn, interval in ((1e-3, 1e-9), (0.03, 10.0), (1.0, 1e-4)):
            error, coasts = guarded(interval, turn, rate, completion, dtype)
            assert error[~coasts].max(initial=0.0) < 0.02
            seen += (~coasts).mean() > 0.9
    assert seen >= (14 if dtype == np.float64 else 8)


@pytest.mark.parametrize("interval", [1e-9, 1e-3, 10.0])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_only_products_with_the_interval_count(interval, dtype):
    found = error_and_certificate(interval, 0.03, 0.02, dtype)
    expected = error_and_certificate(1e-4, 0.03, 0.02)
    assert found == pytest.approx(expected, rel=1e-6 if dtype == np.float64 else 0.05)


@pytest.mark.parametrize("turn", [1e-4, 1e-3, 0.01, 0.1])
def test_single_beside_double_precision(turn):
    rate = max(turn, 1e-3) / 1.7
    double, sure = error_and_certificate(1e-4, turn, rate)
    single, _ = error_and_certificate(1e-4, turn, rate, np.float32)
    assert sure < 1e-3 or abs(single - double) < 1e-4
    assert abs(single - double) < 5e-3


@pytest.mark.parametrize(
    ("dtype", "offset", "error"),
    [
        (np.float64, 0.0, 1e-10),
        (np.float64, 1e3, 2e-10),
        (np.float64, 1e6, 6e-7),
        (np.float32, 0.0, 0.02),
        (np.float32, 1e3, 0.6),
    ],
)
def test_angles_far_from_zero(dtype, offset, error):
    t = 1e-4 * np.arange(20_001)
    angle = (offset + 50.0 * t).astype(dtype)
    loop = aslo.observers.PhaseLockedLoop(jnp.asarray(100.0, dtype))
    found = aslo.replay(loop, t.astype(dtype), np.zeros_like(angle), angle)
    speed = np.asarray(found.value)[-5000:, 1]
    assert np.abs(speed - 50.0).max() < 2.0 * error
    assert not np.asarray(found.coasting)[-5000:].any()


def test_it_recovers_again_and_again():
    """Half a second of motion and half a second at rest, six times over: each time it is
    flagged at rest and right within the same time."""
    R, interval, rows = 1.3, 1e-3, 6000
    t = interval * np.arange(rows + 1)
    moves = (t % 1.0) < 0.5
    speed = np.where(moves, 80.0 * np.sin(2.0 * np.pi * (t % 1.0)) ** 2, 0.0)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * interval * (speed[1:] + speed[:-1]))])
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    y = 2.0 * circle[:, ::-1] * [-1.0, 1.0]
    flux = M * circle + L * y
    u = R * 0.5 * (y[1:] + y[:-1]) + np.diff(flux, axis=0) / interval
    observer = aslo.AlgebraicObserver(
        aslo.plants.PMSM(R, L, M, 3, 1e-3).flux_relation(),
        aslo.LowPass(30.0),
        aslo.LeastSquares(),
        guard=aslo.Guard(1e-3),
    )
    found = aslo.replay(observer, t[:-1], u, y[:-1])
    error = np.linalg.norm(np.asarray(found.value) - flux[:-1], axis=1).reshape(6, 1000) / M
    coasts = np.asarray(found.coasting).reshape(6, 1000)
    assert coasts[:, 900:].all()  # at rest for 0.4 s
    assert not coasts[:, 300:500].any()
    assert error[:, 300:500].max() < 5e-3
    assert error[1:, 900:].max() < 5e-3  # what it knew, held
    trusted = np.where(coasts, 0.0, error)
    assert trusted[1:].max() < 0.05


@pytest.mark.parametrize(
    ("times", "error", "samples"),
    [(1.0, 3e-3, 0), (3.0, 8e-3, 0), (10.0, 0.047, 94), (100.0, 5.4, 720), (1e12, 0.0, 0)],
)
def test_one_sample_that_is_wrong(times, error, samples):
    """The worst error that is not flagged, and how many samples are off by more than 2 %;
    a gate flags the one sample, and nothing is off."""
    R, t, u, y, flux = motor(1e-4, 0.03)
    y = y + 0.01 * np.random.default_rng(3).standard_normal(y.shape)
    y[2000, 0] += 3.0 * times
    plain = aslo.AlgebraicObserver(
        aslo.plants.PMSM(R, L, M, 3, 1e-3).flux_relation(),
        aslo.LowPass(100.0),
        guard=aslo.Guard(1e-3),
    )

    def after(observer):
        found = aslo.replay(observer, t, u, y)
        off = np.linalg.norm(np.asarray(found.value) - flux, axis=1) / M
        coasts = np.asarray(found.coasting)[2000:]
        return np.where(coasts, 0.0, off[2000:]), coasts

    off, _ = after(plain)
    assert 0.5 * error <= off.max() <= 2.0 * error
    assert 0.5 * samples <= (off > 0.02).sum() <= 2.0 * samples
    off, coasts = after(aslo.Gated(plain))
    assert off.max() < 2.0 * 3e-4
    assert np.flatnonzero(coasts).tolist() == [0]


@pytest.mark.slow
@pytest.mark.parametrize("dtype", soak.DRIFT)
@pytest.mark.parametrize("name", soak.OBSERVERS)
def test_a_hundred_thousand_steps_more_change_nothing(name, dtype):
    """`python -m benchmarks soak` takes ten million."""
    found = soak.soak(name, dtype, "scan", 300_000)
    assert not soak.faults(name, found, dtype)


@pytest.mark.slow
def test_single_steps_change_nothing():
    found = soak.soak("ASLO", "float32", "calls", 50_000, first=2)
    assert not soak.faults("ASLO", found, "float32")


@pytest.mark.slow
def test_ten_million_steps_take_no_memory_and_no_second_compilation():
    R, turns, rows = 1.3, 2.0 * np.pi / 200, 200  # a record that repeats
    angle = turns * np.arange(rows + 1)
    circle = lambda a: np.stack([np.cos(a), np.sin(a)], axis=-1)
    current = lambda a: 3.0 * circle(a + 1.9)
    flux = M * circle(angle) + L * current(angle)
    between = angle[:-1, None] + 0.5 * turns * (1.0 + X)
    mean = np.einsum("k,nkc->nc", 0.5 * W, current(between))
    u = jnp.asarray(R * mean + np.diff(flux, axis=0) / 1e-4)
    y, count = jnp.asarray(current(angle)), 0
    observer = aslo.AlgebraicObserver(
        aslo.plants.PMSM(R, L, M, 3, 1e-3).flux_relation(),
        aslo.LowPass(100.0),
        aslo.LeastSquares(),
    )

    @jax.jit
    def many(state):
        nonlocal count
        count += 1

        def one(state, k):
            state, _ = observer.step(state, u[k % rows], y[(k + 1) % rows], 1e-4)
            return state, None

        state, _ = jax.lax.scan(one, state, jnp.arange(10_000))
        return state, observer.step(state, u[0], y[1], 1e-4)[1].value

    state = observer.init(y[0], u[0])
    after_ten = None
    for k in range(1000):
        state, value = many(state)
        if k == 9:
            after_ten = np.asarray(value)
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert count == 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < memory + 20_000  # kB
    np.testing.assert_allclose(value, after_ten, rtol=1e-12, atol=1e-14)
    assert np.linalg.norm(np.asarray(value) - flux[1]) < 1e-3 * M
