"""The leg and the ball and beam in closed loop, in continuous time: the identities."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..._simulate import Simulation, simulate
from ..._structure import structure_of
from ...observers import AbstractObserver
from ...plants import AbstractMechanicalSystem
from .._batch import batch, solved, tight
from . import settings as s

# From 1 ms on, so that "for all t > 0" is looked at where it is hardest.
INSTANTS = np.unique(
    np.concatenate([[0.0, 1e-3, 3e-3], np.arange(0.01, s.SPAN + 0.005, 0.01)])
)


def simulated(
    mechanism: s.Mechanism,
    observers: dict[str, AbstractObserver],
    system: AbstractMechanicalSystem | None = None,
) -> Simulation:
    """The mechanism (or another `system` from the same start, under the same controller)
    on its true velocities, at 1e-11."""
    plant = mechanism.system if system is None else system
    return simulate(
        plant,
        mechanism.controller(plant),
        observers,
        t1=s.SPAN,
        ts=INSTANTS,
        initial=mechanism.start,
        feedback=s.true_feedback,
        # P2 is driven by an estimate that does not exist yet at t = 0 itself: the first
        # step, which looks there, has to be short.
        **tight(1e-11, 1e-13, first=1e-9),
    )


def _asymptotic(printed: s.Printed, system, proposition: AbstractObserver):
    """P2 on the proposition, which starts from zero, and on the library's exact start."""
    # Unguarded: a guard holds the first guess until rounding is small, some 0.3 us, and P2
    # would be as wrong as it has moved by then, 1e-6.
    exact = printed.aslo(system, guard=None)
    each = {"paper": proposition, "exact": exact}
    return {k: printed.a_aslo(observer, system, s.GAINS) for k, observer in each.items()}


def _named(run: Simulation[Any], proposition: str) -> Simulation:
    """The run with an estimate for each observer and gain, by name."""
    found = dict(run.estimates)
    for start, name in (("paper", proposition), ("exact", "ASLO, exact")):
        both = found.pop(start)
        found[name] = both["ASLO"]
        for k, gain in enumerate(s.GAINS):
            found[f"A-ASLO {gain:g}, {start}"] = jax.tree.map(
                lambda x, k=k: x[:, k], both["A-ASLO"]
            )
    return eqx.tree_at(lambda run: run.estimates, run, found)


def leg(printed: s.Printed) -> Simulation:
    """The robotic leg: Prop. 4 as printed, with its denominator corrected, and with the
    sign of q3' corrected too, which P2 smooths; the library's ASLO and P2 on it."""
    mechanism = s.leg()
    system = mechanism.system
    corrected = printed.leg(system, s.RATE, "F[1/z1]", -1)
    observers = {
        "Prop. 4": printed.leg(system, s.RATE),
        "Prop. 4, F[1/z1]": printed.leg(system, s.RATE, "F[1/z1]"),
        **_asymptotic(printed, system, corrected),
    }
    run = solved(lambda: simulated(mechanism, observers))
    return _named(run, "Prop. 4, corrected")


def ball(printed: s.Printed) -> Simulation:
    """The ball and beam: Prop. 5, the library's ASLO, and P2 on both."""
    mechanism = s.ball()
    proposition = printed.ball(mechanism.system, s.RATE)
    observers = _asymptotic(printed, mechanism.system, proposition)
    return _named(solved(lambda: simulated(mechanism, observers)), "Prop. 5")


def friction(printed: s.Printed) -> tuple[Simulation, Simulation]:
    """The leg with constant friction, integrated, and with friction that varies with its
    length, in the bounded form; each also with friction left out."""
    mechanism = s.leg()
    forms = {
        "integrated": structure_of(s.leg_with_friction(0.0)),
        "bounded": structure_of(s.leg_with_friction(1.0)),
        "left out": structure_of(mechanism.system),
    }

    def run(weight):
        system = s.leg_with_friction(weight)
        observers = {k: printed.aslo(system, form=form) for k, form in forms.items()}
        return simulated(mechanism, observers, system)

    both = batch(run, np.array([0.0, 1.0]))

    def without(name, k):
        found = jax.tree.map(lambda x: x[k], both)
        rest = {k: e for k, e in found.estimates.items() if k != name}
        return eqx.tree_at(lambda run: run.estimates, found, rest)

    return without("bounded", 0), without("integrated", 1)


def error(run: Simulation, name: str) -> np.ndarray:
    """Estimate less truth, shape (N, n)."""
    return np.asarray(run.estimates[name].value - run.hidden)


def size(run: Simulation, name: str) -> np.ndarray:
    """The largest error of the velocities at each instant (their units differ), shape
    (N,)."""
    return np.abs(error(run, name)).max(axis=1)
