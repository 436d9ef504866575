"""Section 4 of the paper, from its experiments to its files."""

from .._claims import Claim
from .._section import Section
from . import (
    comparison_claims,
    comparison_figures,
    figures,
    friction_claims,
    identity_claims,
    records,
    tables,
    tuning,
)
from .runs import Runs, run_all
from .settings import Printed

NOTES = (
    "Mechanical systems: the robotic leg (m1 = 2 kg, m2 = 3 kg m^2) and the ball and beam "
    "(length 1.2 m, gravity 9.81 m/s^2) in closed loop under tracking controllers that are "
    "fed the true positions and velocities, so that no observer has a part in the motion. "
    "The paper prints no numbers and no figures for this section; all are ours. In "
    "continuous time lambda = 5 rad/s. Sampled at 1 kHz, every contender has one gain for "
    "each coordinate, found by the same search (Sobol points of the logarithms, "
    f"{tuning.ROUNDS} rounds of {tuning.TRIALS} trials on {records.TRAINING} records) and "
    f"measured on {records.VALIDATION} other records, from other first states. Angles have "
    "encoders of one turn over 2^bits; lengths of 2 m (leg) and 1.2 m (ball) over 2^bits. "
    "The box of every bandwidth is 0.3 to 1000 rad/s, of the bound of super-twisting 0.1 "
    "to 300; gains at 0.3 rad/s are at the edge of it, since an exact model is best "
    "trusted for longer than a record. The extended Kalman filter is tuned by (W/V)^(1/4) "
    "of each coordinate, since its steady gain depends on these ratios alone."
)


def claims(runs: Runs) -> list[Claim]:
    """Every claim of the section, in the order of the paper."""
    return [
        *identity_claims.proposition4(runs.leg),
        *identity_claims.asymptotic("leg", "4.1, Prop. 4, P2", runs.leg),
        *identity_claims.proposition5(runs.ball),
        *identity_claims.asymptotic("ball", "4.2, Prop. 5, P2", runs.ball),
        *friction_claims.claims(runs.constant, runs.varying),
        *comparison_claims.claims(runs.compared),
    ]


SECTION = Section(
    number=4,
    notes=NOTES,
    printed=Printed(),
    run=run_all,
    figures=(
        figures.identities,
        figures.proposition4,
        figures.friction,
        comparison_figures.peers,
        comparison_figures.tuned,
        comparison_figures.model_errors,
    ),
    claims=claims,
    tables=(tables.settling, tables.comparison, tables.contenders),
)
