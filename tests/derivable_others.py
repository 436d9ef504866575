"""Tanks, vehicles, oscillators and mechanisms, whose observers are derived."""

import jax.numpy as jnp
from derivable_case import GRAVITY, Case, around

from aslo_jax.derivation import Model


def two_tanks() -> Case:
    """Laminar flow between two tanks, and a leak that is not known."""
    model = Model(
        lambda x, y, u, p: [(u[0] - 0.06 * (x[0] - y[0]) - p["leak"]) / 0.5],
        lambda x, y, u, p: [(0.06 * (x[0] - y[0]) - 0.03 * jnp.sqrt(y[0])) / 0.3],
        states={"h1": (0.2, 1.0)},
        outputs={"h2": (0.1, 0.5)},
        inputs={"q": (0, 0.05)},
        parameters={"leak": 0.004},
        unknown=["leak"],
    )
    return Case(model, [0.7, 0.004, 0.3], 2e-8, 0.8, 30.0, around(0.03, 0.02, 0.5))


def chemostat() -> Case:
    """Biomass from the substrate; the inputs are dilution and growth."""
    model = Model(
        lambda x, y, u: [(u[1] - u[0]) * x[0]],
        lambda x, y, u: [u[0] * (5.0 - y[0]) - 2.1 * u[1] * x[0]],
        states={"biomass": (0.5, 3)},
        outputs={"substrate": (0.5, 5)},
        inputs={"dilution": (0.1, 0.5), "growth": (0.1, 0.5)},
    )

    def drive(t):
        return [0.3 + 0.1 * jnp.sin(0.5 * t), 0.35 + 0.1 * jnp.cos(0.3 * t)]

    return Case(model, [1.2, 2.0], 3e-13, 3.0, 10.0, drive)


def vehicle() -> Case:
    """Lateral speed and the bias of the accelerometer, from the yaw rate."""
    a, b, Cf, Cr, Iz, m = 1.1, 1.6, 6.2e4, 8.1e4, 2100.0, 1480.0

    def forces(v, r, u):
        front = Cf * (u[2] - (v + a * r) / u[1])
        return front, Cr * (-(v - b * r) / u[1])

    def yaw(v, r, u):
        front, rear = forces(v, r, u)
        return (a * front - b * rear) / Iz

    model = Model(
        lambda x, y, u, p: [u[0] - p["bias"] - u[1] * y[0]],
        lambda x, y, u, p: [yaw(x[0], y[0], u)],
        states={"v": (-2, 2)},
        outputs={"r": (-0.4, 0.4)},
        inputs={"a": (-3, 3), "speed": (10, 25), "steering": (-0.1, 0.1)},
        parameters={"bias": 0.37},
        unknown=["bias"],
    )

    def signals(t, s):
        speed, steering = 18.0 + 2 * jnp.sin(0.7 * t), 0.05 * jnp.sin(2.1 * t) + 0.02
        front, rear = forces(s[0], s[2], (0.0, speed, steering))
        return s[:2], s[2:], [(front + rear) / m + s[1], speed, steering]

    def rate(t, s):
        _, _, (acceleration, speed, _) = signals(t, s)
        u = signals(t, s)[2]
        return [acceleration - s[1] - speed * s[2], 0.0, yaw(s[0], s[2], u)]

    return Case(model, [0.2, 0.37, 0.05], 3e-8, 5.0, 5.0, signals=signals, rate=rate)


def unicycle() -> Case:
    """The heading from the position, speed and rate of turn."""
    model = Model(
        lambda x, y, u: [u[1]],
        lambda x, y, u: u[0] * jnp.stack([jnp.cos(x[0]), jnp.sin(x[0])]),
        states={"heading": (-3, 3)},
        outputs={"px": (-5, 5), "py": (-5, 5)},
        inputs={"speed": (0.5, 2), "turn": (-1, 1)},
    )

    def drive(t):
        return [1 + 0.4 * jnp.sin(t), 0.5 * jnp.cos(2 * t)]

    return Case(model, [0.7, 0.1, -0.3], 2e-12, 5.0, 5.0, drive)


def van_der_pol(measured: str = "position") -> Case:
    if measured == "position":
        model = Model(
            lambda x, y, u: [1.3 * (1 - y[0] ** 2) * x[0] - y[0]],
            lambda x, y, u: [x[0]],
            states={"speed": (-3, 3)},
            outputs={"position": (-2, 2)},
        )
        return Case(model, [0.4, 1.1], 1e-9, 10.0, 8.0)
    model = Model(
        lambda x, y, u: [y[0]],
        lambda x, y, u: [1.3 * (1 - x[0] ** 2) * y[0] - x[0]],
        states={"position": (-2, 2)},
        outputs={"speed": (-3, 3)},
    )
    return Case(model, [0.4, 1.1], 1e-9, 5.0, 8.0)


def lorenz(measured: int) -> Case:
    """The other two of its three states."""
    sigma, rho, beta = 10.0, 28.0, 8 / 3

    def rates(a, b, c):
        return [sigma * (b - a), a * (rho - c) - b, a * b - beta * c]

    ranges = [(-15.0, 15.0), (-20.0, 20.0), (5.0, 40.0)]
    others = [k for k in range(3) if k != measured - 1]

    def full(x, y):
        entries = list(x)
        entries.insert(measured - 1, y[0])
        return rates(*entries)

    model = Model(
        lambda x, y, u: [full(x, y)[k] for k in others],
        lambda x, y, u: [full(x, y)[measured - 1]],
        states={f"x{k + 1}": ranges[k] for k in others},
        outputs={f"x{measured}": ranges[measured - 1]},
    )
    start, figure, cutoff, horizon = {
        1: ([1.4, 22.0, -3.0], 2e-11, 20.0, 3.0),
        2: ([1.4, 22.0, -3.0], 7e-8, 40.0, 1.5),
        3: ([1.4, -3.0, 22.0], 7e-8, 60.0, 2.0),
    }[measured]
    return Case(model, start, figure, cutoff, horizon)


def epidemic(unknown: str = "recovery") -> Case:
    """S, I, R: the infected are measured, a rate is not known."""
    model = Model(
        lambda x, y, u, p: [-p["infection"] * x[0] * y[0]],
        lambda x, y, u, p: [p["infection"] * x[0] * y[0] - p["recovery"] * y[0]],
        states={"susceptible": (0.3, 1)},
        outputs={"infected": (0.01, 0.3)},
        parameters={"infection": 0.9, "recovery": 0.23},
        unknown=[unknown],
    )
    return Case(model, [0.93, 0.23, 0.02], 3e-7, 1.0, 20.0)


def drone(drag: str = "linear") -> Case:
    laws = {
        "linear": lambda v: 0.4 * v,
        "quadratic": lambda v: 0.05 * v**2,
        "of either sign": lambda v: 0.05 * jnp.abs(v) * v,
    }
    model = Model(
        lambda x, y, u: [u[0] / 1.3 - GRAVITY - laws[drag](x[0])],
        lambda x, y, u: [x[0]],
        states={"speed": (0, 5)},
        outputs={"height": (0, 30)},
        inputs={"thrust": (5, 20)},
    )
    start = [0.5, 2.0] if drag == "linear" else [2.5, 1.0]
    return Case(model, start, 4e-13, 5.0, 3.0, around(13.0, 2.0, 3.0))


def tube() -> Case:
    """A mass in a rotating tube, with friction: Coriolis and centrifugal forces."""
    inertia, slope = (lambda q: 0.3 + 0.8 * q**2), (lambda q: 1.6 * q)
    model = Model(
        lambda x, y, u: [
            (u[0] + 0.5 * slope(y[0]) * x[1] ** 2 - 0.2 * x[0]) / 1.4,
            (u[1] - slope(y[0]) * x[0] * x[1]) / inertia(y[0]),
        ],
        lambda x, y, u: x,
        states={"v1": (-1, 1), "v2": (-1, 1)},
        outputs={"q1": (0.2, 1.5), "q2": (-3, 3)},
        inputs={"u1": (-2, 2), "u2": (-2, 2)},
    )

    def drive(t):
        return [-0.9 + 0.3 * jnp.sin(2 * t), 0.5 * jnp.cos(3 * t)]

    return Case(model, [0.3, 0.7, 0.8, 0.1], 8e-8, 6.0, 3.0, drive)


def cart_pole() -> Case:
    """A pole that swings on a cart, with friction in its joint."""
    M, m, length = 1.7, 0.3, 0.6

    def f(x, y, u):
        c, s = jnp.cos(y[1]), jnp.sin(y[1])
        inertia = jnp.array([[M, 0.0], [0.0, m * length**2]])
        inertia = inertia + m * length * c * jnp.array([[0.0, 1.0], [1.0, 0.0]])
        centrifugal = u[0] + m * length * s * x[1] ** 2
        return jnp.linalg.solve(
            inertia,
            jnp.stack([centrifugal, m * GRAVITY * length * s - 0.02 * x[1]]),
        )

    model = Model(
        f,
        lambda x, y, u: x,
        states={"v": (-2, 2), "turn": (-3, 3)},
        outputs={"position": (-1, 1), "angle": (-4, 4)},
        inputs={"force": (-5, 5)},
    )

    def drive(t):
        return [3.0 * jnp.sin(2 * t)]

    return Case(model, [0.3, -0.7, 0.1, 2.8], 2e-12, 15.0, 3.0, drive)


def rigid_body() -> Case:
    """The rate of turn of a body from its attitude, a unit quaternion."""
    inertia = jnp.array([0.7, 1.1, 1.9])

    def attitude(x, q, u):
        w, v = q[0], q[1:]
        return 0.5 * jnp.concatenate([-(v @ x)[None], w * x + jnp.cross(v, x)])

    model = Model(
        lambda x, y, u: (u - jnp.cross(x, inertia * x)) / inertia,
        attitude,
        states={"w1": (-1, 1), "w2": (-1, 1), "w3": (-1, 1)},
        outputs=dict.fromkeys(("q0", "q1", "q2", "q3"), (-1, 1)),
        inputs=dict.fromkeys(("t1", "t2", "t3"), (-1, 1)),
    )

    def drive(t):
        return [0.3 * jnp.sin(t), 0.2, -0.4 * jnp.cos(2 * t)]

    q = jnp.array([0.8, 0.3, -0.4, 0.33])
    start = [0.6, -0.4, 0.9, *map(float, q / jnp.linalg.norm(q))]
    return Case(model, start, 3e-11, 6.0, 3.0, drive)
