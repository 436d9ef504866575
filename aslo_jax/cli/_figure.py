"""The figure that a command writes."""

from pathlib import Path

from ._summary import Summary
from ._trace import Trace

SUFFIXES = (".png", ".pdf", ".svg")


def check_figure_suffix(path: Path) -> None:
    """Refuse a figure whose suffix is not that of a known format."""
    if path.suffix.lower() not in SUFFIXES:
        raise ValueError(
            f"{path} has the suffix {path.suffix!r}, but a figure is one of "
            f"{', '.join(SUFFIXES)}."
        )


def save_figure(path: Path, trace: Trace, summary: Summary, title: str) -> None:
    """Draw what was measured and estimated and write it to `path`, in the format of its
    suffix."""
    from ..plot._log import log_figure

    # The Agg, PDF or SVG canvas is chosen by the suffix; no window is opened.
    log_figure(trace, summary, title).savefig(path)
