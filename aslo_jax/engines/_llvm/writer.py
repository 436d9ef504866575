"""Scalar operations as instructions of LLVM, on one lane or on a vector of lanes."""

import struct
from typing import Any

import numpy as np

from ..._ir.node import COMPARISONS

TYPES = {
    "float64": "double",
    "float32": "float",
    "int64": "i64",
    "uint64": "i64",
    "int32": "i32",
    "uint32": "i32",
    "int16": "i16",
    "uint16": "i16",
    "int8": "i8",
    "uint8": "i8",
    "bool": "i1",
}
BY_TYPE = {np.dtype(name): kind for name, kind in TYPES.items()}
# Products may be fused with sums; NaN and infinity keep their meaning, and a zero its sign:
# without it (nsz), 0.5 to 1 % faster, the sign would depend on the lanes of a kernel.
FLAGS = "contract arcp "
BINARY = ("add", "sub", "mul", "div", "and", "or", "xor")
SHIFTS = ("shl", "lshr", "ashr")
# Of whole numbers, those that LLVM does not define for every second operand.
PARTIAL = (*SHIFTS, "div")
# A product and a sum, rounded once where the host can: which operand is negative.
PRODUCTS = {"muladd": None, "mulsub": 2, "submul": 0}
INTRINSICS = {
    "sqrt": "sqrt",
    "floor": "floor",
    "ceil": "ceil",
    "rint": "rint",
    "abs": "fabs",
    "fma": "fma",
    "ones": "ctpop",
}


class Writer:
    """The lines of a function, and the instructions that they are made of; `exact` where
    LLVM may change none, whoever else needs its result."""

    def __init__(self, width: int, exact: bool = False) -> None:
        self.width, self.flags = width, "" if exact else FLAGS
        self.lines: list[str] = []
        self.block = "entry"
        self.declarations: set[str] = set()
        self.tables: dict[bytes, tuple[str, str]] = {}  # names and definitions
        self._count = 0

    def label(self, name: str) -> None:
        """The block of the lines that follow."""
        self.block = name
        self.lines.append(f"{name}:")

    def line(self, text: str) -> None:
        self.lines.append("  " + text)

    def next_block(self) -> str:
        """Goes on in a basic block of its own: its name."""
        self._count += 1
        name = f"block{self._count}"
        self.line(f"br label %{name}")
        self.label(name)
        return name

    def define(self, text: str) -> str:
        """A new name for the value of an instruction."""
        self._count += 1
        self.line(f"%v{self._count} = {text}")
        return f"%v{self._count}"

    # -- types and constants -------------------------------------------------------------

    def type(self, dtype: Any, vector: bool) -> str:
        scalar = BY_TYPE[np.dtype(dtype)]
        return f"<{self.width} x {scalar}>" if vector else scalar

    def stored(self, dtype: Any, vector: bool) -> str:
        """The type in memory, where a boolean is a byte."""
        return self.type(np.uint8 if np.dtype(dtype) == np.bool_ else dtype, vector)

    def constant(self, value: Any, dtype: Any, vector: bool) -> str:
        one = literal(np.asarray(value).astype(dtype)[()])
        if not vector:
            return one
        return f"<{', '.join([f'{self.type(dtype, False)} {one}'] * self.width)}>"

    def splat(self, scalar: str, dtype: Any) -> str:
        kind, wide = self.type(dtype, False), self.type(dtype, True)
        one = self.define(f"insertelement {wide} poison, {kind} {scalar}, i64 0")
        mask = f"<{self.width} x i32> zeroinitializer"
        return self.define(f"shufflevector {wide} {one}, {wide} poison, {mask}")

    def agree(self, mask: str, everywhere: bool) -> str:
        """Whether a boolean holds for all lanes, or for some."""
        lanes = self.width
        bits = self.define(f"bitcast <{lanes} x i1> {mask} to i{lanes}")
        test = f"eq i{lanes} {bits}, -1" if everywhere else f"ne i{lanes} {bits}, 0"
        return self.define(f"icmp {test}")

    def cut(self, vector: str, first: int, lanes: int, dtype: Any) -> str:
        """So many lanes of a vector, from `first`."""
        if (first, lanes) == (0, self.width):
            return vector
        wide = self.type(dtype, True)
        mask = ", ".join(f"i32 {first + k}" for k in range(lanes))
        return self.define(
            f"shufflevector {wide} {vector}, {wide} poison, <{lanes} x i32> <{mask}>"
        )

    def joined(self, vectors: list[str], dtype: Any) -> str:
        """A vector with the lanes of several, a power of two of them, that are alike."""
        scalar, lanes = self.type(dtype, False), self.width // len(vectors)
        while len(vectors) > 1:
            kind, mask = (
                f"<{lanes} x {scalar}>",
                ", ".join(f"i32 {k}" for k in range(2 * lanes)),
            )
            vectors = [
                self.define(
                    f"shufflevector {kind} {a}, {kind} {b}, <{2 * lanes} x i32> <{mask}>"
                )
                for a, b in zip(vectors[::2], vectors[1::2], strict=True)
            ]
            lanes *= 2
        return vectors[0]

    # -- operations ----------------------------------------------------------------------

    def operation(
        self, op: str, dtype: np.dtype, source: np.dtype, x: list[str], vector: bool
    ) -> str:
        """`op` on operands x, the last of which is of type `source`, to a `dtype`."""
        kind, inner = self.type(dtype, vector), self.type(source, vector)
        real = source.kind == "f"
        if op in COMPARISONS:
            return self.define(f"{_comparison(op, source)} {inner} {x[0]}, {x[1]}")
        if op in BINARY:
            name = f"f{op} {self.flags}" if real else f"{_binary(op, dtype)} "
            return self.define(f"{name}{kind} {x[0]}, {x[1]}")
        if op == "neg" and real:
            return self.define(f"fneg {self.flags}{kind} {x[0]}")
        if op == "neg":
            return self.define(f"sub {kind} {self.constant(0, dtype, vector)}, {x[0]}")
        if op == "not":
            ones = self.constant(
                True if dtype == np.bool_ else ~dtype.type(0), dtype, vector
            )
            return self.define(f"xor {kind} {x[0]}, {ones}")
        if op == "abs" and not real:
            return self.call("abs", kind, x, "i1 false")
        if op == "zeros":
            return self.call("ctlz", kind, x, "i1 false")
        if op in INTRINSICS:
            return self.call(INTRINSICS[op], kind, x)
        if op in PRODUCTS:
            sign = PRODUCTS[op]
            x = [
                self.define(f"fneg {self.flags}{kind} {v}") if k == sign else v
                for k, v in enumerate(x)
            ]
            return self.call("fmuladd", kind, x)
        if op == "select":
            which = self.type(np.bool_, vector)
            return self.define(f"select {which} {x[0]}, {kind} {x[1]}, {kind} {x[2]}")
        if op == "bitcast":
            return self.define(f"bitcast {inner} {x[0]} to {kind}")
        assert op == "convert", op
        if real and dtype.kind in "iu":
            return self._whole(x[0], source, dtype, vector)
        cast = _cast(source, dtype)
        return self.define(f"{cast} {inner} {x[0]} to {kind}") if cast else x[0]

    def _whole(self, x: str, source: np.dtype, dtype: np.dtype, vector: bool) -> str:
        """A real number as a whole one: out of range the next one, and zero for none."""
        name = "fptosi" if dtype.kind == "i" else "fptoui"
        kind, inner = self.type(dtype, vector), self.type(source, vector)
        lanes = f"v{self.width}" if vector else ""
        suffix = f"{lanes}i{8 * dtype.itemsize}.{lanes}f{8 * source.itemsize}"
        self.declarations.add(f"declare {kind} @llvm.{name}.sat.{suffix}({inner})")
        return self.define(f"call {kind} @llvm.{name}.sat.{suffix}({inner} {x})")

    def partial(
        self, op: str, dtype: np.dtype, x: list[str], vector: bool, second: Any
    ) -> str:
        """An operation on whole numbers that LLVM does not define everywhere, defined as
        XLA does; `second` is the second operand where that is known."""
        if op == "div":
            return self._quotient(dtype, x, vector, second)
        return self._shift(op, dtype, x, vector, second)

    def _quotient(self, dtype: np.dtype, x: list[str], vector: bool, divisor: Any) -> str:
        """Towards zero. By zero it is all ones, and the least number by -1 itself."""
        kind, signed = self.type(dtype, vector), dtype.kind == "i"
        op = f"{_binary('div', dtype)} {kind} {x[0]},"
        if divisor is not None and divisor not in (0, -1):
            return self.define(f"{op} {x[1]}")
        flag = self.type(np.bool_, vector)
        number = lambda value: self.constant(value, dtype, vector)
        ones = number(~dtype.type(0))
        empty = self.define(f"icmp eq {kind} {x[1]}, {number(0)}")
        beyond = empty
        if signed:
            least = self.define(f"icmp eq {kind} {x[0]}, {number(np.iinfo(dtype).min)}")
            turned = self.define(f"icmp eq {kind} {x[1]}, {ones}")
            wraps = self.define(f"and {flag} {least}, {turned}")
            beyond = self.define(f"or {flag} {empty}, {wraps}")
        safe = self.define(f"select {flag} {beyond}, {kind} {number(1)}, {kind} {x[1]}")
        found = self.define(f"{op} {safe}")
        return self.define(f"select {flag} {empty}, {kind} {ones}, {kind} {found}")

    def _shift(
        self, op: str, dtype: np.dtype, x: list[str], vector: bool, amount: Any
    ) -> str:
        """By `amount` where that is known. By the width or more it is poison to
        LLVM; here it leaves zero, or the sign."""
        kind, bits = self.type(dtype, vector), dtype.itemsize * 8
        if amount is not None and 0 <= amount < bits:
            return self.define(f"{op} {kind} {x[0]}, {x[1]}")
        flag, most = self.type(np.bool_, vector), self.constant(bits - 1, dtype, vector)
        fits = self.define(f"icmp ule {kind} {x[1]}, {most}")
        within = self.define(f"select {flag} {fits}, {kind} {x[1]}, {kind} {most}")
        shifted = self.define(f"{op} {kind} {x[0]}, {within}")
        if op == "ashr":
            return shifted
        zero = self.constant(0, dtype, vector)
        return self.define(f"select {flag} {fits}, {kind} {shifted}, {kind} {zero}")

    def call(self, name: str, kind: str, arguments: list[str], flags: str = "") -> str:
        """An intrinsic of LLVM whose arguments are of `kind`, and then `flags`."""
        scalar = kind.rpartition(" ")[2].rstrip(">")
        suffix = {"double": "f64", "float": "f32"}.get(scalar, scalar)
        suffix = f"v{self.width}{suffix}" if kind.startswith("<") else suffix
        extra = [flags] if flags else []
        types = [kind] * len(arguments) + [e.partition(" ")[0] for e in extra]
        given = [f"{kind} {x}" for x in arguments] + extra
        self.declarations.add(f"declare {kind} @llvm.{name}.{suffix}({', '.join(types)})")
        return self.define(f"call {kind} @llvm.{name}.{suffix}({', '.join(given)})")

    def table(self, values: np.ndarray) -> str:
        """The name of a table of constants."""
        stored = values.astype(np.uint8) if values.dtype == np.bool_ else values
        kind = self.type(stored.dtype, False)
        key = kind.encode() + stored.tobytes()
        if key not in self.tables:
            name, whole = f"@table{len(self.tables)}", f"[{len(stored)} x {kind}]"
            entries = ", ".join(f"{kind} {literal(x)}" for x in stored)
            self.tables[key] = name, f"{name} = private constant {whole} [{entries}]"
        return self.tables[key][0]

    def hidden(self, table: str) -> str:
        """The address of a table, of which LLVM does not know that it is that: it would
        make each entry's anew."""
        name = f"{table}.address"
        definition = f"{name} = private global ptr {table}"
        self.tables.setdefault(name.encode(), (name, definition))
        return self.define(f"load ptr, ptr {name}")

    def lookup(self, values: np.ndarray, index: str, vector: bool) -> str:
        """The entry of a table of constants at `index` (int64), lane by lane."""
        kind, name = self.stored(values.dtype, False), self.table(values)

        def entry(place: str) -> str:
            pointer = self.define(f"getelementptr {kind}, ptr {name}, i64 {place}")
            return self.load(pointer, values.dtype, False)

        if not vector:
            return entry(index)
        places, inner = self.type(np.int64, True), self.type(values.dtype, False)
        wide, found = self.type(values.dtype, True), "poison"
        for lane in range(self.width):
            place = self.define(f"extractelement {places} {index}, i64 {lane}")
            one = entry(place)
            found = self.define(f"insertelement {wide} {found}, {inner} {one}, i64 {lane}")
        return found

    # -- memory --------------------------------------------------------------------------

    def load(self, pointer: str, dtype: Any, vector: bool) -> str:
        dtype = np.dtype(dtype)
        kind = self.stored(dtype, vector)
        found = self.define(f"load {kind}, ptr {pointer}, align {dtype.itemsize}")
        if dtype == np.bool_:
            return self.define(f"trunc {kind} {found} to {self.type(dtype, vector)}")
        return found

    def store(self, value: str, pointer: str, dtype: Any) -> None:
        """Stores a vector."""
        dtype = np.dtype(dtype)
        kind = self.stored(dtype, True)
        if dtype == np.bool_:
            value = self.define(f"zext {self.type(dtype, True)} {value} to {kind}")
        self.line(f"store {kind} {value}, ptr {pointer}, align {dtype.itemsize}")

    def offset(self, pointer: str, dtype: Any, index: str) -> str:
        kind = self.stored(dtype, False)
        return self.define(f"getelementptr {kind}, ptr {pointer}, i64 {index}")


def literal(value: Any) -> str:
    if value.dtype == np.bool_:
        return "true" if value else "false"
    if value.dtype.kind == "f":  # a float32 is written as the double that it is
        (bits,) = struct.unpack("<Q", struct.pack("<d", float(value)))
        return f"0x{bits:016X}"
    return str(int(value))


def _comparison(op: str, dtype: np.dtype) -> str:
    if dtype.kind == "f":
        return f"fcmp {'une' if op == 'ne' else 'o' + op}"
    sign = "" if op in ("eq", "ne") else "s" if dtype.kind == "i" else "u"
    return f"icmp {sign}{op}"


def _binary(op: str, dtype: np.dtype) -> str:
    if op == "div":
        return "sdiv" if dtype.kind == "i" else "udiv"
    return op


def _cast(source: np.dtype, target: np.dtype) -> str | None:
    """The instruction that converts numbers, `None` where the bits are the same."""
    unsigned = source.kind in "ub"
    if source.kind == "f":
        return "fpext" if target.itemsize > source.itemsize else "fptrunc"
    if target.kind == "f":
        return "uitofp" if unsigned else "sitofp"
    bits = 1 if source == np.bool_ else source.itemsize * 8
    if bits == target.itemsize * 8:
        return None
    if bits > target.itemsize * 8:
        return "trunc"
    return "zext" if unsigned else "sext"
