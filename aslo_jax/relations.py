"""Relations between the unmeasured state and measured signals, and their rows."""

from ._relations import (
    AbstractTerms as AbstractTerms,
    Linear as Linear,
    Quadratic as Quadratic,
    Rate as Rate,
    Row as Row,
    contract as contract,
    filtered_rows as filtered_rows,
    settled as settled,
    swap as swap,
    terms_of as terms_of,
)

__all__ = [
    "AbstractTerms",
    "Linear",
    "Quadratic",
    "Rate",
    "Row",
    "contract",
    "filtered_rows",
    "settled",
    "swap",
    "terms_of",
]
