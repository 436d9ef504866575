"""Disturbances between controller, plant and observers, as modules."""

from ._base import (
    AbstractDisturbance as AbstractDisturbance,
    AbstractMemoryless as AbstractMemoryless,
    AbstractSampled as AbstractSampled,
    DisturbanceState as DisturbanceState,
)
from ._bias import Bias as Bias, Drift as Drift, RandomWalk as RandomWalk
from ._chain import Chain as Chain
from ._dead_time import DeadTime as DeadTime
from ._delay import Delay as Delay
from ._gain import GainError as GainError
from ._lag import ParasiticLag as ParasiticLag
from ._missing import MissingSamples as MissingSamples
from ._noise import SampledNoise as SampledNoise, held_index as held_index
from ._quantisation import Encoder as Encoder, Quantisation as Quantisation
from ._saturation import Saturation as Saturation
from ._sinusoid import Sinusoid as Sinusoid
from ._streams import check_streams as check_streams

__all__ = [
    "AbstractDisturbance",
    "AbstractMemoryless",
    "AbstractSampled",
    "Bias",
    "Chain",
    "DeadTime",
    "Delay",
    "DisturbanceState",
    "Drift",
    "Encoder",
    "GainError",
    "MissingSamples",
    "ParasiticLag",
    "Quantisation",
    "RandomWalk",
    "SampledNoise",
    "Saturation",
    "Sinusoid",
    "check_streams",
    "held_index",
]
