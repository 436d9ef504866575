"""The columns of every kind of machine, for the help of `aslo-jax estimate`.

The machines import JAX, which takes longer than all else that help does; hence a file of
their columns, written by `python -m aslo_jax.cli._columns`."""

import textwrap
from pathlib import Path

PATH = Path(__file__).with_name("columns.txt")


def of_every_kind() -> str:
    """The columns of every kind, those alike together."""
    from ..machines import KINDS

    kinds: dict[tuple[str, ...], list[str]] = {}
    for name, kind in KINDS.items():
        signals, suffixes = kind.layout.signals, kind.layout.suffixes()
        units = [f"{', '.join(q.columns)} ({q.unit})" for q in kind.layout.quantities]
        guards = [f"{n}{s}" for n in ("certificate", "coasting") for s in suffixes]
        optional = f"; optionally {', '.join(signals.optional)}" if signals.optional else ""
        lines = (
            f"in: {', '.join(signals.required)}{optional}",
            f"out: t, {', '.join([*units, *guards])}",
            f"truth: {', '.join(signals.truth)}",
            f"note: {signals.note}",
        )
        kinds.setdefault(lines, []).append(name)
    texts = []
    for lines, names in kinds.items():
        indented = [
            textwrap.fill(line, 76, initial_indent="  ", subsequent_indent="      ")
            for line in lines
        ]
        texts.append("\n".join(["\b", f"{', '.join(names)}", *indented]))
    return "\n\n".join(texts)


def written() -> str:
    """[`of_every_kind`][], from the file."""
    return PATH.read_text("utf-8")


if __name__ == "__main__":
    PATH.write_text(of_every_kind(), "utf-8")
