"""The order of the operations of a step: which one comes next, for a processor that looks a
hundred instructions ahead and has few registers (list scheduling, by the critical path or
by register pressure)."""

import heapq
from collections.abc import Collection, Iterable

from ..._ir.graph import Graph
from ..._ir.latency import latency
from ..._ir.specialisation import Special

# Values that wait in registers, at most; from 4 to 12 it is the same.
WAITING = 6

Nodes = Graph | Special


def depth_first(graph: Nodes, roots: Iterable[int], inside: Collection[int]) -> list[int]:
    """The nodes `inside` that the roots need, each as late as those after it allow: first
    the root that is made of the fewest levels, and of each node first the argument of most.
    Little waits in between."""
    level: dict[int, int] = {}
    for number in sorted(inside):
        below = (level.get(a, 0) for a in graph.nodes[number].args)
        level[number] = 1 + max(below, default=0)
    out, seen = [], set()
    for root in sorted(roots, key=lambda n: level.get(n, 0)):
        left = [(root, False)]
        while left:
            number, complete = left.pop()
            if complete:
                out.append(number)
            elif number in level and number not in seen:
                seen.add(number)
                left.append((number, True))
                args = sorted(graph.nodes[number].args, key=lambda n: level.get(n, 0))
                left += [(a, False) for a in args]
    return out


def ordered(graph: Nodes, numbers: Iterable[int]) -> list[int]:
    """The nodes, arguments first: among those whose arguments are there, the one that the
    longest chain of operations waits for, or, while many values wait to be used, one that
    uses the last of some."""
    return _Schedule(graph, list(numbers)).order()


class _Schedule:
    def __init__(self, graph: Nodes, numbers: list[int]) -> None:
        self.graph, self.numbers = graph, numbers
        inside = set(numbers)
        self.done: dict[int, int] = {}  # when a result is there
        self.ready: set[int] = set()
        self.longest: list[tuple[int, int]] = []
        self.freeing: list[tuple[int, int, int]] = []
        self.args = {n: set(graph.nodes[n].args) & inside for n in numbers}
        self.users: dict[int, list[int]] = {n: [] for n in numbers}
        for n in numbers:
            for a in self.args[n]:
                self.users[a].append(n)
        self.chain: dict[int, int] = {}
        for n in reversed(numbers):
            after = max((self.chain[u] for u in self.users[n]), default=0)
            self.chain[n] = after + latency(graph.nodes[n])
        self.unused = {n: len(self.users[n]) for n in numbers}
        # How many values more wait after a node than before it.
        self.more = {n: self._waits(n) and bool(self.users[n]) for n in numbers}
        for n in numbers:
            if self.unused[n] == 1:
                self._last_use(n)

    def _waits(self, number: int) -> int:
        return self.graph.nodes[number].op not in ("const", "input")

    def _last_use(self, number: int) -> None:
        """One node is left that uses a value: after it, the value waits no more."""
        user = next(n for n in self.users[number] if n not in self.done)
        self.more[user] -= self._waits(number)
        if user in self.ready:
            self._offer(user)

    def _offer(self, number: int) -> None:
        """A node whose arguments are there, to both queues."""
        self.ready.add(number)
        heapq.heappush(self.longest, (-self.chain[number], number))
        frees = self.more[number], -self.chain[number], number
        heapq.heappush(self.freeing, frees)

    def _taken(self, crowded: bool) -> int:
        """The next node; what queues hold of nodes that are done, or of what has changed
        since, is passed over."""
        while crowded:
            more, _, number = heapq.heappop(self.freeing)
            if number in self.ready and self.more[number] == more:
                self.ready.remove(number)
                return number
        while True:
            _, number = heapq.heappop(self.longest)
            if number in self.ready:
                self.ready.remove(number)
                return number

    def order(self) -> list[int]:
        out: list[int] = []
        missing = {n: len(self.args[n]) for n in self.numbers}
        later = [(0, n) for n in self.numbers if not missing[n]]
        time = waiting = 0
        while later or self.ready:
            while later and later[0][0] <= time:
                self._offer(heapq.heappop(later)[1])
            if not self.ready:
                time = later[0][0]
                continue
            number = self._taken(waiting >= WAITING)
            out.append(number)
            waiting += self.more[number]
            self.done[number] = time + latency(self.graph.nodes[number])
            time += latency(self.graph.nodes[number]) > 0
            for a in self.args[number]:
                self.unused[a] -= 1
                if self.unused[a] == 1:
                    self._last_use(a)
            for user in self.users[number]:
                missing[user] -= 1
                if not missing[user]:
                    at = max(self.done[a] for a in self.args[user])
                    heapq.heappush(later, (at, user))
        return out
