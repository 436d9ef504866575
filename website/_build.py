"""The pages are written, turned into HTML, and checked."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from . import BUILD, PACKAGE, ROOT
from ._navigation import navigation, pages

SHIM = Path(__file__).parent / "worker.js"
CDN = "https://unpkg.com/iframe-worker/shim"


def build(folder: Path = BUILD) -> Path:
    """Write the site to `folder / "html"`, and return that.

    **Raises:** `RuntimeError` with what Zensical says, where a link or a reference leads
    nowhere."""
    shutil.rmtree(folder, ignore_errors=True)
    for path, content in pages().items():
        target = folder / "pages" / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, str):
            target.write_text(content, "utf-8")
        else:
            target.write_bytes(content)
    (folder / "mkdocs.yml").write_text(json.dumps(configuration(), indent=1), "utf-8")
    _run(folder)
    html = folder / "html"
    (html / "assets" / "javascripts" / SHIM.name).write_bytes(SHIM.read_bytes())
    for page in sorted(html.rglob("*.html")):
        depth = len(page.relative_to(html).parts) - 1
        text = page.read_text("utf-8")
        page.write_text(_local(text, "../" * depth or "./"), "utf-8")
    return html


def _local(page: str, top: str) -> str:
    """The script that makes workers of pages from files, ours in place of a network's."""
    return page.replace(CDN, f"{top}assets/javascripts/{SHIM.name}")


def _run(folder: Path) -> None:
    made = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict", "-f", "mkdocs.yml"],
        cwd=folder,
        # For the extension of griffe.
        env={**os.environ, "PYTHONPATH": str(ROOT), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode:
        said = re.sub(r"\x1b\[[0-9;]*m", "", made.stdout + made.stderr)
        raise RuntimeError(f"zensical build failed:\n{said}")


def configuration() -> dict[str, object]:
    """What Zensical is told: YAML that MkDocs and its forks read, too."""
    return {
        "site_name": PACKAGE,
        "site_description": "Differentiable state observers in JAX",
        "docs_dir": "pages",
        "site_dir": "html",
        "use_directory_urls": False,
        "strict": True,
        "nav": navigation(),
        "theme": {
            "name": "material",
            "font": False,
            "features": [
                "navigation.indexes",
                "navigation.tabs",
                "navigation.top",
                "navigation.footer",
                "content.code.copy",
                "search.highlight",
                "toc.follow",
            ],
            "palette": [
                {
                    "media": f"(prefers-color-scheme: {scheme})",
                    "scheme": name,
                    "toggle": {"icon": icon, "name": f"Switch to {other}"},
                }
                for scheme, name, icon, other in (
                    ("light", "default", "lucide/sun", "dark"),
                    ("dark", "slate", "lucide/moon", "light"),
                )
            ],
        },
        "extra": {"generator": False},
        "extra_css": ["site.css"],
        "markdown_extensions": [
            "admonition",
            "attr_list",
            "def_list",
            "md_in_html",
            "tables",
            {"toc": {"permalink": True}},
            "pymdownx.details",
            {"pymdownx.highlight": {"pygments_lang_class": True}},
            "pymdownx.inlinehilite",
            "pymdownx.superfences",
        ],
        "plugins": [
            "search",
            "offline",
            "autorefs",
            {
                "mkdocstrings": {
                    "handlers": {
                        "python": {
                            "paths": [str(ROOT)],
                            "options": {
                                "allow_inspection": False,
                                "extensions": ["dataclasses", "website._griffe"],
                                "scoped_crossrefs": True,
                                "show_root_heading": True,
                                "show_root_full_path": False,
                                "show_root_toc_entry": True,
                                "show_category_heading": False,
                                "show_signature_annotations": True,
                                "separate_signature": True,
                                "line_length": 80,
                                "merge_init_into_class": True,
                                "filters": ["!^_"],
                                "show_bases": False,
                                "show_source": True,
                                "members_order": "source",
                            },
                        }
                    }
                }
            },
        ],
    }
