"""The wheel and the sdist: the same from the same source, and with the right files."""

import hashlib
import os
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from datetime import UTC, datetime
from pathlib import Path

from . import PACKAGE, ROOT
from ._changelog import releases

WHEEL_HAS = (
    "py.typed",
    "data/motor.toml",
    "data/pmsm_log.csv",
    "data/site.zip",
    "cli/columns.txt",
)
SDIST_HAS = ("CHANGELOG.md", "CITATION.cff", "LICENSE", "README.md", "pyproject.toml")


def check_archives() -> list[str]:
    """Built from the tree, and once more from the sdist that this gave."""
    with tempfile.TemporaryDirectory() as folder:
        first, second, source = (
            Path(folder, each) for each in ("first", "second", "source")
        )
        build(ROOT, first)
        with tarfile.open(_one(first, "*.tar.gz")) as packed:
            packed.extractall(source, filter="data")
        build(_one(source, "*"), second)
        wheel, sdist = _one(first, "*.whl"), _one(first, "*.tar.gz")
        with zipfile.ZipFile(wheel) as packed:
            found = wrong_in_wheel(packed.namelist())
        with tarfile.open(sdist) as packed:
            found += wrong_in_sdist(packed.getnames())
        return found + [
            f"{each.name} differs when it is built again"
            for each in (wheel, sdist)
            if digest(each) != digest(second / each.name)
        ]


def build(source: Path, to: Path) -> None:
    """The sdist of the tree at `source`, and the wheel of that."""
    made = subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(to), str(source)],
        env={**os.environ, "SOURCE_DATE_EPOCH": str(epoch())},
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode:
        raise RuntimeError(f"python -m build failed:\n{made.stdout}{made.stderr}")


def epoch() -> int:
    """The date of the latest release of the changelog (s)."""
    date = datetime.strptime(releases()[0][1], "%Y-%m-%d").replace(tzinfo=UTC)
    return int(date.timestamp())


def wrong_in_wheel(names: list[str]) -> list[str]:
    """Files that do not belong to the package, or are not there."""
    found = [f"The wheel lacks {each}" for each in _lacking(names, PACKAGE, WHEEL_HAS)]
    for name in names:
        top, *_, last = Path(name).parts
        own = top == PACKAGE or top.startswith(f"{PACKAGE}-")
        if not own or "__pycache__" in name or last.startswith(("test_", "conftest")):
            found.append(f"The wheel has {name}")
    return found


def wrong_in_sdist(names: list[str]) -> list[str]:
    """What a build or a packager needs and is not there, and what is of one machine."""
    top = Path(names[0]).parts[0]
    found = [f"The sdist lacks {each}" for each in _lacking(names, top, SDIST_HAS)]
    strange = ("__pycache__", ".venv", "node_modules", ".git/")
    return found + [
        f"The sdist has {n}" for n in names if any(each in n for each in strange)
    ]


def _lacking(names: list[str], top: str, wanted: tuple[str, ...]) -> list[str]:
    return [each for each in wanted if f"{top}/{each}" not in names]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _one(folder: Path, pattern: str) -> Path:
    (found,) = folder.glob(pattern)
    return found
