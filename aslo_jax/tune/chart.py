"""Design charts: a loss over two leaves, the path of a descent, a front of two costs."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import random
from .._extras import require
from .._typing import PyTree
from .coordinates import Coordinates
from .descent import Descent, Limits, progress_bar
from .fit import Fitted, Loss, default_optimiser
from .gradients import slope


class Surface(NamedTuple):
    """A loss over two leaves: `loss[i, j]` at `first[i]` and `second[j]`."""

    first: Float[np.ndarray, " I"]
    second: Float[np.ndarray, " J"]
    loss: Float[np.ndarray, "I J"]


def surface(
    tree: PyTree,
    loss: Loss,
    *,
    where: Callable[[PyTree], Any],
    first: Sequence[float] | np.ndarray,
    second: Sequence[float] | np.ndarray,
    key: random.Key | None = None,
) -> Surface:
    """The loss of `tree` with its two leaves `where(tree)`, scalars, at every pair of the
    values `first` and `second`, with the random numbers of [`fit`][] for the same `key`."""
    key = random.key(0) if key is None else key
    first, second = np.asarray(first, float), np.asarray(second, float)
    if len(where(tree)) != 2 or any(jnp.ndim(x) for x in where(tree)):
        raise ValueError("Argument `where` must select two leaves, each a number.")

    @jax.jit
    @jax.vmap
    def row(pair):
        return loss(eqx.tree_at(where, tree, (pair[0], pair[1])), key)

    rows = [row(jnp.stack([jnp.full(second.shape, a), second], axis=1)) for a in first]
    return Surface(first, second, np.stack([np.asarray(r) for r in rows]))


def design_chart(
    fitted: Fitted,
    over: Surface,
    *,
    names: tuple[str, str] = ("lambda (rad/s)", "gamma (rad/s)"),
    label: str = "loss",
    marked: dict[str, tuple[float, float]] | None = None,
    axes: Any = None,
) -> Any:
    """Draw the loss over two leaves as contours, with the path of every descent, where the
    best one began and where it ended, and further points by name. Returns the axes of
    matplotlib (the extra `plot`), by default of a new figure."""
    pyplot = require("matplotlib.pyplot", "plot")
    colors = require("matplotlib.colors", "plot")
    if axes is None:
        axes = pyplot.subplots(figsize=(6.5, 5), layout="constrained")[1]
    finite = over.loss[np.isfinite(over.loss)]
    low, high = finite.min(), finite.max()
    # Levels are dense near the least loss, where a designer looks.
    levels = low * (high / low) ** (np.linspace(0.0, 1.0, 16) ** 2)
    drawn = axes.contourf(
        over.first,
        over.second,
        np.ma.masked_invalid(over.loss.T),
        levels,
        norm=colors.LogNorm(low, high),
        cmap="viridis_r",
    )
    bar = axes.figure.colorbar(drawn, ax=axes, label=label)
    bar.ax.set_yticks(levels[::3], [f"{x:.3g}" for x in levels[::3]], minor=False)
    bar.ax.minorticks_off()
    for k, history in enumerate(fitted.histories):
        path = history.parameters
        own = k == fitted.best
        style = dict(color="black", linewidth=1.4) if own else dict(color="0.5")
        axes.plot(*path.T, ".-", label="path" if own else None, **style)
    start = fitted.history.parameters[0]
    axes.plot(*start, "s", color="black", markersize=7, label="start")
    end = fitted.parameters
    axes.plot(*end, "*", color="red", markersize=15, markeredgecolor="white", label="tuned")
    for (name, point), shape in zip((marked or {}).items(), "oD^v", strict=False):
        axes.plot(*point, shape, color="white", markeredgecolor="black", label=name)
    axes.set(
        xscale="log",
        yscale="log",
        xlim=(over.first.min(), over.first.max()),
        ylim=(over.second.min(), over.second.max()),
        xlabel=names[0],
        ylabel=names[1],
    )
    axes.legend()
    return axes


def plot_history(fitted: Fitted, *, names: Sequence[str] = (), axes: Any = None) -> Any:
    """Draw the loss, the parameters and the gradient norm of every descent over its
    iterations, in three axes of matplotlib (the extra `plot`), which are returned."""
    pyplot = require("matplotlib.pyplot", "plot")
    if axes is None:
        size = dict(figsize=(6.5, 7), layout="constrained", sharex=True)
        axes = pyplot.subplots(3, 1, **size)[1]
    for k, history in enumerate(fitted.histories):
        own = k == fitted.best
        style = dict(alpha=1.0 if own else 0.35)
        axes[0].plot(history.loss, ".-", color="C0", **style)
        for j, column in enumerate(history.parameters.T):
            name = names[j] if own and j < len(names) else None
            axes[1].plot(column, ".-", color=f"C{j % 10}", label=name, **style)
        axes[2].plot(history.gradient_norm, ".-", color="C0", **style)
    axes[0].set(ylabel="loss", yscale="log")
    axes[1].set(ylabel="parameters")
    if (fitted.history.parameters > 0).all():
        axes[1].set_yscale("log")
    if names:
        axes[1].legend()
    axes[2].set(xlabel="iteration", ylabel="gradient norm", yscale="log")
    axes[0].set_title(fitted.stopped)
    return axes


class Front(NamedTuple):
    """Points of a Pareto front, one for each of the `weights`: the two `costs`, shape
    `(K, 2)`, the same on fresh samples in `validation`, and the `parameters`, `(K, P)`."""

    weights: Float[np.ndarray, " K"]
    costs: Float[np.ndarray, "K 2"]
    validation: Float[np.ndarray, "K 2"]
    parameters: Float[np.ndarray, "K P"]


def pareto(
    tree: PyTree,
    costs: Callable[[PyTree, random.Key], Float[Array, " 2"]],
    *,
    where: Callable[[PyTree], Any],
    weights: Sequence[float] | np.ndarray,
    key: random.Key | None = None,
    optimiser: Any = None,
    bounds: Any = None,
    steps: int = 60,
    tolerance: float = 1e-4,
) -> Front:
    """The front of two positive costs `costs(tree, key)`, shape `(2,)`, such as a settling
    time and a variance: for each weight w in [0, 1] the leaves `where(tree)` that minimise
    `costs[0]^(1 - w) costs[1]^w`, which no units enter. Where the front is not convex in
    the logarithms, points are left out.

    Compiled once for all weights; each descent starts where the last one ended. The other
    arguments are as in [`fit`][]; forward mode.
    """
    key = random.key(0) if key is None else key
    weights = np.asarray(weights, float)
    if not ((weights >= 0) & (weights <= 1)).all():
        raise ValueError(
            f"Argument `weights` must lie in [0, 1], but got {weights.tolist()}."
        )
    coordinates = Coordinates(tree, where, bounds, "auto")

    def mixed(z, data):
        key, weight = data
        first, second = costs(coordinates.placed(z), key)
        return (1.0 - weight) * jnp.log(first) + weight * jnp.log(second)

    # Its gradient counts as such: the logarithms are already relative.
    limits = Limits(steps, tolerance, 1e-8, 10, relative=False)
    descent = Descent(slope(mixed, "forward"), default_optimiser(optimiser), limits)
    both = jax.jit(lambda z, key: costs(coordinates.placed(z), key))
    values = jax.jit(coordinates.values)
    advance, _ = progress_bar(0, False)
    z, rows = coordinates.inverse(coordinates.start), []
    for weight in weights:
        path, history = descent.run(z, (key, jnp.asarray(weight)), advance)
        z = path[history.best]
        there = jnp.asarray(z)
        fresh = both(there, random.fold(key, 1))
        rows.append((both(there, key), fresh, values(there)))
    found = [
        np.stack([np.asarray(x) for x in column]) for column in zip(*rows, strict=True)
    ]
    return Front(weights, *found)


def front_chart(
    front: Front, *, names: tuple[str, str] = ("transient", "noise"), axes: Any = None
) -> Any:
    """Draw a front, on the samples it was found with and on fresh ones, with the weights
    beside its points. Returns the axes of matplotlib (the extra `plot`)."""
    pyplot = require("matplotlib.pyplot", "plot")
    if axes is None:
        axes = pyplot.subplots(figsize=(6.5, 4.5), layout="constrained")[1]
    axes.plot(*front.costs.T, "o-", color="C0", label="training")
    axes.plot(*front.validation.T, "x--", color="C1", label="unseen samples")
    for weight, point in zip(front.weights, front.costs, strict=True):
        axes.annotate(f"w = {weight:.2g}", point, xytext=(6, 4), textcoords="offset points")
    axes.margins(0.12)  # room for the weights
    axes.set(xlabel=names[0], ylabel=names[1])
    axes.legend()
    return axes
