"""Studies: an experiment over thousands of samples of its parameters and noises."""

from .designs import DESIGNS as DESIGNS
from .distributions import (
    AbstractDistribution as AbstractDistribution,
    Correlated as Correlated,
    Discrete as Discrete,
    LogNormal as LogNormal,
    Normal as Normal,
    Uniform as Uniform,
)
from .run import open_study as open_study, run as run
from .spread import Parameter as Parameter, Spread as Spread
