"""What every link of the chain knows: a log that cannot be used, and columns by name."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Columns = dict[str, Float[np.ndarray, " N"]]
Where = Callable[[int], str]  # the place of a row in a file, in words


class LogError(ValueError):
    """A log that cannot be used: names file, row, column and remedy."""
