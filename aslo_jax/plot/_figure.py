"""A figure of a report: what is drawn, its data, its rendering to files."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

WIDTH = 7.2  # inch: the text width of a page of A4
DPI = 150


@dataclasses.dataclass(frozen=True)
class Figure:
    """A figure of a report or of the paper.

    - `name` of its files; `caption`, a sentence or two;
    - `data`: columns of one length, by a name that ends in the unit;
    - `draw(figure)`: draws on an empty `matplotlib.figure.Figure`;
    - `size`: width and height (inch);
    - `layout`: of matplotlib, or `None` where `draw` places its axes itself.
    """

    name: str
    caption: str
    data: Mapping[str, np.ndarray]
    draw: Callable[[Any], Any]
    size: tuple[float, float] = (WIDTH, 4.8)
    layout: str | None = "constrained"

    def csv(self) -> str:
        """The data, one row per instant."""
        rows = np.column_stack([np.asarray(column) for column in self.data.values()])
        lines = [",".join(self.data)]
        lines += [",".join(f"{x:.9g}" for x in row) for row in rows]
        return "\n".join(lines) + "\n"

    def render(self, *kinds: str) -> dict[str, bytes]:
        """The figure as `"png"`, `"svg"` or `"pdf"`, without a display, drawn once for all
        of them; the same figure, the same bytes."""
        from ._canvas import Canvas, styled

        with styled():
            canvas = Canvas(*self.size, dpi=DPI, layout=self.layout)
            self.draw(canvas)
            if self.layout is not None:  # once for all kinds
                canvas.draw_without_rendering()
                canvas.set_layout_engine(None)
            return {kind: canvas.bytes(kind) for kind in kinds}

    def png(self) -> bytes:
        """The figure as a picture."""
        return self.render("png")["png"]
