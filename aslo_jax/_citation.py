"""What an observer is made of, and whom to cite for it."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import equinox as eqx
import jax

PAPER = (
    "Bobtsov, Romero, Ortega, Pyrkin, "
    '"An Algebraic State Observer for a Class of Physical Systems"'
)


class Made(NamedTuple):
    """A class that a module is made of: its `name`, the first sentence of its docstring,
    and the `source` that this names; the last two may be empty."""

    name: str
    sentence: str
    source: str


@dataclass(frozen=True)
class Citation:
    """Whom to cite for an observer; its text is a paragraph for each class and a list.

    - `parts`: what each class of the observer is, and where it comes from;
    - `references`: each source once, without what only the library's pages say.
    """

    parts: tuple[str, ...]
    references: tuple[str, ...]

    def __str__(self) -> str:
        listed = "".join(f"- {each}\n" for each in self.references)
        return "\n".join(self.parts) + f"\n\nReferences:\n{listed}"


def citation(observer: Any) -> Citation:
    """Whom to cite for an `observer`, or for any other module: the sources that the
    docstrings of its classes and of its parts name, the paper of the method written out,
    and this library in its version.

    ```python
    print(aslo.citation(observer))
    ```

    **Raises:** `TypeError` for what is not a module of equinox.
    """
    if not isinstance(observer, eqx.Module):
        raise TypeError(
            "Argument `observer` must be an observer or another module, but is "
            f"{type(observer).__name__}."
        )
    made = list(made_of(observer))
    found = [each for part in made for each in _references(part.source)]
    library = f"aslo_jax {version('aslo_jax')}, Apache-2.0"
    return Citation(
        tuple(dict.fromkeys(described(part) for part in made)),
        tuple(dict.fromkeys([*found, library])),
    )


def described(part: Made) -> str:
    """In one paragraph: name, sentence and source."""
    said = f"{part.name}: {part.sentence}" if part.sentence else part.name
    source = [f"Source: {part.source}"] if part.source else []
    return "; ".join(each.rstrip(".") for each in (said, *source)) + "."


def made_of(module: Any) -> Iterator[Made]:
    """The class of a module and those of its parts, from the outside to the inside, but for
    those without a docstring of their own."""
    kind = type(module)
    doc = " ".join((kind.__doc__ or "").partition("**Raises")[0].split())
    doc = re.sub(r"\[`([^`]*)`\]\[[^]]*\]", r"`\1`", doc)
    if not doc.startswith(f"{kind.__name__}("):  # which a dataclass makes up
        name = f"{kind.__module__.split('.')[0]}.{kind.__qualname__}"
        named = re.search(r"Source: (.*?)(?=[.] (?=[A-Z][a-z]+ [a-z])|[.]?$)", doc)
        yield Made(name, re.split(r"[.:](?= [-A-Z])", doc)[0], named[1] if named else "")
    inner = lambda x: x is not module and isinstance(x, eqx.Module)
    for each in jax.tree.leaves(module, is_leaf=inner):
        if isinstance(each, eqx.Module):
            yield from made_of(each)


def _references(source: str) -> list[str]:
    """Those of a source: the paper in place of places in it, and none for pages of ours."""
    found = []
    for each in source.split("; "):
        if re.match(r"paper\b", each) or each.startswith("Bobtsov, Romero, Ortega, Pyrkin"):
            found.append(PAPER)
        elif each and not re.match(r"(theory|docs)\b", each):
            found.append(each)
    return found
