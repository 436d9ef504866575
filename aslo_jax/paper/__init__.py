"""Every figure, table and claim of the paper, as an experiment that can be run again."""

import importlib
import pathlib
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Literal

import jax

from .._extras import require
from .._interrupts import unfinished
from .._written import write_files

__all__ = ["SECTIONS", "run"]

SECTIONS = (2, 3, 4)


def run(section: int | Literal["all"], out: pathlib.Path) -> None:
    """Run the experiments of a `section` of the paper and write them to the folder `out`:
    those of `"all"` to folders of their own in it, `section_2` and so on, beside an
    `index.md` of all.

    Writes every figure as PNG and as PDF, whose text is text, and its data as CSV, the
    claims of the section with the number measured for each and the verdict that follows
    (`claims.csv`, `claims.md`), tables, and `index.md`, which lists the files; prints the
    claims. The files are the same in every run on one machine. No file of a section is
    written before all of it is computed.

    **Raises:** `ValueError` for a section that has no experiments, for an `out` that is a
    file, or in single precision; `OSError` for one that cannot be written to;
    `ImportError` without matplotlib or SciPy.
    """
    if section not in (*SECTIONS, "all"):
        raise ValueError(
            f'Argument `section` must be one of {SECTIONS} or "all", but got {section!r}.'
        )
    out = pathlib.Path(out)
    if out.exists() and not out.is_dir():
        raise ValueError(f"Argument `out` must be a folder, but `{out}` is a file.")
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise ValueError(
            "The claims of the paper are measured to 1e-10, but JAX is in single "
            'precision; call `jax.config.update("jax_enable_x64", True)` first.'
        )
    sections = SECTIONS if section == "all" else (section,)
    reports = {each: _experiments(each) for each in sections}
    made, counts = not out.exists(), {}
    with unfinished(lambda: _forget(out, made)):
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):  # it can be written to, or that is found now
            pass
        for each, report in reports.items():
            files, summary = report()
            _write(files, out / f"section_{each}" if section == "all" else out)
            counts[each] = summary.rpartition("\n")[2]
            print(summary)
        if section == "all":
            _write({"index.md": _contents(counts).encode()}, out)


def _write(files: Mapping[str, bytes], out: pathlib.Path) -> None:
    out.mkdir(exist_ok=True)
    write_files(out, files)


def _contents(counts: Mapping[int, str]) -> str:
    """The index of all sections, with the count of the verdicts of each."""
    lines = ["# The paper's experiments", ""]
    for section, count in counts.items():
        at = f"section_{section}"
        lines.append(
            f"- [Section {section}]({at}/index.md): {count} [Claims]({at}/claims.md)"
        )
    return "\n".join(lines) + "\n"


def _forget(out: pathlib.Path, made: bool) -> None:
    """Remove the folder `out` where it was `made` and holds nothing yet."""
    if made:
        with suppress(OSError):
            out.rmdir()


def _experiments(section: int) -> Callable[[], tuple[dict[str, bytes], str]]:
    require("matplotlib", "plot")
    return importlib.import_module(f"._section{section}", __package__).SECTION.report
