"""The instants of samples, and what is keyed by them, far from the first."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax import Experiment, random
from aslo_jax.disturbances import SampledNoise, held_index
from aslo_jax.engines import Runner
from aslo_jax.plants import AbstractPlant

MOST = 2**24  # whole numbers that float32 counts


class Turn(AbstractPlant):
    """q'' = -q, of which q is measured."""

    def initial(self):
        return jnp.array([0.3, -0.1])

    def vector_field(self, t, x, u):
        return jnp.stack([x[1], u - x[0]])

    def output(self, x):
        return x[0]

    def hidden(self, x):
        return x[1:]

    def no_input(self, y):
        return jnp.zeros_like(y)


def experiment(interval, sensor=None):
    return Experiment(Turn(), lambda t: jnp.zeros_like(t), {}, interval, sensor=sensor)


def nearest(k, interval, dtype):
    """The number of a precision that is nearest to `k interval`."""
    exact = k * Fraction(float(interval))
    guess = dtype(float(exact))
    near = [np.nextafter(guess, dtype(-np.inf)), guess, np.nextafter(guess, dtype(np.inf))]
    return min(near, key=lambda x: abs(Fraction(float(x)) - exact))


@pytest.mark.parametrize(
    ("dtype", "most"), [(np.float64, 10**9), (np.float32, MOST - 1)], ids=["64", "32"]
)
def test_the_instant_of_a_sample_is_exact_to_rounding(dtype, most):
    interval = dtype(1.7e-4)
    one = experiment(jnp.asarray(interval))
    carry, _ = one.init()
    prepared = one.prepare(carry)
    advance = jax.jit(lambda k: one.advance(k, carry, prepared)[1].t)
    for k in [0, 1, most // 3, most - 2, most - 1]:
        found = np.asarray(advance(jnp.asarray(k)))
        assert found.dtype == dtype
        assert found == nearest(k + 1, interval, dtype)


@pytest.mark.parametrize("first", [2**31 - 2, 2**32 - 2, 10**12])
def test_noise_goes_on_where_a_counter_of_32_bits_ends(first):
    interval, k = 1e-6, np.arange(first, first + 5)
    t = jnp.asarray(k * interval)
    np.testing.assert_array_equal(jax.vmap(lambda t: held_index(t, interval))(t), k)
    noise = SampledNoise(jnp.asarray(0.7), interval, key=random.key(3))
    found = jax.vmap(lambda t: noise(t, None, jnp.zeros(())))(t)
    key = random.key(3)
    draw = lambda k: 0.7 * random.normal(key, int(k) % 2**32, noise.stream)
    np.testing.assert_allclose(found, [draw(n) for n in k], rtol=1e-14)
    assert len(set(np.asarray(found).tolist())) == 5


def test_more_samples_than_a_precision_counts_are_refused():
    single, double = jnp.asarray(1e-4, jnp.float32), jnp.asarray(1e-4, jnp.float64)
    with pytest.raises(ValueError, match="`steps` must be at most 16777216 in float32"):
        experiment(single).run(MOST + 1, MOST + 1)
    with pytest.raises(ValueError, match="`steps` must be at most 16777216 in float32"):
        Runner(experiment, single, MOST + 1, engine="scan")
    assert Runner(experiment, single, MOST, engine="scan").steps == MOST
    assert Runner(experiment, double, 10**9, engine="scan").steps == 10**9
