"""What a user of `aslo-jax explore` waits for in headless Chromium: from the command to the
first plot, and from a key on a slider to the new one and its band of 256 runs."""

import re
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from . import results
from .browser import Browser, found
from .timing import load

STARTS, MOVES = 5, 40
FIRST, UPDATE = 3.0, 0.3  # s
COMMAND = [sys.executable, "-m", "aslo_jax", "explore", "--no-browser"]
DRAWN = "document.body && document.body.dataset.drawn > 0"
# The time from a key to a drawing, told by the page itself: after what `done` says of the
# data of its body.
MOVED = """new Promise((tell) => {
  const slider = document.querySelector('[data-key="observers.ASLO.cutoff"]');
  const body = document.body.dataset, before = Number(body.drawn);
  const begun = performance.now();
  let run = null;
  const watch = new MutationObserver(() => {
    if (run === null && Number(body.drawn) > before) run = performance.now() - begun;
    if (run !== null && body.banded === body.drawn) {
      watch.disconnect();
      tell([run, performance.now() - begun]);
    }
  });
  watch.observe(document.body, { attributes: true });
  slider.value = Number(slider.value) + 5;
  slider.dispatchEvent(new Event("input"));
})"""


def main() -> list[str]:
    if found() is None:
        print("explore: no Chromium to draw the page in; not measured.")
        return []
    browser = Browser()
    firsts, processor, bands, moves = [], [], [], []
    try:
        for _ in range(STARTS):
            begun = time.perf_counter()
            process = subprocess.Popen(COMMAND, stdout=subprocess.PIPE, text=True)
            assert process.stdout is not None
            browser.open(process.stdout.readline().split()[0])
            browser.wait(DRAWN)
            firsts.append(time.perf_counter() - begun)
            processor.append(_processor_time(process.pid))
            browser.wait("document.body.dataset.banded > 0")
            bands.append(time.perf_counter() - begun)
            if len(firsts) == STARTS:
                moves = [browser.value(MOVED) for _ in range(MOVES)]
            process.send_signal(signal.SIGINT)
            process.communicate()
    finally:
        browser.close()
    runs, both = (statistics.median(each) / 1000 for each in zip(*moves, strict=True))
    figures: dict[str, Any] = {
        "first_plot_s": statistics.median(firsts),
        "first_plot_processor_s": statistics.median(processor),
        "first_band_s": statistics.median(bands),
        "update_s": runs,
        "update_with_band_s": both,
        "load": load(),
    }
    print(f"The explorer's page, medians of {STARTS} starts and {MOVES} moves; {load()}")
    print(
        f"  first plot {figures['first_plot_s']:.2f} s after the command, of which the "
        f"program's processor time {figures['first_plot_processor_s']:.2f} s; its band "
        f"after {figures['first_band_s']:.2f} s"
    )
    print(f"  a slider moved: new plot after {runs:.3f} s, with its band {both:.3f} s")
    results.save("explore", figures)
    failures = []
    if figures["first_plot_s"] > FIRST:
        failures.append(f"explore: the first plot took more than {FIRST} s.")
    if both > UPDATE:
        failures.append(f"explore: an update took more than {UPDATE} s.")
    return failures


def _processor_time(pid: int) -> float:
    """Of a process so far (s), where the system tells."""
    status = Path(f"/proc/{pid}/stat")
    if not status.exists():
        return float("nan")
    fields = re.sub(r"\(.*\)", "", status.read_text()).split()
    return (int(fields[12]) + int(fields[13])) / 100.0  # ticks of 10 ms
