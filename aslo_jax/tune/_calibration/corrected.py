"""A relation fed through an imperfect supply and imperfect sensors."""

from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float

from ..._checks import positive, real
from ..._module import Module
from ..._relations import AbstractTerms
from ..._typing import PyTree


class Corrected(Module):
    """A relation whose inputs and outputs are recorded with a wrong gain and with offsets:
    `relation(gain u + input_offset, y - output_offset)`. It is a relation itself, so that
    an observer of it corrects as it runs, and [`calibrate`][] finds the errors.

    - `relation`: of the true signals;
    - `gain`: of the supply, dimensionless: what it gives over what is recorded;
    - `input_offset`: what it gives beyond that (V), shape `(m,)` or `()`;
    - `output_offset`: what the sensors show of nothing (A), shape `(p,)` or `()`.

    Scaling gain, resistances, inductances and magnet fluxes all alike changes nothing that
    is measured: the gain can be found where one of these is known.
    """

    relation: Callable[[PyTree, PyTree], AbstractTerms]
    gain: Float[Array, ""] = eqx.field(converter=real, default=1.0)
    input_offset: Float[Array, "*m"] = eqx.field(converter=real, default=0.0)
    output_offset: Float[Array, "*p"] = eqx.field(converter=real, default=0.0)

    def __check_init__(self) -> None:
        positive("gain", self.gain)

    def __call__(self, u: Float[Array, " m"], y: Float[Array, " p"]) -> AbstractTerms:
        return self.relation(self.gain * u + self.input_offset, y - self.output_offset)
