"""Where values are, and loops that bring many of them to one array."""

from collections.abc import Sequence
from typing import NamedTuple

LEAST = 4  # entries that are worth a loop


class Place(NamedTuple):
    """An entry of an array."""

    array: str
    at: int

    @property
    def text(self) -> str:
        return f"{self.array}[{self.at}]"


class Run(NamedTuple):
    """; where `array` is an
    expression, which all of them are, the stride is zero."""

    array: str
    first: int
    stride: int
    length: int
    is_array: bool = True

    def entry(self, k: str) -> str:
        """The entry with the number k."""
        if not self.is_array:
            return self.array
        return f"{self.array}[{_place(self.first, ((self.stride, k),))}]"


Value = Place | str


def _place(first: int, steps: Sequence[tuple[int, str]]) -> str:
    """`first` and multiples of counters, unsigned as these are."""
    parts = [k if s == 1 else f"({s}U * {k})" for s, k in steps if s > 0]
    if first:
        parts.insert(0, f"{first}U")
    back = "".join(f" - {k}" if s == -1 else f" - ({-s}U * {k})" for s, k in steps if s < 0)
    return (" + ".join(parts) or "0U") + back


def runs(values: Sequence[Value]) -> list[Run]:
    """The fewest runs, found from the first to the last."""
    found: list[Run] = []
    k = 0
    while k < len(values):
        run = _longest(values, k)
        found.append(run)
        k += run.length
    return found


def _longest(values: Sequence[Value], k: int) -> Run:
    first, end = values[k], k + 1
    if isinstance(first, str):
        while end < len(values) and values[end] == first:
            end += 1
        return Run(first, 0, 0, end - k, False)
    stride, last = None, first
    while end < len(values):
        value = values[end]
        if isinstance(value, str) or value.array != first.array:
            break
        if stride is not None and value.at - last.at != stride:
            break
        stride, last, end = value.at - last.at, value, end + 1
    return Run(first.array, first.at, stride or 0, end - k)


def filled(array: str, values: Sequence[Value], first: int = 0) -> list[str]:
    """Statements that put values into an array, or into its entries from `first` on."""
    lines: list[str] = []
    found, at, k = runs(values), first, 0
    while k < len(found):
        alike = _alike(found, k)
        run = found[k]
        if alike > 1 and run.length > 1:
            lines += _nested(array, at, found[k : k + alike])
            at += alike * run.length
            k += alike
            continue
        lines += _single(array, at, run)
        at += run.length
        k += 1
    return lines


def _single(array: str, at: int, run: Run) -> list[str]:
    if run.length < LEAST:
        each = (_text(run, j) for j in range(run.length))
        return [f"{array}[{at + j}] = {text};" for j, text in enumerate(each)]
    return [
        f"for (i = 0U; i < {run.length}U; ++i) {{",
        f"    {array}[{_place(at, ((1, 'i'),))}] = {run.entry('i')};",
        "}",
    ]


def _text(run: Run, j: int) -> str:
    return f"{run.array}[{run.first + j * run.stride}]" if run.is_array else run.array


def _alike(found: list[Run], k: int) -> int:
    """How many runs from the k-th on are one array's rows: as long, and as far apart."""
    first, count, apart = found[k], 1, None
    while k + count < len(found):
        run, last = found[k + count], found[k + count - 1]
        if not run.is_array or run._replace(first=0) != first._replace(first=0):
            break
        if apart is not None and run.first - last.first != apart:
            break
        apart, count = run.first - last.first, count + 1
    return count if count * first.length >= LEAST else 1


def _nested(array: str, at: int, rows: list[Run]) -> list[str]:
    first, apart = rows[0], rows[1].first - rows[0].first
    source = _place(first.first, ((apart, "i"), (first.stride, "j")))
    return [
        f"for (i = 0U; i < {len(rows)}U; ++i) {{",
        f"    for (j = 0U; j < {first.length}U; ++j) {{",
        f"        {array}[{_place(at, ((first.length, 'i'), (1, 'j')))}] = "
        f"{first.array}[{source}];",
        "    }",
        "}",
    ]
