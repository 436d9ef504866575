"""What cannot be derived is refused with its line, the states and a repair; and nothing is
taken for a polynomial that is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivable_others import drone, epidemic, van_der_pol

import aslo_jax as aslo
from aslo_jax.derivation import Model, NotDerivable, derive


def of_output(g, n=1):
    """Constant states behind the rate of one output."""
    return Model(
        lambda x, y, u: 0.0 * x,
        lambda x, y, u: [g(x, y[0])],
        states={f"x{k}": (0.5, 2.0) for k in range(n)},
        outputs={"y": (0.5, 2.0)},
    )


def refusal(model):
    with pytest.raises(NotDerivable) as caught:
        derive(model)
    return caught.value


def test_a_magnitude_is_refused_by_its_line():
    error = refusal(drone("of either sign").model)
    assert "`jnp.abs`" in str(error) or "primitive `abs`" in str(error)
    assert "derivable_others.py:" in str(error) and "speed" in str(error)


def test_roots_and_logarithms_are_refused():
    tanks = Model(
        lambda x, y, u: [(u[0] - 0.02 * jnp.sqrt(x[0] - y[0])) / 0.5],
        lambda x, y, u: [0.02 * jnp.sqrt(x[0] - y[0]) - 0.05 * jnp.sqrt(y[0])],
        states={"level": (0.6, 1.0)},
        outputs={"other": (0.1, 0.5)},
        inputs={"flow": (0.0, 0.05)},
    )
    assert "`sqrt`" in str(refusal(tanks))
    nernst = Model(
        lambda x, y, u: [-u[0] / 900.0],
        None,
        lambda x, y, u: [3.5 + 0.1 * jnp.log(x[0]) - 0.02 * u[0] - y[0]],
        states={"charge": (0.1, 0.9)},
        outputs={"v": (3.0, 4.0)},
        inputs={"i": (-5.0, 15.0)},
    )
    assert "`log`" in str(refusal(nernst))


def test_an_unknown_infection_rate_is_refused_with_the_pair_and_a_repair():
    error = refusal(epidemic("infection").model)
    assert set(error.pair) == {"susceptible", "infection"}
    assert error.repair == ("susceptible",)
    assert "product of susceptible and infection" in str(error)
    assert "if susceptible were measured too" in str(error)


def test_a_double_pendulum_is_refused():
    def f(x, y, u):
        c, s = jnp.cos(y[0] - y[1]), jnp.sin(y[0] - y[1])
        M = jnp.array([[0.45, 0.0], [0.0, 0.448]]) + 0.28 * c * jnp.array([[0, 1], [1, 0]])
        force = 0.28 * s * jnp.stack([-(x[1] ** 2), x[0] ** 2])
        return jnp.linalg.solve(M, u + force - jnp.sin(y))

    model = Model(
        f,
        lambda x, y, u: x,
        states={"v1": (-1.0, 1.0), "v2": (-1.0, 1.0)},
        outputs={"q1": (-2.0, 2.0), "q2": (-2.0, 2.0)},
        inputs={"u1": (-1.0, 1.0), "u2": (-1.0, 1.0)},
    )
    error = refusal(model)
    assert set(error.pair) <= {"v1", "v2"} and error.pair
    assert "does not close" in str(error)


@jax.custom_jvp
def lying(x):
    return x**2


@lying.defjvp
def _(primals, tangents):
    return lying(*primals), tangents[0]


REFUSED = {
    "floor": lambda x, y: jnp.floor(x[0]) * 1e-3 - y,
    "where of a state": lambda x, y: jnp.where(x[0] > 50, x[0] ** 2, x[0]),
    "where of a state, equal": lambda x, y: jnp.where(x[0] > 0, 2.0 * x[0], x[0]),
    "maximum": lambda x, y: jnp.maximum(x[0], -1e3),
    "quotient": lambda x, y: x[0] * x[0] / x[0],
    "varying frequency": lambda x, y: jnp.sin(x[0] * y),
}
FOUND = {
    "stopped gradient": (lambda x, y: jax.lax.stop_gradient(x[0] ** 2) - y, ("x0*x0",)),
    "derivative that lies": (lambda x, y: lying(x[0]), ("x0*x0",)),
    "rare branch": (
        lambda x, y: jnp.where(y > 1.99999, x[0] ** 2, x[0]),
        ("x0", "x0*x0"),
    ),
    "cancelled square": (lambda x, y: (x[0] - y) ** 2 - x[0] ** 2, ("x0",)),
    "small square": (lambda x, y: 1e-13 * x[0] ** 2 + y * x[0], ("x0", "x0*x0")),
    "loop": (
        lambda x, y: jax.lax.fori_loop(0, 3, lambda i, a: a + x[0] * y, 0.0),
        ("x0",),
    ),
    "table": (
        lambda x, y: jnp.interp(y, jnp.array([0.0, 1, 3]), jnp.array([1.0, 2, 5])) * x[0],
        ("x0",),
    ),
    "polynomial": (
        lambda x, y: jnp.polyval(jnp.array([0.3, 1.0, 2.0]), y * x[0]),
        ("x0", "x0*x0"),
    ),
    "einsum": (
        lambda x, y: jnp.einsum("i,ij,j->", x, jnp.array([[0.0, 1], [1, 0]]), x),
        ("x0*x1",),
    ),
    "linear equations": (
        lambda x, y: jnp.linalg.solve(y * jnp.array([[2.0, 0.3], [0.1, 1.0]]), x)[0],
        ("x0 + -0.3 x1",),
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_no_polynomial_is_refused(name):
    assert "test_derive_refusals.py" in str(refusal(of_output(REFUSED[name])))


@pytest.mark.parametrize("name", FOUND)
def test_polynomials_are_seen_through(name):
    """Also where jacobians at random points see something else."""
    function, lifted = FOUND[name]
    assert derive(of_output(function, 1 if "x1" not in str(lifted) else 2)).lifted == lifted


def test_a_condition_guards_what_is_not_finite():
    model = Model(
        lambda x, y, u: 0.0 * x,
        lambda x, y, u: [x[0] * jnp.where(y[0] > 0, jnp.sqrt(jnp.abs(y[0])), jnp.inf)],
        states={"x": (0.0, 1.0)},
        outputs={"y": (0.5, 2.0)},
    )
    assert derive(model).lifted == ("x",)
    nowhere = Model(
        lambda x, y, u: 0.0 * x,
        lambda x, y, u: [x[0] * jnp.sqrt(y[0] - 3.0)],
        states={"x": (0.0, 1.0)},
        outputs={"y": (0.5, 2.0)},
    )
    with pytest.raises(ValueError, match="must be finite on the ranges"):
        derive(nowhere)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"g": None}, "`g` and `h` must not both be left out"),
        ({"states": {"speed": (1.0, 1.0)}}, "must give `speed` a range"),
        ({"outputs": {"speed": (0.0, 1.0)}}, "must occur once, but speed"),
        ({"unknown": ["load"]}, "must name parameters, which are none"),
        ({"units": {"load": "N m"}}, "has load"),
    ],
)
def test_a_wrong_model_is_refused(changes, expected):
    of = van_der_pol().model
    given = {"f": of.f, "g": of.g, "states": of.states, "outputs": of.outputs} | changes
    with pytest.raises(ValueError, match=expected):
        Model(**given)


def test_a_wrong_number_of_rates_is_refused():
    model = Model(
        lambda x, y, u: [x[0], x[0]],
        lambda x, y, u: [x[0]],
        states={"speed": (0.0, 1.0)},
        outputs={"y": (0.5, 2.0)},
    )
    with pytest.raises(ValueError, match="one rate for each of the 1 states speed"):
        derive(model)


def test_a_primitive_that_is_not_known_is_refused_by_its_line():
    def called(x):
        shape = jax.ShapeDtypeStruct((), x.dtype)
        return jax.pure_callback(np.sin, shape, x, vmap_method="sequential")

    with pytest.raises(aslo.NotFusible, match=r"test_derive_refusals\.py"):
        derive(of_output(lambda x, y: called(x[0])))


def test_a_function_that_fails_is_named():
    model = aslo.Model(
        f=lambda x, y, u, p: [p["gain"] * u[0]],
        g=lambda x, y, u, p: [p["gian"] * x[0]],
        states={"v": (-1, 1)},
        outputs={"q": (-1, 1)},
        inputs={"force": (-1, 1)},
        parameters={"gain": 2.0},
    )
    with pytest.raises(ValueError, match=r"Argument `g` must be .* KeyError: 'gian'"):
        aslo.derive(model)
