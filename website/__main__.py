"""`python -m website build`: the documentation as a site of files."""

import argparse
import sys
import tempfile
from pathlib import Path

from . import BUILD, _commands, _errata, _gallery, _notebooks
from ._build import build
from ._crawl import faults
from ._pack import pack


def main(arguments: list[str] | None = None) -> int:
    """Run a command; 1 if the site has faults."""
    parser = argparse.ArgumentParser(prog="python -m website", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    made = commands.add_parser("build", help="write the site, and print where it is")
    made.add_argument("--folder", type=Path, default=BUILD)
    packed = commands.add_parser("pack", help="build it elsewhere, and write it as a zip")
    packed.add_argument("zip", type=Path)
    for name, what in (("gallery", "its scripts"), ("notebooks", "them")):
        run = commands.add_parser(name, help=f"run {what}, and store what they show")
        run.add_argument("names", nargs="*", help="by default all")
    commands.add_parser("commands", help="write docs/commands.md anew")
    measured = commands.add_parser("errata", help="write docs/errata.md anew")
    measured.add_argument("folder", type=Path, help="from `aslo-jax paper --section all`")
    given = parser.parse_args(arguments)
    match given.command:
        case "build":
            return _build(given.folder)
        case "pack":
            with tempfile.TemporaryDirectory() as folder:
                pack(build(Path(folder)), given.zip)
        case "gallery":
            _gallery.record(given.names)
        case "notebooks":
            _notebooks.record(given.names)
        case "commands":
            _commands.PAGE.write_text(_commands.written(), "utf-8")
        case "errata":
            _errata.PAGE.write_text(_errata.written(given.folder), "utf-8")
    return 0


def _build(folder: Path) -> int:
    html = build(folder)
    found = faults(html)
    for line in found:
        print(line)
    print(html / "index.html")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
