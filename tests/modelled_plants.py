"""Plants that are models, each with a motion, its equations written a second time, and what
the theory's page says of the error of its estimate without noise."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from aslo_jax import plants


class Case(NamedTuple):
    """A `plant` that starts at `start`, `None` for its own, under the input `drive(t)`.

    - `figure`: the relative error of every entry of the relation's x, from `since` (s) to
      the `horizon`, with a filter of `cutoff` (rad/s) and the `completion`;
    - `equations(s, u)`: the rates of its state, in NumPy and numbers;
    - `stored(s)`, `flow(s, u)`: what is stored (mostly energy), and its rate.
    """

    plant: Any
    drive: Callable[[Any], Any]
    figure: float
    cutoff: float
    horizon: float
    equations: Callable[[Any, Any], Any]
    stored: Callable[[Any], Any]
    flow: Callable[[Any, Any], Any]
    start: Any = None
    since: float = 0.01
    completion: str = "repeat"


def waves(*inputs: tuple) -> Callable[[Any], Any]:
    """Inputs, each a mean and the (amplitude, frequency in rad/s) of sines."""

    def at(t):
        each = (
            middle + sum(a * jnp.sin(w * t) for a, w in parts) for middle, *parts in inputs
        )
        return jnp.stack([*map(jnp.asarray, each)]) if inputs else jnp.zeros(0)

    return at


def half(*of: float) -> Callable[[Any], Any]:
    """Half the weighted squares of the state."""
    return lambda s: 0.5 * sum(k * x**2 for k, x in zip(of, s, strict=True))


def buck() -> Case:
    return Case(
        plants.Buck(),
        waves((0.5, (0.2, 900.0))),
        *(3e-14, 1500.0, 0.02),
        lambda s, u: (
            np.array([[-500.0, -1e4], [1 / 220e-6, -0.2 / 220e-6]]) @ s
            + np.array([24e4, 0.0]) * u[0]
        ),
        half(100e-6, 220e-6),
        lambda s, u: 24 * u[0] * s[0] - 0.05 * s[0] ** 2 - 0.2 * s[1] ** 2,
    )


def boost() -> Case:
    def equations(s, u):
        off = 1 - u[0]
        A = np.array([[-500.0, -off * 1e4], [off / 330e-6, -0.05 / 330e-6]])
        return A @ s + np.array([12e4, 0.0])

    return Case(
        plants.Boost(),
        waves((0.45, (0.1, 400.0), (0.05, 1300.0))),
        *(3e-14, 600.0, 0.02),
        equations,
        half(100e-6, 330e-6),
        lambda s, u: 12 * s[0] - 0.05 * s[0] ** 2 - 0.05 * s[1] ** 2,
    )


def cuk() -> Case:
    def equations(s, u):
        off = 1 - u[0]
        circuit = [
            [-0.08, -off, 0, 0],
            [off, 0, -u[0], 0],
            [0, u[0], -0.06, -1],
            [0, 0, 1, -0.1],
        ]
        sizes = np.array([300e-6, 47e-6, 200e-6, 220e-6])
        return (np.array(circuit) @ s + np.array([12.0, 0, 0, 0])) / sizes

    return Case(
        plants.Cuk(),
        waves((0.5, (0.1, 900.0), (0.05, 2300.0))),
        *(2e-13, 1000.0, 0.03),
        equations,
        half(300e-6, 47e-6, 200e-6, 220e-6),
        lambda s, u: 12 * s[0] - 0.08 * s[0] ** 2 - 0.06 * s[2] ** 2 - 0.1 * s[3] ** 2,
    )


def synchronous_reluctance() -> Case:
    def currents(s):
        """On the d and q axes, and the turn to the stationary frame."""
        c, n = np.cos(2 * s[3]), np.sin(2 * s[3])
        turn = np.array([[c, -n], [n, c]])
        return turn.T @ s[:2] / np.array([41.5e-3, 6.2e-3]), turn

    def equations(s, u):
        i, turn = currents(s)
        torque = 1.5 * 2 * (41.5e-3 - 6.2e-3) * i[0] * i[1]
        return np.array([*(u - 0.54 * turn @ i), torque / 0.015, s[2]])

    def stored(s):
        i, _ = currents(s)
        magnetic = 0.5 * (41.5e-3 * i[0] ** 2 + 6.2e-3 * i[1] ** 2)
        return 1.5 * magnetic + 0.5 * 0.015 * s[2] ** 2

    def flow(s, u):
        i, turn = currents(s)
        return 1.5 * (u @ turn @ i - 0.54 * i @ i)

    def drive(t):
        angle = 40.0 * t + 1.0
        return 30.0 * jnp.stack([jnp.cos(angle), jnp.sin(angle)])

    plant = plants.SynchronousReluctance()
    start = plants.MachineState(jnp.array([0.3, 0.1]), jnp.asarray(20.0), jnp.asarray(0.2))
    return Case(plant, drive, 2e-9, 60.0, 0.3, equations, stored, flow, start=start)


def dc_motor(*order: int) -> dict[str, Any]:
    """Equations of current and speed, in the order of the state."""
    A = np.array([[-0.6, -0.05], [0.05, -1e-5]]) / np.array([[0.6e-3], [1e-4]])
    sizes = np.array([0.6e-3, 1e-4])[list(order)]

    def equations(s, u):
        rates = A @ s[list(order)] + np.array([u[0] / 0.6e-3, -0.1 / 1e-4])
        return rates[list(order)]

    def flow(s, u):
        i, w = s[list(order)]
        return u[0] * i - 0.6 * i**2 - 1e-5 * w**2 - 0.1 * w

    return {
        "drive": waves((12.0, (4.0, 30.0), (3.0, 83.0))),
        "equations": equations,
        "stored": half(*sizes),
        "flow": flow,
        "figure": 2e-10,
    }


def levitation() -> Case:
    k, m = 1.2e-4, 0.06
    return Case(
        plants.Levitation(),
        waves((4.95, (0.1, 90.0))),
        *(3e-12, 30.0, 0.1),
        lambda s, u: np.array(
            [u[0] - 5 * s[2] * s[0] / k, 9.81 - s[0] ** 2 / (2 * k * m), s[1]]
        ),
        lambda s: s[2] * s[0] ** 2 / (2 * k) + 0.5 * m * s[1] ** 2 - m * 9.81 * s[2],
        lambda s, u: (u[0] - 5 * s[2] * s[0] / k) * s[2] * s[0] / k,
    )


def battery() -> Case:
    def stored(s):
        """The energy of an ideal cell and of its capacitor."""
        line = 3.6406 * s[0] + 0.3859 / 2 * s[0] ** 2
        fading = 1.031 / 35 * np.exp(-35 * s[0])
        return 3060 * (line + fading) + 0.5 * 703.6 * s[1] ** 2

    def flow(s, u):
        opened = 3.6406 + 0.3859 * s[0] - 1.031 * np.exp(-35 * s[0])
        return -opened * s[2] + s[1] * (s[2] - 703.6 / 32.85 * s[1])

    return Case(
        plants.Battery(),
        waves((0.5, (0.8, 0.05), (0.3, 0.13))),
        *(2e-6, 0.07, 300.0),
        lambda s, u: np.array(
            [-s[2] / 3060, s[2] / 703.6 - s[1] / 32.85, (u[0] - s[2]) / 0.5]
        ),
        stored,
        flow,
        since=0.1,
    )


def lateral_vehicle() -> Case:
    def equations(s, u):
        v, r, V, delta = s
        m, inertia, a, b, C = 1573.0, 2873.0, 1.1, 1.58, 160e3
        A = -C / V * np.array([[2 / m, (a - b) / m], [(a - b) / inertia, 0.0]])
        A[1, 1] = -C / V * (a**2 + b**2) / inertia
        A[0, 1] -= V
        rates = A @ [v, r] + C * delta * np.array([1 / m, a / inertia])
        return np.array([*rates, u[0], (u[1] - delta) / 0.1])

    def flow(s, u):
        """The power of the lateral forces of the tyres, as seen from the ground."""
        v, r, V, delta = s
        front = 160e3 * (delta - (v + 1.1 * r) / V)
        rear = 160e3 * -(v - 1.58 * r) / V
        forces = front * (v + 1.1 * r) + rear * (v - 1.58 * r)
        return forces - 1573 * V * r * v

    return Case(
        plants.LateralVehicle(),
        waves((0.0, (1.0, 0.7)), (0.01, (0.04, 2.1))),
        *(3e-8, 5.0, 5.0),
        equations,
        half(1573.0, 2873.0, 0.0, 0.0),
        flow,
    )


def chemostat() -> Case:
    def equations(s, u):
        mu = 0.4 / 3600 * s[1] / (0.5 + s[1])
        return np.array([(mu - u[0]) * s[0], u[0] * (10 - s[1]) - 2 * mu * s[0]])

    return Case(
        plants.Chemostat(),
        waves((6e-5, (2e-5, 2e-4))),
        *(3e-13, 3e-4, 3e4),
        equations,
        lambda s: 2 * s[0] + s[1],  # mass: all that flowed in as feed
        lambda s, u: u[0] * (10 - 2 * s[0] - s[1]),
        since=30.0,  # it takes hours, the page's seconds
    )


def van_der_pol() -> Case:
    return Case(
        plants.VanDerPol(),
        waves((0.0, (0.3, 1.3))),
        *(1e-9, 11.0, 8.0),
        lambda s, u: np.array([(1 - s[1] ** 2) * s[0] - s[1] + u[0], s[0]]),
        half(1.0, 1.0),
        lambda s, u: (1 - s[1] ** 2) * s[0] ** 2 + u[0] * s[0],
    )


def lorenz() -> Case:
    return Case(
        plants.Lorenz(),
        waves(),
        *(2e-11, 10.0, 2.0),
        lambda s, u: np.array(
            [s[2] * (28 - s[1]) - s[0], s[2] * s[0] - 8 / 3 * s[1], 10 * (s[0] - s[2])]
        ),
        half(1.0, 1.0, 1.0),  # of which the products of the motion cancel
        lambda s, u: -(s[0] ** 2) - 8 / 3 * s[1] ** 2 - 10 * s[2] ** 2 + 38 * s[0] * s[2],
    )


def cart_pole() -> Case:
    m, length = 0.1, 0.5

    def speeds(s):
        c = m * length * np.cos(s[3])
        return np.linalg.solve([[1.1, c], [0.0, 1.0]], s[:2])

    def equations(s, u):
        """By the accelerations, the momentum last."""
        (v, w), c, n = speeds(s), np.cos(s[3]), np.sin(s[3])
        M = np.array([[1.1, m * length * c], [m * length * c, 4 / 3 * m * length**2]])
        forces = [
            u[0] - 0.1 * v + m * length * n * w**2,
            m * 9.81 * length * n - 2e-3 * w,
        ]
        a = np.linalg.solve(M, forces)
        momentum = 1.1 * a[0] + m * length * (c * a[1] - n * w**2)
        return np.array([momentum, a[1], v, w])

    def stored(s):
        (v, w), c = speeds(s), np.cos(s[3])
        pole = 0.5 * 4 / 3 * m * length**2 * w**2 + m * length * c * v * w
        return 0.5 * 1.1 * v**2 + pole + m * 9.81 * length * c

    def flow(s, u):
        v, w = speeds(s)
        return (u[0] - 0.1 * v) * v - 2e-3 * w**2

    return Case(
        plants.CartPole(),
        waves((0.0, (3.0, 2.0))),
        *(2e-12, 5.0, 3.0),
        equations,
        stored,
        flow,
        start=[0.3, -0.7, 0.1, 2.8],
    )


def drone() -> Case:
    return Case(
        plants.Drone(),
        waves((9.81, (1.0, 3.0))),
        *(4e-13, 2.0, 3.0),
        lambda s, u: np.array([u[0] - 0.5 * (s[0] - 1.0) - 9.81, s[0]]),
        lambda s: 0.5 * s[0] ** 2 + 9.81 * s[1],
        lambda s, u: (u[0] - 0.5 * (s[0] - 1.0)) * s[0],
        start=[0.5, 2.0],
        since=0.1,  # from where on the wind is told from the speed
    )


CASES: dict[str, Callable[[], Case]] = {
    "Buck": buck,
    "Boost": boost,
    "Cuk": cuk,
    "SynchronousReluctance": synchronous_reluctance,
    "DCMotor": lambda: Case(plants.DCMotor(), cutoff=50.0, horizon=0.5, **dc_motor(1, 0)),
    "DCMotorWithTachometer": lambda: Case(
        plants.DCMotorWithTachometer(), cutoff=1500.0, horizon=0.3, **dc_motor(0, 1)
    ),
    "Levitation": levitation,
    "Battery": battery,
    "LateralVehicle": lateral_vehicle,
    "Chemostat": chemostat,
    "VanDerPol": van_der_pol,
    "Lorenz": lorenz,
    "CartPole": cart_pole,
    "Drone": drone,
}
