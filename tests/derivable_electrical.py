"""Converters, motors, a coil and a battery, whose observers are derived."""

import jax.numpy as jnp
from derivable_case import GRAVITY, Case, around

from aslo_jax.derivation import Model


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
