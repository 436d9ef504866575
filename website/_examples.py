"""Where the public names are used in code that runs: pages, gallery, notebooks, tests."""

import ast
import importlib
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

from . import PACKAGE, ROOT
from ._names import Name, public_names

PYTHON = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LIBRARY = 5  # the rank of the library's own code, the last resort
LONGEST = 32  # lines of an example; of longer code only the statements that use the name


@dataclass(frozen=True)
class Example:
    """Code that uses a name: `source`, the file relative to the checkout; `title` of the
    page, or the name of the test; `code`; `through`: the path of the name that is written
    there instead, which returns it or is made of it."""

    source: Path
    title: str
    code: str
    through: str = ""


@cache
def examples() -> dict[str, list[Example]]:
    """Those of each path, the best first: pages, then the gallery, notebooks and tests,
    and the shortest of each."""
    found: dict[str, list[tuple[int, int, Example]]] = {n.path: [] for n in public_names()}
    paths = {id(n.value): n.path for n in public_names() if n.is_documented}
    plain = {
        f"{module}.{n.name}": n.path
        for n in public_names()
        if not n.is_documented
        for module in (n.module, *n.others)
    }
    for rank, source, title, code, scope in _sources():
        for path, used in _uses(code, scope, paths, plain).items():
            shown = code if code.count("\n") <= LONGEST else used
            if shown.count("\n") <= LONGEST:
                example = Example(source, title, shown.strip("\n"))
                found[path].append((rank, len(shown), example))
    ranked = {path: sorted(some, key=lambda each: each[:2]) for path, some in found.items()}
    best = {
        path: [example for rank, _, example in some if rank < LIBRARY]
        for path, some in ranked.items()
    }
    # Twice, since what is related may itself be found by what is related to it.
    for each in 2 * public_names():
        if not best[each.path]:
            best[each.path] = [
                replace(example, through=other)
                for other in related(each)
                for example in best[other][:1]
            ]
    for path, some in ranked.items():
        best[path] = best[path] or [example for _, _, example in some]
    return best


def related(name: Name) -> list[str]:
    """What shows a name that is seldom written: what returns it, and what is made of it."""
    found = []
    for other in public_names():
        if not other.is_documented or other.value is name.value:
            continue
        if inspect.isclass(other.value):
            if inspect.isclass(name.value) and issubclass(other.value, name.value):
                found.append(other.path)
                continue
            returning = [
                getattr(each, "fget", None) or getattr(each, "__func__", each)
                for key, each in vars(other.value).items()
                if not key.startswith("_")
            ]
        else:
            returning = [other.value]
        if any(_holds(_returned(each), name.value) for each in returning):
            found.append(other.path)
    return found


def _returned(function: Any) -> Any:
    if not inspect.isfunction(function):
        return None
    try:
        return get_type_hints(function).get("return")
    except NameError:  # a name for type checkers only
        return None


def _holds(annotation: Any, value: Any) -> bool:
    parts = get_args(annotation)
    return annotation is value or any(_holds(part, value) for part in parts)


def _sources() -> Iterator[tuple[int, Path, str, str, dict[str, str]]]:
    """Rank, file, title, code, and what the names in it stand for."""
    for page in [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md"]:
        text = page.read_text("utf-8")
        scope: dict[str, str] = {}
        for block in PYTHON.findall(text):
            scope |= _imported(ast.parse(block))
            yield 0, page.relative_to(ROOT), title_of(text), block, dict(scope)
    for script in sorted((ROOT / "docs" / "gallery").glob("*.py")):
        code = script.read_text("utf-8")
        tree = ast.parse(code)
        title = (ast.get_docstring(tree) or "").partition("\n")[0].rstrip(".")
        for part in _parts(code, tree):
            yield 1, script.relative_to(ROOT), title, part, _imported(tree)
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        cells = json.loads(notebook.read_text("utf-8"))["cells"]
        scope = {}
        title = title_of("".join(cells[0]["source"]))
        for cell in cells:
            if cell["cell_type"] == "code":
                code = "".join(cell["source"]) + "\n"
                scope |= _imported(ast.parse(code))
                yield 2, notebook.relative_to(ROOT), title, code, dict(scope)
    for test in sorted((ROOT / "tests").glob("*.py")):
        code = test.read_text("utf-8")
        tree = ast.parse(code)
        scope = _imported(tree)
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                part = ast.get_source_segment(code, node) or ""
                own = scope | _imported(node)
                is_test = test.name.startswith("test_") and node.name.startswith("test_")
                yield 3 if is_test else 4, test.relative_to(ROOT), node.name, part, own
    for module in sorted((ROOT / PACKAGE).rglob("*.py")):
        code = module.read_text("utf-8")
        tree = ast.parse(code)
        home = module.relative_to(ROOT).parent.parts
        dotted = ".".join(module.relative_to(ROOT).with_suffix("").parts)
        own_names = (getattr(node, "name", "") for node in tree.body)
        scope = {name: f"{dotted}.{name}" for name in own_names if name}
        scope |= _imported(tree, home)
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Assign):
                own = scope | _imported(node, home)
                inner = node.body if isinstance(node, ast.ClassDef) else []
                for each in [*inner, node]:
                    title = getattr(each, "name", getattr(node, "name", module.stem))
                    part = _segment(code, each)
                    # What defines a name does not use it.
                    yield (
                        LIBRARY,
                        module.relative_to(ROOT),
                        title,
                        part,
                        _without(own, title),
                    )


def _parts(code: str, tree: ast.Module) -> Iterator[str]:
    """A script, whole if it is short, else its statements by paragraphs."""
    if code.count("\n") <= LONGEST:
        yield code
        return
    lines = code.splitlines(keepends=True)
    group: list[ast.stmt] = []
    for node in tree.body:
        if group and node.lineno - (group[-1].end_lineno or 0) > 1:
            yield "".join(lines[group[0].lineno - 1 : group[-1].end_lineno])
            group = []
        group.append(node)
    if group:
        yield "".join(lines[group[0].lineno - 1 : group[-1].end_lineno])


def title_of(page: str) -> str:
    """The first heading of Markdown."""
    found = re.search(r"^# (.+)$", page, re.MULTILINE)
    return found[1] if found else ""


def _imported(tree: ast.AST, home: tuple[str, ...] = ()) -> dict[str, str]:
    """What the names that are imported from the package stand for; `home` is the package
    that relative imports are from."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for each in node.names:
                if each.name.split(".")[0] == PACKAGE:
                    found[each.asname or PACKAGE] = each.name if each.asname else PACKAGE
        elif isinstance(node, ast.ImportFrom):
            above = home[: len(home) + 1 - node.level] if node.level else ()
            source = ".".join([*above, *([node.module] if node.module else [])])
            if source.split(".")[0] == PACKAGE:
                for each in node.names:
                    found[each.asname or each.name] = f"{source}.{each.name}"
    return found


def _without(scope: dict[str, str], name: str) -> dict[str, str]:
    return {key: value for key, value in scope.items() if key != name}


def _uses(
    code: str, scope: dict[str, str], paths: dict[int, str], plain: dict[str, str]
) -> dict[str, str]:
    """The statements of `code` that use each public name, imports apart."""
    found: dict[str, list[ast.stmt]] = {}
    try:
        tree = ast.parse(code)
    except SyntaxError:  # a method, cut out of its class
        return {}
    body = tree.body
    if len(body) == 1 and isinstance(body[0], ast.FunctionDef):
        body = body[0].body
    for statement in _short(body):
        if isinstance(statement, ast.Import | ast.ImportFrom):
            continue
        for node in ast.walk(statement):
            dotted = _dotted(node, scope)
            path = plain.get(dotted) or paths.get(id(_found(dotted))) if dotted else None
            if path and statement not in found.setdefault(path, []):
                found[path].append(statement)
    return {
        path: "\n".join(_segment(code, each) for each in statements)
        for path, statements in found.items()
    }


def _short(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Statements, and in place of the long ones those within them."""
    for each in body:
        inner = [
            deeper
            for field in ("body", "orelse", "handlers", "finalbody")
            for deeper in getattr(each, field, ())
            if isinstance(deeper, ast.stmt | ast.ExceptHandler)
        ]
        if inner and (each.end_lineno or 0) - each.lineno > LONGEST:
            yield from _short([deeper for deeper in inner if isinstance(deeper, ast.stmt)])
        else:
            yield each


def _segment(code: str, statement: ast.stmt) -> str:
    lines = code.splitlines()[statement.lineno - 1 : statement.end_lineno]
    decorators = getattr(statement, "decorator_list", [])
    if decorators:
        lines = code.splitlines()[decorators[0].lineno - 1 : statement.end_lineno]
    return inspect.cleandoc("\n" + "\n".join(lines))


def _dotted(node: ast.AST, scope: dict[str, str]) -> str:
    """`aslo_jax.tune.fit` of `aslo.tune.fit`, and of `fit` that was imported."""
    if isinstance(node, ast.Name):
        return scope.get(node.id, "")
    if isinstance(node, ast.Attribute):
        inner = _dotted(node.value, scope)
        return f"{inner}.{node.attr}" if inner else ""
    return ""


@cache
def _found(dotted: str) -> Any:
    module, _, rest = dotted.partition(".")
    value: Any = importlib.import_module(module)
    for part in rest.split(".") if rest else ():
        try:
            value = getattr(value, part)
        except AttributeError:
            try:
                value = importlib.import_module(f"{value.__name__}.{part}")
            except (ImportError, AttributeError):
                return None
    return value
