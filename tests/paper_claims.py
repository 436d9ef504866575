"""The verdicts on claims of the paper, and runs in which an observer is exchanged."""

import equinox as eqx


def verdicts(claims):
    """By name, the first word of each."""
    return {c.name: c.verdict.split(":")[0] for c in claims}


def kind(claims, verdict):
    """The names of the claims of one verdict."""
    return {name for name, found in verdicts(claims).items() if found == verdict}


def replaced(run, estimates):
    """The run with other estimates."""
    return eqx.tree_at(lambda run: run.estimates, run, run.estimates | estimates)
