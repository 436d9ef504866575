"""Clarke's and Park's transformation, and their inverses."""

from ._frames import (
    clarke as clarke,
    inverse_clarke as inverse_clarke,
    inverse_park as inverse_park,
    park as park,
)

__all__ = [
    "clarke",
    "inverse_clarke",
    "inverse_park",
    "park",
]
