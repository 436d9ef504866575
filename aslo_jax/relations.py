"""Relations between the unmeasured state and measured signals, and their rows."""

from ._relations import (
    AbstractTerms as AbstractTerms,
    Linear as Linear,
    Quadratic as Quadratic,
    Rate as Rate,
    Row as Row,
    Rows as Rows,
    swap as swap,
)

__all__ = [
    "AbstractTerms",
    "Linear",
    "Quadratic",
    "Rate",
    "Row",
    "Rows",
    "swap",
]
