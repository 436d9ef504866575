"""Deprecated names whose time is over."""

import ast
from collections.abc import Iterator
from pathlib import Path

from packaging.version import Version

from . import PACKAGE, ROOT
from ._versions import project


def check_deprecations() -> list[str]:
    """Uses of `deprecated(since, removed, instead)` that this version must not have."""
    version = Version(project()["version"])
    files = sorted((ROOT / PACKAGE).rglob("*.py"))
    return [
        line for path in files for line in overdue(path.read_text("utf-8"), path, version)
    ]


def overdue(code: str, path: Path, version: Version) -> Iterator[str]:
    """What in the `code` of the file `path` should have gone by `version`."""
    if "deprecated(" not in code:
        return
    for node in ast.walk(ast.parse(code)):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            continue
        given = {each.arg: each.value for each in node.keywords}
        removed = given.get("removed")
        if node.func.id != "deprecated" or not isinstance(removed, ast.Constant):
            continue
        if Version(str(removed.value)) <= version:
            yield f"{path}:{node.lineno} is to be removed in {removed.value}"
