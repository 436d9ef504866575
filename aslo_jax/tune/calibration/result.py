"""What a calibration found, how surely, and what the record cannot say."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True)
class Undetermined:
    """A direction in the parameters along which the record says too little.

    - `parts`: by parameter, its relative share, the largest of size one;
    - `deviation`: standard deviation along it, relative; infinite where it is flat.
    """

    parts: Mapping[str, float]
    deviation: float

    def __str__(self) -> str:
        return " ".join(
            f"{'-' if share < 0 else '+' if k else ''}{'' if not k else ' '}"
            f"{'' if abs(share) > 0.995 else f'{abs(share):.2g} '}{name}"
            for k, (name, share) in enumerate(self.parts.items())
        )


@dataclasses.dataclass(frozen=True)
class Calibration:
    """The outcome of [`calibrate`][].

    - `model`: what was calibrated, with its new parameters. Along an undetermined
      direction it stays where it was;
    - `before`, `after`: by name, in the units of the parameters; `after` is NaN for one
      that is not determined;
    - `interval`: by name, (low, high), which holds the true value with the `confidence`, if
      the model is right; NaN as `after`;
    - `undetermined`: directions that the record does not determine;
    - `output_noise`: standard deviation of the noise of every output, in its units, shape
      `(p,)`; `drift_noise`: of what disturbs the known derivatives, held from sample to
      sample, in their units, shape `(w,)`;
    - `correlation`: of prediction errors one sample apart: near zero where the model
      explains the record;
    - `rounds`: of the search; `reason`: why it stopped.
    """

    model: Any
    before: dict[str, float]
    after: dict[str, float]
    interval: dict[str, tuple[float, float]]
    undetermined: tuple[Undetermined, ...]
    confidence: float
    output_noise: Float[np.ndarray, " p"]
    drift_noise: Float[np.ndarray, " w"]
    correlation: float
    rounds: int
    reason: str

    def rows(self) -> list[tuple[str, str, str, str]]:
        """A table: parameter, before, after, and its interval or why there is none."""
        found = []
        for name, before in self.before.items():
            after, (low, high) = self.after[name], self.interval[name]
            if np.isfinite(after):
                half = 0.5 * (high - low)
                size = f" ({100 * half / abs(after):.2g} %)" if after else ""
                found.append(
                    (name, f"{before:.6g}", f"{after:.6g}", f"+- {half:.2g}{size}")
                )
            else:
                along = [str(d) for d in self.undetermined if name in d.parts]
                why = f"not determined by this record (flat: {'; '.join(along)})"
                found.append((name, f"{before:.6g}", "", why))
        return found

    def __str__(self) -> str:
        head = ("parameter", "before", "after", f"interval ({100 * self.confidence:g} %)")
        table = [head, *self.rows()]
        widths = [max(len(row[k]) for row in table) for k in range(3)]
        lines = []
        for row in table:
            cells = [row[0].ljust(widths[0])]
            cells += [row[k].rjust(widths[k]) for k in (1, 2)]
            lines.append("  ".join([*cells, row[3]]).rstrip())
        return "\n".join(lines)
