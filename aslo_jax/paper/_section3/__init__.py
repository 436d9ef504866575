"""Section 3 of the paper, from its experiments to its files."""

from .._claims import Claim
from .._section import Section
from . import comparison_claims, figures, flux_claims, machine_claims, machine_figures
from .runs import Runs, run_all
from .settings import Printed
from .settling import table

NOTES = (
    "Electrical machines: the surface-mounted PMSM of Table 1 (BMP0701F) in a closed loop, "
    "the wound-rotor induction machine, the interior PMSM, the stepper, and the magnetic "
    "bearing. Fluxes are in Wb; an error is the estimate less the truth, its size the "
    "Euclidean norm. The torque of the PMSM has the factor 3/2 of the amplitude-invariant "
    "convention, since the paper's load of up to 3.5 N m takes 3.36 A with the torque as "
    "printed and 2.24 A with 3/2, and Table 1 allows 2.3 A. The speed controller is a PI "
    "with the measured angle and speed in place of the paper's PLL; the motor starts at "
    "rest, without current, at angle zero. The paper does not print its initial "
    "conditions. Observers start as printed, every filter and estimate at zero, unless a "
    "name says `exact`. The A-ASLO with the printed start is frozen where the certificate "
    "is below 1e-6, as the footnote of Prop. 2 permits: its correction is not integrable "
    "where Delta crosses zero."
)


def claims(runs: Runs) -> list[Claim]:
    """Every claim of the section, in the order of the paper."""
    return [
        *flux_claims.proposition(runs.closed),
        *flux_claims.asymptotic(runs.closed),
        *flux_claims.determinant(runs.closed, runs.steady, runs.reversal),
        *comparison_claims.comparison(runs.closed, runs.growth),
        *comparison_claims.drive(runs.closed),
        *machine_claims.claims(runs),
    ]


SECTION = Section(
    number=3,
    notes=NOTES,
    printed=Printed(),
    run=run_all,
    figures=(
        figures.flux_errors,
        figures.exact_start,
        figures.reversal,
        machine_figures.wrim,
        machine_figures.interior_pmsm,
        machine_figures.bearing,
    ),
    claims=claims,
    tables=(table,),
)
