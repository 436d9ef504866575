"""Every disturbance of the library beside the same in plain Python, and a loop for them.
A new one is a line in `CASES` and a class above it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.control import AbstractController
from aslo_jax.disturbances import (
    Bias,
    Chain,
    DeadTime,
    Delay,
    Drift,
    Encoder,
    GainError,
    MissingSamples,
    Quantisation,
    RandomWalk,
    SampledNoise,
    Saturation,
    Sinusoid,
)
from aslo_jax.plants import AbstractPlant

H, STEPS, LANES = 0.05, 30, 3
A = np.array([[-1.0, 0.7], [-0.4, -2.0]])
K = np.array([1.5, 0.8])
VECTOR, PHASE = np.array([0.3, -0.2]), np.array([0.3, -1.0])
T0 = jnp.zeros(())
STARTS = np.array([[1.0, -0.3], [0.2, 0.6], [-0.8, 0.1]])


class Coupled(AbstractPlant):
    """`x' = A x + u`, both entries measured."""

    def initial(self):
        return jnp.zeros(2)

    def vector_field(self, t, x, u):
        return jnp.sum(jnp.asarray(A) * x, axis=1) + u

    def output(self, x):
        return x

    def hidden(self, x):
        return x


class Proportional(AbstractController):
    """`u = r(t) - K y`."""

    def init(self, fed):
        del fed

    def vector_field(self, t, state, fed):
        del t, state, fed

    def __call__(self, t, state, fed):
        return jnp.stack([jnp.sin(3.0 * t), 0.5 * jnp.cos(2.0 * t)]) - jnp.asarray(K) * fed


def loop(x, **disturbances):
    return aslo.Experiment(Coupled(), Proportional(), {}, H, initial=x, **disturbances)


# `at(k, t, s, y)` is the disturbed signal; k counts the samples, and `sample` says that the
# one that begins with s is over. `numbers` are those of its key and stream.
class Plain:
    def __init__(self, function):
        self.function = function

    def at(self, k, t, s, y):
        return self.function(t, s)

    def sample(self, k, t, s, y):
        pass


class Noisy(Plain):
    def __init__(self, deviation, key, stream):
        self.deviation = deviation
        self.numbers = normals(key, stream)

    def at(self, k, t, s, y):
        return s + self.deviation * self.numbers[k]


class Walking(Noisy):
    def at(self, k, t, s, y):
        return s + self.deviation * self.numbers[:k].sum(axis=0)


class Delayed(Plain):
    def __init__(self, delay):
        self.delay, self.past = delay, []

    def at(self, k, t, s, y):
        signal = np.array([*self.past, s])
        when = max(k - self.delay, 0.0)
        return np.array([np.interp(when, np.arange(k + 1), entry) for entry in signal.T])

    def sample(self, k, t, s, y):
        self.past.append(np.array(s))


class Losing(Plain):
    def __init__(self, probability, key, stream):
        draw = jax.vmap(lambda k: aslo.random.uniform(key, k, stream))
        self.lost = np.asarray(draw(jnp.arange(STEPS + 1))) < probability
        self.held = None

    def at(self, k, t, s, y):
        return self.held if self.lost[k] and self.held is not None else s

    def sample(self, k, t, s, y):
        self.held = self.at(k, t, s, y)


class Dead(Plain):
    def __init__(self, voltage, threshold):
        self.voltage, self.threshold = voltage, threshold

    def at(self, k, t, s, y):
        angles = 2 * np.pi / 3 * np.arange(3)
        clarke = 2 / 3 * np.stack([np.cos(angles), np.sin(angles)])
        phases = np.array([y[0] * np.cos(a) + y[1] * np.sin(a) for a in angles])
        legs = [
            i / self.threshold if abs(i) < self.threshold else np.sign(i) for i in phases
        ]
        return s - self.voltage * clarke @ legs


class Chained(Plain):
    def __init__(self, *parts):
        self.parts = parts

    def at(self, k, t, s, y):
        for part in self.parts:
            s = part.at(k, t, s, y)
        return s

    def sample(self, k, t, s, y):
        for part in self.parts:
            passed = part.at(k, t, s, y)
            part.sample(k, t, s, y)
            s = passed


def normals(key, stream):
    draw = jax.vmap(lambda k: aslo.random.normal(key, k, stream, (2,)))
    return np.asarray(draw(jnp.arange(STEPS + 1)))


class Case(NamedTuple):
    """The library's, from a key, a stream and a scale; the same in plain Python."""

    make: object
    plain: object


def encoded(s, resolution, turn):
    counts = np.round(s / resolution)
    return np.array([counts[0] * resolution[0], counts[1] % turn * resolution[1]])


BITS = np.array([0.01, 2 * np.pi / 256])
CASES = {
    "noise": Case(
        lambda key, n, a: SampledNoise(0.1 * a * VECTOR, H, key, n),
        lambda key, n, a: Noisy(0.1 * a * VECTOR, key, n),
    ),
    "bias": Case(
        lambda key, n, a: Bias(a * VECTOR),
        lambda key, n, a: Plain(lambda t, s: s + a * VECTOR),
    ),
    "drift": Case(
        lambda key, n, a: Drift(a * VECTOR),
        lambda key, n, a: Plain(lambda t, s: s + a * VECTOR * t),
    ),
    "walk": Case(
        lambda key, n, a: RandomWalk(0.1 * a, key, n),
        lambda key, n, a: Walking(0.1 * a, key, n),
    ),
    "quantisation": Case(
        lambda key, n, a: Quantisation(0.03 * a),
        lambda key, n, a: Plain(lambda t, s: 0.03 * a * np.rint(s / (0.03 * a))),
    ),
    "encoder": Case(
        lambda key, n, a: Encoder(BITS, (False, True)),
        lambda key, n, a: Plain(lambda t, s: encoded(s, BITS, 256)),
    ),
    "gain": Case(
        lambda key, n, a: GainError(a * VECTOR),
        lambda key, n, a: Plain(lambda t, s: s + a * VECTOR * s),
    ),
    "whole delay": Case(lambda key, n, a: Delay(2.0), lambda key, n, a: Delayed(2)),
    "delay": Case(
        lambda key, n, a: Delay(1.0 + 0.3 * a, longest=4),
        lambda key, n, a: Delayed(1.0 + 0.3 * a),
    ),
    "saturation": Case(
        lambda key, n, a: Saturation([-0.1, -0.2], 0.15 * a),
        lambda key, n, a: Plain(
            lambda t, s: np.minimum(np.maximum(s, [-0.1, -0.2]), 0.15 * a)
        ),
    ),
    "dead time": Case(
        lambda key, n, a: DeadTime(0.4 * a, 0.1), lambda key, n, a: Dead(0.4 * a, 0.1)
    ),
    "missing": Case(
        lambda key, n, a: MissingSamples(0.4 * a, key, n),
        lambda key, n, a: Losing(0.4 * a, key, n),
    ),
    "sinusoid": Case(
        lambda key, n, a: Sinusoid(a * VECTOR, 9.0, PHASE),
        lambda key, n, a: Plain(lambda t, s: s + a * VECTOR * np.sin(9 * t + PHASE)),
    ),
    "chain": Case(
        lambda key, n, a: Chain(
            GainError(0.5 * a),
            Delay(0.7),
            Bias(VECTOR),
            Chain(DeadTime(0.4, 0.1), Delay(1.0)),
        ),
        lambda key, n, a: Chained(
            Plain(lambda t, s: (1 + 0.5 * a) * s),
            Delayed(0.7),
            Plain(lambda t, s: s + VECTOR),
            Dead(0.4, 0.1),
            Delayed(1),
        ),
    ),
}
