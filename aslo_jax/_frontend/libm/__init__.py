"""Elementary functions without branches, as formulas on scalar expressions."""

from .exponential import ULP as ULP
