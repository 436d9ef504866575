"""The verdict on logs of eight motors: how many right ones raise an alarm, and how many
wrong ones pass in silence or are put down to another cause. The motors, their motions and
what is wrong with a log are those of the tests (tests/motor_logs.py)."""

import collections
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .page import table
from .results import save

FALSE_ALARMS = 0.02  # of right logs, at most
NAMED = 0.9  # of wrong logs, at least
HARMLESS = 0.03  # of the flux: an error that raises no alarm
NOISE = 0.005  # of the rated current, on wrong logs
ROUND = ("stepper",)  # machines without three phases


def main() -> list[str]:
    """Prints the tables; what is out of bounds."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    import motor_logs as logs  # pyright: ignore[reportMissingImports]

    right = collections.Counter(_right(logs))
    wrong: dict[str, collections.Counter] = collections.defaultdict(collections.Counter)
    for cause, outcome in _wrong(logs):
        wrong[cause][outcome] += 1
    alarms = right["alarm"] / right.total()
    print(f"right logs: {right.total()}, of which {right['alarm']} raise an alarm\n")
    head = ("what is wrong", "logs", "named", "undecided", "harmless", "silent")
    head = (*head, "another cause")
    outcomes = ("named", "undecided", "harmless", "silent", "other")
    rows = [
        (cause, str(c.total()), *(str(c[k]) for k in outcomes))
        for cause, c in wrong.items()
    ]
    print(table(head, rows))
    total = sum(c.total() - c["harmless"] for c in wrong.values())
    named = sum(c["named"] for c in wrong.values()) / total
    print(f"\n{100 * named:.3g} % of {total} logs that are wrong and harmed have it named")
    save("verdict", {"right": dict(right), "wrong": {k: dict(c) for k, c in wrong.items()}})
    failures = []
    if alarms > FALSE_ALARMS:
        failures.append(f"{100 * alarms:.2g} % of right logs raise an alarm")
    if named < NAMED:
        failures.append(f"only {100 * named:.3g} % of wrong logs have their cause named")
    return failures


def _right(logs: Any) -> Iterator[str]:
    """Right logs, with noise and with parameters that are off as far as is likely."""
    from aslo_jax.diagnosis import diagnose

    for motor in logs.MOTORS:
        for profile in logs.PROFILES:
            clean = logs.run(motor, profile)
            cases: list[tuple[float, dict[str, float]]] = [(0.0, {}), (0.02, {})]
            cases += [
                (NOISE, {"R": 1.01 * motor.R}),
                (NOISE, {"psi": 1.05 * motor.psi}),
                (NOISE, {"Ld": 1.05 * motor.Ld, "Lq": 1.05 * motor.Lq}),
            ]
            for seed, (noise, changed) in enumerate(cases):
                log = logs.as_log(logs.noisy(clean, motor, seed, noise, noise / 4))
                found = diagnose(log, [motor.circle(**changed)])
                yield "alarm" if found.warnings else "silent"
            log, circle = _in_dq(logs.noisy(clean, motor, 7, NOISE), motor)
            yield "alarm" if diagnose(log, [circle]).warnings else "silent"


def _wrong(logs: Any) -> Iterator[tuple[str, str]]:
    """What is wrong with a log, and whether that is named."""
    from aslo_jax.diagnosis import diagnose

    for motor in logs.MOTORS:
        for seed, profile in enumerate(("rich", "load", "steps")):
            plain = logs.noisy(logs.run(motor, profile), motor, 5 + seed, NOISE)
            for kind, log, changed in _causes(logs, motor, profile, plain):
                found = diagnose(logs.as_log(log), [motor.circle(**changed)])
                yield kind, _outcome(kind, found)
            for kind, changes in _AXES.items():
                log, circle = _in_dq(plain, motor, **changes)
                yield f"{kind} in dq", _outcome(kind, diagnose(log, [circle]))


def _outcome(kind: str, found: Any) -> str:
    kinds = [warning.kind for warning in found.warnings]
    if kind in kinds:
        return "named"
    if any(kind in warning.candidates for warning in found.warnings):
        return "undecided"
    if kinds:
        return "other"
    # Where something explains the log, and costs the flux less than is worth a warning.
    return "harmless" if found.figures.get("flux_error", 1.0) < HARMLESS else "silent"


_AXES = {
    "q_sign": {"flipped": True},
    "angle_sign": {"factor": -1.0},
    "angle_kind": {"mechanical": True},
}


def _in_dq(
    x: Any,
    motor: Any,
    flipped: bool = False,
    factor: float = 1.0,
    mechanical: bool = False,
) -> tuple[Any, Any]:
    """A log in dq, turned by an angle that is multiplied by `factor`, or the mechanical one
    taken as electrical; its current's q `flipped`."""
    from aslo_jax.logs import Frame, Log

    back = np.exp(-1j * x["angle"])
    u, i = x["u"] * back, x["i"] * back
    angle = factor * x["angle"] / (motor.pole_pairs if mechanical else 1)
    on = np.exp(1j * angle)
    pair = lambda z: np.stack([z.real, z.imag], axis=1)
    log = Log(x["t"], pair(u * on), pair((i.conj() if flipped else i) * on), {}, angle)
    frame = Frame("dq", "theta", pole_pairs=motor.pole_pairs)
    return log, motor.circle().read_from(frame, {})


def _causes(logs: Any, motor: Any, profile: str, x: Any) -> Iterator[tuple[str, Any, dict]]:
    u, i = x["u"], x["i"]
    yield "sign", x | {"i": -i}, {}
    yield "current_unit", x | {"i": 1e3 * i}, {}
    yield "voltage_scale", x | {"u": u / 37}, {}
    yield "beta_flipped", x | {"i": i.conj()}, {}
    yield "axes_swapped", x | {"i": 1j * i.conj()}, {}
    yield "offset", x | {"i": i + 0.05 * motor.current}, {}
    yield "voltage_timing", x | {"u": logs.late(u, 1)}, {}
    yield "voltage_timing", x | {"u": logs.late(u, 2)}, {}
    yield "outliers", logs.spiked(x, 1234, 10 * motor.current), {}
    yield "lost_rows", logs.without(x, slice(1500, 1530)), {}
    yield "missing_rows", logs.dropped(x, 1), {}
    yield "resistance", x, {"R": 1.4 * motor.R}
    yield "resistance", x, {"R": 0.5 * motor.R}
    yield "inductance_unit", x, {"Ld": 1e3 * motor.Ld, "Lq": 1e3 * motor.Lq}
    volts = 0.04 * float(np.sqrt(np.mean(np.abs(u) ** 2)))
    dead = logs.run(motor, profile, dead=volts)
    yield "dead_time", logs.noisy(dead, motor, 5, NOISE), {}
    if motor.kind in ROUND:
        return
    yield "phases_a_b", x | {"u": logs.swapped(u), "i": logs.swapped(i)}, {}
    yield "power_invariant", x | {"u": 1.5**0.5 * u}, {}
    yield "power_invariant", x | {"u": 1.5**0.5 * u, "i": 1.5**0.5 * i}, {}
    for k in (2.0, 3.0):
        changed = {"R": k * motor.R, "Ld": k * motor.Ld, "Lq": k * motor.Lq}
        yield "line_to_line", x, changed
