"""Why nothing can be derived, and what would help."""

from .closure import Failure
from .lifted import Lowered, NotFinite, closed, lower
from .model import Model
from .polynomials import Monomial, Top

SHOWN = 4  # monomials


class NotDerivable(ValueError):
    """A model from which no relation could be derived.

    - `reasons`: why, one for each equation of the model; `pair`: two states whose product
      is in the way, or the same one twice, empty where there is none; `repair`: states each
      of which, if it were measured too, would make it possible.
    """

    def __init__(
        self, reasons: tuple[str, ...], pair: tuple[str, ...], repair: tuple[str, ...]
    ) -> None:
        self.reasons = reasons
        self.pair = pair
        self.repair = repair
        text = "No relation could be derived: " + "; ".join(reasons) + "."
        if pair:
            text += f" In the way is the product of {pair[0]} and {pair[1]}."
        if repair:
            text += f" It could be if {' or '.join(repair)} were measured too."
        elif pair or reasons:
            text += " No single further state that is measured would change that."
        super().__init__(text)


def named(lowered: Lowered, failure: Failure) -> str:
    """The row of a failure, in words."""
    if failure.kind == "rate":
        return f"the rate of {list(lowered.model.outputs)[failure.index]}"
    return f"equation {failure.index + 1}"


def reason(lowered: Lowered, failure: Failure) -> str:
    """Why a row does not close, in words."""
    ring, row = lowered.ring, named(lowered, failure)
    if failure.node is not None:
        place = lowered.graph.described(failure.node)
        touched = _touched(lowered, failure.node)
        of = " and ".join(touched) or "what is not measured"
        through = ""
        if failure.at is not None:
            through = (
                f", which is in the derivative of {ring.text(next(iter(failure.at)))},"
            )
        return f"{row}: {place}{through} of {of} {failure.why}"
    grown = ", ".join(ring.text(m) for m in failure.growing[-SHOWN:])
    return f"{row} does not close: its derivatives bring in {grown}, and so on"


def _touched(lowered: Lowered, node: int) -> list[str]:
    names = list(lowered.model.ranges)
    places = sorted(k for kind, k in lowered.graph.inputs(node) if kind == "x")
    return [names[k] for k in places if k not in lowered.ring.measured]


def pair(lowered: Lowered, failures: tuple[Failure, ...]) -> tuple[str, ...]:
    """Two states whose product makes a row grow without end."""
    ring = lowered.ring
    for failure in failures:
        involved = {g for m in failure.growing for g in m if g < ring.states}
        if not involved:
            continue
        products: list[Monomial] = []
        sources = [lowered.rates[g] for g in sorted(involved)]
        sources += [
            p for kind, k, p in lowered.rows if (kind, k) == (failure.kind, failure.index)
        ]
        for p in sources:
            if not isinstance(p, Top):
                products += [m for m in p if len(m) > 1]
        if products:
            first = min(products, key=len)
            return ring.names[first[0]], ring.names[first[1]]
    return ()


def repairs(model: Model, wanted: int) -> tuple[str, ...]:
    """The states each of which, were it measured, would make all others known."""
    found = []
    for name in model.states:
        if len(model.ranges) < 2:
            break
        try:
            trial = lower(model, (name,))
            closure, _ = closed(trial)
        except NotFinite:
            continue
        seen = {g for b in closure.basis for m in b for g in _states(trial, m)}
        if len(seen) >= wanted - 1:
            found.append(name)
    return tuple(found)


def _states(lowered: Lowered, monomial: Monomial) -> set[int]:
    ring, seen = lowered.ring, set()
    for g in monomial:
        rule = ring.rules.get(g)
        seen |= {g} if rule is None else {i for m in rule.argument for i in m}
    return seen


def refusal(lowered: Lowered, failures: tuple[Failure, ...]) -> NotDerivable:
    """The error of a model none of whose rows closes."""
    reasons = tuple(reason(lowered, failure) for failure in failures)
    if not failures:
        reasons = ("no rate of an output, and no equation, contains a state",)
    count = len(lowered.model.ranges)
    return NotDerivable(reasons, pair(lowered, failures), repairs(lowered.model, count))
