"""Random programs: typed expressions over a carry, the step, samples and tables, as source
that can be pasted."""

import random
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from operations import HALVES, OPERATIONS, SMOOTH, Operation

LARGE = 2.0**-20  # of the largest number: what is scaled may overflow sooner, or later
SITES = 61  # roundings that the oracle moves apart from each other
CARRY = {"F": 4, "V": 1, "I": 2, "L": 1, "U": 1, "B": 1}
DTYPES = {"I": "jnp.int32", "L": "jnp.int64", "U": "jnp.uint32", "B": "bool"}
CONSTANTS = (0.5, -0.5, 2.0, -1.3, 0.7, 3.0, -0.25, 0.1)
WHOLE = (-7, -3, -2, -1, 0, 1, 2, 3, 5, 31, 33)
# What each entry of the carry becomes, of a value `{0}`, itself `{1}` and another `{2}`.
ENDS = {
    "F": (
        "R({0} / R(1.0 + jnp.abs({0})))",
        "R({1} + R(0.1 * R({0} / R(1.0 + jnp.abs({0})))))",
        "R({c} * R({0} / R(1.0 + jnp.abs({0}))))",
        "R(p['y'] * R({0} / R(1.0 + jnp.abs({0}))))",
        "{2}",
        "jnp.clip({0}, -3.0, 3.0)",
        "{0}",
    ),
    "V": ("R({0} / R(1.0 + jnp.abs({0})))", "R(R(0.9 * {1}) + R(0.1 * R(jnp.tanh({0}))))"),
    "I": ("{0}", "{1} + 1", "{0} % 10"),
    "L": ("{0}", "{1} + k"),
    "U": ("{0}", "{1} * 1664525 + 1013904223"),
    "B": ("{0}", "{0} ^ {1}"),
}


class Line(NamedTuple):
    """A value and how it is made of earlier ones."""

    name: str
    kind: str
    text: str
    operands: tuple[str, ...]


class Code(NamedTuple):
    """A program: `real` is the type of its real numbers; the lines of a step, what becomes
    of the carry, and what is recorded beside it."""

    seed: int
    real: str
    smooth: bool
    steps: int
    every: int
    lines: tuple[Line, ...]
    ends: tuple[Line, ...]
    kept: tuple[tuple[str, str], ...]


def carried() -> Iterator[tuple[str, str]]:
    """The names of the carry, with their types; `w` is the same for all lanes."""
    for kind, count in CARRY.items():
        yield from ((f"{kind.lower()}{i}", kind) for i in range(count))
    yield "w", "F"


# What a step may begin with: samples, the step as a real number, entries of a table.
GIVEN = [
    ("F", 'p["x"]'),
    ("F", 'p["y"]'),
    ("F", "k.astype(F)"),
    ("F", "T[k]"),
    ("F", 'p["c"][k]'),
    ("V", 'p["c"]'),
    ("I", 'p["i"]'),
    ("L", "k"),
    ("L", 'p["l"]'),
    ("U", 'p["u"]'),
    ("B", 'p["b"]'),
    ("B", "(k % 2 == 0)"),
]


def generate(seed: int) -> Code:
    """The program of a seed: every third one in single precision, every fifth one smooth,
    and every other one mostly sums and products; every twentieth one uses numbers of half
    precision too."""
    rng = random.Random(seed)
    smooth = seed % 5 == 3
    menu = SMOOTH if smooth else OPERATIONS
    if not smooth and seed % 2:
        menu = menu + 4 * SMOOTH
    if seed % 20 == 19:
        menu = menu + HALVES
    weights = [operation.weight for operation in menu]
    known = [(name, kind) for name, kind in carried()]
    known += [(text, kind) for kind, text in GIVEN]
    lines: list[Line] = []

    def pick(kind: str) -> str:
        """Of the latest values of a type, or of all."""
        names = [name for name, k in known if k == kind]
        return rng.choice(names[-4:] if rng.random() < 0.6 else names)

    def filled(text: str, kind: str) -> str:
        whole = [m for m in WHOLE if m >= 0 or kind != "U"]
        for mark, values in (("{c}", CONSTANTS), ("{m}", whole), ("{u}", (2, 3, 5, 7, 33))):
            while mark in text:
                text = text.replace(mark, str(rng.choice(values)), 1)
        return text

    for n in range(rng.randint(10, 20)):
        operation: Operation = rng.choices(menu, weights)[0]
        text = filled(operation.text, operation.result)
        if operation.rounding == "M":
            for mark in ("{0}", "{1}"):
                text = text.replace(mark, f"R({mark})")
        if operation.rounding:
            text = f"E({text})" if operation.rounding == "E" else f"R({text})"
        operands = tuple(pick(kind) for kind in operation.operands)
        lines.append(Line(f"e{n}", operation.result, text, operands))
        known.append((f"e{n}", operation.result))
    ends = []
    for name, kind in carried():
        text = filled(rng.choice(ENDS[kind]), kind)
        if name == "w":
            text = "R(R(0.9 * w) + R(0.1 * jnp.sin(R(0.3 * k.astype(F)))))"
        others = [n for n, k in carried() if k == kind]
        ends.append(Line(name, kind, text, (pick(kind), name, rng.choice(others))))
    made = [(line.name, line.kind) for line in lines]
    kept = tuple(rng.sample(made, min(4, len(made))))
    real = "float32" if seed % 3 == 2 else "float64"
    every = rng.choice((1, 1, 2, 3))
    return Code(seed, real, smooth, 6, every, tuple(lines), tuple(ends), kept)


def reduced(code: Code, fails: Callable[[Code], bool]) -> Code:
    """A program with as few lines as greedy removal finds that still fails."""

    def without(name: str, kind: str) -> Code | None:
        other = next((n for n, k in carried() if k == kind), None)
        if other is None:
            return None
        change = lambda lines: tuple(
            line._replace(operands=tuple(other if o == name else o for o in line.operands))
            for line in lines
            if line.name != name or line.name in dict(carried())
        )
        kept = tuple(k for k in code.kept if k[0] != name)
        return code._replace(lines=change(code.lines), ends=change(code.ends), kept=kept)

    for k in reversed(range(len(code.kept))):
        smaller = code._replace(kept=code.kept[:k] + code.kept[k + 1 :])
        code = smaller if fails(smaller) else code
    for k, line in enumerate(code.ends):
        same = line._replace(text="{1}", operands=(line.name,) * 3)
        smaller = code._replace(ends=(*code.ends[:k], same, *code.ends[k + 1 :]))
        if line.text != "{1}" and fails(smaller):
            code = smaller
    for line in reversed(code.lines):
        smaller = without(line.name, line.kind)
        if smaller is not None and fails(smaller):
            code = smaller
    return code


# -- source --------------------------------------------------------------------------------

HEAD = """\
# Program {seed}, {steps} steps, every {every}, recorded.
import jax, jax.numpy as jnp, numpy as np
from jax import lax
F = jnp.{real}
R = E = lambda x, *site: x
T = jnp.asarray(np.sin(np.arange(80.0) ** 1.3), F)
# Quotients for whose remainder there are digits enough, and special ones.
bounded = lambda x: jnp.where(jnp.abs(x) < 1e9, x, jnp.inf)
divisor = lambda x: jnp.where(jnp.abs(x) < 1e-9, 0.0, x)

def begin(p):
    carry = dict(
        f0=p["x"], f1=p["y"], f2=0.5 * p["y"], f3=jnp.asarray(0.3, F), v0=p["c"],
        i0=p["i"], i1=jnp.asarray(3, jnp.int32), l0=p["l"], u0=p["u"], b0=p["b"],
        w=jnp.asarray(0.4, F),
    )
    return carry, dict({zeros})

def advance(k, s, p):
"""


def source(code: Code) -> str:
    zero = lambda kind: (
        "jnp.zeros(3, F)" if kind == "V" else f"jnp.zeros((), {DTYPES.get(kind, 'F')})"
    )
    zeros = ", ".join(f"kept{n}={zero(kind)}" for n, (_, kind) in enumerate(code.kept))
    head = HEAD.format(zeros=zeros, **code._asdict())
    names = [name for name, _ in carried()]
    body = [", ".join(names) + " = " + ", ".join(f's["{name}"]' for name in names)]
    body += [f"{line.name} = {_made(line)}" for line in code.lines]
    ends = "".join(f"\n        {line.name}={_made(line)}," for line in code.ends)
    body.append(f"carry = dict({ends}\n    )")
    kept = ", ".join(f"kept{n}={name}" for n, (name, _) in enumerate(code.kept))
    body.append(f"return carry, dict({kept})")
    return head + "".join(f"    {line}\n" for line in body)


def _made(line: Line) -> str:
    text = line.text
    for n, operand in enumerate(line.operands):
        text = text.replace(f"{{{n}}}", operand)
    return text


# -- what it runs as -----------------------------------------------------------------------


class Moved:
    """The marks of roundings, for one lane of the oracle: `R` moves a number by a part of
    itself, one that is nearly too large to infinity, and gives a zero a sign; `E` does only
    the last. Counts its places, each
    with numbers of its own, as a step is traced."""

    def __init__(self, noise: dict[str, jax.Array]):
        self.noise, self.places = noise, 0

    def _at(self, x: jax.Array, name: str, place: int) -> jax.Array:
        return self.noise[name][place : place + x.size].reshape(x.shape)

    def R(self, x: jax.Array) -> jax.Array:
        place, self.places = self.places % SITES, self.places + 1
        at = lambda name: self._at(x, name, place)
        near = jnp.where(
            jnp.abs(x) < LARGE * jnp.finfo(x.dtype).max, at("near"), at("over")
        )
        return x * jnp.where(x == 0, at("turned"), near)

    def E(self, x: jax.Array) -> jax.Array:
        place, self.places = self.places % SITES, self.places + 1
        return jnp.where(x == 0, x * self._at(x, "sign", place), x)


class Program:
    """A program with the interface of an experiment, for one sample `p`."""

    def __init__(self, made: SimpleNamespace, p: dict[str, Any]):
        self.made, self.p = made, p

    def init(self):
        carry, kept = self.made.begin(self.p)
        return carry, carry | kept | self._noise()

    def prepare(self, carry):
        return None

    def advance(self, k, carry, prepared):
        if "noise" in self.p:
            moved = Moved(self.p["noise"])
            self.made.space.update(R=moved.R, E=moved.E)
        try:
            carry, kept = self.made.advance(k, carry, self.p)
        finally:
            self.made.space.update(R=lambda x: x, E=lambda x: x)
        return carry, carry | kept | self._noise()

    def _noise(self):
        """For the metric; `recorded` leaves it out."""
        return {name: x for name, x in self.p.items() if name == "noise"}


def recorded(record: dict[str, Any]) -> dict[str, Any]:
    return {name: x for name, x in record.items() if name != "noise"}


class Sum:
    """A metric: the sums of two real entries, the greatest whole number, a count."""

    def init(self, record):
        f, v = record["f0"], record["v0"]
        return f * 0.5, v * 1.0, record["i0"], record["b0"].astype(jnp.int32), v

    def update(self, state, record):
        total, vector, most, count, _ = state
        R = Moved(record["noise"]).R if "noise" in record else lambda x: x
        return (
            R(total + R(0.25 * record["f0"])),
            R(0.5 * R(vector + record["v0"])),
            jnp.maximum(most, record["i0"]),
            count + record["b0"],
            record["v0"],
        )

    def result(self, state):
        *sums, last = state
        return *sums, jnp.maximum(last[2], last[0])


def compiled(text: str, name: str) -> Callable[[dict[str, Any]], Program]:
    """From a sample to the program whose source is `text`."""
    space: dict[str, Any] = {}
    exec(compile(text, name, "exec"), space)
    made = SimpleNamespace(begin=space["begin"], advance=space["advance"], space=space)
    return lambda p: Program(made, p)


def sampled(seed: int, real: str, lanes: int) -> dict[str, Any]:
    """Samples of every type; in one of eight lanes one of them is special."""
    rng = np.random.default_rng(seed)
    F = np.dtype(real)
    limits = np.finfo(F)
    specials = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 0.5, 1e20, -3e9, 300.0]
    large = limits.max * LARGE
    specials += [large, -large, limits.tiny * 2.0**20, 2.0**31, -(2.0**63), 1e-13]
    whole = lambda dtype: [0, 1, np.iinfo(dtype).max, np.iinfo(dtype).min, 31, 32, 64]

    def mixed(plain, special):
        chosen = rng.random(plain.shape) < 1 / (8 * plain[0].size)
        drawn = np.asarray(rng.choice(np.array(special, plain.dtype), plain.shape))
        return np.where(chosen, drawn, plain)

    shape = (lanes,)
    return {
        "x": mixed(rng.normal(size=shape).astype(F), specials),
        "y": mixed(rng.uniform(-1.5, 1.5, shape).astype(F), [0.0, -0.0, 1.0, -1.0]),
        "d": rng.choice([-1.0, 1.0], shape).astype(F)
        * rng.uniform(0.6, 2.0, shape).astype(F),
        "c": mixed(rng.uniform(-1, 1, (lanes, 3)).astype(F), [0.0, 1.0, *specials]),
        "i": mixed(rng.integers(-5, 9, shape).astype(np.int32), whole(np.int32)),
        "l": mixed(rng.integers(-50, 90, shape), whole(np.int64)),
        "u": mixed(rng.integers(0, 90, shape).astype(np.uint32), whole(np.uint32)),
        "b": rng.random(shape) < 0.5,
    }
