"""How every figure looks: one palette, one set of settings of matplotlib."""

from typing import Any

# Okabe and Ito's palette, which survives colour blindness, without its yellow, which white
# paper swallows; a violet and a grey in its place.
COLORS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F3C8D", "#666666",
)  # fmt: skip
DASHES = ("-", (0, (5, 1.5)), (0, (5, 1.5, 1, 1.5)), (0, (1, 1)))
# With a dash pattern of its own each, so that lines are told apart in grey too.
STYLES = tuple(
    {"color": color, "linestyle": dashes}
    for color, dashes in zip(COLORS, DASHES, strict=False)
)
BLACK: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 2))}
TRUTH: dict[str, Any] = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 0.9}
SHADE: dict[str, Any] = {"color": "black", "alpha": 0.15, "linewidth": 0}

# A name that a user chose is text, whatever dollars and underscores are in it.
PLAIN: dict[str, Any] = {"text.parse_math": False}
SETTINGS: dict[str, Any] = PLAIN | {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 4.0,
    "axes.titley": 1.0,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "legend.borderaxespad": 0.0,
    "legend.columnspacing": 1.1,
    # Letters and not their outlines: text of a PDF can be searched and edited.
    "pdf.fonttype": 42,
    "ps.fonttype": 42,
    "svg.hashsalt": "aslo_jax",
}


def color(k: int) -> str:
    """The colour of the `k`-th of several."""
    return COLORS[k % len(COLORS)]


def style(k: int) -> dict[str, Any]:
    """Colour and dashes of the `k`-th of several lines, other dashes in each round of the
    palette."""
    return {"color": color(k), "linestyle": DASHES[k // len(COLORS) % len(DASHES)]}
