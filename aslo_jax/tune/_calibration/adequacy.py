"""Whether an error of the record explains what a calibration leaves: score tests."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..._derive.plant import ModelPlant
from ...plants import AbstractMechanicalSystem
from .information import normalised, spread
from .search import Search

CANDIDATES = ("output_offset", "dead_time", "delay")
WORDS = {
    "output_offset": ("an offset of the outputs", "(their units)"),
    "dead_time": ("a dead time", "V"),
    "delay": ("a delay of the inputs", "samples"),
}
SURE = 12.0  # of a test statistic per degree of freedom: noise reaches it in 2 of 1000


@dataclasses.dataclass(frozen=True)
class Finding:
    """An error of the record that a calibration without it shows signs of.

    - `field`: of `Imperfections`;
    - `size`: about how large it is, in the units of the field, shape `()`, or of each
      signal; to first order, with all else free;
    - `statistic`: of the score test, or of the likelihood ratio where it was fitted, over
      its degrees of freedom: about one by chance;
    - `share`: of the sum of squares that it explains;
    - `shift`: what the parameters are off by where it is left out, relative, shape `(k,)`.
    """

    field: str
    size: Float[np.ndarray, " s"]
    statistic: float
    share: float
    shift: Float[np.ndarray, " k"]

    def __str__(self):
        name, unit = WORDS[self.field]
        size = ", ".join(f"{x:.2g}" for x in np.ravel(self.size))
        return f"{name} of about {size} {unit}"


def named(fields: Sequence[str]) -> str:
    """Errors of the record in words."""
    return ", ".join(WORDS[field][0] for field in fields)


def tested(
    model: Any,
    u: Float[np.ndarray, "N m"],
    y: Float[np.ndarray, "N p"],
    fitted: Sequence[str],
) -> tuple[str, ...]:
    """The errors of the record that a calibration looks for without fitting them."""
    if isinstance(model, AbstractMechanicalSystem):
        fields = ["delay"]
    elif isinstance(model, ModelPlant):
        fields = ["output_offset", *(["delay"] if u.shape[1] else [])]
    elif u.shape[1] == y.shape[1]:
        fields = list(CANDIDATES)
    else:
        fields = ["output_offset", "delay"]
    if "input_offset" in fitted and "output_offset" in fields:
        fields.remove("output_offset")  # an offset of either explains one of the other
    return tuple(field for field in fields if field not in fitted)


def places_of(search: Search, field: str) -> list[int]:
    """The places, among the unknowns, of an error of the record that is tested."""
    return [
        j
        for j, name in enumerate(search.problem.parameters.names)
        if j >= search.k and name.partition("[")[0] == field
    ]


def findings(scores: Sequence[Finding]) -> tuple[Finding, ...]:
    """Those of the `scores` that prediction errors show beyond doubt, the one that explains
    most first."""
    return tuple(sorted((f for f in scores if f.statistic > SURE), key=lambda f: -f.share))


def undecided(errors: int, scores: Sequence[Finding]) -> bool:
    """Whether an error of the record explains more of so many prediction `errors` than
    white ones allow, but not more than those do that are left: correlated as they are, the
    test decides nothing."""
    return any(f.share * errors / f.size.size > SURE >= f.statistic for f in scores)


def scored(search: Search, fields: Sequence[str]) -> tuple[Finding, ...]:
    """The score tests of the errors of the record among the `fields`.

    Source: the score test, Rao, 1948, doi:10.1017/S0305004100023987."""
    problem, e, k = search.problem, search.errors, search.k
    parameters = problem.parameters
    mean = float(np.mean(e**2))
    own, size = normalised(search.slopes[..., search.free].reshape(e.size, -1))
    prior = np.diag(search.prior * mean / size**2)
    inverse = np.linalg.pinv(own.T @ own + prior, rcond=1e-15, hermitian=True)
    found = []
    for field in fields:
        places = places_of(search, field)
        theirs = search.slopes[..., places].reshape(e.size, -1)
        share = inverse @ (own.T @ theirs)
        left = theirs - own @ share
        F = left.T @ left
        cover = np.linalg.pinv(F, rcond=1e-12, hermitian=True)
        there = -cover @ (left.T @ np.ravel(e))
        explained = float(there @ F @ there / np.sum(e**2))
        # The spread of the score where the finding is right, and its errors are gone.
        rest = e + (left @ there).reshape(e.shape)
        score = np.einsum("ngv,ng->nv", left.reshape(*e.shape, -1), rest)
        robust = cover @ spread(score, e.shape[0]) @ cover + mean * cover
        statistic = float(there @ np.linalg.pinv(robust, hermitian=True) @ there)
        units = parameters.scale[places] * there
        shift = (share @ there / size)[:k]
        found.append(Finding(field, units, statistic / len(places), explained, shift))
    return tuple(found)
