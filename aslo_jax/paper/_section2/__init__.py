"""Section 2 of the paper, from its experiments to its files."""

from .._claims import Claim
from .._section import Section
from . import figures, simulations, systems, theory
from .experiments import Printed, member
from .runs import Runs, run_all

NOTES = (
    "The double integrator x1' = x2, x2' = u, y = x1 and its chain. The paper gives no "
    "units; here x1 is in m, x2 in m/s, u in m/s^2, gains in rad/s. An error is the "
    "estimate less the true x2. In names, `exact` marks the library's exact start; the "
    "others start as printed, at zero."
)


def claims(runs: Runs) -> list[Claim]:
    """Every claim of the section, in the order of the paper."""
    fourth, fifth = (member(runs.chains[n], 0) for n in (4, 5))
    return [
        *theory.identity(runs.scenarios),
        *theory.corollary(runs.transients, runs.gains, runs.scenarios),
        *systems.other_filters(runs.printed),
        *systems.realisations(runs.printed),
        *theory.chains(fourth, fifth),
        *theory.biases(runs.scenarios, member(runs.chains[4], 1)),
        *simulations.figure1(runs.transients, runs.gains),
        *simulations.figure2(runs.noise, runs.printed),
        *simulations.figure3(runs.parasitics),
    ]


SECTION = Section(
    number=2,
    notes=NOTES,
    printed=Printed(),
    run=run_all,
    figures=(
        figures.transients,
        figures.noise,
        figures.parasitics,
        figures.exact_start,
        figures.input_bias,
        figures.noise_variance,
    ),
    claims=claims,
)
