"""Section 2 of the paper, from its experiments to its files."""

from .._claims import Claim
from .._report import files
from . import figures, simulations, systems, theory
from .experiments import Printed, Runs, member, run_all

NOTES = (
    "The double integrator x1' = x2, x2' = u, y = x1 and its chain. The paper gives no "
    "units; here x1 is in m, x2 in m/s, u in m/s^2, gains in rad/s. An error is the "
    "estimate less the true x2. In names, `exact` marks the library's exact start; the "
    "others start as printed, at zero."
)


def claims(runs: Runs, printed: Printed) -> list[Claim]:
    """Every claim of the section, in the order of the paper."""
    fourth, fifth = (member(runs.chains[n], 0) for n in (4, 5))
    return [
        *theory.identity(runs.scenarios),
        *theory.corollary(runs.transients, runs.gains, runs.scenarios),
        *systems.other_filters(printed),
        *systems.realisations(printed),
        *theory.chains(fourth, fifth),
        *theory.biases(runs.scenarios, member(runs.chains[4], 1)),
        *simulations.figure1(runs.transients, runs.gains),
        *simulations.figure2(runs.noise, printed),
        *simulations.figure3(runs.parasitics),
    ]


def report() -> tuple[dict[str, bytes], str]:
    """The files of the section by name, and a table for the terminal."""
    printed = Printed()
    runs = run_all(printed)
    drawn = [
        figures.transients(runs),
        figures.noise(runs, printed),
        figures.parasitics(runs),
        figures.exact_start(runs),
        figures.input_bias(runs),
        figures.noise_variance(printed),
    ]
    return files("Section 2 of the paper", NOTES, drawn, claims(runs, printed))
