"""The wheel in an empty environment of each supported Python that is there."""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from . import PACKAGE, ROOT
from ._archives import build
from ._versions import project


def check_install() -> list[str]:
    """That the wheel installs there, with the extra for logs, and that README.md's blocks
    of Python print what stands below them."""
    with tempfile.TemporaryDirectory() as folder:
        build(ROOT, Path(folder))
        (wheel,) = Path(folder).glob("*.whl")
        return [line for python in pythons() for line in _installed(wheel, python)]


def pythons() -> list[str]:
    """Those of the classifiers that run here."""
    prefix = "Programming Language :: Python :: 3."
    minors = [each.removeprefix(prefix) for each in project()["classifiers"]]
    names = [f"python3.{minor}" for minor in minors if minor.isdigit()]
    own = f"python3.{sys.version_info.minor}"
    there = [sys.executable if name == own else shutil.which(name) for name in names]
    runs = lambda path: not subprocess.run([path, "-V"], capture_output=True).returncode
    return [path for path in there if path and runs(path)]


def readme_blocks() -> list[tuple[str, str]]:
    """Each block of Python of README.md, with the text that it prints."""
    text = (ROOT / "README.md").read_text("utf-8")
    return re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", text, re.S)


def _installed(wheel: Path, python: str) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder, "environment")
        inside = here / "bin" / "python"
        run = lambda *command: subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False
        )
        for command in (
            (python, "-m", "venv", str(here)),
            (str(inside), "-m", "pip", "install", "--quiet", f"{wheel}[cli]"),
        ):
            made = run(*command)
            if made.returncode:
                return [f"{python}: {' '.join(command)}: {made.stderr.strip()}"]
        # The blocks read the package's data from a checkout's folder.
        (home,) = here.glob(f"lib/python*/site-packages/{PACKAGE}")
        shutil.copytree(home / "data", Path(folder, PACKAGE, "data"))
        found = []
        for code, printed in readme_blocks():
            # Isolated: neither the folder of the data nor PYTHONPATH is the package.
            made = run(str(inside), "-I", "-c", code)
            if made.returncode or made.stdout != printed:
                found.append(
                    f"{python}: README.md's block gives {made.stdout}{made.stderr}"
                )
        return found
