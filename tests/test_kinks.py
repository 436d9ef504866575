"""Kinks that are declared: located by the continuous engine, and nothing elsewhere."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import aslo_jax as aslo
from aslo_jax._kinks import NAME, below, clip, larger, smaller
from aslo_jax.disturbances import DeadTime, SampledNoise, Saturation
from aslo_jax.engines._adaptive.switches import switched, switches

pytest.importorskip("llvmlite")


class Integrator(aslo.plants.AbstractPlant):
    """`x' = f(t, x, u)`, of which all is measured."""

    f: object
    start: object

    def initial(self):
        return jnp.asarray(self.start)

    def vector_field(self, t, x, u):
        return self.f(t, x)

    def output(self, x):
        return x

    def hidden(self, x):
        return x

    def no_input(self, y):
        return jnp.zeros(())


def run(f, start, t1, rtol, **more):
    plant = Integrator(f, start)
    how = dict(t1=t1, rtol=rtol, atol=rtol, engine="fused", ts=np.array([t1])) | more
    return aslo.simulate(plant, lambda t: jnp.zeros(()), {}, **how)


magnitude, sign = aslo.kinked(jnp.abs), aslo.kinked(jnp.sign)
TOLERANCES = (1e-4, 1e-8)


# -- closed forms -------------------------------------------------------------------------


def test_the_integral_of_a_rectified_cosine():
    """`2 n + (-1)^n sin(t)` after n zeros: within the tolerance, as the step control alone
    is not."""
    t1 = 20.0
    n = int((t1 + np.pi / 2) // np.pi)
    exact = 2 * n + (-1) ** n * np.sin(t1)
    for rtol in TOLERANCES:
        declared = run(lambda t, x: magnitude(jnp.cos(t)) + 0.0 * x, [0.0], t1, rtol)
        assert abs(declared.x[0, 0] - exact) < rtol * exact
    plain = run(lambda t, x: jnp.abs(jnp.cos(t)) + 0.0 * x, [0.0], t1, 1e-8)
    assert abs(plain.x[0, 0] - exact) > 1e-8 * exact


def test_jumps_of_the_field():
    """A triangular wave, whose derivative jumps."""
    for rtol in TOLERANCES:
        found = run(lambda t, x: sign(jnp.cos(3.0 * t)) + 0.0 * x, [0.0], 7.0, rtol)
        np.testing.assert_allclose(
            found.x[0, 0], np.arcsin(np.sin(21.0)) / 3.0, atol=2.0 * rtol
        )


def test_a_bouncing_mass_in_closed_form():
    """A mass between springs that begin to push at a distance d: half a turn of
    `sqrt(k/m)` in each, free flight at constant speed between them."""
    d, k, v = 0.4, 30.0, 1.3

    def field(t, x):
        push = larger(x[0] - d, 0.0) - larger(-d - x[0], 0.0)
        return jnp.stack([x[1], -k * push])

    period = 4 * d / v + 2 * np.pi / np.sqrt(k)
    ts = np.array([0.25, 0.5, 1.0, 7.0]) * period
    for rtol in (1e-6, 1e-9):
        found = run(field, [0.0, v], ts[-1], rtol, ts=ts).x
        reach = d + v / np.sqrt(k)
        exact = [[reach, 0.0], [0.0, -v], [0.0, v], [0.0, v]]
        np.testing.assert_allclose(found, exact, atol=40 * rtol)


def test_a_kink_between_the_ends_of_a_step_is_seen():
    """A side that changes for a while, so short that both ends of a step do not show it:
    `max(sin(t) - c, 0)` for c near 1."""
    c = 0.999
    width = np.arccos(c)  # half of how long it is positive
    exact = 2 * (np.sin(width) - c * width)
    for rtol in (1e-4, 1e-6, 1e-8):
        field = lambda t, x: larger(jnp.sin(t) - c, 0.0) + 0.0 * x
        found = run(field, [0.0], 2 * np.pi, rtol).x[0, 0]
        np.testing.assert_allclose(found, exact, atol=rtol)


def test_a_sliding_mode_comes_to_an_end():
    """Dry friction holds a mass up to t = 4 s, where the force becomes larger: along the
    kink steps are short, but the run reaches its end."""
    field = lambda t, x: jnp.stack([0.25 * t - sign(x[0])])
    found = run(field, [0.0], 8.0, 1e-4, max_steps=20_000)
    assert not found.result.any()
    np.testing.assert_allclose(found.x[0, 0], 2.0, atol=0.05)


# -- against SciPy from kink to kink ------------------------------------------------------


def exactly(field, start, t1, breaks):
    """SciPy, which restarts at every event that `breaks` has."""
    t, x = 0.0, np.asarray(start, float)
    events = [lambda t, x, g=g: g(t, x) for g in breaks]
    for event in events:
        event.terminal = True
    while t < t1:
        found = scipy.integrate.solve_ivp(
            field, (t, t1), x, "DOP853", rtol=1e-12, atol=1e-13, events=events
        )
        t, x = found.t[-1], found.y[:, -1]
        if t < t1:  # over the event, by a step that is too short to matter
            x, t = x + 1e-9 * np.asarray(field(t, x)), t + 1e-9
    return x


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 4))]
)
def test_random_oscillators_with_limits(seed):
    """An oscillator whose input has limits and whose damping begins beyond a circle."""
    rng = np.random.default_rng(seed)
    size, w, limit = rng.uniform(0.5, 2), rng.uniform(1, 5), rng.uniform(0.2, 1.0)
    damping = rng.uniform(0.5, 5.0)

    def field(t, x, clip, larger, stack, sin):
        u = clip(size * sin(w * t) + x[1], -limit, limit)
        excess = larger(x[0] * x[0] + x[1] * x[1] - 0.5, 0.0)
        return stack([x[1], -x[0] - damping * excess * x[1] + u])

    own = lambda t, x: field(t, x, clip, larger, jnp.stack, jnp.sin)
    plain = lambda t, x: field(t, x, np.clip, np.maximum, np.stack, np.sin)
    breaks = [
        lambda t, x: size * np.sin(w * t) + x[1] - limit,
        lambda t, x: size * np.sin(w * t) + x[1] + limit,
        lambda t, x: x[0] * x[0] + x[1] * x[1] - 0.5,
    ]
    exact = exactly(plain, [0.6, 0.0], 6.0, breaks)
    for rtol in (1e-5, 1e-8):
        found = run(own, [0.6, 0.0], 6.0, rtol).x[0]
        np.testing.assert_allclose(found, exact, atol=max(10 * rtol, 5e-9))


# -- what the library declares ------------------------------------------------------------


MOTOR = aslo.plants.PMSM.bmp0701f(load=lambda t: jnp.full_like(t, 0.4))


def turning(t):
    return 45.0 * jnp.stack([jnp.cos(90.0 * t), jnp.sin(90.0 * t)])


def observed(**parts):
    observers = {"FO2": aslo.FO2(MOTOR.flux_relation(), 900.0)}
    how = dict(t1=0.06, ts=np.array([0.031, 0.06]), engine="fused")
    return lambda rtol: aslo.simulate(
        MOTOR, turning, observers, rtol=rtol, atol=1e-2 * rtol, **how, **parts
    )


@pytest.mark.parametrize(
    "parts",
    [
        dict(actuator=DeadTime(3.0, 0.2)),
        pytest.param(
            dict(actuator=Saturation(-31.0, 38.0), sensor=Saturation(-5.0, 4.0)),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["dead time", "saturations"],
)
def test_parts_of_the_library_keep_the_tolerance(parts):
    at = observed(**parts)
    exact = at(1e-12)
    for rtol in (1e-4, 1e-7):
        found = at(rtol)
        for a, b in [
            (found.x.flux, exact.x.flux),
            (found.x.speed, exact.x.speed),
            (found.estimates["FO2"].value, exact.estimates["FO2"].value),
        ]:
            assert np.abs(a - b).max() < 10 * rtol * np.abs(b).max()


def test_a_limit_may_be_infinite():
    """Of which the switching function is too."""
    how = dict(t1=0.02, ts=np.array([0.02]), engine="fused", rtol=1e-7, atol=1e-9)
    one = aslo.simulate(MOTOR, turning, {}, actuator=Saturation(-jnp.inf, 38.0), **how)
    both = aslo.simulate(MOTOR, turning, {}, actuator=Saturation(-900.0, 38.0), **how)
    assert not one.result.any()
    np.testing.assert_allclose(one.x.flux, both.x.flux, atol=1e-9)


@pytest.mark.slow
def test_kinks_beside_held_noise():
    """Whose jumps move the switching functions: they are taken anew there."""
    noise = SampledNoise(0.5, 2e-3, aslo.random.key(3))
    at = observed(actuator=DeadTime(3.0, 0.2), sensor=noise)
    exact, found = at(1e-11), at(1e-7)
    worst = np.abs(found.estimates["FO2"].value - exact.estimates["FO2"].value).max()
    assert worst < 1e-6 * np.abs(exact.estimates["FO2"].value).max()


def test_lanes_with_kinks_do_not_depend_on_their_neighbours():
    def one(limit):
        actuator = Saturation(-limit, limit)
        how = dict(t1=0.02, ts=np.array([0.02]), engine="fused", rtol=1e-7)
        return aslo.simulate(MOTOR, turning, {}, actuator=actuator, **how).x.flux

    limits = jnp.linspace(20.0, 60.0, 11)
    batch, back = jax.vmap(one)(limits), jax.vmap(one)(limits[::-1])[::-1]
    np.testing.assert_array_equal(batch, back)
    np.testing.assert_array_equal(batch[4], one(limits[4]))


class Push(eqx.Module):
    size: jax.Array

    def __call__(self, t):
        return self.size * jnp.cos(t)


def test_derivatives_through_kinks():
    """Of a clipped input the tangent stops where the input does."""

    def moved(size):
        plant, limits = aslo.plants.IntegratorChain(2), Saturation(-0.5, 0.5)
        how = dict(t1=2.0, ts=np.array([2.0]), rtol=1e-9, atol=1e-11, engine="fused")
        return aslo.simulate(plant, Push(size), {}, actuator=limits, **how).x[0, 1]

    size = jnp.asarray(1.3)
    slope = jax.jacfwd(moved)(size)
    begins = np.arccos(0.5 / 1.3)  # within its limits up to the end of that time
    ends = min(np.pi - begins, 2.0)
    np.testing.assert_allclose(slope, np.sin(ends) - np.sin(begins), atol=1e-7)
    value = 0.5 * begins + 1.3 * (np.sin(ends) - np.sin(begins))
    np.testing.assert_allclose(moved(size), value - 0.5 * (2.0 - ends), atol=1e-8)


# -- declarations -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["gt", "ge", "lt", "le", "maximum", "minimum", "abs", "sign"]
)
def test_switching_functions(name):
    """Values as without a declaration, and the other branch where a side is held."""
    function = {
        "gt": lambda x, y: x > y,
        "ge": lambda x, y: x >= y,
        "lt": lambda x, y: x < y,
        "le": lambda x, y: x <= y,
        "maximum": jnp.maximum,
        "minimum": jnp.minimum,
        "abs": lambda x, y: jnp.abs(x - y),
        "sign": lambda x, y: jnp.sign(x - y),
    }[name]
    x, y = jnp.array([1.0, -2.0, 0.5]), jnp.array([0.3, 0.4, 2.0])
    closed = jax.make_jaxpr(aslo.kinked(function))(x, y)
    assert switches(closed) == 3
    (free,), g = switched(closed, [x, y], jnp.zeros(3))
    np.testing.assert_array_equal(free, function(x, y))
    np.testing.assert_array_equal(np.abs(g), np.abs(x - y))
    (held,), _ = switched(closed, [x, y], -np.sign(g) * 1e300)
    expected = function(y, x)  # each exchanges its branches with its arguments
    if name in ("maximum", "minimum"):
        expected = {"maximum": jnp.minimum, "minimum": jnp.maximum}[name](x, y)
    if name in ("abs", "sign"):
        expected = -function(x, y)
    np.testing.assert_array_equal(held, expected)


def test_what_is_not_declared_has_no_switching_functions():
    closed = jax.make_jaxpr(lambda x: jnp.where(x > 0, jnp.abs(x), jnp.clip(x, -1, 1)))(1.0)
    assert switches(closed) == 0


def test_a_declaration_changes_nothing_elsewhere():
    x = jnp.linspace(-2.0, 2.0, 9)
    np.testing.assert_array_equal(clip(x, -0.5, 1.0), jnp.clip(x, -0.5, 1.0))
    np.testing.assert_array_equal(smaller(1.0, x), jnp.minimum(1.0, x))
    np.testing.assert_array_equal(larger(1.0, x), jnp.maximum(1.0, x))
    np.testing.assert_array_equal(below(x, 0.5), x < 0.5)
    (slope,) = jax.jvp(lambda x: clip(x, -0.5, 1.0), (x,), (jnp.ones(9),))[1:]
    np.testing.assert_array_equal(slope[::4], [0.0, 1.0, 0.0])
    assert NAME in str(jax.make_jaxpr(aslo.kinked(jnp.abs))(x))
