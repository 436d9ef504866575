"""A run of gym-electric-motor as a log."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._frames import clarke, inverse_park
from ..logs import Log

__all__ = ["from_gem"]

KINDS = ("SynchronousMotorSystem", "SquirrelCageInductionMotorSystem")
TURN = 1.0 + 1e-9  # the largest of an angle that is divided by half a turn


def from_gem(env: Any, states: ArrayLike) -> Log:
    """A [`Log`][] of a run of gym-electric-motor 3.0 with a synchronous motor or a squirrel
    cage, in SI units and in the stationary frame.

    - `env`: the environment, also within wrappers of gymnasium;
    - `states`: what its `reset` and then every `step` gave, normalised, shape `(N, n)`: the
      first part of each observation.

    The u of a row there was applied over the interval that *ended* at it; here it stands at
    the row where it begins. A synchronous motor is simulated there with a voltage that is
    constant in d and q over the interval: u is its mean in alpha and beta, by the angle at
    both ends. Its `i_a`, `i_b`, `i_c` are turned by the angle of the row *before*, and are
    not read: y is `i_sd` and `i_sq` turned by `epsilon`. The last u, which is unknown, is
    the one before.

    The truth is `theta_electrical`, `omega_mechanical` and, of a motor with magnets, the
    stator flux.

    **Raises:** `ValueError` for other motors, for states that are filtered away or not
    normalised, and for a switched converter with an interlocking time, of whose voltages
    only the last one of an interval is told.
    """
    inner = env.unwrapped
    system = inner.physical_system.unwrapped
    names = tuple(inner.state_names)
    kinds = [kind.__name__ for kind in type(system).__mro__]
    if not set(kinds) & set(KINDS):
        raise ValueError(
            "Argument `env` must have a synchronous motor or a squirrel-cage induction "
            f"motor, but its system is a {kinds[0]}."
        )
    values = _denormalised(states, names, np.asarray(inner.limits, float))
    _refuse_switched(system)
    t = float(system.tau) * np.arange(len(next(iter(values.values()))))
    if KINDS[0] in kinds:
        return _synchronous(t, values, names, system.electrical_motor.motor_parameter)
    needed = ("i_sa", "i_sb", "i_sc", "u_sa", "u_sb", "u_sc", "epsilon", "omega")
    *phases, angle, speed = _columns(values, names, needed)
    truth = {"theta_electrical": np.unwrap(angle), "omega_mechanical": speed}
    i_abc, u_abc = (np.stack(three, axis=1) for three in (phases[:3], phases[3:]))
    u = np.asarray(clarke(u_abc))[1:]
    return Log(t, np.concatenate([u, u[-1:]]), np.asarray(clarke(i_abc)), truth)


def _synchronous(
    t: np.ndarray,
    values: Mapping[str, np.ndarray],
    names: Sequence[str],
    parameters: Mapping[str, float],
) -> Log:
    needed = ("i_sd", "i_sq", "u_sd", "u_sq", "epsilon", "omega")
    i_d, i_q, u_d, u_q, angle, speed = _columns(values, names, needed)
    angle = np.unwrap(angle)
    half = 0.5 * np.diff(angle)
    # The mean of a vector that turns by 2 half: in the middle, and shorter.
    voltage = np.stack([u_d, u_q], axis=1)[1:] * np.sinc(half / np.pi)[:, None]
    u = inverse_park(voltage, angle[:-1] + half)
    current = np.stack([i_d, i_q], axis=1)
    truth = {"theta_electrical": angle, "omega_mechanical": speed}
    if {"l_d", "l_q", "psi_p"} <= parameters.keys():
        direct = parameters["psi_p"] + parameters["l_d"] * i_d
        flux = np.stack([direct, parameters["l_q"] * i_q], axis=1)
        truth["flux_alpha"], truth["flux_beta"] = inverse_park(flux, angle).T
    u = np.concatenate([u, u[-1:]])
    return Log(t, u, np.asarray(inverse_park(current, angle)), truth, angle)


def _denormalised(
    states: ArrayLike, names: Sequence[str], limits: np.ndarray
) -> dict[str, np.ndarray]:
    found = np.asarray(states, float)
    if found.ndim != 2 or found.shape[1] != len(names) or len(found) < 2:
        raise ValueError(
            f"Argument `states` must have the shape (N, {len(names)}), a row for the reset "
            "and for every step, each the first part of an observation, but has the shape "
            f"{found.shape}."
        )
    angle = np.abs(found[:, names.index("epsilon")]) if "epsilon" in names else np.zeros(1)
    if not np.isfinite(found).all() or np.max(angle) > TURN:
        raise ValueError(
            "Argument `states` must hold the states as `env.step` gives them, finite and "
            "divided by `env.unwrapped.limits`, but epsilon, an angle over half a turn, is "
            f"{np.max(angle):.4g} there."
        )
    return dict(zip(names, (found * limits).T, strict=True))


def _columns(
    values: Mapping[str, np.ndarray], names: Sequence[str], needed: Sequence[str]
) -> list[np.ndarray]:
    lacking = [name for name in needed if name not in values]
    if lacking:
        raise ValueError(
            f"Argument `env` must give the states {', '.join(needed)}, but gives only "
            f"{', '.join(names)}; leave {', '.join(lacking)} in its `state_filter`, and no "
            "wrapper that replaces them."
        )
    return [values[name] for name in needed]


def _refuse_switched(system: Any) -> None:
    converter = system.converter
    parts = [converter, *getattr(converter, "sub_converters", ())]
    waits = any(getattr(part, "_interlocking_time", 0.0) for part in parts)
    if waits and not hasattr(converter.action_space, "low"):
        raise ValueError(
            "Argument `env` must have a converter without `interlocking_time`, or an "
            "averaged one: of a switched one only the last voltage of an interval is told."
        )
