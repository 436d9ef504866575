"""Figures: what is drawn, its data, and its rendering to a file."""

import dataclasses
import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

# Okabe and Ito's palette, which survives colour blindness; each with a dash pattern of its
# own, so that lines are told apart in grey too.
STYLES = (
    {"color": "#0072B2", "linestyle": "-"},
    {"color": "#D55E00", "linestyle": (0, (5, 1.5))},
    {"color": "#009E73", "linestyle": (0, (5, 1.5, 1, 1.5))},
    {"color": "#CC79A7", "linestyle": (0, (1, 1))},
)
BLACK = {"color": "black", "linestyle": (0, (4, 2))}

_SETTINGS: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.grid": True,
    "grid.color": "0.9",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "svg.hashsalt": "aslo_jax",
}


@dataclasses.dataclass(frozen=True)
class Figure:
    """A figure of the paper, or one of ours.

    - `name` of its files; `caption`, a sentence or two;
    - `data`: columns of one length, by a name that ends in the unit;
    - `draw(figure)`: draws on an empty `matplotlib.figure.Figure`;
    - `size`: width and height (inch).
    """

    name: str
    caption: str
    data: Mapping[str, np.ndarray]
    draw: Callable[[Any], None]
    size: tuple[float, float] = (7.2, 4.8)

    def csv(self) -> str:
        """The data, one row per instant."""
        rows = np.column_stack([np.asarray(column) for column in self.data.values()])
        lines = [",".join(self.data)]
        lines += [",".join(f"{x:.9g}" for x in row) for row in rows]
        return "\n".join(lines) + "\n"

    def png(self) -> bytes:
        """The figure, rendered without a display."""
        require_matplotlib()
        import matplotlib
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Canvas

        with matplotlib.rc_context(_SETTINGS):
            canvas = Canvas(figsize=self.size, layout="constrained")
            FigureCanvasAgg(canvas)
            self.draw(canvas)
            out = io.BytesIO()
            # No version of the software in the file: the same figure, the same bytes.
            canvas.savefig(out, dpi=150, format="png", metadata={"Software": None})
        return out.getvalue()


def require_matplotlib() -> None:
    """Raise an `ImportError` that says how to install matplotlib, where it is missing."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise ImportError(
            'The figures of the paper need matplotlib: pip install "aslo_jax[plot]".'
        ) from error
