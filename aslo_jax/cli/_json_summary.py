"""The summary of `aslo-jax estimate` for programs: every figure by a stable key."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from ..machines._lifted import is_lifted
from ._running import Done


def summary_of(done: Done) -> dict[str, Any]:
    """`warnings`, a list of `{"kind", "message", "rows"}`; `columns` of the table;
    `log`, `machine`, `rates` (rad/s), `noise` of a Kalman filter, `coasting` by suffix,
    `quantities` with their figures and `diagnosis`, the figures behind the verdict. What is
    not finite is null."""
    summary = done.summary
    reader, machine = summary.reader, summary.machine
    t = reader.t
    return _finite(
        {
            "warnings": done.warned(),
            "columns": list(done.columns),
            "log": {
                "file": str(reader.path),
                "rows": int(t.size),
                "duration": float(t[-1] - t[0]),
                "interval": float(reader.interval),
                "offset_removed": _offset(reader.offset),
            },
            "machine": machine.kind,
            "substeps": summary.substeps,
            "noise": _noise(summary),
            "smoothed": summary.smoothed,
            "rates": {name: rate.as_json() for name, rate in summary.rates.items()},
            "coasting": {
                suffix.removeprefix("_"): {
                    "rows": rows,
                    "share": rows / t.size,
                    "settled": summary.settled.get(suffix),
                }
                for suffix, rows in summary.coasting.items()
            },
            "scored": summary.scored,
            "quantities": {q.name: _figures(done, q) for q in machine.quantities},
            "diagnosis": dict(done.diagnosis.figures),
            "notes": [*reader.unread, *done.diagnosis.notes],
        }
    )


def write_json(path: Path, done: Done) -> None:
    """Write [`summary_of`][] to `path`."""
    text = json.dumps(summary_of(done), indent=2, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def _offset(removed: Any) -> dict[str, list[float]] | None:
    """Alpha and beta of voltage (V) and current (A)."""
    if removed is None:
        return None
    u, i = removed.voltage, removed.current
    return {"voltage": [u.real, u.imag], "current": [i.real, i.imag]}


def _noise(summary: Any) -> dict[str, Any]:
    """The deviations of a Kalman filter, and which of them come from the log."""
    settings, names = summary.machine.observer, ("output_deviation", "input_deviation")
    if not is_lifted(settings):
        return {}
    values = {name: np.atleast_1d(getattr(settings, name)).tolist() for name in names}
    return values | {"found": list(summary.noise)}


def _figures(done: Done, quantity: Any) -> dict[str, Any]:
    summary = done.summary
    figures: dict[str, Any] = {"unit": quantity.unit}
    if kept := summary.relative.get(quantity.name):
        x = np.concatenate(kept)
        x = x[~np.isnan(x)]
        if x.size:
            figures["relative_median"] = float(np.median(x))
            figures["relative_max"] = float(x.max())
    errors = {
        name: {
            "bias": summary.errors[name].bias,
            "scatter": summary.errors[name].scatter,
            "truth_rms": summary.sizes[name].rms,
            "bias_removed": summary.offsets.get(name),
        }
        for name in quantity.columns
        if name in summary.errors
    }
    if errors:
        figures["errors"] = errors
    return figures


def _finite(x: Any) -> Any:
    if isinstance(x, dict):
        return {key: _finite(value) for key, value in x.items()}
    if isinstance(x, list):
        return [_finite(value) for value in x]
    return None if isinstance(x, float) and not math.isfinite(x) else x
