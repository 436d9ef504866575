"""Errors of the record fitted one at a time, where a parameter enters nonlinearly: there
another value of it hides an error from a score test, which is of first order.

Without direct current a voltage that is a sample late is such an error of a motor: an
inductance some 30 % too large explains it almost, and the slopes there are not those at the
true one. Fitted, with all else free, it is found.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from .adequacy import Finding, places_of
from .information import information
from .profile import Profile
from .search import Search

# Standard deviations of errors of a record as one meets them, in their sizes (`sizes_of`):
# 2 % of the outputs, 5 % of the inputs, one and a half samples.
PLAUSIBLE = {"output_offset": 0.02, "dead_time": 0.05, "delay": 0.5}
# Of the statistic of a fit: five deviations. What is small in a right record, as that a
# held voltage bends a current, may look like a delay along thousands of rows: four of them.
CERTAIN = 25.0
NOTABLE = 0.1  # of a half width, by which an error widens an interval
# Of a parameter's logarithm: what a fit has for its interval is of first order, and says
# nothing of one that enters nonlinearly over more than that.
STRAIGHT = 0.1


@dataclasses.dataclass(frozen=True)
class Alternative:
    """What a calibration finds with one error of the record fitted too.

    - `finding`: that error, its statistic that of the likelihood ratio;
    - `place`: of the parameters, relative to where they started, shape `(k,)`;
    - `deviation`: their standard deviations, shape `(k,)`;
    - `doubt`: what is not known of their pull, shape `(k,)`.
    """

    finding: Finding
    place: Float[np.ndarray, " k"]
    deviation: Float[np.ndarray, " k"]
    doubt: Float[np.ndarray, " k"]


def alternatives(
    search: Search, v: Float[np.ndarray, " v"], fields: Sequence[str]
) -> tuple[Alternative, ...]:
    """One of each of the `fields`, from the unknowns `v` that the search has found."""
    return tuple(_alternative(search, v, field) for field in fields)


def _alternative(search: Search, v: Float[np.ndarray, " v"], field: str) -> Alternative:
    k, places = search.k, places_of(search, field)
    other, (there, known) = search.beside(v, places, PLAUSIBLE[field])
    found = k + len(places)
    own = other.slopes[..., other.free]
    inflation = information(other.errors, own, found, other.prior).inflation[k:]
    before, after = (float(np.sum(e**2)) for e in (search.errors, other.errors))
    ratio = max(before - after, 0.0) / (after / other.errors.size)
    finding = Finding(
        field=field,
        size=search.problem.parameters.scale[places] * there[places],
        statistic=ratio / len(places) / float(np.max(inflation)),
        share=max(before - after, 0.0) / before,
        shift=(v - there)[:k],
    )
    return Alternative(finding, there[:k], known.deviation, other.doubtful(known))


def together(
    findings: Sequence[Finding], others: Sequence[Alternative]
) -> tuple[Finding, ...]:
    """What score tests have found and what fits have, which know the sizes better; the one
    that explains most first."""
    found = {f.field: f for f in findings}
    found |= {a.finding.field: a.finding for a in others if a.finding.statistic > CERTAIN}
    return tuple(sorted(found.values(), key=lambda f: -f.share))


def widened(
    profiles: Sequence[Profile], others: Sequence[Alternative], confidence: float
) -> list[Profile]:
    """The profiles with intervals that hold whichever one of the alternatives is right, or
    none of them; without ends where an alternative cannot tell them."""
    from scipy.special import chdtri  # heavy to import

    # As of a profile where that of another parameter is no parabola.
    factor = float(np.sqrt(chdtri(2, 1.0 - confidence)))
    found = []
    for j, profile in enumerate(profiles):
        low, high, allowed = profile.low, profile.high, []
        for other in others:
            reach = factor * other.deviation[j] + other.doubt[j]
            reach = reach if reach < STRAIGHT else np.inf
            ends = float(other.place[j] - reach), float(other.place[j] + reach)
            notable = 0.5 * NOTABLE * (profile.high - profile.low)
            if ends[0] < profile.low - notable or ends[1] > profile.high + notable:
                allowed.append(other.finding.field)
            low, high = min(low, ends[0]), max(high, ends[1])
        found.append(
            dataclasses.replace(profile, low=low, high=high, allowed=tuple(allowed))
        )
    return found
