"""Logs of motors with prescribed motion and currents, right and wrong, in closed form: the
held voltage of an interval is the one that takes the flux from sample to sample exactly."""

import dataclasses
import json
from collections.abc import Callable

import numpy as np
import pytest

Columns = dict[str, np.ndarray]
PHASES = np.exp(2j * np.pi / 3 * np.arange(3))


@dataclasses.dataclass(frozen=True)
class Motor:
    """A motor, and how it is run: `speed` electrical (rad/s), `current` (A), `dt` (s)."""

    name: str
    kind: str
    R: float
    Ld: float
    Lq: float
    psi: float
    pole_pairs: int
    speed: float
    current: float
    dt: float

    def circle(self, **changed: float):
        """What its flux satisfies, if its parameters are as they are said to be."""
        from aslo_jax.diagnosis import Circle

        p = dataclasses.replace(self, **changed)
        saliency = p.Ld - p.Lq
        phases = 2 if self.kind == "stepper" else 3
        return Circle("flux", p.R, p.Lq, p.psi, saliency=saliency, phases=phases)


MOTORS = (
    Motor("small", "pmsm", 0.05, 50e-6, 50e-6, 5e-3, 7, 1400.0, 12.0, 5e-5),
    Motor("drone", "pmsm", 0.09, 30e-6, 30e-6, 1.6e-3, 7, 2200.0, 15.0, 4e-5),
    Motor("servo", "pmsm", 2.8, 8e-3, 8e-3, 0.175, 4, 300.0, 2.5, 1e-4),
    Motor("traction", "pmsm", 0.02, 0.4e-3, 0.4e-3, 0.15, 4, 700.0, 120.0, 1e-4),
    Motor("crane", "pmsm", 0.35, 6e-3, 6e-3, 1.3, 10, 110.0, 40.0, 2e-4),
    Motor("salient", "interior_pmsm", 3.6, 36e-3, 51e-3, 0.545, 3, 240.0, 4.0, 1e-4),
    Motor("interior", "interior_pmsm", 0.03, 0.2e-3, 0.55e-3, 0.08, 4, 900.0, 90.0, 5e-5),
    Motor("stepper", "stepper", 0.55, 1.5e-3, 1.5e-3, 3.8e-3, 50, 260.0, 1.2, 1e-4),
)

# Of time over the length of the log: speed (relative), d and q current (relative).
PROFILES: dict[str, tuple[Callable, Callable, Callable]] = {
    "rich": (
        lambda s: 0.8 + 0.3 * np.sin(9 * s),
        lambda s: 0.3 * np.sin(23 * s),
        lambda s: 0.7 + 0.3 * np.sin(15 * s),
    ),
    "start": (
        lambda s: np.minimum(s / 0.4, 1.0),
        lambda s: 0.0 * s,
        lambda s: 0.4 + 0.5 * np.exp(-5 * s),
    ),
    "reversal": (
        lambda s: np.cos(6 * s),
        lambda s: 0.0 * s,
        lambda s: 0.5 * np.sin(6 * s) + 0.3,
    ),
    "load": (
        lambda s: 1.0 + 0.0 * s,
        lambda s: -0.2 + 0.0 * s,
        lambda s: 0.6 + 0.4 * np.sin(11 * s),
    ),
    "steps": (
        lambda s: 0.7 + 0.2 * s,
        lambda s: -0.2 * (s > 0.5),
        lambda s: 0.3 + 0.5 * ((5 * s) % 1 > 0.5),
    ),
    "constant": (lambda s: 1.0 + 0 * s, lambda s: 0.0 * s, lambda s: 0.6 + 0.0 * s),
    "slow": (
        lambda s: 0.1 + 0.03 * np.sin(7 * s),
        lambda s: 0.0 * s,
        lambda s: 0.7 + 0.3 * np.sin(13 * s),
    ),
    "standstill": (lambda s: 0.0 * s, lambda s: 0.0 * s, lambda s: 0.6 + 0.0 * s),
}


def run(motor: Motor, profile: str, rows: int = 4001, dead: float = 0.0) -> Columns:
    """t, u, i (complex, alpha + j beta), the flux, and the electrical angle. `dead`: what
    dead time takes off the voltage of a phase (V); u is then the commanded one."""
    speed, direct, quadrature = PROFILES[profile]
    fine = 16
    t = motor.dt * np.arange(rows)
    s = np.arange((rows - 1) * fine + 1) / ((rows - 1) * fine)
    w = motor.speed * speed(s)
    steps = 0.5 * (w[1:] + w[:-1]) * motor.dt / fine
    angle = 0.7 + np.concatenate([[0.0], np.cumsum(steps)])
    i_d, i_q = (motor.current * f(s) + 0.0 * s for f in (direct, quadrature))
    flux_dq = motor.psi + motor.Ld * i_d + 1j * motor.Lq * i_q
    ends = slice(None, None, fine)
    turn = np.exp(1j * angle)
    flux, i = (flux_dq * turn)[ends], ((i_d + 1j * i_q) * turn)[ends]
    # Inside an interval the flux moves with the held voltage less R i, and i follows it.
    lines = np.arange(fine + 1) / fine
    inside = flux[:-1, None] + np.diff(flux)[:, None] * lines
    index = fine * np.arange(rows - 1)[:, None] + np.arange(fine + 1)
    weights = np.full(fine + 1, 2.0)
    weights[1::2] = 4.0
    weights[0] = weights[-1] = 1.0
    weights /= weights.sum()
    for _ in range(3):
        dq = inside * turn[index].conj()
        current = (dq.real - motor.psi) / motor.Ld + 1j * dq.imag / motor.Lq
        current = current * turn[index]
        drop = motor.R * current
        u = np.diff(flux) / motor.dt + drop @ weights
        rate = u[:, None] - drop
        middle = 0.5 * (rate[:, 1:] + rate[:, :-1]) * motor.dt / fine
        inside = flux[:-1, None] + np.concatenate(
            [np.zeros((rows - 1, 1)), np.cumsum(middle, axis=1)], axis=1
        )
    if dead and motor.kind == "stepper":
        u = u + dead * (np.sign(i.real) + 1j * np.sign(i.imag))[:-1]
    elif dead:
        signs = np.sign((i[:-1, None] * PHASES.conj()).real)
        u = u + dead * 2 / 3 * signs @ PHASES
    u = np.append(u, u[-1])
    return {"t": t, "u": u, "i": i, "flux": flux, "angle": angle[ends]}


def noisy(log: Columns, motor: Motor, seed: int, i: float, u: float = 0.0) -> Columns:
    """With white noise of `i` on the current and `u` on the voltage, relative to the rated
    current and to the typical voltage."""
    generator = np.random.default_rng(seed)
    white = lambda: generator.standard_normal((log["t"].size, 2)) @ np.array([1.0, 1j])
    level = np.sqrt(np.mean(np.abs(log["u"]) ** 2))
    return log | {
        "i": log["i"] + i * motor.current * white(),
        "u": log["u"] + u * level * white(),
    }


def as_log(log: Columns):
    """The log, as it is read from a file."""
    from aslo_jax.logs import Log

    pair = lambda x: np.stack([x.real, x.imag], axis=1)
    return Log(log["t"], pair(log["u"]), pair(log["i"]), {})


def swapped(z: np.ndarray) -> np.ndarray:
    """Phases a and b of alpha + j beta, written where these belong."""
    return z.real + 1j * (-z.real / 2 + np.sqrt(3) / 2 * z.imag)


def late(u: np.ndarray, rows: int) -> np.ndarray:
    """The voltages of some rows before, or after."""
    return u[np.clip(np.arange(u.size) - rows, 0, u.size - 1)]


def instant(log: Columns) -> Columns:
    """The voltages of the instants of the rows."""
    half = 0.5 * np.diff(log["angle"], append=2 * log["angle"][-1] - log["angle"][-2])
    return log | {"u": log["u"] * np.exp(-1j * half)}


def without(log: Columns, rows: slice) -> Columns:
    """Without some rows, of which time tells nothing."""
    kept = np.ones(log["t"].size, bool)
    kept[rows] = False
    cut = {name: x[kept] for name, x in log.items()}
    return cut | {"t": log["t"][: cut["t"].size]}


def spiked(log: Columns, row: int, size: float) -> Columns:
    """With one current that is off."""
    i = log["i"].copy()
    i[row] += size
    return log | {"i": i}


def dropped(log: Columns, seed: int) -> Columns:
    """Without some rows, with the instants of the others."""
    generator = np.random.default_rng(seed)
    kept = generator.random(log["t"].size) > 0.003
    kept[[0, -1]] = True
    return {name: x[kept] for name, x in log.items()}


def described(motor: Motor, path) -> None:
    """Writes the description of a motor without saliency."""
    path.write_text(
        f'[machine]\nkind = "pmsm"\nresistance = {motor.R}\ninductance = {motor.Lq}\n'
        f"magnet_flux = {motor.psi}\npole_pairs = {motor.pole_pairs}\ninertia = 1e-4\n"
    )


def estimated(folder, motor: Motor, columns: dict, *options: str):
    """`aslo-jax estimate` on a log of some columns: its summary for programs, its table."""
    from aslo_jax.cli import main

    log, machine, out, summary = (
        folder / name for name in ("log.npz", "motor.toml", "out.npz", "out.json")
    )
    described(motor, machine)
    np.savez(log, **columns)
    arguments = [log, "--machine", machine, "--out", out, "--json", summary, *options]
    with pytest.raises(SystemExit) as left:
        main(["estimate", *map(str, arguments)])
    assert not left.value.code
    with np.load(out) as table:
        return json.loads(summary.read_text()), dict(table)


def in_alpha_beta(log: Columns) -> dict:
    """The columns of a file."""
    u, i = log["u"], log["i"]
    return dict(t=log["t"], u_alpha=u.real, u_beta=u.imag, i_alpha=i.real, i_beta=i.imag)
