"""What stands over a column."""

from ._names import kind
from ._units import split_unit

SEPARATORS = (".", "/", "::")  # before the last part of a name of several


class Head:
    """A column of a file: `name`, `base` without its unit, `unit`, the last part of `base`,
    `last`, and the `kind` of quantity that this tells."""

    def __init__(self, name: str, unit: str = ""):
        self.name = name
        self.base, in_name = split_unit(name)
        self.unit = in_name or unit
        self.last = self.base
        for separator in SEPARATORS:
            self.last = self.last.rpartition(separator)[2]
        self.kind = kind(self.last)
