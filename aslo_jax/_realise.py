"""One set of equations, realised as a start, a vector field, or a sampled recurrence.

An observer is a function `equations(F, u, y)` of a [`Pass`][] `F`. The same lines allocate
the states ([`Start`][]), give their derivatives ([`Flow`][]), or advance them over a
sampling interval ([`Advance`][]). States are addressed by name.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._filters import AbstractFilter, AbstractLaw, Integrator, LowPass
from ._realisations import (
    AbstractRealisation,
    Advance,
    Drive,
    Flow,
    Interval,
    Start,
    States,
    state_of,
)
from ._swapped import Carried, Motion, Rule, Swapped, Turning
from ._typing import FilterStart, PyTree
from ._varying import AbstractSchedule

__all__ = [
    "AbstractRealisation",
    "Advance",
    "Drive",
    "Flow",
    "Interval",
    "Pass",
    "Start",
    "States",
    "state_of",
]


class Pass:
    """One pass over an observer's equations, with a filter bound to it.

    `F(s)` is the filtered signal F[s]; `F.p(s)` is pF[s], its filtered derivative;
    `F.one()` is F[1]; `F.hidden(v)` is a state `X' = A X + v` of the filter itself, from
    which `F.output` gives the filtered signal; `F.state(name, start, rate)` is any other
    state, `F.loop(law, start)` one that other signals feed back to. `F.using(filter)`
    binds a filter; `F.scope(name)` nests the names of states.

    - `realisation`: what is done with each state, a [`Start`][], [`Flow`][] or
      [`Advance`][]; `scope`: what the names of states begin with;
    - `signals`: u and y, and `closing`, what waits for the estimate of them, where the
      rate of a filter varies;
    - `interval`: what the pass knows of samples that are missing, `None` where none can
      be; `doubted`, shape `()`: whether its measurements are not to be trusted.

    With `start="exact"` every identity of the library holds for all t > 0; with
    `start="paper"` F[1] is taken as settled and every filter starts from zero, as printed.

    **Raises:** `ValueError` where `F` is called without a filter, for `F.p` with a filter
    that is not strictly proper, and for two states of one name.
    """

    def __init__(
        self,
        realisation: AbstractRealisation,
        filter: AbstractFilter | None = None,
        start: FilterStart = "exact",
        scope: str = "",
        interval: Interval | None = None,
        doubted: Bool[Array, ""] | None = None,
        signals: tuple[PyTree, PyTree] | None = None,
        closing: list[Callable[[Any], object]] | None = None,
    ) -> None:
        self._realisation = realisation
        self._filter = filter
        self._start: FilterStart = start
        self._scope = scope
        self._interval = interval
        self._doubted = doubted
        self._signals = signals
        self._closing = [] if closing is None else closing

    @property
    def filter(self) -> AbstractFilter:
        if self._filter is None:
            raise ValueError("No filter is bound to this pass; bind one with `F.using`.")
        return self._filter

    @property
    def exact(self) -> bool:
        """Whether the start is exact."""
        return self._start == "exact"

    def using(self, filter: AbstractFilter, start: FilterStart | None = None) -> "Pass":
        """The same pass with `filter` bound to it: as it is now, where its rate varies."""
        mode = self._start if start is None else start
        if isinstance(filter, LowPass) and isinstance(filter.rate, AbstractSchedule):
            filter = self._paced(filter.rate)
        return self._with(filter=filter, start=mode)

    def _paced(self, schedule: AbstractSchedule) -> AbstractFilter:
        if self._signals is None:
            raise ValueError(
                "Argument `filter` has a rate that varies, which needs the signals of the "
                "pass; call the observer, not its `equations`, or use `F.observing(u, y)`."
            )
        filter, close = schedule.paced(self.scope("rate"), *self._signals)
        if close is not None:
            self._closing.append(close)
        return filter

    def observing(self, u: PyTree, y: PyTree) -> "Pass":
        """The same pass for an observer of the input `u` and the measurement `y`, of which
        rates that vary are functions; [`Pass.close`][] ends it."""
        return self._with(signals=(u, y), closing=[])

    def close(self, estimate: Any) -> None:
        """Tell the `estimate` to the rates that depend on it."""
        for each in self._closing:
            each(estimate)

    def scope(self, name: str) -> "Pass":
        """The same pass with the names of its states nested under `name`."""
        return self._with(scope=f"{self._scope}{name}.")

    def doubting(self, doubted: Bool[Array, ""]) -> "Pass":
        """The same pass for what measures something `doubted`, shape `()`: no correction by
        it is trusted."""
        if self._doubted is not None:
            doubted = doubted | self._doubted
        return self._with(doubted=doubted)

    def _with(self, **changed: Any) -> "Pass":
        kept = {
            "filter": self._filter,
            "start": self._start,
            "scope": self._scope,
            "interval": self._interval,
            "doubted": self._doubted,
            "signals": self._signals,
            "closing": self._closing,
        }
        return Pass(self._realisation, **(kept | changed))

    @property
    def certain(self) -> bool:
        """Whether no sample can be missing in this pass, nor doubted, which is known while
        tracing."""
        return self._interval is None and self._doubted is None

    @property
    def missing(self) -> Bool[Array, ""]:
        """Whether a sample of this interval is missing or doubted, shape `()`."""
        missing = jnp.asarray(False) if self._interval is None else self._interval.missing
        return missing if self._doubted is None else missing | self._doubted

    @property
    def blind(self) -> Bool[Array, ""]:
        """Whether the input of this interval is missing, shape `()`."""
        return jnp.asarray(False) if self._interval is None else self._interval.blind

    @property
    def trust(self) -> Float[Array, ""] | float:
        """What a correction by a measurement is to be multiplied by: 1, and 0 over an
        interval of which a sample is missing."""
        return 1.0 if self.certain else jnp.where(self.missing, 0.0, 1.0)

    @property
    def weight(self) -> Float[Array, ""] | float:
        """The weight of what is injected: 1, and 0 where a sample is missing."""
        return 1.0 if self._interval is None else self._interval.weight

    def measured(self, y: Array, predicted: Array) -> Array:
        """y, or over an interval of which a sample is missing what the observer predicts
        in its place, so that it corrects nothing."""
        return y if self.certain else jnp.where(self.missing, predicted, y)

    def apart(
        self, name: str | None, by: Callable[[], Array], *, whole: bool = False
    ) -> str:
        """The full name of a new state that follows a measured signal, which jumps where
        samples come back: while they are missing it is kept less `by()`, a function of
        that signal, and where they come back, unless `whole`, less what of that has no
        weight."""
        full = self._realisation.claim(self._scope, name)
        if self._interval is not None and self._interval.before is not None:
            now, before = self._interval.weight, self._interval.before
            if whole:
                now, before = jnp.sign(now), jnp.sign(before)
            self._realisation.shift(full, (now - before).astype(by().dtype) * by())
        return full

    def evolve(
        self, law: AbstractLaw, drive: Drive, start: PyTree, name: str | None = None
    ) -> PyTree:
        """A state that follows `law` under `drive`, a value or a function of the state."""
        full = self._realisation.claim(self._scope, name)
        return self._realisation.evolve(full, law, drive, start)

    def continued(self, full: str, law: AbstractLaw, drive: Drive, start: PyTree) -> PyTree:
        """[`evolve`][] of a state whose full name [`apart`][] gave."""
        return self._realisation.evolve(full, law, drive, start)

    def loop(
        self, law: AbstractLaw, start: PyTree, name: str | None = None
    ) -> tuple[PyTree, Callable[[Drive], PyTree]]:
        """A state that feeds others which drive it: its value now, and `close(drive)`,
        which must be called once and returns the final value. The sampled scheme stays of
        second order."""
        full = self._realisation.claim(self._scope, name)
        return self._realisation.loop(full, law, start)

    def state(self, name: str, start: Array, rate: Drive) -> Array:
        """Any other state: `rate`, its derivative, is a value or a function of it."""
        return self.evolve(Integrator(), rate, start, name)

    def inject(self, s: Array | float) -> Array:
        """`B s`; with the exact start nothing over an interval of which a sample is
        missing: a row with every injection weighted alike still holds."""
        v = self.filter.inject(s)
        return self.weight * v if self.exact and self._interval is not None else v

    def output(self, X: Array) -> Array:
        """`C X`."""
        return self.filter.output(X)

    def hidden(
        self, drive: Drive, name: str | None = None, start: Array | None = None
    ) -> Array:
        """`X' = A X + drive` from zero, or from `start`; a drive that depends on X needs
        one."""
        return self.evolve(*self.filter.following(drive, start), name)

    def carried(
        self,
        rule: Rule,
        b: Array,
        motion: Motion,
        name: str | None = None,
        *,
        X: Array | None = None,
        w: Array | None = None,
        turning: Turning | None = None,
        means: bool = False,
    ) -> Array:
        """A hidden state from zero that goes along with an x whose `motion` is known, by a
        `rule` of the Swapping Lemma, exactly so in samples: `b` is injected into it, and
        it is driven by the product of z with the hidden state `X`, into which `w` is. `X`
        may be `turning`; `means`: where a derivative is known between samples only."""
        law, b, start = self.filter.following(b, jnp.zeros_like(b))
        drive = Carried(b, motion, X, w, turning)
        return self.evolve(Swapped(law, rule, means), drive, start, name)

    def standing(self, drive: Drive, start: Array, name: str | None = None) -> Array:
        """[`hidden`][] from the `start` at which it has settled under a `drive` that is
        constant: that value, unless the filter varies."""
        return self.hidden(drive, name, start) if self.filter.varies else start

    def __call__(self, s: Array, name: str | None = None) -> Array:
        """`F[s]`, from zero."""
        return self.output(self.hidden(self.inject(s), name)) + self.filter.feedthrough(s)

    def settling(self, name: str | None = None) -> Array:
        """The hidden state of F[1]: from zero, or settled with the paper's start."""
        if not self.exact:
            return self.standing(self.inject(1.0), self.filter.equilibrium(1.0), name)
        return self.hidden(self.inject(1.0), name)

    def one(self, name: str | None = None) -> Array:
        """`F[1]`, equal to one with the paper's start."""
        return self.output(self.settling(name)) + self.filter.feedthrough(1.0)

    def p(self, s: Array, name: str | None = None, *, settled: bool | None = None) -> Array:
        """`pF[s]`, the filtered derivative, F starting `settled` at s(0) or from zero: by
        default settled with the exact start."""
        if not self.filter.strictly_proper:
            raise ValueError(
                "Argument `filter` must be strictly proper for a rate relation, since pF "
                "of a filter with feedthrough is improper; use `LowPass` or a "
                "`LinearFilter` with `D=None`."
            )
        filter = self.filter.derivative
        v = filter.inject(s)
        settled = self.exact if settled is None else settled
        start = filter.equilibrium(s) if settled else jnp.zeros_like(v)
        # While samples are missing the state is kept less its equilibrium, so that F[s'] is
        # A X and decays, and s goes on from where it comes back.
        v = v if self._interval is None else self.weight * v
        full = self.apart(name, lambda: filter.equilibrium(s))
        X = self.continued(full, *filter.following(v, start))
        return filter.output(filter.flow(X, v))
