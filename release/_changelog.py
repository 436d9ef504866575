"""What CHANGELOG.md says."""

import re

from . import ROOT

HEADING = re.compile(r"^## \[([^]]+)\](?: - (\d{4}-\d\d-\d\d))?$", re.M)


def changelog() -> str:
    return (ROOT / "CHANGELOG.md").read_text("utf-8")


def releases() -> list[tuple[str, str]]:
    """The version and the date of each, the latest first."""
    return [(version, date) for version, date in HEADING.findall(changelog()) if date]


def latest_release() -> str:
    return releases()[0][0]


def unreleased() -> str:
    """What stands under `## [Unreleased]`; nothing where there is no such heading."""
    found = re.search(r"^## \[Unreleased\]$(.*?)(?=^## )", changelog(), re.M | re.S)
    return found[1] if found else ""
