"""What a step of a loop depends on of the processor that it is made for."""

from typing import NamedTuple


class Target(NamedTuple):
    """A processor (target description).

    - `register`: bytes of a vector register; `registers`: how many there are;
    - `widths`: lanes that a kernel may advance at a time, in one register of doubles or in
      several that take turns;
    - `decoded`: instructions of a step that the processor keeps decoded: more are decoded
      anew in every step (the capacity of its cache of micro-operations);
    - `turn`: instructions in a turn of one register of lanes (`splitting`);
    - `features`: of LLVM, on top of those of the host that compiles.
    """

    register: int
    registers: int
    widths: tuple[int, ...]
    decoded: int = 2_400
    turn: int = 36
    features: str = ""


# On AVX2 two registers of lanes run 1.2 times as fast as one, and three as fast as two. The
# loop with five observers takes 2,430 instructions for eight lanes in one order and 2,040 in
# the other, which runs 1.8 times as fast.
AVX2 = Target(32, 16, (4, 8))
AVX512 = Target(64, 32, (8, 16, 32))
