"""Results of motulator as a log."""

from typing import Any

import numpy as np

from ..logs import Log

__all__ = ["from_motulator"]

# Of the instants of the controller, which the model's are to hold (s, relative to the
# sampling period).
SAME = 1e-6


def from_motulator(results: Any, *, missing: str = "refuse") -> Log:
    """A [`Log`][] of a simulated drive of motulator 0.18: what its controller sampled and
    commanded, in the stationary frame, and the truth of its model at the same instants.

    - `results`: what `Simulation.simulate` gave, of one drive without an LC filter; or
      anything with the same attributes, `ctrl.t`, `ctrl.fbk.i_s`, `ctrl.fbk.u_s_zoh`,
      `ctrl.fbk.theta_c`, `ctrl.ref.enabled`, and for the truth `mdl.t`,
      `mdl.machine.psi_s_ab`, `theta_m` (not of an induction machine) and `w_M`;
    - `missing`: what is done of the voltages that are not known, as in [`read_log`][].

    u is `u_s_zoh`, the voltage over the period that begins at the instant; `u_s` is a mean
    with the period before and is not read. Both series are in the coordinates of the
    controller, and turned by `theta_c`. While the gates are blocked, and over the period
    after their release, u is not known and missing.

    The truth is `flux_alpha`, `flux_beta`, `theta_electrical` and `omega_mechanical`.

    **Raises:** `ValueError` for results of another structure; [`LogError`][] as
    [`Log.from_columns`][].
    """
    ctrl, mdl = (_found(results, name) for name in ("ctrl", "mdl"))
    if getattr(mdl, "lc_filter", None) is not None:
        raise ValueError(
            "Argument `results` must be of a drive without an LC filter, behind which the "
            "voltage of the machine is not the one that the controller commands."
        )
    feedback = _found(ctrl, "fbk", "ctrl.fbk")
    i_s, u_s, angle = (
        np.asarray(_found(feedback, name, f"ctrl.fbk.{name}"))
        for name in ("i_s", "u_s_zoh", "theta_c")
    )
    turn, t = np.exp(1j * angle), np.asarray(_found(ctrl, "t"), float)
    enabled = np.asarray(_found(_found(ctrl, "ref"), "enabled", "ctrl.ref.enabled"), bool)
    known = enabled & np.concatenate([[True], enabled[:-1]])
    u, y = np.where(known, turn * u_s, complex(np.nan, np.nan)), turn * i_s
    columns = {"t": t, "u_alpha": np.real(u), "u_beta": np.imag(u)}
    columns |= {"i_alpha": np.real(y), "i_beta": np.imag(y)}
    machine, rows = _found(mdl, "machine"), _rows(mdl, t)
    flux = np.asarray(_found(machine, "psi_s_ab"))[rows]
    columns |= {"flux_alpha": np.real(flux), "flux_beta": np.imag(flux)}
    if (theta := getattr(machine, "theta_m", None)) is not None and np.size(theta):
        columns["theta_electrical"] = np.unwrap(np.asarray(theta, float)[rows])
    columns["omega_mechanical"] = np.asarray(_found(machine, "w_M"), float)[rows]
    return Log.from_columns(columns, missing=missing)


def _found(of: Any, name: str, path: str = "") -> Any:
    found = getattr(of, name, None)
    if found is None:
        raise ValueError(
            "Argument `results` must be results of motulator 0.18, of one drive, but has "
            f"no `{path or name}`; of a composite model give the part of one drive, as "
            "SimpleNamespace(mdl=..., ctrl=...)."
        )
    return found


def _rows(mdl: Any, t: np.ndarray) -> np.ndarray:
    """Where the instants of the controller are among those of the model, of equal ones the
    first."""
    instants = np.asarray(_found(mdl, "t", "mdl.t"), float)
    period = float(np.median(np.diff(t)))
    rows = np.searchsorted(instants, t - SAME * period)
    rows = np.minimum(rows, instants.size - 1)
    off = np.abs(instants[rows] - t)
    if np.max(off) > 2.0 * SAME * period:
        k = int(np.argmax(off))
        raise ValueError(
            "Argument `results` must hold the model at the instants of the controller, but "
            f"does not at t = {t[k]:g} s; give the whole of `mdl`, as it was simulated."
        )
    return rows
