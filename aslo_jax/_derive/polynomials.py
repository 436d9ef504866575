"""Polynomials in what is not measured, with coefficients that are nodes of a graph, or
values at points: the ring, and the interpretation of a graph in it.

A polynomial is a dictionary from monomials, sorted tuples of generators, to coefficients.
Generators are the unmeasured states, by their numbers, and sines, cosines and exponentials
of polynomials in them, which are added when they are met.
"""

import itertools
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from .evaluation import Lots, at_points
from .symbols import Symbolic

DEGREE = 6  # the highest of a monomial
Monomial = tuple[int, ...]
Polynomial = dict[Monomial, Any]
Drawn = Literal["all", "branches", "nothing"]


class Top(NamedTuple):
    """What is no polynomial: the number of the node where it stops being one, and why."""

    node: int
    why: str


class Rule(NamedTuple):
    """The derivative of a generator that is a function of `argument`: `sign` times the
    generator `outer` times the derivative of the argument."""

    argument: Polynomial
    outer: int
    sign: float
    function: str


class Algebra(Protocol):
    """The arithmetic of coefficients."""

    def plus(self, a: Any, b: Any) -> Any: ...
    def times(self, a: Any, b: Any) -> Any: ...
    def number(self, value: float) -> Any: ...
    def of(self, node: int) -> Any: ...


class Nodes:
    """Coefficients that are nodes of a graph."""

    def __init__(self, graph: Symbolic) -> None:
        self.graph = graph

    def plus(self, a: int, b: int) -> int:
        graph = self.graph
        for x, y in ((a, b), (b, a)):
            node = graph.nodes[y]
            if node.op == "neg" and node.args[0] == x:
                return graph.zero
        return graph.op("add", a, b)

    def times(self, a: int, b: int) -> int:
        graph = self.graph
        if graph.value(a) == 0 or graph.value(b) == 0:
            return graph.zero
        return graph.op("mul", a, b)

    def number(self, value: float) -> int:
        return self.graph.const(value, float)

    def of(self, node: int) -> int:
        return node


class Sampled:
    """Coefficients that are values at points and their magnitudes, shape `(2, N)`."""

    def __init__(self, graph: Symbolic, points: "Points") -> None:
        self.graph = graph
        self.points = points
        self._known: dict[int, np.ndarray] = {}

    def plus(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a + b

    def times(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a * b

    def number(self, value: float) -> np.ndarray:
        return np.array([[value], [abs(value)]])

    def of(self, node: int) -> np.ndarray:
        if node not in self._known:
            self.look([node])
        return self._known[node]

    def at(self, p: "Polynomial | Top") -> "Polynomial | Top":
        """A polynomial with nodes as coefficients, at the points."""
        return p if isinstance(p, Top) else {m: self.of(c) for m, c in p.items()}

    def look(self, nodes: Iterable[int]) -> None:
        """Evaluate several at once."""
        wanted = [n for n in nodes if n not in self._known]
        values = self.points.of(self.graph, wanted)
        self._known.update(zip(wanted, values, strict=True))


class Points:
    """Points at which coefficients are compared: values of inputs by slot, shape `(N,)`.

    `drawn` says what of a model is by lot ([`Lots`][]): `"all"`, `"branches"` or
    `"nothing"`; within an elimination, whose conditions belong together, nothing is."""

    def __init__(self, inputs: dict[Any, np.ndarray], seed: int, drawn: Drawn) -> None:
        self.inputs = inputs
        self.count = len(next(iter(inputs.values()))) if inputs else 1
        self.seed = seed
        self.drawn = drawn
        self.good = np.ones(self.count, bool)
        self._found: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    @property
    def size(self) -> int:
        """How many of them are good."""
        return int(self.good.sum())

    def of(self, graph: Symbolic, nodes: list[int]) -> list[np.ndarray]:
        lots = None
        if self.drawn != "nothing":
            lots = Lots(self.seed, self.count, self.drawn == "all", graph.eliminates)
        found = self._found
        order = [n for n in graph.reachable(nodes) if n not in found]
        at_points(graph.nodes, order, self.inputs, lots, found)
        return [self._whole(graph, n, found[n], lots) for n in nodes]

    def _whole(
        self, graph: Symbolic, number: int, found: tuple[np.ndarray, ...], lots: Lots | None
    ) -> np.ndarray:
        """Value and magnitude at the good points. What is zero at all of them by no
        cancellation, as a number that is too small is, may be none elsewhere."""
        both = np.stack([np.broadcast_to(np.asarray(x, float), self.count) for x in found])
        nothing = lots is not None and lots.wild and not both.any()
        varies = any(kind != "p" for kind, _ in graph.inputs(number))
        if nothing and varies and graph.value(number) is None:
            assert lots is not None
            both = np.stack([lots.numbers(number), np.ones(self.count)])
        return both[:, self.good]


def add(algebra: Algebra, p: Polynomial, q: Polynomial) -> Polynomial:
    """The sum of two polynomials."""
    out = dict(p)
    for monomial, c in q.items():
        out[monomial] = algebra.plus(out[monomial], c) if monomial in out else c
    return out


def multiply(algebra: Algebra, p: Polynomial, q: Polynomial) -> Polynomial | None:
    """The product of two polynomials, `None` where its degree is too high."""
    out: Polynomial = {}
    for (a, c), (b, d) in itertools.product(p.items(), q.items()):
        monomial = tuple(sorted(a + b))
        if len(monomial) > DEGREE:
            return None
        product = algebra.times(c, d)
        old = out.get(monomial)
        out[monomial] = product if old is None else algebra.plus(old, product)
    return out


def scaled(algebra: Algebra, p: Polynomial, c: Any) -> Polynomial:
    """A polynomial times a coefficient."""
    return {monomial: algebra.times(c, each) for monomial, each in p.items()}


class Ring:
    """The generators, by name; `rules` are of those that are functions of others. They are
    the inputs of the `kind`; those that are `measured` are none, but coefficients."""

    def __init__(
        self,
        graph: Symbolic,
        names: tuple[str, ...],
        measured: frozenset[int] = frozenset(),
        kind: str = "x",
    ) -> None:
        self.graph = graph
        self.kind = kind
        self.measured = measured
        self.nodes = Nodes(graph)
        self.states = len(names)
        self.names = list(names)
        self.rules: dict[int, Rule] = {}
        self._adjoined: dict[Any, int] = {}
        self._found: dict[int, Polynomial | Top] = {}

    # Names

    def text(self, monomial: Monomial) -> str:
        """A monomial in words."""
        return "*".join(self.names[g] for g in monomial) or "1"

    # Generators

    def adjoin(self, function: str, p: Polynomial) -> tuple[int, float] | None:
        """The generator of a function of a polynomial without constant, and its sign;
        `None` where a coefficient varies with what is measured."""
        if any(kind != "p" for c in p.values() for kind, _ in self.graph.inputs(c)):
            return None
        monomials = sorted(p)
        trigonometric, sign = function != "exp", 1.0
        leading = self.graph.value(p[monomials[0]])
        turned = self.graph.nodes[p[monomials[0]]].op == "neg"
        if trigonometric and (turned or (leading is not None and leading < 0)):
            p = {m: self.graph.op("neg", c) for m, c in p.items()}
            sign = -1.0 if function == "sin" else 1.0
        family = "trigonometric" if trigonometric else "exp"
        key = (family, tuple((m, p[m]) for m in monomials))
        if key not in self._adjoined:
            first = len(self.names)
            text = self._shown(p)
            if trigonometric:
                self.names += [f"sin({text})", f"cos({text})"]
                self.rules[first] = Rule(p, first + 1, 1.0, "sin")
                self.rules[first + 1] = Rule(p, first, -1.0, "cos")
            else:
                self.names.append(f"exp({text})")
                self.rules[first] = Rule(p, first, 1.0, "exp")
            self._adjoined[key] = first
        return self._adjoined[key] + (function == "cos"), sign

    def _shown(self, p: Polynomial) -> str:
        parts = []
        for monomial, c in p.items():
            value = self.graph.value(c)
            name = self.text(monomial)
            if value is None:
                parts.append(f"p*{name}")
            else:
                parts.append(name if value == 1 else f"{value:.4g}*{name}")
        return " + ".join(parts)

    def reduced(self, algebra: Algebra, p: Polynomial) -> Polynomial:
        """With every square of a sine in terms of the cosine."""
        for sine, rule in self.rules.items():
            if rule.function != "sin":
                continue
            while True:
                monomial = next((m for m in p if m.count(sine) >= 2), None)
                if monomial is None:
                    break
                p = dict(p)
                c = p.pop(monomial)
                rest = list(monomial)
                rest.remove(sine)
                rest.remove(sine)
                squared = tuple(sorted([*rest, sine + 1, sine + 1]))
                minus = algebra.times(algebra.number(-1.0), c)
                p = add(algebra, p, {tuple(rest): c, squared: minus})
        return p

    # Interpretation

    def moves(self, number: int) -> bool:
        """Whether a node depends on what is not measured."""
        states = (k for kind, k in self.graph.inputs(number) if kind == self.kind)
        return any(k not in self.measured for k in states)

    def of(self, number: int) -> Polynomial | Top:
        """The polynomial that a node is."""
        return self.graph.followed(number, self._found, self._made)

    def _made(self, number: int) -> Polynomial | Top:
        graph, nodes = self.graph, self.nodes
        node = graph.nodes[number]
        if not self.moves(number):
            return {} if graph.value(number) == 0 else {(): number}
        if node.op == "input":
            return {(node.data[1],): graph.one}
        args = [self._found[a] for a in node.args]
        for each in args:
            if isinstance(each, Top):
                return each
        polynomials: list[Any] = args
        found = self._applied(number, node, polynomials)
        if isinstance(found, Top):
            return found
        return self._cleaned(self.reduced(nodes, found))

    def _cleaned(self, p: Polynomial) -> Polynomial:
        return {m: c for m, c in p.items() if self.graph.value(c) != 0}

    def _applied(self, number: int, node: Any, args: list[Polynomial]) -> Polynomial | Top:
        nodes = self.nodes
        minus = self.graph.const(-1.0, float)
        if node.op == "add":
            return add(nodes, args[0], args[1])
        if node.op == "sub":
            return add(nodes, args[0], scaled(nodes, args[1], minus))
        if node.op == "neg":
            return scaled(nodes, args[0], minus)
        if node.op == "convert" and node.dtype.kind == "f":
            return args[0]
        if node.op in ("mul", "fma"):
            product = multiply(nodes, args[0], args[1])
            if product is None:
                return Top(number, f"is of a degree above {DEGREE}")
            return add(nodes, product, args[2]) if node.op == "fma" else product
        if node.op == "div":
            return self._quotient(number, args)
        if node.op == "select":
            return self._select(number, node, args)
        if node.op in ("sin", "cos", "exp"):
            return self._function(number, node.op, args[0])
        return Top(number, "is no polynomial")

    def _quotient(self, number: int, args: list[Polynomial]) -> Polynomial | Top:
        top, below = args
        if set(below) - {()}:
            return Top(number, "divides by it")
        graph = self.graph
        divisor = below[()] if below else graph.zero
        if len(top) == 1:
            return {m: graph.op("div", c, divisor) for m, c in top.items()}
        return scaled(self.nodes, top, graph.op("div", graph.one, divisor))

    def _select(self, number: int, node: Any, args: list[Polynomial]) -> Polynomial | Top:
        graph, (which, *_) = self.graph, node.args
        if self.moves(which):
            return Top(number, "chooses by it")
        _, yes, no = args
        zero = graph.zero
        return {
            m: graph.select(which, yes.get(m, zero), no.get(m, zero))
            for m in dict.fromkeys([*yes, *no])
        }

    def _function(self, number: int, function: str, p: Polynomial) -> Polynomial | Top:
        graph, nodes = self.graph, self.nodes
        moving = {m: c for m, c in p.items() if m}
        found = self.adjoin(function, moving)
        if found is None:
            return Top(number, "has a factor that varies with what is measured")
        generator, sign = found
        one = graph.const(sign, float)
        shift = p.get(())
        if shift is None:
            return {(generator,): one}

        def of(name: str) -> int:
            return graph.kept(name, graph.dtype(shift), {"accuracy": None}, shift)

        if function == "exp":
            return {(generator,): of("exp")}
        other = generator + 1 if function == "sin" else generator - 1
        sine, cosine = of("sin"), of("cos")
        # An odd function of an argument that is turned changes its sign, an even one not.
        turned = graph.const(self._turned(function, moving), float)
        if function == "sin":
            return {(generator,): nodes.times(one, cosine), (other,): sine}
        minus = nodes.times(graph.const(-1.0, float), nodes.times(turned, sine))
        return {(generator,): cosine, (other,): minus}

    def _turned(self, function: str, moving: Polynomial) -> float:
        found = self.adjoin("sin", moving)
        return 1.0 if found is None else found[1]


def lie(
    ring: Ring, algebra: Algebra, p: Polynomial, rates: list[Polynomial | Top]
) -> Polynomial | Top:
    """The derivative of `p`, whose coefficients are constants, along `x' = rates`."""
    total: Polynomial = {}
    for monomial, c in p.items():
        for place, generator in enumerate(monomial):
            rate = _rate(ring, algebra, generator, rates)
            if isinstance(rate, Top):
                return rate
            rest = monomial[:place] + monomial[place + 1 :]
            part = multiply(algebra, {rest: c}, rate)
            if part is None:
                return Top(-1, f"is of a degree above {DEGREE}")
            total = add(algebra, total, part)
    return ring.reduced(algebra, total)


def _rate(
    ring: Ring, algebra: Algebra, generator: int, rates: list[Polynomial | Top]
) -> Polynomial | Top:
    if generator < ring.states:
        return rates[generator]
    rule = ring.rules[generator]
    argument = {m: algebra.of(c) for m, c in rule.argument.items()}
    inner = lie(ring, algebra, argument, rates)
    if isinstance(inner, Top):
        return inner
    product = multiply(algebra, inner, {(rule.outer,): algebra.number(rule.sign)})
    return Top(-1, f"is of a degree above {DEGREE}") if product is None else product
