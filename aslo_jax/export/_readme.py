"""The README of an export."""

from collections.abc import Mapping, Sequence

from ._fields import Field
from ._header import described
from ._traced import Traced


def readme(
    traced: Traced,
    prefix: str,
    above: Sequence[str],
    notes: Mapping[str, str],
    columns: Mapping[str, Sequence[str]],
) -> str:
    """What is in the structs, and how to use them."""
    tables = {
        "Parameters": traced.parameters,
        "Inputs": traced.inputs,
        "Outputs": traced.outputs,
        "State": traced.state,
    }
    lines = [f"# {prefix}", ""]
    for text in above:
        quoted = [f"    {line.strip()}" for line in text.splitlines()]
        lines += [*(quoted if text.startswith("  ") else [text]), ""]
    given = [f.name for f in traced.inputs]
    own = "&parameters, " if traced.parameters else ""
    first = ", ".join(f.name for f in traced.first)
    lines += ["## Use", "", "```c", f'#include "{prefix}.h"', ""]
    lines += [f"{prefix}_state state;", f"{prefix}_output output;"]
    if traced.parameters:
        lines += [f"{prefix}_parameters parameters;", f"{prefix}_defaults(&parameters);"]
    lines += [
        f"{prefix}_init(&state, {own}{first}, &output);",
        f"{prefix}_step(&state, {own}{', '.join(given)}, &output); /* in every interval */",
        "```",
        "",
        f"`make test` replays recorded vectors, `make {prefix}_csv` builds a filter of CSV "
        f"files: `./{prefix}_csv < log.csv > estimate.csv`. With a compiler for another "
        "processor, `make CC=arm-none-eabi-gcc`; `-ffp-contract=off` gives the same bits "
        "with and without a fused multiply-add, and may be left out.",
        "",
    ]
    for title, fields in tables.items():
        if not fields:
            continue
        lines += [
            f"## {title}",
            "",
            "| member | type | what | by default |",
            "|---|---|---|---|",
        ]
        for f in fields:
            default = "" if f.default is None else _default(f)
            size = f"[{f.size}]" if f.is_array else ""
            what = described(f._replace(default=None), notes)
            if title in ("Inputs", "Outputs") and f.name in columns:
                what += f"; in CSV files {', '.join(columns[f.name])}"
            lines.append(f"| `{f.name}` | `{f.dtype.name}{size}` | {what} | {default} |")
        lines.append("")
    return "\n".join(lines)


def _default(field: Field) -> str:
    assert field.default is not None
    values = field.default.reshape(-1)
    if values.size <= 6:
        return " ".join(str(x) for x in values)
    return f"{values[0]} ... {values[-1]}"
