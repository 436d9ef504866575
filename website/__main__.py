"""`python -m website build`: the documentation as a site of files."""

import argparse
import sys
import tempfile
from pathlib import Path

from . import BUILD
from ._build import build
from ._crawl import faults
from ._pack import pack


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m website", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    made = commands.add_parser("build", help="write the site, and print where it is")
    made.add_argument("--folder", type=Path, default=BUILD)
    packed = commands.add_parser("pack", help="build it elsewhere, and write it as a zip")
    packed.add_argument("zip", type=Path)
    given = parser.parse_args(arguments)
    if given.command == "pack":
        with tempfile.TemporaryDirectory() as folder:
            pack(build(Path(folder)), given.zip)
        return 0
    html = build(given.folder)
    found = faults(html)
    for line in found:
        print(line)
    print(html / "index.html")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
