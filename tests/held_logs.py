"""Logs of every kind of machine, by an independent path: the physics written out for SciPy,
integrated at 1e-10 from sample to sample with the voltages held in between."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

Columns = dict[str, np.ndarray]


def held(rate: Callable, voltage: Callable, x0, dt: float, rows: int, scale):
    """t, x and u of `x' = rate(t, x, u)` with `u = voltage(k, t[k], x)` held. `scale` is
    the size of the entries of x."""
    t = dt * np.arange(rows)
    x, u = np.empty((rows, len(x0))), []
    x[0] = x0
    for k in range(rows):
        u.append(voltage(t[k], x[k]))
        if k + 1 < rows:
            solution = solve_ivp(
                lambda s, x, held=u[k]: rate(s, x, held),
                (t[k], t[k + 1]),
                x[k],
                "DOP853",
                rtol=1e-10,
                atol=1e-12 * np.asarray(scale),
                first_step=t[k + 1] - t[k],
            )
            x[k + 1] = solution.y[:, -1]
    return t, x, np.array(u)


def direction(angle):
    return np.array([np.cos(angle), np.sin(angle)])


def turned(vector, angle):
    """A vector turned forward by an angle."""
    (a, b), c, s = vector, np.cos(angle), np.sin(angle)
    return np.array([c * a - s * b, s * a + c * b])


def motor(
    R: float,
    Ld: float,
    Lq: float,
    m: float,
    pole_pairs: int,
    speed: float,
    current: float,
    dt: float = 1e-4,
    rows: int = 3001,
) -> Columns:
    """A motor that a load machine turns at about `speed` (rad/s, electrical), with d and q
    currents of about `current` (A) that ripple. The flux is a tenth off at the start; the
    angle has turned twice before it."""

    def angle(t):
        return 13.0 + speed * t - 0.1 * speed / 20 * (np.cos(20 * t) - 1)

    def flux(i_d, i_q, theta):
        return turned(np.array([Ld * i_d + m, Lq * i_q]), theta)

    def wanted(t):
        i_d = -0.3 * current * (1 + 0.6 * np.sin(17 * t))
        return i_d, current * (1 + 0.3 * np.sin(31 * t))

    def output(phi, theta):
        d, q = turned(phi, -theta)
        return turned(np.array([(d - m) / Ld, q / Lq]), theta)

    def rate(t, phi, u):
        return u - R * output(phi, angle(t))

    def voltage(t, phi):
        before, after = (flux(*wanted(s), angle(s)) for s in (t, t + dt))
        middle = t + 0.5 * dt
        return (after - before) / dt + R * turned(np.array(wanted(middle)), angle(middle))

    start = 0.9 * flux(*wanted(0.0), angle(0.0))
    t, phi, u = held(rate, voltage, start, dt, rows, [m, m])
    i = np.array([output(p, angle(s)) for s, p in zip(t, phi, strict=True)])
    return {
        "t": t,
        "u_alpha": u[:, 0],
        "u_beta": u[:, 1],
        "i_alpha": i[:, 0],
        "i_beta": i[:, 1],
        "flux_alpha": phi[:, 0],
        "flux_beta": phi[:, 1],
        "theta_electrical": angle(t),
        "omega_mechanical": speed * (1 + 0.1 * np.sin(20 * t)) / pole_pairs,
    }


WRIM = dict(R_s=1.3, R_r=0.7, L_s=0.10, L_r=0.14, L_sr=0.11)


def wrim(fed: bool, dt: float = 1e-4, rows: int = 4001) -> Columns:
    """A wound-rotor machine of `WRIM`, on a supply of 314 rad/s, that a load machine turns
    at 260 rad/s (electrical); slip rings shorted, or `fed`."""
    R_s, R_r, L_s, L_r, L_sr = WRIM.values()
    supply = 314.0

    def angle(t):
        return 0.3 + 260.0 * t - 0.5 * (np.cos(15 * t) - 1)

    def output(phi, theta):
        """From phi_s = L_s i_s + L_sr e^(J theta) i_r and the same for the rotor."""
        phi_s, phi_r = phi[:2], phi[2:]
        sigma = L_s * L_r - L_sr**2
        i_s = (L_r * phi_s - L_sr * turned(phi_r, theta)) / sigma
        i_r = (L_s * phi_r - L_sr * turned(phi_s, -theta)) / sigma
        return np.concatenate([i_s, i_r])

    def rate(t, phi, u):
        i = output(phi, angle(t))
        return u - np.concatenate([R_s * i[:2], R_r * i[2:]])

    def voltage(t, phi):
        u_s = 300 * (1 + 0.1 * np.sin(23 * t)) * direction(supply * (t + 0.5 * dt))
        slip = supply * t - angle(t)
        u_r = 30 * (1 + 0.2 * np.cos(11 * t)) * direction(slip + 0.5) if fed else 0 * u_s
        return np.concatenate([u_s, u_r])

    start = np.array([0.1, -0.85, 0.2, -0.7])
    t, phi, u = held(rate, voltage, start, dt, rows, np.ones(4))
    i = np.array([output(p, angle(s)) for s, p in zip(t, phi, strict=True)])
    names = ("s_alpha", "s_beta", "r_alpha", "r_beta")
    columns = {"t": t}
    columns |= {f"u_{n}": u[:, k] for k, n in enumerate(names) if fed or k < 2}
    columns |= {f"i_{n}": i[:, k] for k, n in enumerate(names)}
    return columns | {f"flux_{n}": phi[:, k] for k, n in enumerate(names)}


BEARING = dict(R_1=2.0, R_2=2.7, gap=0.5e-3, k=2.0e-5, mass=0.8)


def bearing(dt: float = 1e-4, rows: int = 5001) -> Columns:
    """A bearing of `BEARING` whose controller, held between samples, lets the body follow a
    motion of 0.1 mm while the bias varies."""
    R_1, R_2, g, k, mass = BEARING.values()
    R = np.array([R_1, R_2])

    def output(x):
        return 2 / k * np.array([g - x[2], g + x[2]]) * x[:2]

    def rate(t, x, u):
        force = (x[0] ** 2 - x[1] ** 2) / k
        return np.concatenate([u - R * output(x), [x[3], force / mass]])

    def voltage(t, x):
        wanted = 1e-4 * np.sin(40 * t) + 5e-5 * np.cos(90 * t)
        common = 8e-3 * (1 + 0.15 * np.sin(60 * t))
        force = -mass * (300**2 * (x[2] - wanted) + 2 * 300 * x[3])
        share = np.clip(k * force / (4 * common), -0.9 * common, 0.9 * common)
        return R * output(x) + 2500.0 * (np.array([common + share, common - share]) - x[:2])

    start = np.array([8e-3, 7e-3, 3e-5, 0.0])
    t, x, u = held(rate, voltage, start, dt, rows, [1e-2, 1e-2, 1e-4, 1e-2])
    i = np.array([output(row) for row in x])
    names = ("flux_1", "flux_2", "position", "velocity")
    columns = {"t": t, "u_1": u[:, 0], "u_2": u[:, 1], "i_1": i[:, 0], "i_2": i[:, 1]}
    return columns | {name: x[:, j] for j, name in enumerate(names)}


def mechanism(acceleration: Callable, force: Callable, q0, v0, angles, rows: int):
    """A mechanism from q0 at v0, at 1 kHz under held forces; angles in [0, 2 pi)."""
    n = len(q0)

    def rate(t, x, u):
        return np.concatenate([x[n:], acceleration(x[:n], x[n:], u)])

    start = np.array([*q0, *v0], float)
    t, x, u = held(rate, force, start, 1e-3, rows, np.ones(2 * n))
    columns = {"t": t}
    for j in range(n):
        columns[f"q{j + 1}"] = x[:, j] % (2 * np.pi) if angles[j] else x[:, j]
    columns |= {f"u{j + 1}": u[:, j] for j in range(u.shape[1])}
    return columns | {f"qdot{j + 1}_true": x[:, n + j] for j in range(n)}


LEG = dict(m1=2.0, m2=3.1, d1=0.3, d2=0.2, d3=0.5)


def leg(rows: int = 3001) -> Columns:
    """The extensible leg of `LEG`, with friction, which spins at some 3 rad/s."""
    m1, m2, d1, d2, d3 = LEG.values()

    def acceleration(q, v, u):
        return np.array(
            [
                (u[0] - d1 * v[0] + m1 * q[0] * v[1] ** 2) / m1,
                (u[1] - d2 * v[1] - 2 * m1 * q[0] * v[0] * v[1]) / (m1 * q[0] ** 2),
                (-u[1] - d3 * v[2]) / m2,
            ]
        )

    def force(t, x):
        inward = -m1 * x[0] * x[4] ** 2 - 30 * (x[0] - 1) - 6 * x[3]
        return np.array([inward + 8 * np.sin(5 * t), 1.0 + 4 * np.cos(3 * t)])

    return mechanism(
        acceleration, force, [1.1, 0.4, -0.3], [0.2, 3.0, -2.5], (0, 1, 1), rows
    )


BALL = dict(length=1.2, gravity=9.81, d1=0.1, d2=0.3)


def ball(rows: int = 3001) -> Columns:
    """The ball on the beam of `BALL`, which rolls to and fro; the beam crosses zero."""
    length, gravity, d1, d2 = BALL.values()

    def acceleration(q, v, u):
        turning = u[0] - d2 * v[1] - gravity * q[0] * np.cos(q[1]) - 2 * q[0] * v[0] * v[1]
        rolling = q[0] * v[1] ** 2 - gravity * np.sin(q[1]) - d1 * v[0]
        return np.array([rolling, turning / (length**2 + q[0] ** 2)])

    def force(t, x):
        wanted = 0.15 * x[0] + 0.2 * x[2] + 0.1 * np.sin(4 * t)
        return np.array([gravity * x[0] + 40 * (wanted - x[1]) - 10 * x[3]])

    return mechanism(acceleration, force, [0.1, 0.3], [-0.2, 0.6], (0, 1), rows)


def crane(rows: int = 3001) -> Columns:
    """A cart on a spring along an arm that turns, and a wheel on the arm that it drives:
    `CRANE` in the words of the library. The axle of the wheel has friction."""

    def acceleration(q, v, u):
        slip = v[1] - v[2]
        arm = 1.4 * q[0] * v[0] * v[1]
        return np.array(
            [
                (u[0] - 0.2 * v[0] - 9 * (q[0] - 0.5) + 0.7 * q[0] * v[1] ** 2) / 0.7,
                (u[1] - 0.1 * v[1] - 0.05 * slip - arm) / (0.3 + 0.7 * q[0] ** 2),
                (0.4 * u[0] - np.cos(q[0]) * u[1] + 0.05 * slip) / 0.2,
            ]
        )

    def force(t, x):
        return np.array(
            [2 * np.sin(3 * t), 0.6 * np.cos(4 * t) + 0.3 * (2 - x[4]) - 0.02 * x[5]]
        )

    return mechanism(
        acceleration, force, [0.6, 5.2, 0.5], [0.3, 2.0, -3.0], (0, 1, 1), rows
    )


CRANE = """\
import jax.numpy as jnp
from aslo_jax.plants import MechanicalSystem

crane = MechanicalSystem(
    lambda q: jnp.stack([0.7, 0.3 + 0.7 * q[0] ** 2, 0.2]),
    lambda q: 4.5 * (q[0] - 0.5) ** 2,
    lambda q: jnp.array([[1.0, 0.0], [0.0, 1.0], [0.4, -jnp.cos(q[0])]]),
    position=[0.6, 0.2, 0.5],
    friction=lambda q: jnp.array([[0.2, 0, 0], [0, 0.15, -0.05], [0, -0.05, 0.05]]),
    angles=(False, True, True),
)
"""
