"""Differentiable state observers in JAX: algebraic (ASLO), asymptotic, and their peers."""

from importlib.metadata import version as _version

from . import (
    control as control,
    datasheet as datasheet,
    disturbances as disturbances,
    filters as filters,
    metrics as metrics,
    observers as observers,
    plants as plants,
    random as random,
    study as study,
    tune as tune,
)
from .completions import (
    AbstractCompletion as AbstractCompletion,
    FilterBank as FilterBank,
    LeastSquares as LeastSquares,
    Repeat as Repeat,
)
from .engines import (
    Batch as Batch,
    NotFusible as NotFusible,
    Runner as Runner,
    run_batch as run_batch,
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

__version__ = _version("aslo_jax")
