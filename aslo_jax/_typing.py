"""Names of types that annotations share."""

from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import numpy as np
    from jax import Array
    from jax.typing import ArrayLike

    from ._choices import (
        Average as Average,
        ContinuousEngine as ContinuousEngine,
        DesignName as DesignName,
        Engine as Engine,
        FilterStart as FilterStart,
        Hold as Hold,
        Missing as Missing,
        Mode as Mode,
        RunningEngine as RunningEngine,
        Scale as Scale,
        Stopped as Stopped,
        UsedMode as UsedMode,
        Winding as Winding,
    )

    # jaxtyping leaves it unknown to type checkers, and with it all that is made of it.
    PyTree: TypeAlias = Any
    # What is converted to an array of real numbers.
    Numbers: TypeAlias = ArrayLike
    # An array in a method whose protocol says its shape.
    RealArray: TypeAlias = Array
    HostArray: TypeAlias = np.ndarray[Any, np.dtype[Any]]
else:
    from jaxtyping import PyTree as PyTree

    # While it runs, a word or number that does not fit is refused by a check of its own,
    # with an error that says which ones do.
    Average = DesignName = Engine = FilterStart = Hold = Missing = Mode = str
    ContinuousEngine = RunningEngine = str
    Scale = Stopped = UsedMode = Winding = str
    Numbers = RealArray = HostArray = Any

__all__ = [
    "Average",
    "ContinuousEngine",
    "DesignName",
    "Engine",
    "FilterStart",
    "Hold",
    "HostArray",
    "Missing",
    "Mode",
    "Numbers",
    "PyTree",
    "RealArray",
    "RunningEngine",
    "Scale",
    "Stopped",
    "UsedMode",
    "Winding",
]
