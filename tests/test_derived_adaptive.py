"""Unknown parameters of a model of one's own: the filter of its derived relation is that of
the same relation by hand."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from derivable import CASES
from test_adaptive import CURRENT, VOLTAGE, L, M, R, record
from test_derive_cli import run

import aslo_jax as aslo
from aslo_jax.derivation import derive
from aslo_jax.logs import write_table
from aslo_jax.machines import MachineError, read_machine

MODEL = f"""
import jax.numpy as jnp

import aslo_jax as aslo

pmsm = aslo.Model(
    f=lambda x, y, u, p: u - p["R"] * y,
    h=lambda x, y, u, p: [jnp.sum((x - p["L"] * y) ** 2) - p["m"] ** 2],
    states={{"a": (-0.15, 0.15), "b": (-0.15, 0.15)}},
    outputs={{"ia": (-6, 6), "ib": (-6, 6)}},
    inputs={{"ua": (-15, 15), "ub": (-15, 15)}},
    parameters={{"R": {1.1 * R}, "L": {L}, "m": {0.985 * M}}},
    units={{"R": "ohm", "a": "Wb", "b": "Wb", "ia": "A", "ib": "A"}},
)
"""
HEAD = '[machine]\nkind = "derived"\nmodel = "own:pmsm"\n[observer]\nkind = "adaptive"\n'
UNKNOWN = {"parameters": ("R", "m"), "deviations": (0.1, 0.02)}


def turning(t):
    return 90.0 + 30.0 * np.sin(20.0 * t), 1.5 + 0.9 * np.sin(33.0 * t)


@pytest.fixture(scope="module")
def log():
    return record(turning, 0.3, 5)


@pytest.fixture(scope="module")
def model():
    scope = {}
    exec(MODEL, scope)
    return scope["pmsm"]


@pytest.mark.slow
def test_it_is_the_filter_of_the_relation_by_hand(model, log):
    t, u, y, _ = log
    own = derive(model).adaptive_filter(CURRENT, VOLTAGE, **UNKNOWN, bank=5)
    relation = aslo.plants.FluxRelation(1.1 * R, L, 0.985 * M)
    by_hand = aslo.Adaptive(relation, CURRENT, VOLTAGE, bank=5)
    found: Any = None
    for method in (aslo.replay, aslo.smooth):
        found, other = method(own, t, u, y), method(by_hand, t, u, y)
        late = slice(t.size // 2, None)
        assert not found.coasting[late].any()
        for name in ("value", "covariance", "parameters", "parameter_covariance"):
            one, two = (np.asarray(getattr(e, name))[late] for e in (found, other))
            np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-9 * np.abs(two).max())
    assert abs(found.parameters[-1, 0] / R - 1.0) < 0.02


@pytest.mark.slow
def test_the_command_line_takes_it(model, log, tmp_path, capsys):
    t, u, y, flux = log
    (tmp_path / "own.py").write_text(MODEL)
    columns = {"t": t, "ua": u[:, 0], "ub": u[:, 1], "ia": y[:, 0], "ib": y[:, 1]}
    truth = {"a_true": flux[:, 0], "b_true": flux[:, 1]}
    write_table(tmp_path / "log.npz", columns | truth)
    head = (
        '[machine]\nkind = "derived"\nmodel = "own:pmsm"\n[observer]\nkind = "adaptive"\n'
    )
    keys = 'parameters = ["R", "m"]\ndeviations = [0.1, 0.02]\nbank = 5\n'
    (tmp_path / "own.toml").write_text(head + keys)
    files = tmp_path / "log.npz", "--machine", tmp_path / "own.toml"
    out = tmp_path / "out.npz"
    for options in ((), ("--smooth",)):
        code, printed, _ = run(capsys, "estimate", *files, "--out", out, *options)
        assert code == 0 and "derived: adaptive, unknown R and m, 1 substep" in printed
        with np.load(out) as file:
            table = dict(file)
        off = abs(table["R"][-1] - R)
        assert off < 4.0 * table["deviation_R"][-1] and off < 0.02 * R
        assert table["held"][-1] == 0 and table["coasting"][-1] == 0
        late = slice(t.size // 2, None)
        error = np.hypot(table["error_a"], table["error_b"])[late]
        claimed = np.hypot(table["deviation_a"], table["deviation_b"])[late]
        assert 0.3 < np.sqrt(np.mean(error**2)) / np.mean(claimed) < 2.0


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("", "`observer.parameters` must name what is not known"),
        ('parameters = ["Ld"]\ndeviations = [0.1]', "`Ld` is none of DerivedRelation"),
        ('parameters = ["R", "m"]\ndeviations = [0.1]', "must be one for each of"),
    ],
)
def test_parameters_that_the_model_does_not_have_are_refused(keys, message, tmp_path):
    (tmp_path / "own.py").write_text(MODEL)
    (tmp_path / "own.toml").write_text(HEAD + keys)
    with pytest.raises(MachineError, match=message):
        read_machine(tmp_path / "own.toml")


def test_a_relation_of_another_kind_is_refused_with_the_way_out(model):
    found = derive(CASES["dc_motor_from_speed"]().model)
    with pytest.raises(ValueError, match="name them in `unknown` of the model"):
        found.adaptive_filter(0.1, 0.1, parameters=("R",), deviations=(0.1,))
    fixed = derive(model)
    relation = dataclasses.replace(fixed.relation, parameters={}, fixed=(R, L, M))
    fixed = dataclasses.replace(fixed, relation=relation)
    with pytest.raises(ValueError, match="present values of the model's alone"):
        fixed.adaptive_filter(0.1, 0.1, parameters=("R",), deviations=(0.1,))
