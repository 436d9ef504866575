"""Filters: the linear laws that an observer's equations are written in."""

from ._filters import (
    AbstractFilter as AbstractFilter,
    AbstractLaw as AbstractLaw,
    Integrator as Integrator,
    LinearFilter as LinearFilter,
    LinearSystem as LinearSystem,
    LowPass as LowPass,
    bias_rejecting as bias_rejecting,
    second_order as second_order,
    sinusoid_rejecting as sinusoid_rejecting,
)

__all__ = [
    "AbstractFilter",
    "AbstractLaw",
    "Integrator",
    "LinearFilter",
    "LinearSystem",
    "LowPass",
    "bias_rejecting",
    "second_order",
    "sinusoid_rejecting",
]
