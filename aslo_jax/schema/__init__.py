"""Tables of TOML files: their keys, what is said of a fault in them, and their text.

Machine descriptions and the files of studies are made of these; what a table means is no
concern here. Files are written by `schema.toml_text`, which keeps their comments.
"""

from ._faults import (
    choices as choices,
    explain as explain,
    hint as hint,
    unknown_key as unknown_key,
)
from ._read import read_toml as read_toml, text_and_content as text_and_content
from ._signals import (
    NoLoad as NoLoad,
    Signal as Signal,
    SupplyTable as SupplyTable,
    WaveInput as WaveInput,
    WaveTable as WaveTable,
)
from ._table import (
    NonNegative as NonNegative,
    Numbers as Numbers,
    Positive as Positive,
    Table as Table,
    Whole as Whole,
    is_rate as is_rate,
    key as key,
    unit_of as unit_of,
)
from ._template import template_lines as template_lines

__all__ = [
    "NoLoad",
    "NonNegative",
    "Numbers",
    "Positive",
    "Signal",
    "SupplyTable",
    "Table",
    "WaveInput",
    "WaveTable",
    "Whole",
    "choices",
    "explain",
    "hint",
    "is_rate",
    "key",
    "read_toml",
    "template_lines",
    "unit_of",
    "unknown_key",
]
