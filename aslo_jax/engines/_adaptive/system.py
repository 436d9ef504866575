"""What is integrated in continuous time."""

from collections.abc import Callable
from typing import Any, NamedTuple

from ..._typing import PyTree


class System(NamedTuple):
    """What is integrated, as functions of the arrays of one lane.

    - `init(arrays) -> state`, a tree; `rate(arrays, t, state)`, its derivative;
    - `record(arrays, t, state)`: a row.
    """

    init: Callable[[PyTree], PyTree]
    rate: Callable[[PyTree, Any, PyTree], PyTree]
    record: Callable[[PyTree, Any, PyTree], PyTree]
