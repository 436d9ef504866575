"""`aslo-jax docs`: the documentation, as pages of this version that need no network."""

import difflib
import importlib.util
import os
import subprocess
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from .._site import unpacked

PACKAGE = Path(__file__).parents[1]


def docs(
    page: Annotated[
        str | None,
        typer.Argument(help="Page to open, for instance calibration or reference/tune."),
    ] = None,
    browser: Annotated[
        bool, typer.Option(help="Open the page, or only print where it is.")
    ] = True,
) -> None:
    """Open the documentation of this version in a browser, from files: it needs no network.

    It prints the path of the page. The pages of a wheel are unpacked once, to the user's
    cache; those of a checkout are built when something that they are made of has changed,
    which takes half a minute and needs the extra `docs`.
    """
    path = _page(_site(), page or "index")
    typer.echo(path)
    if browser and not webbrowser.open(path.as_uri()):
        typer.echo("aslo-jax: no browser was found; open that file in one.", err=True)


def _site() -> Path:
    """The folder of the pages."""
    packed = PACKAGE / "data" / "site.zip"
    if packed.is_file():
        return unpacked(packed)
    root = PACKAGE.parent
    if not (root / "website" / "__main__.py").is_file():
        raise FileNotFoundError(
            "This installation has no pages, since it was not made from a wheel. In the "
            'checkout that it is of: pip install -e ".[docs]", then `aslo-jax docs`.'
        )
    html = root / "build" / "site" / "html"
    if not _is_current(html / "index.html", root):
        _build(root)
    return html


def _build(root: Path) -> None:
    if importlib.util.find_spec("zensical") is None:
        raise ImportError(
            f'the pages of this checkout are not built: pip install -e "{root}[docs]", '
            f"then `python -m website build` in {root}"
        )
    typer.echo("aslo-jax: building the pages, which takes half a minute", err=True)
    made = subprocess.run(
        [sys.executable, "-m", "website", "build"],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode:
        raise ValueError(f"The pages cannot be built: {made.stdout}{made.stderr}")


def _is_current(index: Path, root: Path) -> bool:
    """Whether the pages are younger than all that they are made of."""
    if not index.is_file():
        return False
    sources = [root / "README.md"]
    for folder in ("docs", "notebooks", "website", "tests", PACKAGE.name):
        sources += (each for each in (root / folder).rglob("*") if each.suffix != ".pyc")
    built = index.stat().st_mtime
    return all(each.stat().st_mtime <= built for each in sources if each.is_file())


def _page(html: Path, name: str) -> Path:
    path = html / f"{name.removesuffix('.html').removesuffix('.md')}.html"
    if path.is_file() and path.resolve().is_relative_to(html.resolve()):
        return path
    names = [
        each.relative_to(html).with_suffix("").as_posix() for each in html.rglob("*.html")
    ]
    near = difflib.get_close_matches(name, names, n=3) or sorted(names)[:3]
    raise ValueError(f"There is no page `{name}`; did you mean {' or '.join(near)}?")
