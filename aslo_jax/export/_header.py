"""The text of the `.h` file, and what stands above the `.c` file."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence

from ..engines._c.types import c_type
from ._fields import Field
from ._functions import head_of
from ._traced import Traced

WIDTH = 88
SAMPLING = (
    "y is sampled when a step is called, and u was held over the interval that ends then: "
    "call `init` with the first y, apply an input, wait for an interval, measure, and call "
    "`step` with that input and what is measured now. An output uses nothing later than y."
)
CONTROL = (
    "y is sampled when `init` or `step` is called, which give the input u to hold from "
    "then on, over the interval that begins."
)
STATUS = {
    "OK": "state and output are new",
    "NOT_FINITE": "an input is infinite or no number; nothing has been changed",
    "NOT_BEGUN": "the state has not been through `init`; nothing has been changed",
    "BAD_INTERVAL": "dt is not positive and finite; nothing has been changed",
}


def comment(paragraphs: Iterable[str]) -> str:
    """A block of paragraphs, each a text to be filled, or lines that begin with spaces."""
    lines: list[str] = []
    for text in paragraphs:
        if lines:
            lines.append("")
        text = text.replace("*/", "* /").replace("/*", "/ *")
        if text.startswith("  "):
            lines += text.splitlines()
        else:
            lines += textwrap.wrap(text, WIDTH - 3, break_on_hyphens=False)
    body = "\n".join(f" * {line}".rstrip() for line in lines)
    return f"/*\n{body}\n */"


def members(fields: Sequence[Field], notes: Mapping[str, str]) -> list[str]:
    """Of a struct, each with what it is."""
    lines = []
    for field in fields:
        size = f"[{field.size}]" if field.is_array else ""
        said = described(field, notes)
        lines += [f"    /* {said} */", f"    {c_type(field.dtype)} {field.name}{size};"]
    return lines


def described(field: Field, notes: Mapping[str, str]) -> str:
    """What a member is: its note, its shape where it is more than a vector, and what it is
    called in the library where that is another name."""
    parts = [notes[field.name]] if field.name in notes else []
    if len(field.shape) > 1:
        parts.append(f"shape {field.shape}, row by row")
    if field.origin != field.name or not parts:
        parts.append(field.origin)
    if field.default is not None and field.size == 1:
        parts.append(f"by default {field.default.reshape(-1)[0]}")
    return "; ".join(parts).replace("*/", "* /")


def struct(name: str, fields: list[str]) -> str:
    return "\n".join(["typedef struct {", *fields, f"}} {name};"])


def header(
    traced: Traced,
    prefix: str,
    above: Sequence[str],
    notes: Mapping[str, str],
    refuses: bool,
) -> str:
    """The declarations; `above` are the paragraphs of the comment that it begins with."""
    upper = prefix.upper()
    used = dict(STATUS)
    if not refuses:
        del used["NOT_FINITE"]
    if traced.interval is not None:
        del used["BAD_INTERVAL"]
    status = [
        f"    {upper}_{name} = {k}{',' if k < len(used) - 1 else ''} /* {said} */"
        for k, (name, said) in enumerate(used.items())
    ]
    parts = [
        comment(above),
        f"#ifndef {upper}_H\n#define {upper}_H",
        "#include <stdbool.h>\n#include <stddef.h>\n#include <stdint.h>",
        '#ifdef __cplusplus\nextern "C" {\n#endif',
        "/* What becomes of a call. */\n"
        + "\n".join(["typedef enum {", *status, f"}} {prefix}_status;"]),
    ]
    if traced.interval is not None:
        dt = f"{traced.interval!r}{'f' if traced.dtype.itemsize == 4 else ''}"
        parts.append(f"/* Seconds from step to step. */\n#define {upper}_INTERVAL {dt}")
    begun = ["    /* whether it has been through `init` */", "    bool begun;"]
    parts.append(
        "/* A value: copy it, compare it, keep several. */\n"
        + struct(f"{prefix}_state", [*members(traced.state, notes), *begun])
    )
    if traced.parameters:
        parts.append(
            "/* May be changed between any two steps. */\n"
            + struct(f"{prefix}_parameters", members(traced.parameters, notes))
        )
    parts.append(struct(f"{prefix}_output", members(traced.outputs, notes)))
    functions = {
        "defaults": "The parameters that it was exported with.",
        "init": "Begin at the first sample.",
        "step": "A sample later.",
    }
    for name, said in functions.items():
        if name == "defaults" and not traced.parameters:
            continue
        parts.append(f"/* {said} */\n{head_of(traced, prefix, name)};")
    parts += ["#ifdef __cplusplus\n}\n#endif", f"#endif /* {upper}_H */"]
    return "\n\n".join(parts) + "\n"


def top(prefix: str) -> str:
    """What the `.c` file begins with."""
    return "\n\n".join(
        [
            comment([f"Made with {prefix}.h, which says of what and how."]),
            f'#include "{prefix}.h"\n\n#include <float.h>',
            "#if defined(__FAST_MATH__)\n"
            '#error "without -ffast-math, which takes every value for a number"\n#endif',
            "#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 2)\n"
            '#error "numbers must have the precision of their type, as with -mfpmath=sse"\n'
            "#endif",
        ]
    )


def wrapped(text: str) -> str:
    """Without longer lines than others like to read: broken at spaces."""
    lines = []
    for line in text.splitlines():
        indent = line[: len(line) - len(line.lstrip())] + "    "
        while len(line) > WIDTH + 8 and not line.lstrip().startswith(("#", "/*", "*")):
            at = line.rfind(" ", len(indent) + 8, WIDTH + 8)
            if at < 0:
                break
            lines.append(line[:at])
            line = indent + line[at + 1 :]
        lines.append(line)
    return "\n".join(lines) + "\n"
