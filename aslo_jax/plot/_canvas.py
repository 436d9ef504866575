"""The figure of matplotlib that everything is drawn on, with a style and a layout of its
own: no global setting is changed, and pyplot knows nothing of it."""

import contextlib
import io
import pathlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from .._extras import missing
from ._style import PLAIN, SETTINGS

try:
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
    from matplotlib.figure import Figure as PlainFigure
except ModuleNotFoundError as error:
    raise missing("matplotlib", "plot") from error

from . import _ticks

DPI = 130
LEFT, RIGHT, TOP, BOTTOM = 1.02, 0.3, 0.36, 0.5  # inch: the margins of a panel
LABEL = 0.86  # inch: from the axis to the middle of its label

_styled = False
# Of a process and not of a figure.
_KEPT = ("backend", "interactive", "toolbar", "timezone", "webagg", "datapath", "tk.")


def _own_settings() -> dict[str, Any]:
    """Matplotlib's own defaults under ours: a style that is switched on elsewhere, such as
    white lines on black, does not enter."""
    defaults = {
        name: value
        for name, value in matplotlib.rcParamsDefault.items()
        if not name.startswith(_KEPT) and matplotlib.rcParams[name] != value
    }
    return defaults | SETTINGS


@contextlib.contextmanager
def styled(own: bool = True) -> Iterator[None]:
    """The style of our figures within the context, and the one before it after it; of a
    figure that is not our `own`, only that text is plain."""
    global _styled
    if _styled:  # the inner of two
        yield
        return
    settings: Any = _own_settings() if own else PLAIN
    with matplotlib.rc_context(settings):
        _styled = True
        try:
            yield
        finally:
            _styled = False


class Canvas(PlainFigure):
    """A figure of `width` and `height` (inch) that is drawn and saved in our style,
    whatever the global one is. A notebook shows it where it is the value of a cell."""

    def __init__(self, width: float, height: float, dpi: float = DPI, **settings: Any):
        with styled():
            super().__init__((width, height), dpi=dpi, **settings)
            FigureCanvasAgg(self)

    def draw(self, renderer: Any) -> None:
        with styled():
            _ticks.without_mathtext(self)
            super().draw(renderer)

    def savefig(self, fname: Any, *, transparent: bool | None = None, **settings: Any):
        """As in matplotlib, with the resolution of the figure."""
        with styled():
            settings = {"dpi": "figure"} | settings
            if str(settings.get("format") or pathlib.Path(str(fname)).suffix).endswith(
                "png"
            ):
                # Lines on white are small at any level, of which the usual one is slow.
                settings["pil_kwargs"] = {"compress_level": 2} | settings.get(
                    "pil_kwargs", {}
                )
            super().savefig(fname, transparent=transparent, **settings)

    def _repr_png_(self) -> bytes:
        return self.bytes("png")

    def bytes(self, kind: str) -> bytes:
        """The figure as a file of the format `kind`: the same figure, the same bytes."""
        # No version and no date: the same figure, the same file.
        dated = {"png": "Software", "svg": "Date", "pdf": "CreationDate"}[kind]
        out = io.BytesIO()
        self.savefig(out, format=kind, metadata={dated: None})
        return out.getvalue()


def is_own(figure: Any) -> bool:
    """Whether a figure, or the one that a subfigure is part of, is a [`Canvas`][]."""
    return isinstance(figure.figure, Canvas)


@contextlib.contextmanager
def drawing(
    figure: Any,
    axes: Any,
    heights: Sequence[float],
    columns: int | Sequence[int] = 1,
    *,
    width: float,
    inch: float,
    of: str,
    **places: Any,
) -> Iterator[tuple[Any, list[Any]]]:
    """The figure and the panels of a public function, in the style that they have.

    - `figure`, `axes`: what its caller gave, of which one may be; by default a figure is
      made, `width` wide, each unit of `heights` so many `inch` high;
    - `of`: what there are so many panels of, for a message; `places` as for [`grid`][].
    """
    if figure is not None and axes is not None:
        raise ValueError(
            "Arguments `figure` and `axes` exclude each other; give the axes alone."
        )
    across = [columns] * len(heights) if isinstance(columns, int) else columns
    count = places.get("count") or sum(across)
    if axes is not None:
        panels = list(np.ravel(np.asarray(axes, object)))
        if len(panels) != count:
            raise ValueError(
                f"Argument `axes` must hold {count} axes, {of}, but holds {len(panels)}; "
                "leave it out for a new figure."
            )
        with styled(is_own(panels[0].figure)):
            yield panels[0].figure.figure, panels
        return
    if figure is None:
        gaps = places.get("gaps", TOP) * (len(heights) - 1)
        ends = places.get("top", TOP) + places.get("bottom", BOTTOM)
        figure = Canvas(width, inch * sum(heights) + gaps + ends)
    with styled(is_own(figure)):
        rows = grid(figure, heights, columns, **places)
        yield figure.figure, [panel for row in rows for panel in row]


def grid(
    figure: Any,
    heights: Sequence[float],
    columns: int | Sequence[int] = 1,
    *,
    left: float = LEFT,
    inner: float | None = None,
    right: float = RIGHT,
    top: float = TOP,
    bottom: float = BOTTOM,
    gaps: Sequence[float] | float = TOP,
    sharex: bool = False,
    count: int | None = None,
) -> list[list[Any]]:
    """Panels in rows, lists of axes, at places computed here: margins around them hold
    every label, so that none need be measured.

    - `heights` of the rows, relative to each other; `columns` of each row, or of all;
    - `left`: margin (inch) of every panel, or of the first of a row where `inner` is given
      for the others; `right`, `top`, `bottom`: those of the figure;
      `gaps` below each row but the last, or one for all of them;
    - `count`: of all panels, where the last row is not full.
    """
    rows = len(heights)
    width, height = (x / figure.dpi for x in (figure.bbox.width, figure.bbox.height))
    columns = [columns] * rows if isinstance(columns, int) else list(columns)
    gaps = [gaps] * (rows - 1) if isinstance(gaps, int | float) else list(gaps)
    # Of a figure that is too small for its margins something is seen all the same.
    free = max(height - top - bottom - sum(gaps), 0.3 * height)
    each = free * np.asarray(heights, float) / sum(heights)
    found: list[list[Any]] = []
    first, y = None, height - top
    for tall, across, gap in zip(each, columns, [*gaps, 0.0], strict=True):
        y -= tall
        between = left if inner is None else inner
        inside = (width - right - left - (across - 1) * between) / across
        inside = max(inside, 0.3 * width / across)
        step = inside + between
        row = []
        for j in range(across):
            if len(found) * across + j == count:
                break
            x = width - right - inside - (across - 1 - j) * step
            box = (max(x, 0.0) / width, max(y, 0.0) / height, inside / width, tall / height)
            axes = figure.add_axes(box, sharex=first if sharex else None)
            first = axes if first is None else first
            # Fixed: matplotlib measures every tick to place a label or a title, each time
            # that it draws.
            axes.yaxis.set_label_coords(-min(LABEL, left - 0.12) / inside, 0.5)
            axes.xaxis.set_label_coords(0.5, -0.3 / tall)
            axes.set_title("", y=1.0)
            row.append(axes)
        found.append(row)
        y -= gap
    return found


def legend(axes: Any, **settings: Any) -> None:
    """The labels of a panel above it, at the right, where no line is."""
    handles, _ = axes.get_legend_handles_labels()
    if handles:
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "ncols": len(handles)}
        axes.legend(**(place | {"borderpad": 0.15} | settings))


def width_of(texts: Sequence[str], size: float) -> float:
    """How wide (inch) the widest of `texts` is at `size` (points)."""
    from matplotlib.font_manager import FontProperties

    font, inch = FontProperties(size=size), 72
    find = RendererAgg(1, 1, inch).get_text_width_height_descent
    return max((find(text, font, False)[0] for text in texts), default=0.0) / inch


def shortened(text: str, most: int) -> str:
    """A text of at most so many characters, its middle left out."""
    if len(text) <= most:
        return text
    head = (most - 1) // 2
    return f"{text[:head]}…{text[len(text) - (most - 1 - head) :]}"
