"""How a text file of samples is written: separators, names, units, comments.

A file begins with anything, has one line of names, perhaps one of units, and rows of
numbers, as many as there are names. The longest such table of its first lines is taken.
"""

import csv
import dataclasses
import gzip
import io
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import IO

from ._error import LogError
from ._units import bare, is_unit

HEAD = 1_000  # lines that are looked at
COMMENTS = ("#", "%", "//")
BLANKS = " "  # for any number of blanks and tabs
DELIMITERS = (";", "\t", ",", "|", BLANKS)

WITH_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?|[+-]?\d+(,\d{3}){2,}")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
MANY_MARKS = re.compile(r"[+-]?\d{1,3}([.,']\d{3})*[.,']\d{3}[.,]\d+|[+-]?\d{1,3}('\d{3})+")


@dataclasses.dataclass(frozen=True)
class Layout:
    """How a file is written.

    - `names`, and `units` of a line of its own, by name;
    - `line`: the last one before the samples, counted from 1;
    - `delimiter`, `decimal_point`;
    - `clean`: whether lines of samples can be parsed as they are.
    """

    path: Path
    names: list[str]
    units: dict[str, str]
    line: int
    delimiter: str
    decimal_point: str
    clean: bool

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """The line number (from 1) and the cells of every row of samples."""
        with opened(self.path, errors="replace") as file:
            lines = (line for line in file)
            if self.delimiter == BLANKS:
                for number, line in enumerate(lines, 1):
                    if number > self.line and line.strip() and not is_comment(line):
                        yield number, line.split()
                return
            reader = csv.reader(lines, delimiter=self.delimiter)
            try:
                for cells in reader:
                    if cells and reader.line_num > self.line and not is_comment(cells[0]):
                        yield reader.line_num, cells
            except csv.Error as error:
                raise LogError(
                    f"{self.path}, line {reader.line_num}: {error}; repair that line."
                ) from error

    def where(self, row: int) -> str:
        """Row `row` of the samples as the line of the file that holds it."""
        line, _ = next(islice(self.rows(), row, None))
        return f"line {line}"


def opened(path: Path, errors: str = "strict", newline: str | None = "") -> IO[str]:
    """A text file, from within a .gz file too."""
    if path.suffix.lower() == ".gz":
        return gzip.open(path, "rt", encoding="utf-8-sig", errors=errors, newline=newline)
    return path.open(encoding="utf-8-sig", errors=errors, newline=newline)


def is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def layout_of(path: Path) -> Layout:
    """The layout of a text file.

    **Raises:** `LogError` for a file that is empty or not text, for units that are none,
    and for numbers whose decimal mark cannot be told."""
    try:
        with opened(path) as file:
            head = [(k, line.strip()) for k, line in enumerate(islice(file, HEAD), 1)]
    except UnicodeDecodeError as error:
        raise LogError(f"{path} is not UTF-8 text; export it as UTF-8 CSV.") from error
    except (gzip.BadGzipFile, EOFError) as error:
        raise LogError(f"{path} is not a readable .gz file: {error}.") from error
    lines = [(k, line) for k, line in head if line and not is_comment(line)]
    if not lines:
        raise LogError(f"{path} is empty; a log begins with a line that names its columns.")
    tables = [
        table for d in DELIMITERS if (table := _longest_table(head, lines, d)) is not None
    ]
    if not tables:
        number, first = lines[0]
        delimiter = max(",;\t", key=first.count)
        delimiter = delimiter if delimiter in first else BLANKS
        names = _names(first, delimiter)
        return Layout(path, names, {}, number, delimiter, ".", delimiter != BLANKS)
    table = max(tables, key=lambda table: table.rows)
    inside = [line for k, line in head if k > table.line and is_comment(line)]
    clean = table.delimiter != BLANKS and not inside
    found = Layout(path, table.names, table.units, table.line, table.delimiter, ".", clean)
    mark = "." if table.delimiter == "," else _decimal_mark(path, found.rows())
    return dataclasses.replace(found, decimal_point=mark)


@dataclasses.dataclass(frozen=True)
class _Table:
    names: list[str]
    units: dict[str, str]
    line: int
    delimiter: str
    rows: int


def _longest_table(
    head: list[tuple[int, str]], lines: list[tuple[int, str]], delimiter: str
) -> _Table | None:
    """The table with most rows, if there is one with this delimiter."""
    split = [(k, _cells(line, delimiter)) for k, line in lines]
    best, begin = None, 0
    while begin < len(split):
        width = len(split[begin][1])
        if not _is_sample(split[begin][1]):
            begin += 1
            continue
        end = begin
        while (
            end < len(split) and len(split[end][1]) == width and _is_sample(split[end][1])
        ):
            end += 1
        if best is None or end - begin > best.rows:
            best = _headed(head, lines, split, begin, end - begin, delimiter) or best
        begin = end
    return best


def _headed(
    head: list[tuple[int, str]],
    lines: list[tuple[int, str]],
    split: list[tuple[int, list[str]]],
    begin: int,
    rows: int,
    delimiter: str,
) -> _Table | None:
    """The table whose samples begin in line `begin` of `split`, if its columns have
    names."""
    first, cells = split[begin]
    width = len(cells)
    if width < 2:
        return None

    def names_at(index: int) -> list[str]:
        found = _names(lines[index][1], delimiter) if index >= 0 else []
        if len(found) == width - 1 and not cells[-1]:
            found = [*found, ""]  # every row ends with a delimiter
        fits = len(found) == width and not any(map(_is_number, found))
        return found if fits else []

    def made(names: list[str], units: list[str]) -> _Table:
        by_name = {n: bare(u) for n, u in zip(names, units, strict=False) if bare(u)}
        return _Table(names, by_name, first - 1, delimiter, rows)

    above, above_that = names_at(begin - 1), names_at(begin - 2)
    words = [cell for cell in above if cell]
    if above and above_that and words and all(map(is_unit, words)):
        return made(above_that, above)
    if above:
        return made(above, [])
    # Names within a comment, the last of those before the samples that has as many.
    for _, line in reversed([(k, text) for k, text in head if k < first]):
        if not line:
            continue
        if not is_comment(line):
            break
        names = _names(re.sub(r"^(#|%|//)+", "", line).strip(), delimiter)
        if len(names) == width and not any(map(_is_number, names)):
            return made(names, [])
    return None


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == BLANKS:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return []


def _names(line: str, delimiter: str) -> list[str]:
    """The cells of a line of names, in which a unit may stand after a blank."""
    names: list[str] = []
    for cell in _cells(line, delimiter):
        if delimiter == BLANKS and names and (cell[0] in "[(" or "[" in _open(names[-1])):
            names[-1] += f" {cell}"
        else:
            names.append(cell)
    return names


def _open(text: str) -> str:
    """A bracket of `text` that is not closed."""
    return (
        "[" if text.count("[") + text.count("(") > text.count("]") + text.count(")") else ""
    )


def _is_sample(cells: list[str]) -> bool:
    """Whether at least half of the cells that are not blank are numbers."""
    full = [cell for cell in cells if cell]
    return bool(full) and 2 * sum(map(_is_number, full)) >= len(full)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return bool(WITH_COMMA.fullmatch(text) or MANY_MARKS.fullmatch(text))
    return True


def _decimal_mark(path: Path, rows: Iterable[tuple[int, list[str]]]) -> str:
    """A point or a comma, judged over as many rows as it takes, `HEAD` at least."""
    undecided = decimal = pointed = None  # a line and a cell of each
    for seen, (line, cells) in enumerate(rows):
        for cell in map(str.strip, cells):
            if MANY_MARKS.fullmatch(cell) and not THOUSANDS.fullmatch(cell):
                raise LogError(
                    f"{path}, line {line}: {cell!r} has a mark between thousands; export "
                    "the numbers without."
                )
            if "," in cell and WITH_COMMA.fullmatch(cell):
                if THOUSANDS.fullmatch(cell):
                    undecided = undecided or (line, cell)
                else:
                    decimal = decimal or (line, cell)
            elif pointed is None and "." in cell and _is_number(cell):
                pointed = (line, cell)
        if seen >= HEAD and (decimal or pointed):
            break
    commas = decimal or undecided
    if commas and pointed:
        raise LogError(
            f"{path}: {commas[1]!r} in line {commas[0]} has a comma and {pointed[1]!r} in "
            f"line {pointed[0]} a point; write every decimal mark alike, and no mark "
            "between thousands."
        )
    if undecided and not decimal:
        cell = undecided[1]
        raise LogError(
            f"{path}, line {undecided[0]}: {cell!r} may be {cell.replace(',', '.')} with a "
            f"decimal comma, or {cell.replace(',', '')} with commas between thousands, and "
            "no number of the file tells which; export it with decimal points, without "
            "marks between thousands."
        )
    return "," if decimal else "."


class Cleaned(io.RawIOBase):
    """The samples of a file as bytes, without the lines before them and without comments;
    blanks between cells are one tab. It is read in blocks."""

    BLOCK = 1 << 20  # characters

    def __init__(self, layout: Layout):
        self._file = opened(layout.path, newline=None)
        for _ in range(layout.line):
            self._file.readline()
        self._blanks = layout.delimiter == BLANKS
        self._rest, self._ready = "", b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer) -> int:
        while not self._ready:
            block = self._file.read(self.BLOCK)
            if not block and not self._rest:
                return 0
            text = self._rest + block
            cut = text.rfind("\n") + 1 if block else len(text)
            self._rest, text = text[cut:], text[:cut]
            text = re.sub(r"(?m)^[ \t]*(#|%|//).*\n?", "", text)
            if self._blanks:
                text = re.sub(r"[ \t]+", "\t", re.sub(r"(?m)^[ \t]+|[ \t]+$", "", text))
            self._ready = text.encode()
        size = min(len(buffer), len(self._ready))
        buffer[:size] = self._ready[:size]
        self._ready = self._ready[size:]
        return size

    def close(self) -> None:
        self._file.close()
        super().close()
