"""The page of the explorer in headless Chromium, by its keyboard and its address."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
import tomlkit
from test_cli import read_csv
from test_explorer import LOG, MOTOR

import aslo_jax
from aslo_jax._studies import ready_made
from benchmarks.browser import Browser, found

ROOT = Path(aslo_jax.__file__).parents[1]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(found() is None, reason="there is no Chromium to draw the page in"),
]
DRAWN = "document.body && document.body.dataset.drawn > 0"
IDLE = "document.body.dataset.busy === 'false'"
# Of a slider, once it has the focus.
VALUE = "document.activeElement.getAttribute('aria-valuetext')"


def command(*arguments, cwd=None, **settings):
    program = "from aslo_jax.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=cwd,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        **settings,
    )


@contextlib.contextmanager
def started(*arguments):
    """A running explorer and its address; it does not outlive its test."""
    process = command("explore", "--no-browser", *arguments)
    try:
        assert process.stdout is not None
        yield process, process.stdout.readline().split()[0]
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def ended(process) -> str:
    """What it says as Ctrl-C ends it."""
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    return said


@pytest.fixture(scope="module")
def explorer():
    with started() as (process, address):
        yield address
        assert ended(process) == "aslo-jax: interrupted\n"


@pytest.fixture(scope="module")
def browser():
    one = Browser()
    yield one
    one.close()


@pytest.fixture
def page(browser, explorer):
    browser.open(explorer)
    browser.wait(f"{DRAWN} && {IDLE} && document.body.dataset.banded > 0")
    return browser


def focus(page, key: str) -> None:
    page.value(f"document.querySelector('[data-key=\"{key}\"]').focus()")


def query(page) -> dict[str, list[str]]:
    return parse_qs(urlsplit(page.value("location.href")).query)


def test_a_slider_that_is_moved_changes_the_plot_and_the_address(page, explorer):
    before = page.value("({...document.body.dataset})")
    picture = "document.querySelector('canvas').toDataURL()"
    told = "document.querySelector('tbody').innerText"
    drawn, table = page.value(picture), page.value(told)
    focus(page, "observers.ASLO.cutoff")
    assert page.value(VALUE) == "238 rad/s"
    page.press("ArrowRight", 40)
    moved = page.value(VALUE)
    page.wait(f"document.body.dataset.digest !== '{before['digest']}' && {IDLE}")
    page.wait("document.body.dataset.banded === document.body.dataset.drawn")
    after = page.value("({...document.body.dataset})")
    assert float(moved.split()[0]) > 300.0
    assert after["traced"] == before["traced"]
    assert page.value(picture) != drawn
    assert page.value(told) != table
    page.wait("location.search.includes('cutoff')")
    assert f"{query(page)['observers.ASLO.cutoff'][0]} rad/s" == moved
    # The address is all there is: another page of it shows the same.
    page.open(page.value("location.href"))
    page.wait(f"{DRAWN} && {IDLE}")
    assert page.value("document.body.dataset.digest") == after["digest"]
    focus(page, "observers.ASLO.cutoff")
    assert page.value(VALUE) == moved
    assert page.errors() == []
    assert all(url.startswith((explorer, "data:", "about:")) for url in page.requested())


def test_an_exact_number_can_be_typed_and_a_wrong_one_is_told(page):
    entry = "document.querySelector('[data-entry=\"error.resistance\"]')"
    typed = (
        f"(text) => {{ {entry}.value = text; {entry}.dispatchEvent(new Event('change')) }}"
    )
    digest = page.value("document.body.dataset.digest")
    page.value(f"({typed})('12.5')")
    page.wait(f"document.body.dataset.digest !== '{digest}'")
    page.wait("location.search.includes('resistance')")
    assert query(page)["error.resistance"] == ["0.125"]
    page.value(f"({typed})('99')")
    assert page.value(f"{entry}.getAttribute('aria-invalid')") == "true"
    assert page.value(f"{entry}.title") == "From -30 to 30 %"


def test_observers_are_chosen_by_the_keyboard(page):
    lines = "document.querySelectorAll('tbody tr').length"
    assert page.value(lines) == 2
    page.value("document.querySelector('[data-observer=\"FO1\"]').click()")
    page.wait(f"{lines} === 3 && {IDLE}")
    assert "observers.FO1.gain" in page.value(
        "[...document.querySelectorAll('[data-key]')].map((e) => e.dataset.key)"
    )
    page.wait("location.search.includes('FO1')")
    assert len(query(page)["observer"]) == 3
    said = page.value("document.getElementById('export-observer').innerText")
    assert "FO1 (study only)" in said


def test_every_control_has_a_name_and_the_order_is_that_of_the_page(page):
    nameless = """[...document.querySelectorAll('input, select, button, canvas')]
        .filter((e) => !(e.labels?.length || e.ariaLabel || e.textContent.trim()))
        .map((e) => e.outerHTML)"""
    assert page.value(nameless) == []
    assert (
        page.value("document.querySelectorAll('[tabindex]:not([tabindex=\"0\"])').length")
        == 1
    )
    page.value("document.activeElement.blur()")
    seen = []
    for _ in range(12):
        page.press("Tab")
        seen.append(
            page.value("document.activeElement.id || document.activeElement.tagName")
        )
    assert seen[:4] == ["A", "source", "horizon", "seed"]
    assert "observer-0" in seen
    for role in ("status", "alert"):
        assert page.value(f"document.querySelectorAll('[role={role}]').length") == 1
    page.wait("document.getElementById('announce').textContent.includes('rms error')")
    page.value("document.querySelector('canvas').focus()")
    page.press("End")
    assert page.value("document.getElementById('announce').textContent").startswith(
        "0.1: ASLO"
    )
    assert "ASLO: from" in page.value("document.querySelector('canvas').ariaLabel")


CONTRAST = """(() => {
  const style = getComputedStyle(document.documentElement);
  const light = (name) => {
    const hex = style.getPropertyValue('--' + name).trim().slice(1);
    const part = (k) => parseInt(hex.slice(2 * k, 2 * k + 2), 16) / 255;
    const linear = (x) => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
    return 0.2126 * linear(part(0)) + 0.7152 * linear(part(1)) + 0.0722 * linear(part(2));
  };
  const ratio = (a, b) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  const names = ['ink', 'soft', 'accent', 'warn', 'truth', 'focus',
    ...[0, 1, 2, 3, 4, 5, 6, 7].map((k) => 'c' + k)];
  return Object.fromEntries(names.map((name) => [name,
    Math.min(ratio(light(name), light('card')), ratio(light(name), light('paper')))]));
})()"""


@pytest.mark.parametrize("dark", [False, True])
def test_text_and_lines_stand_out_in_light_and_dark(page, dark):
    """By 4.5 to 1, which WCAG 2.2 asks of text (1.4.3)."""
    page.prefer(dark)
    paper = page.value("getComputedStyle(document.body).backgroundColor")
    assert (int(re.findall(r"\d+", paper)[0]) < 100) == dark
    ratios = page.value(CONTRAST)
    page.prefer(False)
    assert len(ratios) == 14
    assert min(ratios.values()) >= 4.5, ratios


def test_a_narrow_page_has_nothing_beside_it(page):
    page.resize(390, 800)
    width = page.value("document.documentElement.scrollWidth")
    page.resize(1280, 900)
    assert width <= 390


def test_what_is_exported_gives_the_same_estimate(page, tmp_path):
    """The page's own buttons, and the command that the file names."""
    page("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    focus(page, "observers.ASLO.cutoff")
    page.press("ArrowLeft", 100)
    page.wait(f"location.search.includes('cutoff') && {IDLE}")
    names = ["explored.toml", "explored.csv", "estimates.csv", "explored.py"]
    names += ["explored.png", "explored.svg", "explored-c.zip", "explored-study.toml"]
    for kind in ("toml", "csv", "estimates", "python", "png", "svg", "c", "study"):
        page.value(f"document.querySelector('[data-export={kind}]').click()")
        page.wait(f"!document.querySelector('[data-export={kind}]').disabled")
    until = time.monotonic() + 60.0
    while not all((tmp_path / name).exists() for name in names):
        assert time.monotonic() < until, sorted(tmp_path.iterdir())
        time.sleep(0.05)
    cutoff = query(page)["observers.ASLO.cutoff"][0]
    text = (tmp_path / "explored.toml").read_text()
    assert f"cutoff = {cutoff}" in text
    words = text.splitlines()[1].removeprefix("# aslo-jax ").split()
    process = command(*words, "--outliers", "keep", cwd=tmp_path)
    _, said = process.communicate(timeout=120)
    assert process.returncode == 0, said
    told = read_csv(tmp_path / "estimate.csv")
    table = np.genfromtxt(tmp_path / "estimates.csv", delimiter=",", names=True)
    drawn = table["flux_alpha_ASLO"]
    np.testing.assert_allclose(told["flux_alpha"], drawn, rtol=0, atol=1e-9)
    # The program beside it says the same of the last row.
    found_ = subprocess.run(
        [sys.executable, tmp_path / "explored.py"],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert float(found_.stdout.split()[4]) == pytest.approx(drawn[-1], abs=1e-9)
    assert (tmp_path / "explored.png").read_bytes()[:4] == b"\x89PNG"
    svg = (tmp_path / "explored.svg").read_text()
    assert svg.startswith("<svg") and svg.count("<path") > 50
    assert page.errors() == []


def test_tuning_from_here_moves_the_slider(page):
    page.value("document.querySelector('[data-key=\"observers.ASLO.cutoff\"]').value = 250")
    page.value(
        "document.querySelector('[data-key=\"observers.ASLO.cutoff\"]')"
        ".dispatchEvent(new Event('change'))"
    )
    page.wait(f"location.search.includes('cutoff') && {IDLE}")
    far = float(query(page)["observers.ASLO.cutoff"][0])
    page.value("document.querySelector('[data-tune=\"ASLO\"]').click()")
    page.wait("document.querySelector('[data-tuned=\"ASLO\"]').textContent.includes('→')")
    page.wait(f"{IDLE} && !location.search.includes('cutoff={far}&')")
    said = page.value("document.querySelector('[data-tuned=\"ASLO\"]').textContent")
    before, after = (
        float(x.replace("−", "-")) for x in re.findall(r"[\d.e−]+(?= →|$)", said)
    )
    assert after < before


def test_a_log_of_ones_own_is_opened(browser):
    with started(LOG, "--machine", MOTOR) as (process, address):
        browser.open(address)
        browser.wait(f"{DRAWN} && {IDLE} && document.body.dataset.banded > 0")
        assert browser.value("document.getElementById('source').value") == "log"
        assert "pmsm_log.csv" in browser.value("document.title")
        digest = browser.value("document.body.dataset.digest")
        focus(browser, "error.resistance")
        browser.press("ArrowRight", 50)
        browser.wait(f"document.body.dataset.digest !== '{digest}' && {IDLE}")
        assert ended(process) == "aslo-jax: interrupted\n"
        # Without the program, the page says so at the next change.
        browser.press("ArrowRight", 1)
        browser.wait("!document.getElementById('problem').hidden")
        assert "has ended" in browser.value(
            "document.getElementById('problem').textContent"
        )


def test_a_study_is_opened_and_its_worst_sample_run(browser, tmp_path):
    content = tomllib.loads(ready_made("pmsm")) | {"horizon": 0.2, "every": 20}
    content["observers"] = {n: content["observers"][n] for n in ("ASLO", "FO1")}
    for metric in ("rms", "peak"):
        content["metrics"][metric]["after"] = 0.1
    (tmp_path / "short.toml").write_text(tomlkit.dumps(content))
    quiet = ("--samples", "256", "--out", tmp_path / "out", "--no-report", "-q")
    process = command("study", tmp_path / "short.toml", *quiet)
    _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    with started(tmp_path / "out") as (process, address):
        browser.open(address)
        browser.wait(f"{DRAWN} && {IDLE}")
        panels = json.loads(
            browser.value(
                "JSON.stringify([...document.querySelectorAll('canvas')]"
                ".map((c) => c.dataset.panel))"
            )
        )
        assert panels == ["error", "rms", "peak", "settling", "coasting", "scatter"]
        worst = browser.value("document.querySelector('tbody button').textContent")
        browser.value("document.querySelector('tbody button').click()")
        browser.wait("location.search.includes('source=study')")
        browser.wait(
            f"{IDLE} && document.querySelectorAll('[data-panel=certificate]').length"
        )
        assert f"Sample {worst} of the study" in browser.value(
            "document.getElementById('notice').textContent"
        )
        assert "error.resistance" in query(browser)
        assert "control.reference.offset" in query(browser)
        ended(process)


def test_a_wrong_address_is_told_and_reset(browser, explorer):
    browser.open(f"{explorer}?source=nothing")
    problem = "document.getElementById('problem')"
    browser.wait(f"{problem} && !{problem}.hidden")
    assert "`source` must be one of pmsm" in browser.value(f"{problem}.textContent")
    browser.value("document.getElementById('reset').click()")
    browser.wait(f"{DRAWN} && {IDLE}")
    assert browser.value(f"{problem}.hidden")
    assert browser.value("document.getElementById('source').value") == "pmsm"
