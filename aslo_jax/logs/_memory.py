"""Columns in memory: mappings, data frames, datasets, that need not be imported for it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ._error import LogError
from ._source import Source, of_arrays


def in_memory(data: Any) -> Source:
    """The columns of a mapping, a pandas `DataFrame` or an xarray `Dataset`."""
    units: dict[str, str] = {}
    if hasattr(data, "data_vars") and hasattr(data, "coords"):  # a dataset
        label = "the Dataset"
        arrays = {
            str(name): _array(label, name, data[name].values) for name in data.variables
        }
        for name in data.variables:
            if unit := str(data[name].attrs.get("units", "")):
                units[str(name)] = unit
    elif hasattr(data, "columns") and hasattr(data, "index"):  # a data frame
        label = "the DataFrame"
        names = list(map(str, data.columns))
        for name in names:
            if names.count(name) > 1:
                raise LogError(f"{label} has several columns called `{name}`; rename them.")
        arrays = {str(n): _array(label, n, data[n].to_numpy()) for n in data.columns}
        if data.index.name is not None:
            index = str(data.index.name)
            arrays.setdefault(index, _array(label, index, data.index.to_numpy()))
    elif isinstance(data, Mapping):
        label = "the mapping"
        arrays = {str(name): _array(label, name, x) for name, x in data.items()}
    else:
        raise LogError(
            "Argument `data` must be a mapping of names to arrays, a pandas DataFrame or "
            f"an xarray Dataset, but is a {type(data).__name__}."
        )
    return of_arrays(label, arrays, units=units)


def _array(label: str, name: Any, values: Any) -> np.ndarray:
    if hasattr(values, "magnitude") and hasattr(values, "units"):
        raise LogError(
            f"{label}, column `{name}` is a quantity of {values.units}; give its numbers "
            "in the unit that the name of the column says, as in `t [ms]`."
        )
    try:
        return np.asarray(values)
    except ValueError as error:
        raise LogError(f"{label}, column `{name}` is no array: {error}.") from None
