"""A recipe for conda-forge, from what the sdist says of itself."""

import tarfile
from email import message_from_string
from pathlib import Path
from typing import Any

import yaml
from packaging.requirements import Requirement

from . import PACKAGE
from ._archives import digest

INDEX = "https://pypi.org/packages/source"


def recipe(sdist: Path) -> str:
    """A draft of `recipe.yaml`, for a feedstock that somebody of conda-forge maintains."""
    with tarfile.open(sdist) as packed:
        file = packed.extractfile(f"{sdist.name.removesuffix('.tar.gz')}/PKG-INFO")
        assert file is not None
        said = message_from_string(file.read().decode())
    python = said["Requires-Python"]
    needs = [Requirement(line) for line in said.get_all("Requires-Dist") or ()]
    run = [f"{need.name} {need.specifier}".strip() for need in needs if need.marker is None]
    described: dict[str, Any] = {
        "schema_version": 1,
        "context": {"version": said["Version"]},
        "package": {"name": PACKAGE, "version": "${{ version }}"},
        "source": {
            "url": f"{INDEX}/{PACKAGE[0]}/{PACKAGE}/{PACKAGE}-${{{{ version }}}}.tar.gz",
            "sha256": digest(sdist),
        },
        "build": {
            "number": 0,
            "noarch": "python",
            "script": "${{ PYTHON }} -m pip install . -vv --no-deps --no-build-isolation",
            "python": {"entry_points": ["aslo-jax = aslo_jax.cli:main"]},
        },
        "requirements": {
            "host": [f"python {python}", "hatchling >=1.26", "pip"],
            "run": [f"python {python}", *run],
        },
        "tests": [{"python": {"imports": [PACKAGE], "pip_check": True}}],
        "about": {
            "summary": said["Summary"],
            "license": said["License-Expression"],
            "license_file": "LICENSE",
        },
    }
    return yaml.safe_dump(described, sort_keys=False, width=100)
