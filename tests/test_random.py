"""Counter-based numbers: the right bits, the right law, and independence of the order."""

import jax
import jax.extend.random
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import aslo_jax as aslo

random = aslo.random
KEY = random.key(2**40 + 12345)


def test_bits_equal_threefry():
    counters = jnp.arange(40, dtype=jnp.uint32).reshape(2, 20) * np.uint32(2654435761)
    ours = jnp.stack(random.threefry(KEY, counters[0], counters[1]))
    theirs = jax.extend.random.threefry_2x32(KEY, counters.reshape(-1))
    np.testing.assert_array_equal(ours.reshape(-1), theirs)
    # Random123's known-answer test: key and counter zero, and all ones.
    zero, ones = jnp.uint32(0), jnp.uint32(0xFFFFFFFF)
    answers = [(zero, (0x6B200159, 0x99BA4EFE)), (ones, (0x1CB996FC, 0xBB002BE7))]
    for word, answer in answers:
        key = jnp.full(2, word)
        assert tuple(int(x) for x in random.threefry(key, word, word)) == answer


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_law(dtype):
    draw = jax.vmap(lambda k: random.normal(KEY, k, 3, (4,), dtype))
    x = np.asarray(draw(jnp.arange(50_000)))
    assert x.dtype == dtype
    assert scipy.stats.kstest(x.ravel(), "norm").pvalue > 1e-3
    correlation = np.corrcoef(x.T) - np.eye(4)
    assert np.abs(correlation).max() < 4 / np.sqrt(50_000)
    lagged = np.corrcoef(x[1:, 0], x[:-1, 0])[0, 1]
    assert abs(lagged) < 4 / np.sqrt(50_000)
    u = jax.vmap(lambda k: random.uniform(KEY, k, 3, (3,), dtype))(jnp.arange(50_000))
    assert u.dtype == dtype and u.min() > 0 and u.max() < 1
    assert scipy.stats.kstest(np.asarray(u).ravel(), "uniform").pvalue > 1e-3


def test_independence_of_order_and_chunks():
    keys = jax.vmap(lambda s: random.fold(KEY, s))(jnp.arange(64))
    grid = jax.vmap(lambda key: jax.vmap(lambda k: random.normal(key, k, 1, (2,)))(K))
    K = jnp.arange(100)
    whole = grid(keys)
    np.testing.assert_array_equal(whole[40:47], grid(keys[40:47]))
    np.testing.assert_array_equal(whole[13, 77], random.normal(keys[13], 77, 1, (2,)))
    assert len(np.unique(whole)) == whole.size


def test_streams_seeds_and_samples_differ():
    draws = [
        random.normal(KEY, 5, 0, (2,)),
        random.normal(KEY, 5, 1, (2,)),
        random.normal(KEY, 6, 0, (2,)),
        random.normal(random.fold(KEY, 0), 5, 0, (2,)),
        random.normal(random.fold(KEY, 1), 5, 0, (2,)),
        random.normal(random.key(1), 5, 0, (2,)),
    ]
    assert len(np.unique(np.stack(draws))) == 12


def test_a_longer_shape_begins_with_the_shorter_one():
    np.testing.assert_array_equal(
        random.normal(KEY, 9, 0, (2, 3)).reshape(-1)[:3], random.normal(KEY, 9, 0, (3,))
    )


def test_numbers_work_inside_a_scan():
    def body(carry, k):
        return carry + random.normal(KEY, k, 0, ()), None

    total, _ = jax.lax.scan(body, 0.0, jnp.arange(20))
    expected = sum(random.normal(KEY, k, 0, ()) for k in range(20))
    np.testing.assert_allclose(total, expected, rtol=1e-12)


def test_arguments_are_refused():
    with pytest.raises(ValueError, match=r"`seed` must be an integer in \[0, 2\*\*64\)"):
        random.key(-1)
    with pytest.raises(ValueError, match=r"`stream` must be an integer in \[0, 2\*\*16\)"):
        random.normal(KEY, 0, 70_000)
