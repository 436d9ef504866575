"""The values of a step as `sign factor core`, whose factors do not change over time.

A product multiplies factors and cores. A sum takes out the factor that its terms share;
what else is in it are products of a core and a ratio of factors, which a processor adds at
once.
"""

import collections
from collections.abc import Collection, Iterable
from typing import NamedTuple

import numpy as np

from ..._ir.latency import latency
from ..._ir.loop import Loop, uniform
from ..._ir.rewrite import carries, counted, moving_roots

# Factors of other sizes stay where they are: a product of two might overflow.
MODERATE = {np.dtype(np.float64): 1e60, np.dtype(np.float32): 1e12}
# Nor do more than so many unknown ones meet, each of which may be 1e60, or 1e18: the third
# power of a voltage is not that of a charge times that of 1/C.
UNKNOWN = {np.dtype(np.float64): 5, np.dtype(np.float32): 2}


class Term(NamedTuple):
    """`sign factor core`, the factor a node that does not change over time, or that is the
    same for all lanes; whether nothing else needs the core."""

    sign: int
    factor: int
    core: int
    alone: bool = False


class Item(NamedTuple):
    """A term of a sum: `sign ratio node`."""

    sign: int
    ratio: int
    node: int


Scaled = tuple[int, int]  # a factor and a core


class Terms:
    """The terms `of` the nodes of a loop, with some `factors` of entries of its
    carry, and with products that are `scaled` before they are taken."""

    def __init__(
        self,
        loop: Loop,
        factors: dict[int, int],
        scaled: Collection[Scaled],
    ) -> None:
        self.old, self.graph = loop, loop.graph
        self.factors, self.scaled = factors, scaled
        self.numbers = self.graph.reachable(moving_roots(loop))
        self.entries = carries(self.graph, self.numbers)
        self.users: dict[int, list[int]] = collections.defaultdict(list)
        for n in self.numbers:
            for a in self.graph.nodes[n].args:
                self.users[a].append(n)
        self.uses = counted(loop)
        self.uniform = uniform(loop)
        self._kinds: dict[int, tuple[bool, bool]] = {}
        self._counts: dict[int, int] = {}
        self.moving = {n: all(self.kind(n)) for n in self.numbers}
        self.kept = {loop.carry[i]: f for i, f in factors.items()}
        self.depths: dict[int, int] = {}
        self.requests: dict[Scaled, set[int]] = collections.defaultdict(set)
        self.of: dict[int, Term] = {}
        for n in self.numbers:
            term = self._term(n)
            self.of[n] = term._replace(alone=term.alone and self.uses[n] == 1)

    @property
    def shared(self) -> frozenset[Scaled]:
        """What several products are to be scaled by."""
        return frozenset(k for k, found in self.requests.items() if len(found) > 1)

    def kind(self, number: int) -> tuple[bool, bool]:
        """Whether a node changes over time, and over lanes, as logs are taken to do."""
        return self.graph.followed(number, self._kinds, self._kind)

    def _kind(self, number: int) -> tuple[bool, bool]:
        node = self.graph.nodes[number]
        over_time, over_lanes = node.varies([self._kinds[a] for a in node.args])
        if node.op == "input":
            source, i = node.data
            alike = source == "carry" and i in self.uniform
            over_lanes = source == "log" or (over_lanes and not alike)
        return over_time, over_lanes

    # -- factors -------------------------------------------------------------------------

    def one(self, like: int) -> int:
        return self.graph.const(1, self.graph.dtype(like))

    def value(self, number: int) -> float | None:
        return self.graph.value(number)

    def over(self, a: int, b: int) -> int:
        return self.one(a) if a == b else self.graph.op("div", a, b)

    def moderate(self, factor: int) -> bool:
        dtype, value = self.graph.dtype(factor), self.value(factor)
        if dtype not in MODERATE or all(self.kind(factor)):
            return False
        if value is None:
            return self.unknown(factor) <= UNKNOWN[dtype]
        return 1.0 / MODERATE[dtype] <= abs(value) <= MODERATE[dtype]

    def unknown(self, factor: int) -> int:
        """How many unknown numbers are multiplied or divided in a factor."""

        def count(n: int) -> int:
            node = self.graph.nodes[n]
            if node.op in ("mul", "div", "neg"):
                return sum(self._counts[a] for a in node.args)
            return 0 if node.op == "const" else 1

        return self.graph.followed(factor, self._counts, count)

    def multiplier(self, product: int, number: int) -> int | None:
        """What a product multiplies a node by, if that is a constant."""
        node = self.graph.nodes[product]
        if node.op != "mul":
            return None
        x, y = node.args
        other = y if x == number else x
        return None if self.value(other) is None else other

    def _absorbed(self, number: int) -> bool:
        """Whether all that need a value multiply it by what does not change."""
        users = self.users[number]
        return self.uses[number] == len(users) and all(map(self._scales, users))

    def _scales(self, number: int) -> bool:
        node = self.graph.nodes[number]
        return node.op == "mul" and not all(self.moving[a] for a in node.args)

    # -- terms ---------------------------------------------------------------------------

    def whole(self, number: int) -> int:
        """The value of a node of the old loop."""
        return self.signed(self.of[number])

    def signed(self, term: Term) -> int:
        value = self.graph.op("mul", term.factor, term.core)
        return value if term.sign > 0 else self.graph.op("neg", value)

    def _plain(self, number: int) -> Term:
        return Term(1, self.one(number), number)

    def _term(self, number: int) -> Term:
        graph, node = self.graph, self.graph.nodes[number]
        if not self.moving[number]:
            return self._fixed(number)
        if node.op == "input":
            i = node.data[1] if node.data[0] == "carry" else None
            return (
                Term(1, self.factors[i], number)
                if i in self.factors
                else self._plain(number)
            )
        made = self._real(number) if node.dtype in MODERATE else None
        if made is not None:
            return made
        return self._plain(graph.again(number, tuple(map(self.whole, node.args))))

    def _fixed(self, number: int) -> Term:
        """What does not change over time is a factor of one."""
        value = self.value(number)
        if not self.moderate(number):
            return self._plain(number)
        if value is not None and value < 0:
            return Term(-1, self.graph.op("neg", number), self.one(number))
        return Term(1, number, self.one(number))

    def _real(self, number: int) -> Term | None:
        graph, node = self.graph, self.graph.nodes[number]
        op, terms = node.op, [self.of[a] for a in node.args]
        if op in ("add", "sub"):
            return self._sum(number)
        if op == "neg":
            return terms[0]._replace(sign=-terms[0].sign)
        if op == "abs":
            x = terms[0]
            return Term(1, graph.op("abs", x.factor), graph.op("abs", x.core))
        if op == "select":
            return self._choice(node.args)
        if op in ("mul", "div"):
            x, y = terms
            factor, sign = graph.op(op, x.factor, y.factor), x.sign * y.sign
            if not self.moderate(factor):
                return None
            if op == "div" and self.value(x.core) == 1:
                return Term(sign, self.one(factor), graph.op("div", factor, y.core))
            alone = (
                x.alone if self.value(y.core) == 1 else self.value(x.core) != 1 or y.alone
            )
            return Term(sign, factor, graph.op(op, x.core, y.core), alone)
        return None

    def _choice(self, args: tuple[int, ...]) -> Term | None:
        which, x, y = (self.of[a] for a in args)
        # A zero has any factor that is a number, as that of a lane need not be.
        if self.value(args[1]) == 0 and self.value(y.factor) is not None:
            x = y._replace(core=args[1])
        if self.value(args[2]) == 0 and self.value(x.factor) is not None:
            y = x._replace(core=args[2])
        if x[:2] != y[:2]:
            return None
        core = self.graph.select(self.signed(which), x.core, y.core)
        return Term(x.sign, x.factor, core)

    # -- sums ----------------------------------------------------------------------------

    def _parts(self, number: int, sign: int = 1) -> list[Term]:
        """The terms of a sum, and of the sums that only it needs."""
        node, found = self.graph.nodes[number], []
        signs = (sign, -sign if node.op == "sub" else sign)
        for a, s in zip(node.args, signs, strict=True):
            inner = self.graph.nodes[a]
            if inner.op in ("add", "sub") and self.uses[a] == 1 and self.moving[a]:
                found += self._parts(a, s)
            else:
                term = self.of[a]
                found.append(term._replace(sign=s * term.sign))
        return found

    def _sum(self, number: int) -> Term:
        graph = self.graph
        groups: dict[int, list[Term]] = {}
        constant: int | None = None
        for term in self._parts(number):
            if self.value(term.core) == 1:
                value = self.signed(term)
                total = value if constant is None else graph.op("add", constant, value)
                if not all(self.kind(total)):
                    constant = total
                    continue
                groups.setdefault(self.one(value), []).append(self._plain(value))
            else:
                groups.setdefault(term.factor, []).append(term)
        base = self._base(number, groups, constant)
        items = []
        for factor, members in groups.items():
            if factor != base and len(members) > 1:
                inner = [self._item(t, self.one(base)) for t in members]
                members = [self._chained(inner)]
            items += [self._item(t, self.over(factor, base)) for t in members]
        if constant is not None:
            items.append(Item(1, self.one(base), self.over(constant, base)))
        total = self._chained(items)
        return Term(total.sign, base, total.core)

    def _base(
        self, number: int, groups: dict[int, list[Term]], constant: int | None
    ) -> int:
        """The factor that is taken out of a sum: the only one, or one; or, where all that
        need the sum have a factor themselves, that of most products, or one that meets its
        inverse there; of what the carry keeps, the factor that is not kept."""
        some = next(iter(groups))
        fixed = [f for f in groups if self.value(f) is not None]
        if len(groups) == 1 and (constant is None or fixed):
            return some
        kept = self.kept.get(number)
        if kept in fixed and constant is None:
            return kept
        one = self.one(some)
        if one in groups or not self._absorbed(number) or len(fixed) < len(groups):
            return one
        if constant is not None and self.value(constant) is None:
            return one
        multipliers = (self.multiplier(u, number) for u in self.users[number])
        inverse = {self.graph.op("div", one, m) for m in multipliers if m is not None}

        def worth(factor: int) -> tuple[int, bool, int]:
            members = groups[factor]
            products = sum(self.graph.nodes[t.core].op == "mul" for t in members)
            return products, factor in inverse, len(members)

        return max(fixed, key=worth)

    def _item(self, term: Term, ratio: int) -> Item:
        """A term with a ratio for its factor, which goes to an argument of a product where
        another product has the same."""
        core = term.core
        node = self.graph.nodes[core]
        if node.op == "mul" and term.alone and self.value(ratio) != 1:
            for a in dict.fromkeys(node.args):
                self.requests[ratio, a].add(core)
            for a, b in (node.args, node.args[::-1]):
                if (ratio, a) in self.scaled:
                    scaled = self.graph.op("mul", ratio, a)
                    return Item(term.sign, self.one(core), self.graph.op("mul", scaled, b))
        return Item(term.sign, ratio, core)

    def _chained(self, items: Iterable[Item]) -> Term:
        """The sum of items, those first that are there first. It starts with one that has
        no ratio and that is no product, or subtracts it from what it starts with."""
        graph, (first, *rest) = self.graph, sorted(items, key=self._rank)
        rest.sort(key=lambda item: self._depth(item.node))
        positive = next((x for x in rest if x.sign > 0), None)
        if first.sign < 0 and positive is not None:
            rest.remove(positive)
            rest.insert(0, first)
            first = positive
        total = graph.op("mul", first.ratio, first.node)
        for sign, ratio, node in rest:
            op = "add" if sign == first.sign else "sub"
            total = graph.op(op, total, graph.op("mul", ratio, node))
        return Term(first.sign, self.one(first.node), total)

    def _rank(self, item: Item):
        product = self.graph.nodes[item.node].op == "mul"
        scaled = self.value(item.ratio) != 1
        return scaled, item.sign < 0, product, self._depth(item.node)

    def _depth(self, number: int) -> int:
        """Cycles until a node is there, at least."""

        def later(n: int) -> int:
            node = self.graph.nodes[n]
            return latency(node) + max((self.depths[a] for a in node.args), default=0)

        return self.graph.followed(number, self.depths, later)
