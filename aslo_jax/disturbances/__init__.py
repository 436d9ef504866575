"""Disturbances between controller, plant and observers, as modules."""

from .base import (
    AbstractDisturbance as AbstractDisturbance,
    AbstractMemoryless as AbstractMemoryless,
    AbstractSampled as AbstractSampled,
    DisturbanceState as DisturbanceState,
)
from .bias import Bias as Bias, Drift as Drift, RandomWalk as RandomWalk
from .chain import Chain as Chain
from .dead_time import DeadTime as DeadTime
from .delay import Delay as Delay
from .gain import GainError as GainError
from .lag import ParasiticLag as ParasiticLag
from .missing import MissingSamples as MissingSamples
from .noise import SampledNoise as SampledNoise, held_index as held_index
from .quantisation import Encoder as Encoder, Quantisation as Quantisation
from .saturation import Saturation as Saturation
from .sinusoid import Sinusoid as Sinusoid
from .streams import check_streams as check_streams

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
