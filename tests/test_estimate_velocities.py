"""One Kalman filter of all velocities of a mechanism through the command line."""

import numpy as np
import pytest
from test_estimate_mechanical import CASES, bare, encoded, estimates, run

# Steps of 2 m and of a turn, 4096 of them, over sqrt(12).
NOISE = "output_deviation = [1.41e-4, 4.43e-4, 4.43e-4]\ninput_deviation = 1e-3"
LIFTED = f'kind = "lifted_kalman"\n{NOISE}'
NAMES = ("qdot1", "qdot2", "qdot3")


def errors(table, log, since):
    rows = log["t"] > since
    return np.stack([(table[n] - log[f"{n}_true"])[rows] for n in NAMES], axis=1)


@pytest.fixture(scope="module")
def log():
    case = CASES["leg"]
    return encoded(case.log(), case.angles)


@pytest.fixture(scope="module")
def filtered(log, tmp_path_factory):
    folder = tmp_path_factory.mktemp("leg")
    CASES["leg"].write(folder, LIFTED)
    return estimates(folder, log)


def test_the_filter_is_better_than_the_stages_and_knows_by_how_much(
    log, filtered, tmp_path
):
    CASES["leg"].write(tmp_path)
    staged = estimates(tmp_path, log)
    assert not any(name.startswith("deviation") for name in staged)
    since = 0.5 * log["t"][-1]
    one, other = errors(filtered, log, since), errors(staged, log, since)
    assert np.sqrt(np.mean(one**2)) < 0.3 * np.sqrt(np.mean(other**2))
    claimed = np.stack([filtered[f"deviation_{n}"] for n in NAMES], axis=1)
    assert 0.2 < np.mean((one / claimed[log["t"] > since]) ** 2) < 3.0
    np.testing.assert_allclose(
        filtered["error_qdot2"], filtered["qdot2"] - log["qdot2_true"], atol=1e-12
    )
    for name in NAMES:  # they are certified together
        np.testing.assert_array_equal(
            filtered[f"coasting_{name}"], filtered["coasting_qdot1"]
        )
    assert filtered["coasting_qdot1"][0] == 1 and filtered["coasting_qdot1"][-1] == 0


def test_it_finds_what_is_not_known_and_says_so(log, filtered, tmp_path, capsys):
    adaptive = (
        f'kind = "adaptive"\n{NOISE}\nparameters = ["m1", "damping"]\n'
        "deviations = [0.3, 0.2]"
    )
    CASES["leg"].write(tmp_path, LIFTED, m1="2.3", damping="[0.4, 0.1, 0.45]")
    wrong = estimates(tmp_path, log)
    assert wrong["coasting_qdot1"][-1] == 1  # the model does not fit
    CASES["leg"].write(tmp_path, adaptive, m1="2.3", damping="[0.4, 0.1, 0.45]")
    code, out, _ = run(capsys, tmp_path, bare(log))
    assert code == 0
    assert "robotic_leg: adaptive, unknown m1 and damping, 1 substep\n" in out
    assert "output_deviation 0.000141, 0.000443 m, rad\n" in out
    with np.load(tmp_path / "out.npz") as file:
        table = dict(file)
    truth = {"m1": 2.0, "damping_1": 0.3, "damping_2": 0.2, "damping_3": 0.5}
    for name, true in truth.items():
        off = abs(table[name][-1] - true)
        assert off < 5.0 * table[f"deviation_{name}"][-1] + 2e-3, name
        assert off < 0.3 * abs(table[name][0] - true), name
    assert table["held"][0] == 1 and table["held"][-1] == 0
    since = 0.5 * log["t"][-1]
    best = np.sqrt(np.mean(errors(filtered, log, since) ** 2))
    assert np.sqrt(np.mean(errors(table, log, since) ** 2)) < 3.0 * best


@pytest.mark.parametrize(
    ("observer", "message"),
    [
        ('kind = "lifted_kalman"', "`observer.output_deviation` must be given"),
        (f"{LIFTED}\ncutoff = 30.0", "`observer.cutoff` has no effect"),
        ("force_deviation = 1.0", '`observer.force_deviation` is for `observer.kind = "l'),
        ("output_deviation = 1e-4", "`observer.output_deviation` is for `observer.kind"),
        (f'kind = "adaptive"\n{NOISE}', "`observer.parameters` must name"),
        (
            f'kind = "adaptive"\n{NOISE}\nparameters = ["m1"]\ndeviations = [0.1, 0.2]',
            "`observer.deviations` must have one entry for each",
        ),
        (
            f'kind = "adaptive"\n{NOISE}\nparameters = ["m7"]\ndeviations = [0.1]',
            "`m7` is none of RoboticLeg",
        ),
        (f"{LIFTED}\nbank = 5", "unknown key `observer.bank`"),
    ],
)
def test_keys_that_do_not_go_together_are_refused(observer, message, log, tmp_path, capsys):
    CASES["leg"].write(tmp_path, observer)
    code, _, err = run(capsys, tmp_path, log)
    assert code and message in err


def test_it_is_not_smoothed_and_says_so(log, tmp_path, capsys):
    CASES["leg"].write(tmp_path, LIFTED)
    code, _, err = run(capsys, tmp_path, log, "--smooth")
    assert code and "this is one of all velocities of a mechanism" in err
    CASES["leg"].write(tmp_path)
    code, _, err = run(capsys, tmp_path, log, "--smooth")
    assert code and "--smooth is for an `observer.kind` of" in err


@pytest.mark.slow
def test_of_a_system_in_python(tmp_path):
    case = CASES["crane"]
    log = encoded(case.log(), case.angles)
    case.write(tmp_path, LIFTED.replace("1e-3", "0.01"))
    table = estimates(tmp_path, log)
    assert np.sqrt(np.mean(errors(table, log, 0.5 * log["t"][-1]) ** 2)) < 0.02
