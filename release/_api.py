"""The public names and their signatures, against those of the last release."""

import re
from collections.abc import Iterator
from pathlib import Path

import griffe

from . import PACKAGE, ROOT
from ._changelog import latest_release, unreleased

SNAPSHOTS = Path(__file__).parent / "api"
Signatures = dict[str, str]


def check_api() -> list[str]:
    """Names and parameters added or removed since the last release that the changelog does
    not name."""
    path = SNAPSHOTS / f"{latest_release()}.txt"
    if not path.exists():
        return [f"{path.relative_to(ROOT)} is missing: python -m release snapshot"]
    before = read(path.read_text("utf-8"))
    return unsaid(before, public_api(ROOT), unreleased())


def write_snapshot() -> str:
    """The public API as it is now, as that of the latest release of the changelog."""
    path = SNAPSHOTS / f"{latest_release()}.txt"
    path.parent.mkdir(exist_ok=True)
    path.write_text(written(public_api(ROOT)), "utf-8")
    return str(path.relative_to(ROOT))


def unsaid(before: Signatures, now: Signatures, said: str) -> list[str]:
    """What is new, gone or has other parameters, and does not stand in `said`.

    - `before`, `now`: the signature, `(a, b=)` or nothing, by the name with its module;
    - `said`: the changelog's part on what is not released.

    A name is looked for as a word within backquotes; the members of a class that is named
    need not be. What two modules show is reported once.
    """
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`]+`", said))))
    found: dict[tuple[str, str], str] = {}
    for verb, some, others in (("added", now, before), ("removed", before, now)):
        for name in sorted(some.keys() - others.keys()):
            tail = _tail(name, some)
            outer_is_too = name.rpartition(".")[0] in some.keys() - others.keys()
            if not outer_is_too and not words & set(tail.split(".")):
                found[tail, verb] = f"`{name}` was {verb}"
    for name in sorted(before.keys() & now.keys()):
        was, has = parameters(before[name]), parameters(now[name])
        for each in sorted(was.keys() | has.keys()):
            if each in words or was.get(each) == has.get(each):
                continue
            verb = "is optional now" if has.get(each) else "must be given now"
            verb = "was removed" if each not in has else verb
            verb = "was added" if each not in was else verb
            found[f"{_tail(name, now)}({each})", verb] = f"`{each}` of `{name}` {verb}"
    return [f"{each}, and the changelog does not say so" for each in found.values()]


def _tail(name: str, api: Signatures) -> str:
    """Without its modules: `LowPass`, `LowPass.inject`."""
    parts = name.split(".")
    return ".".join(parts[-2:] if ".".join(parts[:-1]) in api else parts[-1:])


def parameters(signature: str) -> dict[str, bool]:
    """`{"a": False, "b": True}` of `(a, b=)`: which may be left out."""
    shown = [each for each in signature.strip("()").split(", ") if each]
    return {each.strip("*="): each.endswith("=") or "*" in each for each in shown}


def written(api: Signatures) -> str:
    return "".join(f"{name}{api[name]}\n" for name in sorted(api))


def read(text: str) -> Signatures:
    return dict(map(_parted, text.splitlines()))


def _parted(line: str) -> tuple[str, str]:
    name, bracket, rest = line.partition("(")
    return name, bracket + rest


def public_api(root: Path) -> Signatures:
    """The signature of every name in an `__all__` of the package below `root` and of the
    modules that its face names, and of the public methods of classes, read from the source.
    That of a class of fields is its fields."""
    package = griffe.load(
        PACKAGE,
        search_paths=[str(root)],
        try_relative_path=False,  # which would prefer the working directory
        resolve_aliases=True,
        allow_inspection=False,
    )
    assert isinstance(package, griffe.Module)
    faces = [each for each in package.modules.values() if each.name in package.imports]
    found: Signatures = {}
    for module in (package, *(inner for face in faces for inner in _modules(face))):
        for name in map(str, module.exports or ()):
            if name.startswith("__"):
                continue
            member = module.members[name]
            if member.is_alias:
                member = member.final_target  # pyright: ignore[reportAttributeAccessIssue]
            if isinstance(member, griffe.Module):
                continue
            path = f"{module.path}.{name}"
            found[path] = _signature(member)
            if isinstance(member, griffe.Class):
                for method in member.members.values():
                    is_public = not method.name.startswith("_")
                    if isinstance(method, griffe.Function) and is_public:
                        found[f"{path}.{method.name}"] = _signature(method)
    return found


def _modules(module: griffe.Module) -> Iterator[griffe.Module]:
    yield module
    for name, each in module.members.items():
        if isinstance(each, griffe.Module) and not name.startswith("_"):
            yield from _modules(each)


def _signature(member: griffe.Object | griffe.Alias) -> str:
    if isinstance(member, griffe.Function):
        stars: dict[griffe.ParameterKind | None, str] = {
            griffe.ParameterKind.var_positional: "*",
            griffe.ParameterKind.var_keyword: "**",
        }
        shown = [
            stars.get(each.kind, "") + each.name + ("" if each.default is None else "=")
            for each in member.parameters
            if each.name != "self"
        ]
    elif isinstance(member, griffe.Class):
        init = member.members.get("__init__")
        if isinstance(init, griffe.Function):
            return _signature(init)
        shown = [
            name + ("=" if _optional(each) else "")
            for name, each in member.all_members.items()
            if isinstance(each, griffe.Attribute | griffe.Alias)
            and each.is_attribute
            and not name.startswith("_")
            and each.annotation is not None
            and "ClassVar" not in str(each.annotation)
            and "property" not in each.labels
        ]
    else:
        return ""
    return f"({', '.join(shown)})"


def _optional(field: griffe.Object | griffe.Alias) -> bool:
    """Whether a field of a dataclass has a default, itself or within `field(...)`."""
    value = str(getattr(field, "value", None) or "")
    return bool(value) and (".field(" not in value or "default" in value)
