"""Puts the site into the archives: hatchling calls it when it builds one."""

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

WHERE = "aslo_jax/data/site.zip"
NEEDED = ("zensical", "mkdocstrings_handlers", "jax", "typer")


class SiteHook(BuildHookInterface):
    """An sdist gets the pages of its checkout, and a wheel those of its sdist. Where what
    builds them is not installed, as in pip's isolated build of a checkout, there are none,
    and `aslo-jax docs` says so."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        root = Path(self.root)
        if version == "editable":
            return
        if (root / WHERE).exists():  # in the same place of the archive as where it is built
            build_data["force_include"][str(root / WHERE)] = WHERE
            return
        if not all(importlib.util.find_spec(each) for each in NEEDED):
            self.app.display_warning("Without the extra `docs` there will be no pages.")
            return
        self._folder = tempfile.TemporaryDirectory()
        packed = Path(self._folder.name, "site.zip")
        subprocess.run(
            [sys.executable, "-m", "website", "pack", str(packed)],
            cwd=root,
            env={**os.environ, "PYTHONPATH": str(root)},
            check=True,
        )
        build_data["force_include"][str(packed)] = WHERE

    def finalize(
        self, version: str, build_data: dict[str, Any], artifact_path: str
    ) -> None:
        if hasattr(self, "_folder"):
            self._folder.cleanup()
