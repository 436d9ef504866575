"""Studies: an experiment over thousands of samples of its parameters and noises."""

import importlib
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from .._report import write_report as write_report
    from .bound import Bound as Bound, cramer_rao as cramer_rao, with_bound as with_bound
    from .comparison import compare as compare, ranking as ranking
    from .influence import influences as influences
    from .reference import bound_of as bound_of
    from .sensitivity import slopes as slopes, sobol_indices as sobol_indices
    from .statistics import quantile as quantile, summarise as summarise

__all__ = [
    "DESIGNS",
    "AbstractDistribution",
    "Bound",
    "Correlated",
    "Discrete",
    "LogNormal",
    "Normal",
    "Parameter",
    "Spread",
    "Uniform",
    "bound_of",
    "compare",
    "cramer_rao",
    "influences",
    "open_study",
    "quantile",
    "ranking",
    "run",
    "slopes",
    "sobol_indices",
    "summarise",
    "with_bound",
    "write_report",
]

# Evaluation needs scipy.stats, which is slow to import.
_LATER = {
    "Bound": "bound",
    "cramer_rao": "bound",
    "with_bound": "bound",
    "bound_of": "reference",
    "compare": "comparison",
    "ranking": "comparison",
    "influences": "influence",
    "write_report": "._report",
    "slopes": "sensitivity",
    "sobol_indices": "sensitivity",
    "quantile": "statistics",
    "summarise": "statistics",
}


def __getattr__(name: str) -> Any:
    if name in _LATER:
        return getattr(importlib.import_module(f".{_LATER[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_LATER])
