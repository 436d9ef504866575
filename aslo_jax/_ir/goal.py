"""What graphs are made for."""

from typing import NamedTuple


class Goal(NamedTuple):
    """What a graph is made for.

    - `fuses`: whether a product and a sum that may be rounded once are one operation;
      `inverts`: whether what moves is multiplied by the inverse of what is fixed over time;
    - `outlined`: operations of all evaluations of a function from which on it stays one;
      `large`: multiply-adds of a product of matrices, or operations of a function of an
      array, of one that is done in loops; `many`: entries of such an array, at least;
      `entries`: of one whose function is meant to be done so.
    """

    fuses: bool = True
    inverts: bool = False
    outlined: int = 2000
    large: int = 1000
    many: int = 32
    entries: int = 8


MACHINE_CODE = Goal()
