"""What is wrong in the HTML: links and pictures that lead nowhere, and whatever would be
loaded from a network."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Elements whose attribute a browser follows or loads; the rest are names of namespaces.
LOADED = {"href", "src", "srcset", "poster", "data", "action"}


class Page(HTMLParser):
    """The targets of a page, with the line of each, and its anchors."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.targets: list[tuple[int, str]] = []
        self.anchors: set[str] = set()
        self.without_text: list[int] = []
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.anchors |= {given[key] or "" for key in ("id", "name") if key in given}
        line = self.getpos()[0]
        for key in LOADED & given.keys():
            self.targets.append((line, given[key] or ""))
        if tag == "img" and not given.get("alt"):
            self.without_text.append(line)


def faults(html: Path) -> list[str]:
    """One line for each fault of the site in the folder `html`."""
    pages = {path.resolve(): Page(path) for path in sorted(html.rglob("*.html"))}
    found = []
    for page in pages.values():
        where = page.path.relative_to(html)
        found += [f"{where}:{line}: a picture without a text" for line in page.without_text]
        for line, target in page.targets:
            wrong = _wrong(page, target, pages)
            if wrong:
                found.append(f"{where}:{line}: {target}: {wrong}")
    return found


def _wrong(page: Page, target: str, pages: dict[Path, Page]) -> str:
    parts = urlsplit(target)
    if parts.scheme == "data":
        return ""
    if parts.scheme or parts.netloc:
        return "leads out of the site"
    if page.path.name == "404.html":  # whose links are those of a server
        return ""
    path = (page.path.parent / unquote(parts.path)).resolve() if parts.path else page.path
    if not path.is_file():
        return "there is no such file"
    anchor = unquote(parts.fragment)
    other = pages.get(path.resolve())
    if anchor and other and anchor not in other.anchors and not anchor.startswith("__"):
        return "there is no such place in the page"
    return ""
