"""Estimates and simulations as tables of pandas and datasets of xarray."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ._extras import require
from ._series import instants, leaves, names_of, tracks

_NOTES = {
    "certificate": ("1", "measure of observability"),
    "coasting": ("1", "carried along the known derivative"),
}


def estimate_columns(
    estimate: Any, t: Any, names: Sequence[str] | None
) -> dict[str, np.ndarray]:
    """The columns of an estimate, `t` (s) first."""
    (track,) = tracks(estimate).values()
    t = instants(t, track.value.shape[0])
    entries = names_of(names, track.value.shape[1], "value")
    columns = {"t": t} | dict(zip(entries, track.value.T, strict=True))
    more = {"certificate": track.certificate, "coasting": track.coasting}
    return _together(columns, more)


def simulation_columns(
    simulation: Any, names: Sequence[str] | None
) -> dict[str, np.ndarray]:
    """The columns of a simulation, `t` (s) first."""
    t, hidden = np.asarray(simulation.t, float), np.asarray(simulation.hidden, float)
    if t.ndim != 1:
        raise ValueError(
            "The simulation must be a single one, but its `t` has the shape "
            f"{t.shape}; of a batch take one at a time, "
            "`jax.tree.map(lambda x: x[0], simulation)`."
        )
    known = names_of(names, hidden.shape[1], "hidden")
    columns = {"t": t}
    for stem in ("u", "y", "x"):
        columns = _together(columns, leaves(stem, getattr(simulation, stem)))
    columns = _together(columns, dict(zip(known, hidden.T, strict=True)))
    for name, track in tracks(simulation).items():
        width = track.value.shape[1]
        # An observer may estimate more than is hidden, or something else.
        own = names if names is not None and width == len(known) else None
        entries = names_of(own, width, "value")
        more = {"certificate": track.certificate, "coasting": track.coasting}
        both = _together(dict(zip(entries, track.value.T, strict=True)), more)
        columns = _together(columns, {f"{name}.{k}": x for k, x in both.items()})
    return columns


def dataframe(columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Any:
    """A `pandas.DataFrame` with the index `t`."""
    pandas = require("pandas", "study")
    found = _units(columns, units)
    table = pandas.DataFrame(dict(columns)).set_index("t")
    table.attrs["units"] = found
    return table


def dataset(columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Any:
    """An `xarray.Dataset` over `t`, with the units where they are known."""
    xarray = require("xarray", "study")
    found = _units(columns, units)
    attributes = {name: _attributes(name, found) for name in columns}
    variables = {n: ("t", x, attributes[n]) for n, x in columns.items() if n != "t"}
    return xarray.Dataset(variables, {"t": ("t", columns["t"], attributes["t"])})


def _attributes(name: str, units: Mapping[str, str]) -> dict[str, str]:
    found = {"units": units[name]} if name in units else {}
    note = _NOTES.get(name.rpartition(".")[2])
    return found | ({"long_name": note[1]} if note else {})


def _units(columns: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, str]:
    """The unit of each column that has one: given for the column itself, for the same entry
    of every observer, or for all entries of a signal."""
    known = {"t": "s"} | {name: unit for name, (unit, _) in _NOTES.items()} | dict(units)
    found, used = {}, set()
    for name in columns:
        entry = name.rpartition(".")[2]
        for each in (name, entry, name.partition(".")[0], entry.rpartition("_")[0]):
            if each in known:
                found[name] = known[each]
                used.add(each)
                break
    if unknown := sorted(set(units) - used):
        raise ValueError(
            f"Argument `units` must name columns, but {', '.join(unknown)} "
            f"{'is' if len(unknown) == 1 else 'are'} none; there are {', '.join(columns)}."
        )
    return found


def _together(columns: Mapping[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    both = sorted(set(columns) & set(more))
    if both:
        raise ValueError(
            f"Argument `names` must not hold {', '.join(both)}, which another column is "
            "called; choose another name."
        )
    return dict(columns) | dict(more)
