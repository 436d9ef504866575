"""The public functions of the `.c` file, around the statements that compute."""

import re
from collections.abc import Iterable, Sequence

from ..engines._c.types import c_type
from ..engines._c.unit import Unit
from ._fields import Field
from ._traced import Traced


def head_of(traced: Traced, prefix: str, name: str) -> str:
    """The declaration of `init`, `step` or `defaults`, without a semicolon."""
    if name == "defaults":
        return f"void {prefix}_defaults({prefix}_parameters *parameters)"
    given = [f"{prefix}_state *state"]
    if traced.parameters:
        given.append(f"const {prefix}_parameters *parameters")
    for field in traced.first if name == "init" else traced.inputs:
        kind = c_type(field.dtype)
        size = f"[{field.size}]" if field.is_array else ""
        given.append(f"{'const ' if field.is_array else ''}{kind} {field.name}{size}")
    given.append(f"{prefix}_output *output")
    lines = [f"{prefix}_status {prefix}_{name}({given[0]}"]
    for each in given[1:]:
        if len(lines[-1]) + len(each) > 88:
            lines[-1] += ","
            lines.append(f"    {each}")
        else:
            lines[-1] += f", {each}"
    return "\n".join(lines) + ")"


def functions(
    traced: Traced,
    prefix: str,
    refuses: bool,
    unit: Unit,
    begin: Sequence[str],
    step: Sequence[str],
) -> list[str]:
    """Their texts: those of the start and of the step around given statements; `refuses`:
    whether these return at once where an input is not finite."""
    zero, most = ("0.0", "DBL_MAX") if traced.dtype.itemsize == 8 else ("0.0f", "FLT_MAX")
    found = [_defaults(traced, prefix, unit)] if traced.parameters else []
    signals = [f for f in traced.inputs if traced.interval is not None or f.name != "dt"]
    checks = _finite(traced.first, zero, prefix) if refuses else []
    found.append(
        _function(traced, prefix, "init", checks, [*begin, "state->begun = true;"])
    )
    checks = _finite(signals, zero, prefix) if refuses else []
    if traced.interval is None:
        checks += _when(f"!((dt > {zero}) && (dt <= {most}))", prefix, "BAD_INTERVAL")
    checks += _when("!state->begun", prefix, "NOT_BEGUN")
    found.append(_function(traced, prefix, "step", checks, step))
    return found


def _defaults(traced: Traced, prefix: str, unit: Unit) -> str:
    lines = []
    for field in traced.parameters:
        assert field.default is not None
        for k, x in enumerate(field.default.reshape(-1)):
            place = f"[{k}]" if field.is_array else ""
            number = unit.constant(x, field.dtype)
            lines.append(f"parameters->{field.name}{place} = {number};")
    return _text(head_of(traced, prefix, "defaults"), lines)


def _finite(fields: Iterable[Field], zero: str, prefix: str) -> list[str]:
    lines = []
    for field in fields:
        if field.dtype.kind != "f":
            continue
        name = f"{field.name}[i]" if field.is_array else field.name
        each = _when(f"!(({name} - {name}) == {zero})", prefix, "NOT_FINITE")
        if field.is_array:
            loop = f"for (i = 0U; i < {field.size}U; ++i) {{"
            each = [loop, *indented(each), "}"]
        lines += each
    return lines


def _when(condition: str, prefix: str, status: str) -> list[str]:
    return [f"if ({condition}) {{", f"    status = {prefix.upper()}_{status};", "}"]


def _function(
    traced: Traced, prefix: str, name: str, checks: Sequence[str], body: Sequence[str]
) -> str:
    done = f"{prefix.upper()}_OK"
    if checks:
        inner = [f"if (status == {done}) {{", *indented(body), "}"]
    else:
        inner = list(body)
    lines = [*checks, *inner]
    text = "\n".join(lines)
    head = head_of(traced, prefix, name)
    words = set(re.findall(r"\w+", text))
    given = re.findall(r"(\w+)(?:\[\d+\])?(?=[,)])", head)
    counters = [f"size_t {k};" for k in ("i", "j") if f"for ({k} = " in text]
    unused = [f"(void){each};" for each in given if each not in words]
    opened = f"{prefix}_status status = {done};"
    return _text(head, [*counters, opened, *unused, *lines, "return status;"])


def _text(head: str, lines: Sequence[str]) -> str:
    return "\n".join([head, "{", *indented(lines), "}"])


def indented(lines: Iterable[str]) -> list[str]:
    """Lines, one step further to the right."""
    return [f"    {line}" for line in lines]
