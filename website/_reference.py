"""The reference: a page for each public module, with every name, its constructor, where it
is used, and an example."""

import importlib
import inspect
import re
from functools import cache
from pathlib import Path

import griffe

from . import PACKAGE, ROOT
from ._examples import Example, examples
from ._griffe import Fields, ShortReferences, in_full, public_homes
from ._names import Name, public_modules, public_names

USES = 8  # pages named under a name


def reference_pages() -> dict[str, str]:
    """Markdown by path below the pages' folder: `reference/index.md` and one per module."""
    pages = {}
    for module in public_modules():
        pages[page_of(module)] = _page(module)
    pages["reference/index.md"] = _index()
    return pages


def page_of(module: str) -> str:
    """`reference/tune.losses.md` of `aslo_jax.tune.losses`."""
    return f"reference/{module.removeprefix(f'{PACKAGE}.')}.md"


def _page(module: str) -> str:
    doc = inspect.getdoc(importlib.import_module(module)) or ""
    lines = [f"# {module} {{#{module}}}", "", in_full(doc, _homes())]
    here = [each for each in public_names() if each.module == module]
    elsewhere = [each for each in public_names() if module in each.others]
    if elsewhere:
        lines += ["", f"Names that `{module}` shows and other pages document:", ""]
        lines += [
            f"- [`{each.name}`]({Path(page_of(each.module)).name}#{each.path})"
            for each in sorted(elsewhere, key=lambda each: each.name.lower())
        ]
    for each in here:
        lines += ["", *_entry(each)]
    return "\n".join(lines) + "\n"


def _entry(name: Name) -> list[str]:
    lines = [f"[](){{#{other}.{name.name}}}" for other in name.others]
    if name.is_documented:
        lines += ["", f"::: {name.path}", "    options:", "      heading_level: 2"]
    else:
        lines += ["", f"## {name.name} {{#{name.path}}}", "", _described(name)]
    return [*lines, *_shown(name)]


def _described(name: Name) -> str:
    """A value that is no function or class: its assignment, and what is said of it."""
    found = source_of(name.path)
    said = found.docstring.value if found.docstring else _comment(found)
    text = "\n".join(found.lines).strip()
    return "\n\n".join([*([said] if said else []), f"```python\n{text}\n```"])


def source_of(path: str) -> griffe.Object:
    """What stands in the source under a public path."""
    found = _package()[path.removeprefix(f"{PACKAGE}.")]
    return found.final_target if isinstance(found, griffe.Alias) else found


@cache
def _homes() -> dict[str, str]:
    return public_homes(_package())


@cache
def _package() -> griffe.Module:
    found = griffe.load(
        PACKAGE,
        search_paths=[str(ROOT)],
        try_relative_path=False,  # which would prefer the working directory
        resolve_aliases=True,
        allow_inspection=False,
        extensions=griffe.load_extensions("dataclasses", Fields, ShortReferences),
    )
    assert isinstance(found, griffe.Module)
    return found


def _comment(of: griffe.Object) -> str:
    """The comment above an assignment."""
    path = of.filepath
    assert isinstance(path, Path) and of.lineno
    lines = path.read_text("utf-8").splitlines()[: of.lineno - 1]
    said: list[str] = []
    while lines and lines[-1].startswith("#"):
        said.insert(0, lines.pop().removeprefix("#").strip())
    return " ".join(said)


def _shown(name: Name) -> list[str]:
    found = examples()[name.path]
    if not found:
        return []
    best = found[0]
    through = f", by [`{best.through.rpartition('.')[2]}`][{best.through}]"
    lines = [
        "",
        f"*Example* ({_place(best)}{through if best.through else ''}):",
        "",
        "```python",
        best.code,
        "```",
    ]
    pages = dict.fromkeys(_place(each) for each in found if _is_page(each))
    pages.pop(_place(best), None)
    if pages:
        lines += ["", f"*Used in* {', '.join(list(pages)[:USES])}."]
    return lines


def _is_page(of: Example) -> bool:
    return of.source.parts[0] not in ("tests", PACKAGE)


def _place(of: Example) -> str:
    """The page as a link, from a page of the reference; a file that is no page by name."""
    match of.source.parts:
        case ("README.md",):
            return "[the front page](../index.md)"
        case ("docs", "gallery", _):
            return f"[{of.title}](../gallery/{of.source.stem}.md)"
        case ("docs", *rest):
            return f"[{of.title}](../{'/'.join(rest)})"
        case ("notebooks", _):
            return f"[{of.title}](../notebooks/{of.source.stem}.md)"
        case _:
            return f"`{of.title}` in `{of.source.as_posix()}`"


def _index() -> str:
    names = public_names()
    lines = [
        "# Reference",
        "",
        f"Every public name, {len(names)} of them: what it is made or called with, shapes, "
        "units, errors, source, the code, and an example that the tests run. "
        f"`import {PACKAGE} as aslo` reaches them all.",
        "",
        "| module | names | what it is about |",
        "| --- | --- | --- |",
    ]
    for module in public_modules():
        doc = inspect.getdoc(importlib.import_module(module)) or ""
        count = sum(each.module == module for each in names)
        about = in_full(re.split(r"(?<=[.:])\s", " ".join(doc.split()))[0], _homes())
        page = Path(page_of(module)).name
        lines.append(f"| [`{module}`]({page}) | {count} | {about.rstrip(':')} |")
    return "\n".join(lines) + "\n"
