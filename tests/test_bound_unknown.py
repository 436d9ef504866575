"""The Cramer-Rao bound with parameters that are unknown, against the information of the
whole record and against plants that have them as states."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import aslo_jax as aslo
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.plants._base import AbstractPlant
from aslo_jax.plants._machine import MachineState
from aslo_jax.study._bound import both_bounds, cramer_rao

R, L, M, POLES, J, D = 1.7, 9.3e-3, 0.11, 3, 2.3e-3, 0.7e-3
H, CURRENT, VOLTAGE, STEPS = 1e-3, np.array([0.03, 0.05]), 0.4, 30
UNKNOWN = {"resistance": 0.2, "magnet_flux": 0.03, "inertia": 0.1}
PRIOR = np.array([0.04, 0.07, 5.0, 0.3])  # Wb, Wb, rad/s, rad
RATE = np.array([0.0, 0.0, 20.0, 0.0])  # of the speed, rad/s per root second
FIRST = np.array([0.09, 0.05, 21.0, 0.4])


def motor(start):
    plant = aslo.plants.PMSM(R, L, M, POLES, J, D, load=lambda t: 0.3 + 0.0 * t)
    voltage = lambda t: jnp.stack([4.0 * jnp.cos(40.0 * t), 5.0 * jnp.sin(70.0 * t)])
    key = aslo.random.key(5)
    return aslo.Experiment(
        plant,
        OpenLoop(voltage),
        {},
        H,
        sensor=SampledNoise(CURRENT, H, key),
        input_sensor=SampledNoise(VOLTAGE, H, key, stream=1),
        initial=MachineState(start[:2], start[2], start[3]),
    )


def currents(first, errors, noise, kicks):
    """Every current and the last flux, written out in NumPy, for complex numbers too."""
    r, m, inertia = np.array([R, M, J]) * (1.0 + errors)
    x, found = first, []

    def current(x):
        angle = POLES * x[3]
        return (x[:2] - m * np.array([np.cos(angle), np.sin(angle)])) / L

    def rate(x, u):
        i = current(x)
        torque = 1.5 * POLES * (x[0] * i[1] - x[1] * i[0])
        return np.array([*(u - r * i), (torque - D * x[2] - 0.3) / inertia, x[2]])

    for k in range(STEPS):
        found.append(current(x))
        u = np.array([4.0 * np.cos(40.0 * k * H), 5.0 * np.sin(70.0 * k * H)]) + noise[k]
        a = rate(x, u)
        b = rate(x + 0.5 * H * a, u)
        c = rate(x + 0.5 * H * b, u)
        d = rate(x + H * c, u)
        x = x + H / 6.0 * (a + 2.0 * b + 2.0 * c + d) + np.array([0, 0, 1, 0]) * kicks[k]
    return np.concatenate([*found, current(x), x[:2]])


@pytest.mark.parametrize("names", [(), ("magnet_flux", "resistance"), tuple(UNKNOWN)])
def test_it_is_the_information_of_the_whole_record(names):
    """One matrix for the first state, the parameters and all noise of the input and of the
    speed: nothing is recursive."""
    sizes = 4, 3, 2 * STEPS, STEPS
    places = np.cumsum(sizes)[:-1]
    every = [UNKNOWN[n] if n in names else 0.0 for n in UNKNOWN]
    deviations = np.concatenate(
        [PRIOR, every, np.full(2 * STEPS, VOLTAGE), np.full(STEPS, RATE[2] * np.sqrt(H))]
    )

    def at(v):
        first, errors, noise, kicks = np.split(v * deviations, places)
        return currents(FIRST + first, errors, noise.reshape(-1, 2), kicks)

    slopes = np.stack([np.imag(at(1e-30j * e)) / 1e-30 for e in np.eye(sum(sizes))], axis=1)
    rows = slopes[:-2] / np.tile(CURRENT, STEPS + 1)[:, None]
    covariance = np.linalg.inv(np.eye(sum(sizes)) + rows.T @ rows)
    expected = np.diag(slopes[-2:] @ covariance @ slopes[-2:].T)

    state = lambda v: MachineState(*map(jnp.asarray, (v[:2], v[2], v[3])))
    found = cramer_rao(
        motor,
        FIRST[None],
        STEPS,
        prior=state(PRIOR),
        process=state(RATE),
        unknown={name: UNKNOWN[name] for name in names},
    )
    np.testing.assert_allclose(found.variance[0, -1], expected, rtol=1e-9)
    assert list(found.parameters) == list(names)
    for name, variance in found.parameters.items():
        k = 4 + list(UNKNOWN).index(name)
        assert variance.shape == (1, STEPS + 1)
        np.testing.assert_allclose(variance[0, 0], deviations[k] ** 2, rtol=0.9)
        known = deviations[k] ** 2 * covariance[k, k]
        np.testing.assert_allclose(variance[0, -1], known, rtol=1e-9)
        assert known < 0.9 * deviations[k] ** 2


@pytest.mark.slow
def test_both_bounds_come_of_one_run():
    state = lambda v: MachineState(*map(jnp.asarray, (v[:2], v[2], v[3])))
    starts = np.stack([FIRST, FIRST + np.array([0.02, -0.01, 7.0, 0.9])])
    prior = state(PRIOR)
    known, unknown = both_bounds(motor, starts, STEPS, prior=prior, unknown=UNKNOWN)
    for found, given in ((known, None), (unknown, UNKNOWN)):
        alone = cramer_rao(motor, starts, STEPS, prior=prior, unknown=given)
        np.testing.assert_allclose(found.t, alone.t, rtol=0, atol=1e-15)
        np.testing.assert_allclose(found.variance, alone.variance, rtol=1e-9)
        assert found.parameters.keys() == alone.parameters.keys()
    assert (unknown.variance[:, -1] > 1.01 * known.variance[:, -1]).any()


class Spring(AbstractPlant):
    """Two masses on springs of unlike stiffness, of which the places are measured."""

    stiffness: Float[Array, " 2"]
    damper: dict[str, Float[Array, ""]]

    def initial(self):
        return jnp.array([1.0, -0.5, 0.0, 0.0])

    def vector_field(self, t, x, u):
        pull = jnp.stack([-x[0], x[0] - x[1]]) * self.stiffness
        return jnp.concatenate([x[2:], pull - self.damper["rate"] * x[2:] + u])

    def output(self, x):
        return x[:2] / self.stiffness[0]

    def hidden(self, x):
        return self.stiffness * x[2:]


class Carried(Spring):
    """The same with the relative errors of the three numbers as states."""

    def initial(self):
        return jnp.concatenate([super().initial(), jnp.zeros(3)])

    def own(self, x):
        damper = {"rate": self.damper["rate"] * (1.0 + x[6])}
        return Spring(self.stiffness * (1.0 + x[4:6]), damper)

    def vector_field(self, t, x, u):
        return jnp.concatenate([self.own(x).vector_field(t, x[:4], u), jnp.zeros(3)])

    def output(self, x):
        return self.own(x).output(x[:4])

    def hidden(self, x):
        return jnp.concatenate([self.own(x).hidden(x[:4]), x[4:]])


def swing(kind, sample):
    control = OpenLoop(lambda t: jnp.stack([jnp.cos(2.0 * t), 0.0 * t]))
    noise = SampledNoise(np.array([0.02, 0.05]), 0.05, aslo.random.key(0))
    plant = kind(sample * jnp.array([4.0, 7.0]), {"rate": 0.3 * sample})
    return aslo.Experiment(plant, control, {}, 0.05, sensor=noise)


@pytest.mark.slow
def test_entries_of_an_array_and_of_a_dict_are_states_like_others():
    unknown, samples = {"stiffness": [0.1, 0.3], "damper.rate": 0.5}, np.array([0.8, 1.1])
    prior, process = jnp.full(4, 0.2), jnp.array([0.0, 0.1, 0.05, 0.2])
    settings: dict[str, Any] = dict(prior=prior, process=process, unknown=unknown)
    found = cramer_rao(lambda s: swing(Spring, s), samples, 25, **settings)
    whole = cramer_rao(
        lambda s: swing(Carried, s),
        samples,
        25,
        prior=jnp.array([*prior, 0.1, 0.3, 0.5]),
        process=jnp.array([*process, 0.0, 0.0, 0.0]),
    )
    np.testing.assert_allclose(found.variance, whole.variance[..., :2], rtol=1e-10)
    variance = whole.variance[..., 2:]
    assert found.parameters["stiffness"].shape == (2, 26, 2)
    np.testing.assert_allclose(found.parameters["stiffness"], variance[..., :2], rtol=1e-10)
    np.testing.assert_allclose(
        found.parameters["damper.rate"], variance[..., 2], rtol=1e-10
    )
    del settings["unknown"]
    known = cramer_rao(lambda s: swing(Spring, s), samples, 25, **settings)
    # At rest the velocity has no stiffness to be multiplied by.
    assert (found.norm[5:] > 1.01 * known.norm[5:]).all() and not known.parameters


@pytest.mark.parametrize(
    ("unknown", "message"),
    [
        ({"resistence": 0.1}, "`resistence` is none of PMSM"),
        ({"pole_pairs": 0.1}, "`pole_pairs` is none of PMSM"),
        ({"resistance": [0.1, 0.2]}, r"one number for `resistance`.* got the shape \(2,\)"),
        ({"resistance": -0.1}, "zero or positive, but `resistance` has -0.1"),
        ({"resistance": np.nan}, "zero or positive, but `resistance` has nan"),
    ],
)
def test_what_it_refuses(unknown, message):
    with pytest.raises(ValueError, match=message):
        cramer_rao(motor, FIRST[None], 3, prior=1.0, unknown=unknown)


def test_what_has_no_relative_error_or_no_noise():
    without = lambda s: eqx.tree_at(lambda e: e.plant.friction, motor(s), jnp.zeros(()))
    with pytest.raises(ValueError, match="not zero, since deviations are relative"):
        cramer_rao(without, FIRST[None], 3, prior=1.0, unknown={"friction": 0.1})
    settings: dict[str, Any] = dict(prior=1.0, process=1.0, unknown={"friction": 0.1})
    with pytest.raises(ValueError, match='`average` must be "bounds" where parameters'):
        cramer_rao(motor, FIRST[None], 3, average="information", **settings)
