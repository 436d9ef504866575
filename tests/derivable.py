"""Systems whose observers are derived, each with a motion: asymmetric parameters, and the
largest relative error that the theory's page gives for it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp

from aslo_jax.derivation import Model

GRAVITY = 9.81


class Case(NamedTuple):
    """A `model` and a motion of it: `signals(t, s)` are x, y and u of a state s that begins
    at `start` and changes by `rate(t, s)`; by default s is x and y, and u is `drive(t)`.

    `figure`: the relative error of every entry of the relation's x, after `since` (s).
    """

    model: Model
    start: list[float]
    figure: float
    cutoff: float
    horizon: float
    drive: Callable[..., Any] = lambda t: []
    signals: Callable[..., Any] | None = None
    rate: Callable[..., Any] | None = None
    since: float = 0.01
    completion: str = "repeat"

    def of(self, t: Any, s: Any) -> tuple[Any, Any, Any]:
        """x, y and u at an instant."""
        if self.signals is not None:
            return tuple(stacked(each) for each in self.signals(t, s))
        n = len(self.model.ranges)
        return s[:n], s[n:], stacked(self.drive(t))

    def slope(self, t: Any, s: Any) -> Any:
        if self.rate is not None:
            return stacked(self.rate(t, s))
        x, y, u = self.of(t, s)
        p = jnp.asarray(self.model.values())
        rates = self.model.measured_rates(x, y, u, p)
        return jnp.stack([*self.model.rates(x, y, u, p), *rates.values()])


def stacked(parts: Any) -> Any:
    if not isinstance(parts, list | tuple):
        return parts
    return jnp.concatenate([jnp.ravel(jnp.asarray(p, float)) for p in [*parts, []]])


def around(mean: float, swing: float, frequency: float) -> Callable:
    return lambda t: [mean + swing * jnp.sin(frequency * t)]


def buck() -> Case:
    L, C, R, r, E = 2.2e-3, 470e-6, 7.3, 0.21, 24.0
    model = Model(
        lambda x, y, u: [(u[0] * E - r * x[0] - y[0]) / L],
        lambda x, y, u: [(x[0] - y[0] / R) / C],
        states={"i": (0, 5)},
        outputs={"v": (5, 20)},
        inputs={"duty": (0.1, 0.9)},
    )
    return Case(model, [1.3, 11.0], 3e-14, 200.0, 0.5, around(0.5, 0.2, 60.0))


def boost() -> Case:
    L, C, R, r, E = 1.7e-3, 330e-6, 23.0, 0.35, 12.0
    model = Model(
        lambda x, y, u: [(E - r * x[0] - (1 - u[0]) * y[0]) / L],
        lambda x, y, u: [((1 - u[0]) * x[0] - y[0] / R) / C],
        states={"i": (0, 5)},
        outputs={"v": (12, 30)},
        inputs={"duty": (0.1, 0.7)},
    )
    return Case(model, [2.1, 17.0], 3e-14, 300.0, 0.5, around(0.45, 0.2, 60.0))


def cuk() -> Case:
    L1, L2, C1, C2, R, E = 3.1e-3, 1.9e-3, 47e-6, 220e-6, 11.0, 12.0
    model = Model(
        lambda x, y, u: [
            ((1 - u[0]) * y[0] - u[0] * x[1]) / C1,
            (u[0] * x[0] - y[1]) / L2,
        ],
        lambda x, y, u: [(E - (1 - u[0]) * x[0]) / L1, (x[1] - y[1] / R) / C2],
        states={"v1": (5, 40), "i2": (0, 5)},
        outputs={"i1": (0, 5), "v2": (5, 20)},
        inputs={"duty": (0.2, 0.7)},
    )
    start = [21.0, 0.4, 1.1, 8.0]
    return Case(model, start, 2e-13, 400.0, 0.3, around(0.45, 0.15, 80.0))


K_COIL, GAP, MASS, R_COIL = 2.3e-4, 0.012, 0.31, 2.7
HOVERING = (2 * K_COIL * MASS * GRAVITY) ** 0.5


def coil_current(psi, q):
    return (GAP - q) * psi / K_COIL


def levitation(position: bool = True) -> Case:
    """One coil above a ball; its position is measured, or its current alone."""

    def pull(psi):
        return GRAVITY - psi**2 / (2 * K_COIL * MASS)

    if position:
        model = Model(
            lambda x, y, u: [u[0] - R_COIL * y[1], pull(x[0])],
            lambda x, y, u: [x[1], None],
            lambda x, y, u: [coil_current(x[0], y[0]) - y[1]],
            states={"psi": (0, 0.1), "speed": (-0.2, 0.2)},
            outputs={"q": (-2e-3, 8e-3), "i": (0.1, 2)},
            inputs={"u": (0, 8)},
        )
    else:
        model = Model(
            lambda x, y, u: [u[0] - R_COIL * y[0], x[2], pull(x[0])],
            None,
            lambda x, y, u: [coil_current(x[0], x[1]) - y[0]],
            states={"psi": (0, 0.1), "q": (-2e-3, 8e-3), "speed": (-0.2, 0.2)},
            outputs={"i": (0.1, 2)},
            inputs={"u": (0, 8)},
        )
    drive = around(R_COIL * 0.008 * HOVERING / K_COIL, 0.4, 90.0)

    def signals(t, s):
        current = coil_current(s[0], s[1])
        x = [s[0], s[2]] if position else s
        return x, ([s[1], current] if position else [current]), drive(t)

    def rate(t, s):
        return [drive(t)[0] - R_COIL * coil_current(s[0], s[1]), s[2], pull(s[0])]

    start = [HOVERING * 1.02, 0.004, 0.01]
    return Case(model, start, 3e-12, 30.0, 0.12, signals=signals, rate=rate)


def turned(vector, theta):
    c, s = jnp.cos(theta), jnp.sin(theta)
    return jnp.stack([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


def synrm() -> Case:
    """A synchronous reluctance motor at a given speed; the angle is not measured."""
    Ld, Lq, R = 0.085, 0.019, 1.9
    model = Model(
        lambda x, y, u: u - R * y,
        None,
        lambda x, y, u: [(x - Ld * y) @ (x - Lq * y)],
        states={"flux_alpha": (-1, 1), "flux_beta": (-1, 1)},
        outputs={"i_alpha": (-5, 5), "i_beta": (-5, 5)},
        inputs={"u_alpha": (-20, 20), "u_beta": (-20, 20)},
    )

    def voltage(t):
        angle = 23 * t + 1.0
        turning = 14.0 * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        return turning + jnp.stack([3.0 * jnp.sin(71 * t), 2.0 + 0.0 * t])

    def current(t, s):
        theta = 0.4 + 23 * t + 0.6 * jnp.sin(5 * t)
        dq = turned(s[:2], -theta) / jnp.array([Ld, Lq])
        return turned(dq, theta)

    def signals(t, s):
        return s, current(t, s), voltage(t)

    def rate(t, s):
        return voltage(t) - R * current(t, s)

    return Case(model, [0.2, -0.1], 2e-9, 20.0, 1.0, signals=signals, rate=rate)


def pmsm() -> Case:
    L, R, m = 0.004, 0.7, 0.06
    model = Model(
        lambda x, y, u, p: u - p["resistance"] * y,
        None,
        lambda x, y, u, p: [
            jnp.sum((x - p["inductance"] * y) ** 2) - p["magnet_flux"] ** 2
        ],
        states={"flux_alpha": (-0.1, 0.1), "flux_beta": (-0.1, 0.1)},
        outputs={"i_alpha": (-5, 5), "i_beta": (-5, 5)},
        inputs={"u_alpha": (-20, 20), "u_beta": (-20, 20)},
        parameters={"resistance": R, "inductance": L, "magnet_flux": m},
    )

    def angle(t):
        return 0.4 + 40 * t + 3 * (1 - jnp.cos(3 * t))

    def voltage(t):
        return 3.5 * jnp.stack([jnp.cos(40 * t + 1.0), jnp.sin(40 * t + 1.0)])

    def current(t, s):
        magnet = jnp.stack([jnp.cos(angle(t)), jnp.sin(angle(t))])
        return (s[:2] - m * magnet) / L

    def signals(t, s):
        return s, current(t, s), voltage(t)

    def rate(t, s):
        return voltage(t) - R * current(t, s)

    return Case(model, [0.08, -0.02], 2e-9, 20.0, 1.0, signals=signals, rate=rate)


def dc_motor_from_speed() -> Case:
    model = Model(
        lambda x, y, u, p: [(u[0] - p["R"] * x[0] - p["K"] * y[0]) / p["L"]],
        lambda x, y, u, p: [(p["K"] * x[0] - p["b"] * y[0] - p["load"]) / p["J"]],
        states={"i": (-5, 5)},
        outputs={"speed": (-100, 100)},
        inputs={"u": (-12, 12)},
        parameters=DC_MOTOR,
        unknown=["load"],
    )
    start = [0.5, 0.03, 11.0]
    return Case(model, start, 2e-10, 500.0, 0.5, around(6.0, 4.0, 30.0))


DC_MOTOR = {"L": 4e-3, "R": 0.9, "K": 0.06, "J": 3e-4, "b": 2e-4, "load": 0.03}


def dc_motor_from_current() -> Case:
    """Speed, resistance and load, from the current."""
    model = Model(
        lambda x, y, u, p: [(p["K"] * y[0] - p["b"] * x[0] - p["load"]) / p["J"]],
        lambda x, y, u, p: [(u[0] - p["R"] * y[0] - p["K"] * x[0]) / p["L"]],
        states={"speed": (-100, 100)},
        outputs={"i": (-5, 5)},
        inputs={"u": (-12, 12)},
        parameters=DC_MOTOR,
        unknown=["R", "load"],
    )

    def drive(t):
        return [6 + 4 * jnp.sin(30 * t) + 2 * jnp.sin(83 * t)]

    return Case(model, [11.0, 0.9, 0.03, 0.5], 2e-10, 50.0, 0.5, drive)


def battery() -> Case:
    """With a part of the open-circuit voltage that is exponential in the charge."""
    Q, tau, C, R = 900.0, 8.0, 400.0, 0.02

    def open_circuit(charge):
        return 3.3 + 0.7 * charge - 0.6 * jnp.exp(-14.0 * charge)

    model = Model(
        lambda x, y, u: [-u[0] / Q, -x[1] / tau + u[0] / C],
        None,
        lambda x, y, u: [open_circuit(x[0]) - x[1] - R * u[0] - y[0]],
        states={"charge": (0, 1), "v1": (-0.1, 0.1)},
        outputs={"v": (3, 4)},
        inputs={"i": (-5, 15)},
    )

    def current(t):
        return 6 + 9 * jnp.sin(0.9 * t) + 4 * jnp.sin(2.3 * t)

    def signals(t, s):
        return s, [open_circuit(s[0]) - s[1] - R * current(t)], [current(t)]

    def rate(t, s):
        return [-current(t) / Q, -s[1] / tau + current(t) / C]

    return Case(model, [0.3, 0.03], 2e-6, 1.0, 20.0, signals=signals, rate=rate, since=0.1)


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


CASES: dict[str, Callable[[], Case]] = {
    "buck": buck,
    "boost": boost,
    "cuk": cuk,
    "levitation": levitation,
    "synrm": synrm,
    "pmsm": pmsm,
    "dc_motor_from_speed": dc_motor_from_speed,
    "dc_motor_from_current": dc_motor_from_current,
    "battery": battery,
    "two_tanks": two_tanks,
    "chemostat": chemostat,
    "vehicle": vehicle,
    "unicycle": unicycle,
    "van_der_pol": van_der_pol,
    "van_der_pol_from_speed": lambda: van_der_pol("speed"),
    "lorenz_from_x1": lambda: lorenz(1),
    "lorenz_from_x2": lambda: lorenz(2),
    "lorenz_from_x3": lambda: lorenz(3),
    "epidemic": epidemic,
    "drone": drone,
}
CHANGED: dict[str, Callable[[], Case]] = {
    "drone_quadratic": lambda: drone("quadratic"),
    "tube": tube,
    "cart_pole": cart_pole,
    "rigid_body": rigid_body,
}
