"""Tuning: a loss minimised over chosen leaves of an experiment or an observer."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import _choices, random
from .._checks import one_of
from .._module import Module
from .._typing import Mode, PyTree, Scale, Stopped, UsedMode
from ._coordinates import Bound, Coordinates
from ._descent import Descent, History, Limits, progress_bar
from ._gradients import Slope, slope
from .losses import AbstractLoss

# Parameters up to which forward mode is the default for a function of one's own.
FORWARD = 16

Loss = AbstractLoss | Callable[[PyTree, random.Key], Float[Array, ""]]


class Fitted(Module):
    """What [`fit`][] returns.

    - `tree`: the given one with the tuned leaves;
    - `parameters`: the tuned leaves one after the other, shape `(P,)`;
    - `loss`: of the tuned tree; `initial_loss`: of the given one; both on the samples of
      training;
    - `validation`, `initial_validation`: the same on fresh samples;
    - `stopped`: why the best descent ended: `"converged"`, `"no improvement"`,
      `"iteration limit"` or `"not finite"`;
    - `histories`: of every descent; `best`: which of them had the least loss;
    - `mode`: `"forward"` or `"reverse"`, as the gradients were computed.
    """

    tree: PyTree
    parameters: Float[np.ndarray, " P"]
    loss: float
    initial_loss: float
    validation: float
    initial_validation: float
    stopped: Stopped = eqx.field(static=True)
    histories: list[History]
    best: int = eqx.field(static=True)
    mode: UsedMode = eqx.field(static=True)

    @property
    def history(self) -> History:
        """Of the best descent."""
        return self.histories[self.best]

    def __str__(self) -> str:
        values = ", ".join(f"{x:.6g}" for x in self.parameters)
        return (
            f"{self.stopped} after {len(self.history.loss) - 1} iterations "
            f"({self.mode} mode) at [{values}]\n"
            f"  training:   {self.initial_loss:.6g} -> {self.loss:.6g}\n"
            f"  validation: {self.initial_validation:.6g} -> {self.validation:.6g}"
        )


def fit(
    tree: PyTree,
    loss: Loss,
    *,
    where: Callable[[PyTree], Any],
    key: random.KeyLike | None = None,
    optimiser: Any = None,
    bounds: Bound | Sequence[Bound | None] | None = None,
    scale: Scale | Sequence[Scale] = "auto",
    starts: int = 1,
    iterations: int = 100,
    tolerance: float = 1e-4,
    improvement: float = 1e-6,
    patience: int = 10,
    mode: Mode = "auto",
    progress: bool = False,
) -> Fitted:
    """Minimise `loss(tree, key)` over the leaves `where(tree)`, from the values they have.

    **Arguments:**

    - `tree`: an experiment, an observer, or any pytree;
    - `loss`: one of [`aslo_jax.tune.losses`][], or a function of one's own, to a scalar.
      Its `key` is the same at every iteration (common random numbers), and another one for
      the validation;
    - `where`: from the tree to a leaf or a sequence of leaves, each an array of real
      numbers: rates of filters, gains, bandwidths;
    - `key`: of the random numbers of the loss, by default `jax.random.key(0)`;
    - `optimiser`: any of optax; by default `optax.lbfgs()` with its line search, which
      needs the fewest runs (docs/tuning.md);
    - `bounds`: `(low, high)` for each leaf in turn, either of them or the pair `None` where
      there is none, in the units of the leaf;
    - `scale`: `"log"` tunes the logarithm of a leaf, `"linear"` multiples of its start,
      `"auto"` takes the former for a leaf that starts positive; one for all leaves or one
      for each;
    - `starts`: of several descents, the first is from the given tree and the others from
      Sobol points within the bounds, or within a factor of ten of the start;
    - `iterations`: at most as many in each descent; `tolerance`: a descent has
      converged where the slope of the loss in every coordinate (of a positive leaf, its
      logarithm) is below this part of the loss; `improvement`, `patience`: it ends early
      when the loss has not fallen by this part of itself in as many iterations;
    - `mode`: `"forward"` or `"reverse"`; `"auto"` is forward for losses over a batch, which
      the fused engine runs, and for other functions of at most 16 parameters that have
      forward derivatives; otherwise reverse. A loss of `losses` keeps checkpoints in
      reverse;
    - `progress`: show a bar (tqdm, the extra `study`).

    The loss is traced once, and the same compiled code runs in every iteration.

    **Returns:** a [`Fitted`][], from the iteration with the least loss of all descents.

    **Raises:** `ValueError` for leaves that are not real, bounds that do not contain the
    start, or a loss that is no scalar.
    """
    one_of("mode", mode, _choices.Mode)
    if starts < 1 or iterations < 1 or patience < 1:
        raise ValueError(
            "Arguments `starts`, `iterations` and `patience` must be at least 1, but got "
            f"{starts}, {iterations} and {patience}."
        )
    key = random.key(0) if key is None else random.as_key(key)
    coordinates = Coordinates(tree, where, bounds, scale)
    points = coordinates.starts(starts)
    mode, function = sloped(mode, loss, coordinates, key)
    descent = Descent(
        function,
        default_optimiser(optimiser),
        Limits(iterations, tolerance, improvement, patience),
    )
    advance, close = progress_bar(starts * (iterations + 1), progress)
    runs = [descent.run(start, key, advance) for start in points]
    close()
    return finished(coordinates, runs, function, key, mode)


def objective(loss: Loss, coordinates: Coordinates, mode: UsedMode):
    """The loss as a function of the coordinates and the key."""
    if isinstance(loss, AbstractLoss) and mode == "reverse":
        loss = loss.reversible()

    def value(z, key):
        found = jnp.asarray(loss(coordinates.placed(z), key))
        if found.shape:
            raise ValueError(
                f"Argument `loss` must return a scalar, but got the shape {found.shape}."
            )
        return found

    return value


def sloped(
    mode: Mode, loss: Loss, coordinates: Coordinates, key: random.Key
) -> tuple[UsedMode, Slope]:
    """The mode (`"auto"` no more) and the compiled loss with its gradient."""

    def compiled(mode: UsedMode) -> tuple[UsedMode, Slope]:
        return mode, slope(objective(loss, coordinates, mode), mode)

    if mode != "auto":
        return compiled(mode)
    most = loss.most_forward if isinstance(loss, AbstractLoss) else FORWARD
    if coordinates.size > most:
        return compiled("reverse")
    found = compiled("forward")
    try:
        found[1](jnp.asarray(coordinates.inverse(coordinates.start)), key)
    except (TypeError, NotImplementedError) as error:
        # JAX's and equinox's refusals to push forward through what only pulls back, such
        # as diffrax's default adjoint.
        if "forward-mode" not in str(error):
            raise
        return compiled("reverse")
    return found


def default_optimiser(optimiser: Any) -> Any:
    """The given one, or L-BFGS with its line search."""
    import optax

    return optax.lbfgs() if optimiser is None else optimiser


def finished(coordinates, runs, function, key, mode) -> Fitted:
    """The result of the descents."""
    values = jax.jit(jax.vmap(coordinates.values))
    histories = [
        history._replace(parameters=np.asarray(values(jnp.asarray(path))))
        for path, history in runs
    ]
    least = [history.loss[history.best] for history in histories]
    best = int(np.argmin(np.where(np.isfinite(least), least, np.inf)))
    path, history = runs[best]
    tuned, fresh = path[history.best], random.fold(key, 1)
    first = runs[0][0][0]
    validated = [float(function(jnp.asarray(z), fresh)[0]) for z in (first, tuned)]
    return Fitted(
        coordinates.placed(jnp.asarray(tuned)),
        histories[best].parameters[history.best],
        float(history.loss[history.best]),
        float(runs[0][1].loss[0]),
        validated[1],
        validated[0],
        history.stopped,
        histories,
        best,
        mode,
    )
