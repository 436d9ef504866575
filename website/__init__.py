"""The documentation as a site that works without a network: `python -m website build`.

What is not plain Markdown is here, so that the tool that makes HTML of it can be changed in
a day: the reference, the gallery and the navigation are written as Markdown to
`build/site/pages`, beside copies of `docs/`; Zensical only turns that folder into HTML.
"""

from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "aslo_jax"
BUILD = ROOT / "build" / "site"
"""Where `python -m website build` writes; `aslo_jax.cli._docs` looks there as well."""
