"""Observers: the protocol, the algebraic ones, their peers, and compositions."""

from .algebraic import AlgebraicObserver as AlgebraicObserver
from .asymptotic import Asymptotic as Asymptotic
from .base import (
    AbstractObserver as AbstractObserver,
    Estimate as Estimate,
    ObserverState as ObserverState,
)
from .compose import SideBySide as SideBySide, Staged as Staged
from .kalman import SteadyStateKalman as SteadyStateKalman
from .luenberger import ReducedLuenberger as ReducedLuenberger
from .pll import PhaseLockedLoop as PhaseLockedLoop, wrap as wrap
