"""Where the figures of a run are kept: a folder in the working directory."""

import json
from pathlib import Path
from typing import Any

FOLDER = Path("benchmark-results")


def save(name: str, figures: Any) -> None:
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / f"{name}.json").write_text(json.dumps(figures, indent=2) + "\n")
