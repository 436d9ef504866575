"""What a step of a loop depends on of the processor that it is made for (a target)."""

from typing import NamedTuple


class Target(NamedTuple):
    """A processor.

    - `register`: bytes of a vector register; `registers`: how many there are;
    - `widths`: lanes that a kernel may advance at a time, in one register of doubles or in
      several that take turns;
    - `turn`: instructions in a turn of one register of lanes (`splitting`);
    - `rate`: events that begin in a cycle at most, none before the one so many `ahead` of
      it has ended; `products` and `loads`: of these in a cycle at most (`cost`);
    - `decoded`: instructions of a step that the processor keeps decoded: of more, which it
      decodes again in every step, so many are `fetched` in a cycle; `cache`: bytes of
      its first-level cache of data;
    - `outlined`: of a function that a step evaluates many times, how many operations these
      are from which on it is one in machine code, too: less than what is kept decoded, by
      what is between them;
    - `features`: of LLVM, on top of those of the host that compiles.
    """

    register: int
    registers: int
    widths: tuple[int, ...]
    rate: float
    ahead: int
    products: int
    loads: int
    decoded: int
    fetched: float = 1.75
    cache: int = 32_768
    outlined: int = 2_000
    turn: int = 36
    features: str = ""


# What is estimated with these picks, of the widths and of the two orders of a step, those
# that run fastest or within 3 % of it: of the motor's loop, quiet, with noise, with three
# and ten observers and with derivatives, and of the other plants of the benchmark
# `systems`, but for the WRIM on AVX2, 15 % slower for the sake of Zen 3 (below). AVX-512:
# measured on Zen 4, which takes two halves of a register one after the other. AVX2: orders
# on Zen 3, and all again on Zen 4 without its AVX-512.
#
# More than 2,400 instructions: the loop with five observers takes 2,430 for eight lanes in
# one order and 2,040 in the other, which runs 1.8 times as fast on Zen 3. Zen 4 has room
# for 4,000. Of turns of 20 to 64 instructions those of 42 are, on Zen 4, 2 % faster than
# those of 36 for the motor's loop, and 0.4 % with noise; AVX2's are as on Zen 3. The
# field of a motor in continuous time, 16 times 167 operations, is 3 to 5 % faster where it
# is not outlined with registers of 64 bytes, and 5 % slower with those of 32.
AVX2 = Target(32, 16, (4, 8), rate=4.0, ahead=100, products=2, loads=2, decoded=2_400)
AVX512 = Target(
    64,
    32,
    (8, 16, 32),
    rate=4.0,
    ahead=64,
    products=1,
    loads=1,
    decoded=4_000,
    turn=42,
    outlined=3_000,
)
