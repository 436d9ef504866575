"""`python -m release check`: what must hold before a version is published."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from . import ROOT
from ._api import check_api, write_snapshot
from ._archives import build, check_archives
from ._deprecations import check_deprecations
from ._install import check_install
from ._licences import check_licences, licences
from ._recipe import recipe
from ._versions import check_citation, check_versions

Check = Callable[[], list[str]]


def main(arguments: list[str] | None = None) -> int:
    """Run a command; 1 if a check found something."""
    parser = argparse.ArgumentParser(prog="python -m release", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    check = commands.add_parser(
        "check", help="versions, citation, names, licences, archives"
    )
    check.add_argument(
        "--quick", action="store_true", help="without building and installing"
    )
    check.add_argument("--tag", help="of the release, as v0.2.0: nothing may be unreleased")
    commands.add_parser("snapshot", help="store the public names of a release")
    commands.add_parser("licences", help="print those of the installed dependencies")
    made = commands.add_parser("build", help="the wheel and the sdist, into a folder")
    made.add_argument("folder", type=Path)
    drafted = commands.add_parser("recipe", help="print a recipe for conda-forge")
    drafted.add_argument("sdist", type=Path)
    given = parser.parse_args(arguments)
    match given.command:
        case "snapshot":
            print(write_snapshot())
        case "licences":
            for name, licence in licences().items():
                print(f"{name}: {licence}")
        case "build":
            build(ROOT, given.folder)
        case "recipe":
            print(recipe(given.sdist), end="")
        case _:
            return _report(_checks(given.quick, given.tag))
    return 0


def _checks(quick: bool, tag: str | None) -> dict[str, Check]:
    checks: dict[str, Check] = {
        "versions": lambda: check_versions(tag),
        "citation": check_citation,
        "public names": check_api,
        "deprecations": check_deprecations,
        "licences": check_licences,
    }
    if not quick:
        checks |= {"archives": check_archives, "installation": check_install}
    return checks


def _report(checks: dict[str, Check]) -> int:
    wrong = 0
    for name, check in checks.items():
        found = check()
        wrong += len(found)
        print(f"{name}: {'passed' if not found else f'{len(found)} to mend'}")
        for line in found:
            print(f"  {line}")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
