"""The experiments of sections 3.2 and 3.3: the other machines."""

from typing import NamedTuple, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._choices import Winding
from ..._completions import LeastSquares
from ..._filters import LowPass
from ..._module import Module
from ..._simulate import Simulation, simulate
from ...observers import BearingObserver, SelfConsistent
from ...plants import WRIM, InteriorPMSM, MachineState, MagneticBearing, Stepper
from .._batch import batch, solved, tight
from . import settings as s
from .prescribed import PrescribedBearing, PrescribedMachine

WINDINGS: dict[str, slice] = {"stator": slice(0, 2), "rotor": slice(2, 4)}
DEPTHS = np.linspace(0.0, 1.0, 11)  # of the modulation, relative to 30 % of the amplitudes
RATIOS = np.linspace(1.0, 3.0, 9)  # Lq/Ld
ANGLES = np.arange(24) * 2 * np.pi / 24  # of the current from the d axis (rad)
LQ = 40.03e-3  # of the interior PMSM (H)
SALIENT_RATE, CONSISTENT_RATE, CONSISTENT_GAIN = 50.0, 70.0, 50.0  # rad/s
FLUX_RATE, VELOCITY_RATE = 80.0, 200.0  # of the bearing's filters (rad/s)


def wrim(load: float = 3.0) -> WRIM:
    """L_s = 0.1 H, L_r = 0.3 H: a wrong index shows."""
    return WRIM(
        stator_resistance=1.3,
        rotor_resistance=0.7,
        stator_inductance=0.1,
        rotor_inductance=0.3,
        mutual_inductance=0.15,
        pole_pairs=2,
        inertia=0.02,
        friction=2e-3,
        load=lambda t: load + 0.0 * t,
    )


def supply(t: Float[Array, ""], depth: float = 0.3) -> Float[Array, " 2"]:
    """A stator voltage (V) of 20 V at 12 rad/s, its amplitude and phase modulated."""
    a = 12 * t + depth * jnp.sin(2 * t)
    return 20 * (1 + depth * jnp.sin(3 * t)) * jnp.stack([jnp.cos(a), jnp.sin(a)])


def shorted_rotor(printed: s.Printed) -> Simulation:
    """Shorted slip rings under the modulated supply, not from rest: without current at the
    start the paper's start has no transient. Estimates of either winding, by name."""
    machine, observers = wrim(), {}
    for winding in get_args(Winding):
        relation = machine.flux_relation(winding)
        observers |= {
            f"{winding}, ASLO": printed.aslo(relation),
            f"{winding}, A-ASLO": printed.a_aslo(relation, initial=np.zeros(2)),
            f"{winding}, exact, Repeat": printed.aslo(relation, start="exact"),
            f"{winding}, exact, least squares": printed.aslo(
                relation, start="exact", completion=LeastSquares()
            ),
        }
    observers["rotor, as printed"] = printed.aslo(
        printed.winding(machine, "rotor"), start="exact", completion=LeastSquares()
    )
    energised = MachineState(
        jnp.array([0.4, -0.2, 0.5, 0.1]), jnp.array(2.0), jnp.array(0.3)
    )
    ts = np.append(np.arange(1001) * 1e-3, 1.0 + np.arange(1, 901) * 1e-2)
    return solved(
        lambda: simulate(
            machine,
            supply,
            observers,
            t1=float(ts[-1]),
            ts=ts,
            initial=energised,
            **tight(),
        )
    )


def winding_error(run: Simulation, name: str) -> np.ndarray:
    """The size of the flux error (Wb) of the winding that `name` begins with."""
    part = WINDINGS[name.split(",")[0]]
    return np.linalg.norm(run.estimates[name].value - run.hidden[..., part], axis=-1)


class Fed(Module):
    """Both windings of a WRIM fed with currents that turn with the fluxes, their amplitudes
    and the speed modulated by `depth`."""

    depth: Float[Array, ""]

    def angle(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """Mechanical (rad)."""
        return 0.75 * t + 0.2 * self.depth * jnp.sin(t) + 0.3

    def current(self, t: Float[Array, ""]) -> Float[Array, " 4"]:
        """Of the windings (A)."""
        a, b = 4.0 * t + 0.2, 2.5 * t - 0.4
        stator = 3.0 + 0.9 * self.depth * jnp.sin(2 * t)
        rotor = 2.0 + 0.6 * self.depth * jnp.cos(3 * t)
        return jnp.concatenate(
            [
                stator * jnp.stack([jnp.cos(a), jnp.sin(a)]),
                rotor * jnp.stack([jnp.cos(b), jnp.sin(b)]),
            ]
        )


def modulation(printed: s.Printed) -> Simulation:
    """Both windings fed with currents that turn with the fluxes, their amplitudes and the
    speed modulated by `DEPTHS`, over which it is batched. Without modulation every flux has
    a constant amplitude."""
    machine = wrim()

    def one(depth):
        fed = Fed(depth)
        motion = PrescribedMachine(machine, fed.angle, fed.current)
        relations = {
            "as printed": printed.winding(machine, "rotor"),
            "corrected": machine.flux_relation("rotor"),
        }
        observers = {
            name: printed.aslo(r, start="exact", completion=LeastSquares())
            for name, r in relations.items()
        }
        ts = np.linspace(0.0, 10.0, 501)
        return simulate(motion, motion.voltage, observers, t1=10.0, ts=ts, **tight())

    return batch(one, DEPTHS)


def relative_by_depth(run: Simulation, name: str) -> np.ndarray:
    """The largest error of the rotor flux over the largest rotor flux, settled (t > 5 s),
    for each of `DEPTHS`."""
    settled = run.t[0] > 5.0
    flux = run.hidden[:, settled, 2:]
    error = np.linalg.norm(run.estimates[name].value[:, settled] - flux, axis=-1)
    return error.max(axis=1) / np.linalg.norm(flux, axis=-1).max(axis=1)


class Salient(NamedTuple):
    """The size of the flux error (Wb) of both forms, shape (ratios, angles, instants)."""

    t: np.ndarray
    dropped: np.ndarray
    consistent: np.ndarray


class Spinning(Module):
    """An interior PMSM at about 150 rad/s (electrical) under a current of `1 + sin 9 t` A
    that turns with the rotor, `ahead` (rad) of its d axis."""

    ahead: Float[Array, ""]

    def frame(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """Of the current (rad, electrical)."""
        return 5 * (30 * t + 0.5 * (1 - jnp.cos(t)))

    def angle(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """Mechanical (rad)."""
        return (self.frame(t) - self.ahead) / 5

    def current(self, t: Float[Array, ""]) -> Float[Array, " 2"]:
        """Of the windings (A)."""
        a = self.frame(t)
        return (1.0 + jnp.sin(9 * t)) * jnp.stack([jnp.cos(a), jnp.sin(a)])


def salient() -> Salient:
    """The current of a [`Spinning`][] machine knows nothing of the angle at which the rotor
    started: it is `ANGLES` away from the d axis. For each of `RATIOS` and `ANGLES`."""
    ts = np.linspace(0.0, 1.2, 241)

    def one(each):
        ratio, ahead = each
        machine = InteriorPMSM(
            resistance=8.875,
            direct_inductance=LQ / ratio,
            quadrature_inductance=LQ,
            magnet_flux=s.MAGNET,
            pole_pairs=5,
            inertia=60e-6,
        )

        spinning = Spinning(ahead)
        motion = PrescribedMachine(machine, spinning.angle, spinning.current)
        observers = {
            "dropped": s.aslo(
                machine.flux_relation(), SALIENT_RATE, "exact", LeastSquares()
            ),
            "consistent": SelfConsistent(
                machine.self_consistent_relation(),
                LowPass(CONSISTENT_RATE),
                CONSISTENT_GAIN,
                jnp.zeros(2),
            ),
        }
        run = simulate(motion, motion.voltage, observers, t1=1.2, ts=ts, **tight())
        return [jnp.linalg.norm(run.error(name), axis=1) for name in observers]

    ratios, angles = np.meshgrid(RATIOS, ANGLES, indexing="ij")
    found = batch(one, (ratios.ravel(), angles.ravel()))
    dropped, consistent = (x.reshape(*ratios.shape, -1) for x in found)
    return Salient(ts, dropped, consistent)


def bearing() -> Simulation:
    """A test motion of the bearing's body by 0.15 mm in a gap of 0.5 mm, with a common part
    of the fluxes that varies; voltages and currents are measured, nothing else."""
    plant = MagneticBearing.laboratory()
    motion = PrescribedBearing(
        plant,
        lambda t: 1e-4 * jnp.sin(40 * t + 0.4) + 5e-5 * jnp.cos(90 * t),
        lambda t: (8e-3) ** 2 * (1 + 0.3 * jnp.sin(60 * t)),
    )
    completions = {"Repeat": None, "least squares": LeastSquares()}
    observers = {
        name: BearingObserver(
            s.aslo(plant.flux_relation(), FLUX_RATE, "exact", completion),
            LowPass(VELOCITY_RATE),
        )
        for name, completion in completions.items()
    }
    ts = np.linspace(0.0, 0.4, 801)
    return solved(
        lambda: simulate(
            motion, motion.voltage, observers, t1=0.4, ts=ts, **tight(atol=1e-14)
        )
    )


def stepper(printed: s.Printed) -> Simulation:
    """A two-phase stepper with currents and motion of test."""
    machine = Stepper.bodson()
    motion = PrescribedMachine(
        machine,
        lambda t: 0.2 * t + 0.05 * (1 - jnp.cos(t)) + 0.1,
        lambda t: jnp.stack([1.2 * jnp.cos(9 * t) + 0.3, (0.8 + 0.3 * t) * jnp.sin(7 * t)]),
    )
    relation = machine.flux_relation()
    observers = {
        "ASLO": printed.aslo(relation),
        "ASLO exact": printed.aslo(relation, start="exact", completion=LeastSquares()),
    }
    ts = np.linspace(0.0, 5.0, 501)
    return solved(
        lambda: simulate(
            motion, motion.voltage, observers, t1=5.0, ts=ts, **tight(atol=1e-14)
        )
    )
