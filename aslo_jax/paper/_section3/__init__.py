"""Section 3 of the paper, from its experiments to its files."""

from .._claims import Claim
from .._report import files
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


def claims(runs: Runs, printed: Printed) -> list[Claim]:
    """Every claim of the section, in the order of the paper."""
    return [
        *flux_claims.proposition(runs.closed),
        *flux_claims.asymptotic(runs.closed),
        *flux_claims.determinant(runs.closed, runs.steady, runs.reversal),
        *comparison_claims.comparison(runs.closed, runs.growth),
        *comparison_claims.drive(runs.closed),
        *machine_claims.claims(runs, printed),
    ]


def report() -> tuple[dict[str, bytes], str]:
    """The files of the section by name, and a table for the terminal."""
    printed = Printed()
    runs = run_all(printed)
    drawn = [
        figures.flux_errors(runs),
        figures.exact_start(runs),
        figures.reversal(runs),
        machine_figures.wrim(runs),
        machine_figures.interior_pmsm(runs),
        machine_figures.bearing(runs),
    ]
    title = "Section 3 of the paper"
    return files(title, NOTES, drawn, claims(runs, printed), [table(runs)])
