"""Pictures of few colours, which take a third of the room."""

import importlib
import io
from typing import Any

import numpy as np

DPI = 110
COLOURS = 64
FRAME = 60  # ms


def small(png: bytes) -> bytes:
    """The same picture with at most 64 colours."""
    return _png(_images().open(io.BytesIO(png)).convert("RGB"))


def still(figure: Any) -> bytes:
    """A figure of matplotlib as PNG."""
    return _png(_drawn(figure))


def moving(figure: Any, draw: Any, frames: int) -> bytes:
    """The figure after each `draw(frame)`, as GIF."""
    pictures = []
    for frame in range(frames):
        draw(frame)
        pictures.append(_drawn(figure))
    # One palette for all, or colours flicker.
    palette = pictures[frames // 2].quantize(COLOURS // 2)
    first, *rest = [each.quantize(palette=palette, dither=0) for each in pictures]
    out = io.BytesIO()
    first.save(
        out, "gif", save_all=True, append_images=rest, duration=FRAME, loop=0, optimize=True
    )
    return out.getvalue()


def _images() -> Any:
    return importlib.import_module("PIL.Image")


def _png(picture: Any) -> bytes:
    out = io.BytesIO()
    picture.quantize(COLOURS).save(out, "png", optimize=True)
    return out.getvalue()


def _drawn(figure: Any) -> Any:
    agg = importlib.import_module("matplotlib.backends.backend_agg")
    canvas = agg.FigureCanvasAgg(figure)
    figure.set_dpi(DPI)
    canvas.draw()
    return _images().fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
