"""Differentiable state observers in JAX: algebraic (ASLO), asymptotic, and their peers."""

import importlib as _importlib
from importlib.metadata import version as _version
from typing import TYPE_CHECKING as _TYPE_CHECKING, Any as _Any

from . import (
    control as control,
    datasheet as datasheet,
    disturbances as disturbances,
    filters as filters,
    observers as observers,
    plants as plants,
    random as random,
)
from .completions import (
    AbstractCompletion as AbstractCompletion,
    FilterBank as FilterBank,
    LeastSquares as LeastSquares,
    Repeat as Repeat,
)
from .experiment import Experiment as Experiment, Record as Record
from .filters import (
    AbstractFilter as AbstractFilter,
    LinearFilter as LinearFilter,
    LowPass as LowPass,
)
from .guard import Guard as Guard
from .observers import (
    FO1 as FO1,
    FO2 as FO2,
    FO3 as FO3,
    AbstractObserver as AbstractObserver,
    AlgebraicMagnet as AlgebraicMagnet,
    AlgebraicObserver as AlgebraicObserver,
    Asymptotic as Asymptotic,
    BearingObserver as BearingObserver,
    Estimate as Estimate,
    ExtendedKalman as ExtendedKalman,
    FilteredDerivative as FilteredDerivative,
    HighGain as HighGain,
    Joined as Joined,
    ObserverState as ObserverState,
    OpenLoopIntegrator as OpenLoopIntegrator,
    PhaseLockedLoop as PhaseLockedLoop,
    ReducedLuenberger as ReducedLuenberger,
    SelfConsistent as SelfConsistent,
    SideBySide as SideBySide,
    Staged as Staged,
    SteadyStateKalman as SteadyStateKalman,
    SuperTwisting as SuperTwisting,
    Unwrapped as Unwrapped,
    VelocityObserver as VelocityObserver,
    velocity_observer as velocity_observer,
)
from .realise import Pass as Pass
from .relations import (
    AbstractTerms as AbstractTerms,
    Linear as Linear,
    Quadratic as Quadratic,
    Rate as Rate,
    Row as Row,
    swap as swap,
)
from .replay import replay as replay
from .simulate import Simulation as Simulation, simulate as simulate
from .solvers import RungeKutta4 as RungeKutta4
from .structure import (
    Structure as Structure,
    StructureError as StructureError,
    structure_of as structure_of,
)

if _TYPE_CHECKING:
    from . import engines as engines, metrics as metrics, study as study, tune as tune
    from .engines import (
        Batch as Batch,
        NotFusible as NotFusible,
        Runner as Runner,
        run_batch as run_batch,
    )

__version__ = _version("aslo_jax")

# Imported when they are asked for, since they take as long as all the rest.
_LATER = ("engines", "metrics", "study", "tune")
_OF_ENGINES = ("Batch", "NotFusible", "Runner", "run_batch")


def __getattr__(name: str) -> _Any:
    if name in _LATER:
        return _importlib.import_module(f".{name}", __name__)
    if name in _OF_ENGINES:
        return getattr(_importlib.import_module(".engines", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER, *_OF_ENGINES})
