"""The code in README.md and docs/ runs, and prints what it is shown to print.

The `python` blocks of a page run in order, in one namespace, from the top of the checkout.
A `text` block right after one is what it prints.
"""

import contextlib
import io
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")


def blocks(text: str) -> list[tuple[str, str, int, int]]:
    """Language, content, first and last line of every fenced block."""
    found = []
    for match in BLOCK.finditer(text):
        first = text.count("\n", 0, match.start(2)) + 1
        last = text.count("\n", 0, match.end()) + 1
        found.append((match[1], match[2], first, last))
    return found


LONG = ("calibration", "batches", "continuous-time", "modelled-plants", "small-examples")
MARKED = [
    pytest.param(page, marks=[pytest.mark.slow] if page.stem in LONG else [])
    for page in PAGES
]


@pytest.mark.parametrize("page", MARKED, ids=[page.stem for page in PAGES])
def test_page(page, monkeypatch):
    monkeypatch.chdir(ROOT)
    namespace, pending = {"__name__": "__main__"}, None
    for language, content, first, last in blocks(page.read_text("utf-8")):
        if language == "text" and pending is not None and pending[1] == first - 3:
            assert pending[0] == content, f"{page.name}:{first}"
        pending = None
        if language == "python":
            # Blank lines before it give tracebacks the lines of the page.
            code = compile("\n" * (first - 1) + content, page, "exec")
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                exec(code, namespace)
            pending = printed.getvalue(), last


@pytest.mark.parametrize(
    "page", [*PAGES, ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem
)
def test_links_lead_somewhere(page):
    for target in LINK.findall(page.read_text("utf-8")):
        assert (page.parent / target).exists(), target


def test_readme_is_one_screen_with_two_commands():
    text = (ROOT / "README.md").read_text("utf-8")
    commands = [content for language, content, *_ in blocks(text) if language == "sh"]
    assert len(text.splitlines()) <= 60
    assert len(commands) == 2
    for command in commands:
        assert command.count("\n") == 1
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install ")
