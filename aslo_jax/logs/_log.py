"""A recorded run in memory."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from ._error import Columns
from ._frame import Frame
from ._missing import MOST
from ._signals import MOTOR, Signals


@dataclasses.dataclass(frozen=True)
class Log:
    """A recorded run of `N` rows.

    - `t`: sampling instants (s), shape `(N,)`, strictly increasing;
    - `u`: mean inputs over `[t[k], t[k+1])`, shape `(N, m)`, the optional ones last where
      the file has them; for a motor the stator voltage (V), m = 2;
    - `y`: outputs at `t[k]`, shape `(N, n)`; for a motor the stator current (A), n = 2;
    - `truth`: the truth columns that the file has, each of shape `(N,)`.
    """

    t: Float[np.ndarray, " N"]
    u: Float[np.ndarray, "N m"]
    y: Float[np.ndarray, "N n"]
    truth: Columns

    @staticmethod
    def from_columns(
        data: Any,
        signals: Signals = MOTOR,
        *,
        columns: Mapping[str, str] | None = None,
        truth: bool = True,
        max_gap: float | None = None,
        frame: Frame | str = "alpha-beta",
        missing: str = "refuse",
        most_missing: int = MOST,
    ) -> "Log":
        """A log from columns in memory, found by name as those of a file are.

        - `data`: a mapping of names to arrays, `(N,)` or, with columns called `name[0]`,
          `name[1]`, `(N, n)`; a pandas `DataFrame`, whose index is a column if it has a
          name; or an xarray `Dataset`, whose variables may have the attribute `units`;
        - `signals`, `columns`, `truth`, `max_gap`, `frame`, `missing`, `most_missing`: as
          [`read_log`][] takes them.

        **Raises:** `LogError` as `read_log` does.
        """
        from ._memory import in_memory
        from ._reader import LogReader

        reader = LogReader(
            in_memory(data),
            signals,
            columns=columns,
            truth=truth,
            max_gap=max_gap,
            frame=frame,
            missing=missing,
            most_missing=most_missing,
        )
        (log,) = reader.pieces(reader.t.size)
        return log
