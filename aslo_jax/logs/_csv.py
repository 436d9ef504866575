"""Columns of text files, batch by batch. pyarrow reads them; where it refuses, a second,
slow look with the standard library finds the line and the column to name."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ._error import Columns, LogError
from ._source import NOTHING, Source, from_arrow
from ._text import BLANKS, THOUSANDS, Cleaned, Layout, is_comment, layout_of

BLOCK = 1 << 22  # bytes that are parsed at a time


def read_text(path: Path) -> Source:
    require("pyarrow.csv", "cli")
    layout = layout_of(path)
    return Source(
        path,
        layout.names,
        lambda wanted, blanks: _batches(layout, wanted, blanks),
        layout.where,
        units=layout.units,
    )


def _batches(layout: Layout, wanted: Sequence[str], blanks: bool) -> Iterator[Columns]:
    pyarrow, reader = require("pyarrow", "cli"), require("pyarrow.csv", "cli")
    if next(layout.rows(), None) is None:
        yield {name: np.zeros(0) for name in wanted}
        return
    # Columns go by their position, since names that are not read may be repeated.
    position = {name: str(layout.names.index(name)) for name in wanted}
    first = 0
    try:
        with (
            _input(layout) as source,
            reader.open_csv(
                source,
                reader.ReadOptions(
                    column_names=[str(k) for k in range(len(layout.names))],
                    skip_rows=layout.line if layout.clean else 0,
                    block_size=BLOCK,
                ),
                reader.ParseOptions(
                    delimiter="\t" if layout.delimiter == BLANKS else layout.delimiter,
                    invalid_row_handler=_comments_are_skipped,
                ),
                reader.ConvertOptions(
                    column_types=dict.fromkeys(position.values(), pyarrow.float64()),
                    include_columns=list(position.values()),
                    null_values=list(NOTHING) if blanks else [""],
                    decimal_point=layout.decimal_point,
                ),
            ) as file,
        ):
            for batch in file:
                yield {
                    name: from_arrow(
                        layout.path, layout.where, name, batch.column(k), first, blanks
                    )
                    for name, k in position.items()
                }
                first += batch.num_rows
    except pyarrow.ArrowException as error:
        raise _diagnosis(layout, wanted, blanks, str(error)) from None
    # Ten million rows leave 90 MB behind in the pool otherwise.
    pyarrow.default_memory_pool().release_unused()


def _input(layout: Layout) -> Any:
    pyarrow = require("pyarrow", "cli")
    if layout.clean:
        return pyarrow.input_stream(str(layout.path), compression="detect")
    return pyarrow.PythonFile(Cleaned(layout), mode="r")


def _comments_are_skipped(row: Any) -> str:
    return "skip" if is_comment(row.text) else "error"


def _diagnosis(
    layout: Layout, wanted: Sequence[str], blanks: bool, reason: str
) -> LogError:
    columns = [(name, layout.names.index(name)) for name in wanted]
    for line, cells in layout.rows():
        if len(cells) != len(layout.names):
            return LogError(
                f"{layout.path}, line {line}: {len(cells)} cells, but the header names "
                f"{len(layout.names)} columns (is the file cut off?); remove or repair "
                "that line."
            )
        for name, k in columns:
            cell = cells[k].strip()
            place = f"{layout.path}, line {line}, column `{name}`"
            if blanks and cell in NOTHING:
                continue
            if not cell:
                return LogError(
                    f"{place}: the value is blank; remove or repair that row, or --missing "
                    "coast or interpolate."
                )
            try:
                float(cell.replace(layout.decimal_point, "."))
            except ValueError:
                two = (
                    f" ({cell.replace(',', '.')} with a decimal comma, or "
                    f"{cell.replace(',', '')} with commas between thousands?)"
                    if THOUSANDS.fullmatch(cell)
                    else ""
                )
                return LogError(
                    f"{place}: {cell!r} is not a number{two}; remove or repair that row."
                )
    return LogError(f"{layout.path} is not a readable CSV file: {reason}")
