"""Claims of ours on the sampled comparison: the ASLO beside tuned peers."""

import numpy as np

from .._claims import Above, Below, Claim
from .tuning import ASLO, DIFFERENTIATORS, Comparison, Tuned

PLACE = "ours, on section 4"


def best_differentiator(tuned: dict[str, Tuned], coordinate: int) -> tuple[str, float]:
    """The model-free contender with the least rms error of a coordinate, and that error."""
    found = {
        name: float(tuned[name].total[coordinate])
        for name in DIFFERENTIATORS
        if name in tuned
    }
    name = min(found, key=lambda name: found[name])
    return name, found[name]


def ratios(tuned: dict[str, Tuned], name: str = ASLO) -> np.ndarray:
    """The rms error of a contender over that of the best differentiator, shape (n,)."""
    errors = tuned[name].total
    return np.array([x / best_differentiator(tuned, j)[1] for j, x in enumerate(errors)])


def claims(compared: dict[str, Comparison]) -> list[Claim]:
    """The ASLO against the best differentiator, coordinate by coordinate with 16 bit, and
    where it is worst in the other cases; and against the extended Kalman filter."""
    return [
        *(
            claim
            for name, each in compared.items()
            for claim in [*_by_coordinate(name, each), *_other_cases(name, each)]
        ),
        *(claim for name, each in compared.items() for claim in _kalman(name, each)),
    ]


def _by_coordinate(mechanism: str, each: Comparison) -> list[Claim]:
    tuned = each.tuned["16 bit"]
    found = []
    for j, ratio in enumerate(ratios(tuned)):
        name, error = best_differentiator(tuned, j)
        unit = each.mechanism.units[j]
        found.append(
            Claim(
                f"{mechanism}, q{j + 1}', 16 bit",
                PLACE,
                "Tuned alike, the ASLO is no worse than the best differentiator without a "
                f"model, here {name}.",
                "rms error over that of the best differentiator, the same records",
                float(ratio),
                "",
                Below(1.0),
                Above(1.0),
                f"it is {ratio:.3g} times as large",
                f"{tuned[ASLO].total[j]:.3g} against {error:.3g} {unit}.",
            )
        )
    return found


def _other_cases(mechanism: str, each: Comparison) -> list[Claim]:
    found = []
    for case, tuned in each.tuned.items():
        if case == "16 bit":
            continue
        each_ratio = ratios(tuned)
        found.append(
            Claim(
                f"{mechanism}, {case}",
                PLACE,
                "Tuned alike, the ASLO is no worse than the best differentiator without a "
                "model.",
                "largest ratio of rms errors of a coordinate",
                float(each_ratio.max()),
                "",
                Below(1.0),
                Above(1.0),
                f"it is up to {each_ratio.max():.3g} times as large",
                "Ratios of "
                + ", ".join(f"q{j + 1}' {x:.2g}" for j, x in enumerate(each_ratio))
                + ".",
            )
        )
    return found


def _kalman(mechanism: str, each: Comparison) -> list[Claim]:
    if any("extended Kalman" not in tuned for tuned in each.tuned.values()):
        return []

    def ratio(case):
        tuned = each.tuned[case]
        return float((tuned[ASLO].total / tuned["extended Kalman"].total).max())

    wrong = ratio("16 bit, 5 % wrong")
    return [
        Claim(
            f"{mechanism}, ASLO and extended Kalman",
            PLACE,
            "Tuned alike, the ASLO is no worse than the extended Kalman filter.",
            "largest ratio of rms errors of a coordinate, 16 bit",
            ratio("16 bit"),
            "",
            Below(1.0),
            Above(1.0),
            "the extended Kalman filter has the smaller error wherever the model is right",
            f"With 5 % wrong parameters the largest ratio is {wrong:.2g}.",
        )
    ]
