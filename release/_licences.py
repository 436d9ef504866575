"""The licences of what the package needs, as installed."""

import re
from collections.abc import Iterable, Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from packaging.requirements import Requirement

from . import PACKAGE
from ._versions import project

# Licences whose terms would reach users of an Apache-2.0 library; the Lesser ones do not.
COPYLEFT = re.compile(
    r"(?<!L)(?<!Lesser )(?<!\w)A?GPL|Affero|(?<!Lesser )General Public", re.I
)


def check_licences() -> list[str]:
    """Dependencies whose licence is not known, or is a strong copyleft."""
    found = []
    for name, licence in licences().items():
        if not licence:
            found.append(f"The licence of {name} is not known")
        elif COPYLEFT.search(licence):
            found.append(f"The licence of {name} is {licence}")
    return found


def licences() -> dict[str, str]:
    """By the name of every installed dependency of the package and of the extra `all`, and
    of theirs."""
    found: dict[str, str] = {}
    todo = list(_required())
    while todo:
        need = todo.pop()
        name = re.sub(r"[-_.]+", "-", need.name).lower()
        try:
            installed = distribution(name)
        except PackageNotFoundError:
            continue
        if name != PACKAGE.replace("_", "-") and name not in found:
            found[name] = licence_of(installed)
            todo += _needs(installed.requires or (), need.extras)
    return dict(sorted(found.items()))


def licence_of(installed: Distribution) -> str:
    """Its SPDX expression, else its classifiers, else the first line of its free text."""
    said = installed.metadata
    if expression := said.get_all("License-Expression"):
        return expression[0]
    classifiers = [
        each.rpartition(" :: ")[2]
        for each in said.get_all("Classifier") or ()
        if each.startswith("License :: ") and each != "License :: OSI Approved"
    ]
    free = (said.get_all("License") or [""])[0].strip().partition("\n")[0]
    return " AND ".join(classifiers) or free


def _required() -> Iterator[Requirement]:
    described = project()
    for each in (described["dependencies"], *described["optional-dependencies"].values()):
        needs = [Requirement(line) for line in each]
        if not any(
            need.name == PACKAGE and {"all", "test"} & need.extras for need in needs
        ):
            yield from needs


def _needs(lines: Iterable[str], extras: set[str]) -> Iterator[Requirement]:
    for line in lines:
        need = Requirement(line)
        given = ({"extra": extra} for extra in (extras or {""}))
        if need.marker is None or any(need.marker.evaluate(each) for each in given):
            yield need
