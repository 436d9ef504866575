"""Angles from encoders, which wrap, as angles that do not."""

from collections.abc import Mapping
from typing import Any, Generic

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._realise import Pass
from .._signals import Shape
from .._typing import PyTree
from ._base import AbstractObserver, Est
from ._pll import wrap

__all__ = ["Unwrapped"]


class Unwrapped(AbstractObserver[Est], Generic[Est]):
    """An observer of `y`, shape `(p,)`, whose marked entries are angles (rad) that may jump
    by full turns between samples: they are unwrapped on the way in.

    - `observer`: what is given the unwrapped y;
    - `angles`: for each entry, whether it is an angle.

    An angle must turn by less than pi from sample to sample, missing ones left out. In
    continuous time angles are taken as they are, since a jump is no matter of sampling
    there.

    Source: theory, section 5.
    """

    observer: AbstractObserver[Est]
    angles: tuple[bool, ...] = eqx.field(static=True)

    @property
    def signals(self) -> Mapping[str, Shape]:
        return getattr(self.observer, "signals", {})

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> Est:
        return self.observer(F, u, y)

    def continued(self, before: PyTree, y: PyTree) -> Any:
        y = continued_angles(before, y, jnp.asarray(self.angles))
        return self.observer.continued(before, y)


def continued_angles(
    before: Float[Array, " p"], y: Float[Array, " p"], angles: Bool[Array, " p"]
) -> Float[Array, " p"]:
    """The y nearest to `before` that is the same angle."""
    return jnp.where(angles, before + wrap(y - before), y)
