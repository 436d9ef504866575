"""The pages: every name with constructor and example, links, search, what is shipped."""

import contextlib
import importlib
import inspect
import re
import zipfile

import pytest
from typer.testing import CliRunner

import aslo_jax as aslo
from aslo_jax import _site
from aslo_jax.cli import _docs
from aslo_jax.cli._app import app
from benchmarks.browser import Browser, found

pytest.importorskip("zensical", reason="of the extra docs")

from website import _build, _crawl, _griffe, _names, _navigation, _pack, _reference


def parameters(value):
    """What a class or a function is called with, by Python; `None` where it cannot say."""
    try:
        return list(inspect.signature(value).parameters)
    except ValueError:
        return None


def test_constructors_are_shown_with_their_fields():
    wrong, count = {}, 0
    for name in _names.public_names():
        if name.is_documented and inspect.isclass(name.value):
            found = _reference.source_of(name.path)
            shown = [each.name for each in found.parameters if each.name != "self"]
            real = parameters(name.value)
            count += real is not None
            if real not in (shown, None):
                wrong[name.path] = shown, real
    assert not wrong
    assert count > 150
    low_pass = _reference.source_of("aslo_jax.filters.LowPass")
    assert str(low_pass.parameters[1].annotation) == ("Float[Array, ''] | AbstractSchedule")
    observer = _reference.source_of("aslo_jax.AlgebraicObserver")
    assert str(observer.parameters["guard"].default) == "Guard()"
    battery = _reference.source_of("aslo_jax.plants.Battery")
    assert str(battery.parameters["capacity"].default) == "3060.0"


def test_every_public_name_has_one_place():
    listed = {
        (module, name)
        for module in _names.public_modules()
        for name in importlib.import_module(module).__all__
        if not inspect.ismodule(getattr(importlib.import_module(module), name))
    }
    placed = {
        (module, each.name)
        for each in _names.public_names()
        for module in (each.module, *each.others)
    }
    assert placed == listed - {("aslo_jax", "__version__")}
    (low_pass,) = (n for n in _names.public_names() if n.value is aslo.LowPass)
    assert low_pass.path == "aslo_jax.filters.LowPass"
    assert low_pass.others == ("aslo_jax",)


def test_short_references_get_their_path():
    homes = {"LowPass": "p._f.LowPass"}
    text = "[`LowPass`][], [`LowPass.inject`][], [`Other`][] and [`LowPass`][x.y]"
    assert _griffe.in_full(text, homes) == (
        "[`LowPass`][p._f.LowPass], [`LowPass.inject`][p._f.LowPass.inject], "
        "[`Other`][] and [`LowPass`][x.y]"
    )


def test_every_page_of_docs_has_a_place_in_the_navigation():
    placed = [name for names in _navigation.ORDER.values() for name in names]
    assert len(placed) == len(set(placed))
    assert set(placed) == {each.stem for each in (_build.ROOT / "docs").glob("*.md")}


@pytest.mark.parametrize(
    ("page", "module", "base"),
    [
        ("observers", aslo.observers, aslo.AbstractObserver),
        ("plants", aslo.plants, aslo.plants.AbstractPlant),
    ],
)
def test_every_observer_and_plant_is_on_its_page(page, module, base):
    text = (_build.ROOT / "docs" / f"{page}.md").read_text("utf-8")
    kinds = {name: getattr(module, name) for name in module.__all__}
    names = [
        name
        for name, kind in kinds.items()
        if inspect.isclass(kind) and issubclass(kind, base) and "Abstract" not in name
    ]
    assert len(names) > 10
    assert [name for name in names if f"`{name}`" not in text] == []


def test_the_crawl_finds_what_is_wrong(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.html").write_text(
        '<h1 id="here">A</h1><a href="#here">.</a><a href="sub/b.html#there">.</a>'
        '<img src="data:x" alt="x">'
    )
    (tmp_path / "sub" / "b.html").write_text(
        '<p id="there"></p>\n<a href="../a.html#gone">.</a>\n<img src="none.png">\n'
        '<link href="https://example.org/x.css"><script src="//example.org/x.js"></script>'
    )
    assert _crawl.faults(tmp_path) == [
        "sub/b.html:3: a picture without a text",
        "sub/b.html:2: ../a.html#gone: there is no such place in the page",
        "sub/b.html:3: none.png: there is no such file",
        "sub/b.html:4: https://example.org/x.css: leads out of the site",
        "sub/b.html:4: //example.org/x.js: leads out of the site",
    ]


def made(folder, content="<p>page</p>"):
    (folder / "sub").mkdir(parents=True)
    (folder / "index.html").write_text(content)
    (folder / "sub" / "tune.html").write_text(content)
    return folder


def test_a_site_is_packed_the_same_every_time_and_unpacked_once(tmp_path, monkeypatch):
    html = made(tmp_path / "html")
    for name in ("one.zip", "two.zip"):
        _pack.pack(html, tmp_path / name)
    assert (tmp_path / "one.zip").read_bytes() == (tmp_path / "two.zip").read_bytes()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = _site.unpacked(tmp_path / "one.zip")
    assert folder.parent == tmp_path / "cache" / "aslo_jax"
    assert (folder / "sub" / "tune.html").read_text() == "<p>page</p>"
    (folder / "index.html").write_text("mine")
    assert _site.unpacked(tmp_path / "two.zip") == folder
    assert (folder / "index.html").read_text() == "mine"
    monkeypatch.setattr(_pack, "LARGEST", 100)
    with pytest.raises(ValueError, match=r"The pages take .* MB, more than"):
        _pack.pack(html, tmp_path / "three.zip")


def test_the_command_opens_the_pages_of_a_wheel(tmp_path, monkeypatch):
    package = tmp_path / "aslo_jax"
    (package / "data").mkdir(parents=True)
    _pack.pack(made(tmp_path / "html"), package / "data" / "site.zip")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(_docs, "PACKAGE", package)
    opened = []
    monkeypatch.setattr(_docs.webbrowser, "open", lambda url: not opened.append(url))
    run = lambda *given: CliRunner().invoke(app, ["docs", *given])
    shown = run("--no-browser")
    assert shown.exit_code == 0 and not opened
    assert shown.output.endswith("/index.html\n")
    assert run("sub/tune").output.endswith("/sub/tune.html\n")
    assert [url.rpartition("/")[2] for url in opened] == ["tune.html"]
    for name in ("sub/tun", "../../outside"):
        with pytest.raises(ValueError, match=r"no page `.*`; did you mean .*sub/tune"):
            CliRunner().invoke(app, ["docs", name], catch_exceptions=False)
    (package / "data" / "site.zip").unlink()
    with pytest.raises(FileNotFoundError, match="This installation has no pages"):
        CliRunner().invoke(app, ["docs"], catch_exceptions=False)


def test_a_checkout_builds_its_pages_when_they_are_old(tmp_path, monkeypatch):
    for name in ("docs/a.md", "aslo_jax/x.py", "website/__main__.py", "README.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    monkeypatch.setattr(_docs, "PACKAGE", tmp_path / "aslo_jax")
    built = []

    def build(root):
        built.append(root)
        made(root / "build" / "site" / "html") if len(built) == 1 else None

    monkeypatch.setattr(_docs, "_build", build)
    run = lambda: CliRunner().invoke(app, ["docs", "--no-browser"], catch_exceptions=False)
    for _ in range(2):
        assert run().output.endswith("/build/site/html/index.html\n")
    assert built == [tmp_path]
    (tmp_path / "docs" / "b.md").write_text("new")
    index = tmp_path / "build" / "site" / "html" / "index.html"
    old = index.stat().st_mtime - 10
    _docs.os.utime(index, (old, old))
    run()
    assert len(built) == 2


@pytest.fixture(scope="module")
def html(tmp_path_factory):
    """The whole site, built strictly."""
    return _build.build(tmp_path_factory.mktemp("site"))


@pytest.mark.slow
def test_every_name_is_on_its_page_with_an_example(html):
    lacking = []
    for name in _names.public_names():
        page = html / _reference.page_of(name.module).replace(".md", ".html")
        text = page.read_text("utf-8")
        start = text.find(f'id="{name.path}"')
        following = re.search(r"<h2 ", text[start:])
        entry = text[start : start + following.start()] if following else text[start:]
        if start < 0 or "<em>Example</em>" not in entry or "<pre>" not in entry:
            lacking.append(name.path)
        if name.is_documented and not re.search("Source code in", entry):
            lacking.append(f"{name.path}: source")
    assert not lacking
    assert len(_names.public_names()) > 340


@pytest.mark.slow
def test_pages_are_as_many_as_there_should_be_and_lead_somewhere(html):
    count = sum(isinstance(each, str) for each in _navigation.pages().values())
    assert len(list(html.rglob("*.html"))) == count  # one is CSS, and one 404.html
    assert _crawl.faults(html) == []


@pytest.mark.slow
def test_the_site_is_small_and_the_same_when_it_is_built_again(html, tmp_path):
    _pack.pack(html, tmp_path / "one.zip")
    _pack.pack(_build.build(tmp_path / "again"), tmp_path / "two.zip")
    with (
        zipfile.ZipFile(tmp_path / "one.zip") as a,
        zipfile.ZipFile(tmp_path / "two.zip") as b,
    ):
        assert [(e.filename, e.CRC) for e in a.infolist()] == (
            [(e.filename, e.CRC) for e in b.infolist()]
        )


in_a_browser = pytest.mark.skipif(found() is None, reason="no Chromium is installed")
SEARCH = "document.activeElement.shadowRoot"


@pytest.mark.slow
@in_a_browser
def test_search_finds_and_nothing_is_asked_of_a_network(html):
    with contextlib.closing(Browser()) as page:
        for name in ("index", "reference/filters"):
            page.open((html / f"{name}.html").as_uri())
            page.wait("document.readyState === 'complete'")
            page.value("document.querySelector('.md-search__button').click()")
            # The window of the search is in a tree of its own.
            page.wait(f"{SEARCH} && {SEARCH}.activeElement?.tagName === 'INPUT'")
            page("Input.insertText", text="LowPass")
            link = page.wait(
                f"[...{SEARCH}.querySelectorAll('a')].map(a => a.href)"
                ".find(each => each.includes('LowPass'))"
            )
            assert "reference/filters.html" in link
            assert page.errors() == []
            assert {url.partition(":")[0] for url in page.requested()} <= {"file", "data"}


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@in_a_browser
def test_pages_fit_a_narrow_window(html, dark):
    with contextlib.closing(Browser((390, 800), dark)) as page:
        # The colours change nothing of the widths.
        for path in sorted(html.rglob("*.html"))[:: 20 if dark else 1]:
            page.open(path.as_uri())
            page.wait("document.readyState === 'complete'")
            wide = page.value("document.documentElement.scrollWidth")
            assert wide <= 390, path
        background = "getComputedStyle(document.body).backgroundColor"
        light = sum(map(int, re.findall(r"\d+", page.value(background))[:3])) > 382
        assert light != dark
