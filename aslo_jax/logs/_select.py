"""Which columns of a file are those of a log, by name and unit."""

import dataclasses
import shlex
from collections.abc import Mapping

import numpy as np

from ._error import LogError
from ._expressions import Expression
from ._frame import ANGLE, Frame
from ._head import Head
from ._hints import closest, refuse_missing
from ._names import ELECTRICAL, means, plain, says
from ._signals import Signals
from ._source import Source
from ._units import factor_of


@dataclasses.dataclass(frozen=True)
class Column:
    """What one of our columns is read from.

    - `label`: what the file calls it, or an expression, for messages;
    - `sources`: the columns of the file that it needs, by the names that are used for them;
    - `factor`: from the unit of the file to ours;
    - `expression`: over the sources as they are.
    """

    label: str
    sources: Mapping[str, str]
    factor: float = 1.0
    expression: Expression | None = None

    def __call__(self, data: Mapping[str, np.ndarray]) -> np.ndarray:
        """The values, of the columns of the file."""
        columns = {used: data[name] for used, name in self.sources.items()}
        first = next(iter(columns.values()))
        if self.expression is not None:
            return np.broadcast_to(self.expression(columns), first.shape).astype(float)
        return first if self.factor == 1.0 else self.factor * first

    def said(self, name: str) -> str:
        """Where `name` is read from; nothing for a column of that name in our unit."""
        if self.expression is not None:
            return f"{name} = {self.label}"
        by = f" times {self.factor:.6g}" if self.factor != 1.0 else ""
        return f"{name} from `{self.label}`{by}" if by or self.label != name else ""


def checked_mapping(columns: Mapping[str, str], signals: Signals) -> dict[str, str]:
    for name in columns:
        if name not in signals.names:
            close = closest(name, signals.names)
            hint = f"; did you mean `{close[0]}`?" if close else ""
            raise LogError(
                f"Argument `columns` (option --column) must name one of "
                f"{', '.join(signals.names)}, but got `{name}`{hint}"
            )
    return dict(columns)


def select(
    source: Source, signals: Signals, mapped: Mapping[str, str], frame: Frame
) -> dict[str, Column]:
    """The columns to read, by our names: those required, and of the others those there.

    **Raises:** `LogError` for one that is missing, ambiguous, or in a unit that it cannot
    have."""
    heads = [Head(name, source.units.get(name, "")) for name in source.names]
    found = {
        name: _given(source, heads, name, mapped[name])
        if name in mapped
        else _recognised(source, heads, name, signals)
        for name in signals.names
    }
    chosen = {name: column for name, column in found.items() if column is not None}
    some = any(name in chosen for name in signals.optional)
    needed = {*signals.required, *mapped, *(signals.optional if some else ())}
    lacking = [name for name in found if name in needed and name not in chosen]
    if lacking:
        taken = {name for column in chosen.values() for name in column.sources.values()}
        refuse_missing(source, heads, lacking, signals, mapped, frame, taken)
    _refuse_shared(source, chosen, mapped)
    _refuse_clocks(source, chosen)
    if ANGLE in chosen:
        frame.check_angle(chosen[ANGLE].label)
    return chosen


def _given(source: Source, heads: list[Head], name: str, text: str) -> Column | None:
    """What `--column name=text` says: a column, or an expression over columns."""
    if text in source.unusable and text not in source.names:
        raise LogError(f"{source.path}, column `{text}` {source.unusable[text]}.")
    if matching := _called(heads, text):
        return _column(source, matching, name)
    if not any(sign in text for sign in "+-*/()`"):
        return None
    option = f"--column {shlex.quote(f'{name}={text}')}"
    try:
        expression = Expression(text)
    except LogError as error:
        raise LogError(
            f"{option}: {source.path} has no such column, and {error}."
        ) from None
    sources = {}
    for used in expression.names:
        matching = _called(heads, used)
        if len(matching) != 1:
            known = ", ".join(f"`{head.name}`" for head in heads) or "none"
            many = "several columns" if matching else "no column"
            raise LogError(
                f"{option}: {source.path} has {many} `{used}`; its columns: {known}."
            )
        sources[used] = matching[0].name
    if not sources:
        raise LogError(f"{option} names no column of {source.path}, but it must.")
    return Column(text, sources, expression=expression)


def _recognised(
    source: Source, heads: list[Head], name: str, signals: Signals
) -> Column | None:
    """The column that is called `name`, with a unit or in another spelling."""
    if name in source.unusable and name not in source.names:
        raise LogError(f"{source.path}, column `{name}` {source.unusable[name]}.")
    matching = _matching(heads, name, signals)
    if len(matching) > 1 and len({head.name for head in matching}) > 1:
        if name in signals.truth:
            return None  # which `doubtful` tells
        options = " or ".join(
            f"--column {shlex.quote(f'{name}={head.name}')}" for head in matching
        )
        columns = " and ".join(f"`{head.name}`" for head in matching)
        raise LogError(
            f"{source.path} has {columns}, each of which may be `{name}`; say which: "
            f"{options} (in Python, `columns=`)."
        )
    return _column(source, matching, name) if matching else None


def _matching(heads: list[Head], name: str, signals: Signals) -> list[Head]:
    """Those that may be `name`, by the surest way to tell that finds any."""
    matching = _called(heads, name)
    for part in ("base", "last"):
        matching = matching or [h for h in heads if means(name, getattr(h, part), h.unit)]
    if name == ANGLE:
        matching = matching or [h for h in heads if says(h.last, ELECTRICAL)]
    return matching or _of_array(heads, name, signals)


def doubtful(
    source: Source, signals: Signals, chosen: Mapping[str, Column]
) -> tuple[str, ...]:
    """What to say of each truth column that several columns may be, so that none is
    read."""
    heads = [Head(name, source.units.get(name, "")) for name in source.names]
    found = []
    for name in signals.truth:
        columns = dict.fromkeys(head.name for head in _matching(heads, name, signals))
        if name in chosen or len(columns) < 2:
            continue
        options = " or ".join(
            f"--column {shlex.quote(f'{name}={column}')}" for column in columns
        )
        found.append(
            f"not read: {' and '.join(f'`{c}`' for c in columns)}, each of which may be "
            f"`{name}`; say which: {options}"
        )
    return tuple(found)


def _called(heads: list[Head], text: str) -> list[Head]:
    """Those called `text`, as it stands, or else without their unit."""
    return [head for head in heads if head.name == text] or [
        head for head in heads if head.base == text
    ]


def _of_array(heads: list[Head], name: str, signals: Signals) -> list[Head]:
    """The column of an array `u` or `y` that has one for every input, or output."""
    inputs = tuple(name for name in signals.inputs if name != ANGLE)
    wholes = (
        (("u", "v", "inputs"), inputs),
        (("u", "v", "inputs"), (*inputs, *signals.optional)),
        (("y", signals.outputs[0][0], "outputs"), signals.outputs),
    )
    for words, names in wholes:
        for word in words:
            of_word = [h for h in heads if plain(h.last.partition("[")[0]) == word]
            columns = [head for head in of_word if head.last.endswith("]")]
            if name in names and len(columns) == len(names):
                return [columns[names.index(name)]]
    return []


def _column(source: Source, matching: list[Head], name: str) -> Column:
    """The only one of the columns `matching`, in the unit of our column `name`."""
    label = matching[0].name
    if len(matching) > 1:
        names = source.names
        places = [str(k + 1) for k, other in enumerate(names) if _same(other, matching)]
        raise LogError(
            f"{source.path} has {len(matching)} columns called `{label}` (columns "
            f"{', '.join(places)}); rename all but one."
        )
    unit = matching[0].unit
    try:
        factor = factor_of(unit, name) if unit else 1.0
    except LogError as error:
        instead = shlex.quote(f"{name}=1.0*`{label}`")
        raise LogError(
            f"{source.path}, column `{label}`, read as `{name}`, {error}; give it in a "
            f"unit that fits, or write how it is computed: --column {instead} with the "
            "right factor (in Python, `columns=`)."
        ) from None
    return Column(label, {label: label}, factor)


def _same(name: str, matching: list[Head]) -> bool:
    return any(name == head.name for head in matching)


def _refuse_shared(
    source: Source, chosen: Mapping[str, Column], mapped: Mapping[str, str]
) -> None:
    """Refuse a column that is read twice, unless once for the angle of the frame."""
    plain_ones = {k: c.label for k, c in chosen.items() if not c.expression and k != ANGLE}
    for label in plain_ones.values():
        names = [name for name, other in plain_ones.items() if other == label]
        if len(names) > 1:
            both = " and ".join(f"`{name}`" for name in names)
            name = next((k for k in mapped if k in names), names[0])
            raise LogError(
                f"Column `{label}` of {source.path} is read as {both}, where it can be "
                f"only one; map `{name}` to another column."
            )


def _refuse_clocks(source: Source, chosen: Mapping[str, Column]) -> None:
    """Refuse a column whose own instants are not those of `t`."""
    times = {source.clocks.get(name, "") for name in chosen["t"].sources.values()}
    for column in chosen.values():
        for name in column.sources.values():
            clock = source.clocks.get(name)
            if clock and times != {clock}:
                raise LogError(
                    f"{source.path}, column `{name}` has the instants `{clock}`, which are "
                    f"not those of `t`, `{chosen['t'].label}`; {source.resampled}."
                )
