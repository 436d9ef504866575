"""What goes into an estimate of a machine and comes out of it: columns and quantities."""

import dataclasses

from ..logs import Signals


@dataclasses.dataclass(frozen=True)
class Quantity:
    """What is estimated, scored and drawn as one.

    - `name`, in words; `columns` of the table of estimates, `unit` of them all;
    - `suffix`: of the columns `certificate` and `coasting` that speak for it;
    - `angle`: whether it is an unwrapped angle (rad);
    - `turns`: whether it turns so often in a log that it is drawn in close-ups;
    - `tracks`: the column of the angle (rad) whose phase-locked loop gives it; every other
      column comes from [`AbstractDescription.columns`][].
    """

    name: str
    columns: tuple[str, ...]
    unit: str
    suffix: str = ""
    angle: bool = False
    turns: bool = False
    tracks: str | None = None


@dataclasses.dataclass(frozen=True)
class Layout:
    """The columns in, `signals`, and what is estimated from them, `quantities`, in the
    order of the table of estimates.
    """

    signals: Signals
    quantities: tuple[Quantity, ...]

    def suffixes(self) -> list[str]:
        """Those of the columns `certificate` and `coasting`."""
        return list(dict.fromkeys(quantity.suffix for quantity in self.quantities))


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """The keys of `[machine]` that can be found from a log.

    - `usual`: those that its relation depends on, and that are not simply known; `further`:
      those that are found only if they are asked for;
    - `refused`: why there are none, as the end of a sentence.
    """

    usual: tuple[str, ...] = ()
    further: tuple[str, ...] = ()
    refused: str = ""
