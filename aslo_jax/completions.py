"""Completions: from one row `r'x = b` to an estimate of all n entries of x."""

from ._completions import (
    AbstractCompletion as AbstractCompletion,
    FilterBank as FilterBank,
    LeastSquares as LeastSquares,
    Repeat as Repeat,
)

__all__ = [
    "AbstractCompletion",
    "FilterBank",
    "LeastSquares",
    "Repeat",
]
