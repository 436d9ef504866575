"""What must hold before a version of aslo_jax is published: `python -m release check`."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "aslo_jax"
