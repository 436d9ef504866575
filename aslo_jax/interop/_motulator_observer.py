"""An observer behind the protocol of motulator's."""

import cmath
import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._checks import counted, positive
from ..observers import Staged

__all__ = ["MotulatorObserver", "MotulatorOutputs"]


@dataclasses.dataclass
class MotulatorOutputs:
    """What a [`MotulatorObserver`][] gives at an instant, by the names of motulator's own
    `ObserverOutputs`; vectors are complex, in the coordinates of the estimated rotor.

    - `u_dc`, `u_s`: of motulator's controller (V); `u_s_zoh`: over the period that begins;
    - `i_s`: the stator current (A); `psi_s`: the estimated stator flux (Wb);
    - `tau_M`: the torque (Nm), of these;
    - `theta_m`, `theta_c`: the electrical angle of the rotor (rad), in one turn;
    - `w_m`, `w_c`, `w_M`: its speed, electrical twice and mechanical (rad/s);
    - `psi_f`: the magnet flux that is assumed (Wb);
    - `certificate`, `coasting`: of the flux, as of an [`Estimate`][];
    - `e_o`, `eps`, `eps_f`, `psi_a`, `tau_L`, `h`, `caught`: zero, for there are none.
    """

    u_dc: float = 0.0
    i_s: complex = 0j
    u_s: complex = 0j
    u_s_zoh: complex = 0j
    psi_s: complex = 0j
    e_o: complex = 0j
    eps: float = 0.0
    eps_f: float = 0.0
    psi_a: complex = 0j
    tau_M: float = 0.0
    tau_L: float = 0.0
    w_c: float = 0.0
    w_m: float = 0.0
    w_M: float = 0.0
    theta_c: float = 0.0
    theta_m: float = 0.0
    psi_f: float = 0.0
    h: float = 0.0
    caught: bool = False
    certificate: float = 0.0
    coasting: bool = True


class MotulatorObserver:
    """An observer of ours in the loop of motulator 0.18, in place of the sensorless
    `SpeedFluxObserver` of a vector controller: `controller.observer = ...`.

    - `observer`: of the stator flux (Wb), followed by a phase-locked loop, as
      [`track_angle`][aslo_jax.observers.track_angle] makes it;
    - `pole_pairs`: of the machine;
    - `magnet_flux`: of the machine (Wb), for the output `psi_f`.

    At an instant motulator gives the voltage over the period that begins; a step here takes
    the one over the period that ended, which is kept until then. An unknown voltage, of
    blocked gates, is a missing sample, over which the estimate coasts. The angle that
    motulator is told is the estimated one at the instant.

    Used once for each run: it keeps the state, as motulator's own does.

    **Raises:** `ValueError` for an observer without such a loop, and in a step for the
    error of a measured angle, `h`, which it does not take.
    """

    def __init__(self, observer: Staged, pole_pairs: int, magnet_flux: float) -> None:
        if not isinstance(observer, Staged):
            raise ValueError(
                "Argument `observer` must be one of the flux that is followed by a "
                "phase-locked loop, as `track_angle(observer, bandwidth, inductance)` is, "
                f"but is a {type(observer).__name__}."
            )
        positive("magnet_flux", magnet_flux, "Wb")
        self.pole_pairs = counted("pole_pairs", pole_pairs)
        self.magnet_flux = float(magnet_flux)
        self._observer = observer
        self._step = eqx.filter_jit(observer.step)
        self._state: Any = None
        self._before = np.zeros(2)  # the voltage over the period that ends
        self._period: float | None = None
        self._estimate: Any = None

    @property
    def theta_m(self) -> float:
        """The electrical angle of the last output (rad)."""
        return 0.0 if self._estimate is None else self._angle_and_speed()[0]

    @property
    def w_M(self) -> float:
        """The mechanical speed of the last output (rad/s)."""
        return (
            0.0 if self._estimate is None else self._angle_and_speed()[1] / self.pole_pairs
        )

    def _angle_and_speed(self) -> tuple[float, float]:
        angle, speed = np.asarray(self._estimate["second"].value)
        return cmath.phase(cmath.exp(1j * angle)), float(speed)

    def compute_output(
        self,
        u_s_ab: complex | None,
        i_s_ab: complex,
        eps_ext: float = 0.0,
        h: float = 0.0,
    ) -> MotulatorOutputs:
        """What is known at an instant.

        - `u_s_ab`: the stator voltage over the period that begins, alpha and beta as a
          complex number (V), or `None` where it is unknown;
        - `i_s_ab`: the stator current at the instant (A);
        - `eps_ext`, `h`: of a measured angle, for which there is no use here.
        """
        if h != 0:
            raise ValueError(
                "Argument `h` must be 0, since this observer is sensorless: set "
                "`sensorless=True` in the configuration of the controller."
            )
        del eps_ext
        y = jnp.array([i_s_ab.real, i_s_ab.imag])
        if self._state is None:
            u = jnp.zeros(2)
            self._state = self._observer.init(y, u)
            self._estimate = self._observer.estimate(jnp.zeros(()), self._state, u, y)
        elif self._period is not None:
            given = self._state, jnp.asarray(self._before), y, self._period
            self._state, self._estimate = self._step(*given)
            self._period = None
        return self._output(u_s_ab, i_s_ab)

    def _output(self, u_s_ab: complex | None, i_s_ab: complex) -> MotulatorOutputs:
        self._given = u_s_ab
        theta, speed = self._angle_and_speed()
        turn = cmath.exp(-1j * theta)
        flux = self._estimate["first"]
        psi_s = turn * complex(*np.asarray(flux.value))
        i_s = turn * i_s_ab
        known = 1j * speed * psi_s if u_s_ab is None else turn * u_s_ab
        return MotulatorOutputs(
            i_s=i_s,
            u_s_zoh=known,
            psi_s=psi_s,
            tau_M=1.5 * self.pole_pairs * (i_s * psi_s.conjugate()).imag,
            w_c=speed,
            w_m=speed,
            w_M=speed / self.pole_pairs,
            theta_c=theta,
            theta_m=theta,
            psi_f=self.magnet_flux,
            certificate=float(flux.certificate),
            coasting=bool(flux.coasting),
        )

    def update(self, T_s: float, out: MotulatorOutputs) -> None:
        """A period of `T_s` seconds begins, with the voltage that was given last, with
        which `out` was put out."""
        del out
        u = complex(np.nan, np.nan) if self._given is None else self._given
        self._before = np.array([u.real, u.imag])
        self._period = T_s
