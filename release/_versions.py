"""Whether the files that name a version, a licence and authors agree."""

import tomllib
from typing import Any

import yaml

from . import ROOT
from ._changelog import releases, unreleased

METHOD = ("Bobtsov", "Romero", "Ortega", "Pyrkin")


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]


def check_versions(tag: str | None = None) -> list[str]:
    """Of pyproject.toml, CITATION.cff and CHANGELOG.md, and of the `tag` of a release."""
    version = project()["version"]
    latest, date = releases()[0]
    cff = citation_file()
    found = []
    for file, has in (("CHANGELOG.md", latest), ("CITATION.cff", cff.get("version"))):
        if has != version:
            found.append(f"{file} has version {has}, and pyproject.toml {version}")
    if str(cff.get("date-released")) != date:
        found.append(
            f"CITATION.cff has date {cff.get('date-released')}, CHANGELOG.md {date}"
        )
    if tag is not None and tag != f"v{version}":
        found.append(f"The tag is {tag}, and pyproject.toml has {version}")
    if tag is not None and unreleased().strip():
        found.append("CHANGELOG.md has entries that belong to no release")
    return found


def check_citation() -> list[str]:
    """That CITATION.cff is of a version that others read, names the licence of the project
    and the authors of the method."""
    cff = citation_file()
    found = []
    if cff.get("cff-version") != "1.2.0":
        found.append("CITATION.cff must be of version 1.2.0, which cffconvert reads")
    found += [
        f"CITATION.cff has no {key}"
        for key in ("message", "title", "authors", "type")
        if not cff.get(key)
    ]
    if cff.get("license") != project()["license"]:
        found.append(f"CITATION.cff has licence {cff.get('license')}")
    named = [
        tuple(author.get("family-names") for author in each.get("authors", ()))
        for each in cff.get("references", ())
    ]
    if METHOD not in named:
        found.append(f"CITATION.cff has no reference by {', '.join(METHOD)}")
    if (ROOT / ".zenodo.json").exists():
        found.append(".zenodo.json makes Zenodo ignore CITATION.cff")
    return found


def citation_file() -> dict[str, Any]:
    return yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
