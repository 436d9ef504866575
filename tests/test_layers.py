"""Who imports whom: no circles, and no arrow from a lower layer to a higher one."""

import ast
import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# From the lowest to the highest. Parts of one layer do not import each other; what is not
# named here is below all of them.
LAYERS = (
    {"schema"},
    {"machines", "tune"},
    {"study"},
    {"plot"},
    {"_report"},
    {"described"},
    {"paper"},
    {"cli"},
)
# Of the phases of `aslo_jax.engines`.
PHASES = (
    {"_passes", "_backend"},
    {"_llvm", "_c"},
    {"_runtime"},
    {"_fused"},
    {"_adaptive"},
    {"_batch"},
)


def imports(root: Path, package: str) -> dict[str, set[str]]:
    """The modules of a package that each of them imports, wherever in the file, and for
    type checkers too: but for the faces of packages, which name for these what they import
    when it is asked for."""
    files = {}
    for path in (root / package).rglob("*.py"):
        parts = path.relative_to(root).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    found = {}
    for module, path in files.items():
        home = module.split(".")
        home = home if path.name == "__init__.py" else home[:-1]
        tree = ast.parse(path.read_text("utf-8"))
        if path.name == "__init__.py":
            tree.body = [node for node in tree.body if not _for_checkers(node)]
        nodes = list(ast.walk(tree))
        names = [
            name
            for node in nodes
            if isinstance(node, ast.Import | ast.ImportFrom)
            for name in _names(node, home)
        ]
        owners = (_owner(name, files) for name in names)
        found[module] = {each for each in owners if each} - {module}
    return found


def _for_checkers(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _names(node: ast.Import | ast.ImportFrom, home: list[str]) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    above = home[: len(home) + 1 - node.level] if node.level else []
    source = [*above, *(node.module.split(".") if node.module else [])]
    return [".".join([*source, alias.name]) for alias in node.names]


def _owner(name: str, modules: Iterable[str]) -> str | None:
    """The module that a dotted name is, or is in."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name or None


def between(arrows: Mapping[str, set[str]], depth: int) -> dict[str, set[str]]:
    """The arrows between parts of a package, as many names deep."""
    found: dict[str, set[str]] = {}
    for module, others in arrows.items():
        for other in others:
            pair = [each.split(".")[depth : depth + 1] for each in (module, other)]
            same = module.split(".")[:depth] == other.split(".")[:depth]
            if same and all(pair) and pair[0] != pair[1]:
                found.setdefault(pair[0][0], set()).add(pair[1][0])
    return found


def circles(arrows: Mapping[str, set[str]]) -> list[list[str]]:
    """A circle through each arrow that is part of one."""
    found = []
    for first in arrows:
        for second in sorted(arrows[first]):
            ways = [[second]]
            seen = {second}
            while ways:
                way = ways.pop(0)
                if way[-1] == first:
                    found.append([first, *way])
                    break
                ways += [
                    [*way, n] for n in sorted(arrows.get(way[-1], ())) if n not in seen
                ]
                seen |= arrows.get(way[-1], set())
    return found


def upward(arrows: Mapping[str, set[str]], layers: tuple[set[str], ...]) -> list[str]:
    """The arrows that do not lead to a lower layer."""
    rank = {name: k for k, layer in enumerate(layers) for name in layer}
    return [
        f"{name} imports {other}"
        for name, others in sorted(arrows.items())
        for other in sorted(others)
        if other in rank and rank.get(name, -1) <= rank[other]
    ]


@pytest.fixture(scope="module")
def arrows():
    found = imports(ROOT, "aslo_jax")
    # The face of the package names everything, and imports it when it is asked for.
    return {name: others for name, others in found.items() if name != "aslo_jax"}


def test_no_module_is_imported_in_a_circle(arrows):
    """Names of a package that its own modules import through its face count as well."""
    assert len(arrows) > 200
    assert circles(arrows) == []


def test_no_part_of_the_package_is_imported_in_a_circle(arrows):
    assert circles(between(arrows, 1)) == []


def test_nothing_is_imported_from_a_higher_layer(arrows):
    parts = between(arrows, 1)
    named = set(itertools.chain(*LAYERS))
    assert named <= {p.stem for p in (ROOT / "aslo_jax").iterdir()}
    assert upward(parts | {"__main__": set()}, LAYERS) == []


def test_graphs_of_scalars_need_nothing_of_what_is_made_of_them(arrows):
    """Engines, derivations and filters use these two."""
    allowed = {"_ir": {"_ir"}, "_frontend": {"_ir", "_frontend", "_checks", "_typing"}}
    parts = between(arrows, 1)
    assert "_frontend" in parts
    for name, below in allowed.items():
        assert (ROOT / "aslo_jax" / name).is_dir()
        assert parts.get(name, set()) <= below


def test_the_phases_of_the_engine_follow_each_other(arrows):
    inside = {k: v for k, v in arrows.items() if k.startswith("aslo_jax.engines")}
    phases = between(inside, 2)
    assert set(itertools.chain(*PHASES)) <= {
        p.stem for p in (ROOT / "aslo_jax" / "engines").iterdir()
    }
    assert upward(phases, PHASES) == []
    assert circles(phases) == []


def test_circles_and_upward_arrows_are_found(tmp_path):
    """In a package that has some: for type checkers, in a function, through a face."""
    files = {
        "low/__init__.py": "from .one import x",
        "low/one.py": "if TYPE_CHECKING:\n    from .two import y",
        "low/two.py": "def f():\n    from . import one",
        "high/__init__.py": "",
        "high/top.py": "import p.low.one\nfrom ..base import z",
        "base.py": "from .high.top import w",
        "__init__.py": "",
    }
    for name, text in files.items():
        path = tmp_path / "p" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = imports(tmp_path, "p")
    assert found["p.high.top"] == {"p.low.one", "p.base"}
    assert found["p.low.two"] == {"p.low.one"}
    pairs = {frozenset(circle) for circle in circles(found)}
    assert pairs == {
        frozenset({"p.low.one", "p.low.two"}),
        frozenset({"p.base", "p.high.top"}),
    }
    parts = between(found, 1)
    assert parts == {"high": {"low", "base"}, "base": {"high"}}
    assert upward(parts, ({"base"}, {"low"}, {"high"})) == ["base imports high"]
    assert upward(parts, ({"high"},)) == ["base imports high"]
    assert upward(parts, ({"low", "high"},)) == ["base imports high", "high imports low"]
