"""Columns are found by name and unit; what is doubtful is refused with options to paste."""

import math
import shlex

import numpy as np
import pytest

from aslo_jax.logs import Frame, Log, LogError, LogReader, Signals, read_log
from aslo_jax.logs._memory import in_memory

ROWS = 12
K = np.arange(ROWS)
HERE = {
    "t": 1e-3 * K,
    "u_alpha": 1.0 + K,
    "u_beta": 2.0 - K,
    "i_alpha": 3.0 + np.sin(K),
    "i_beta": 4.0 * np.cos(K),
}


def renamed(**names: str) -> dict[str, np.ndarray]:
    """The columns here by other names."""
    return {names.get(name, name): x for name, x in HERE.items()}


def refusal(data, *args, **options) -> str:
    with pytest.raises(LogError) as error:
        Log.from_columns(data, *args, **options)
    return str(error.value)


def assert_same(log: Log, rtol: float = 1e-15):
    found = np.column_stack([log.t, log.u, log.y])
    np.testing.assert_allclose(found, np.column_stack(list(HERE.values())), rtol=rtol)


@pytest.mark.parametrize(
    ("ours", "theirs", "factor"),
    [
        ("t", "Time [ms]", 1e3),
        ("t", "time (µs)", 1e6),
        ("t", "Zeit in ms", 1e3),
        ("t", "t/ns", 1e9),
        ("t", "Time_ms", 1e3),
        ("t", "TIME", 1.0),
        ("u_alpha", "Ualpha (mV)", 1e3),
        ("u_alpha", "v_alpha", 1.0),
        ("u_alpha", "Us_α [V]", 1.0),
        ("u_beta", "V_beta [kV]", 1e-3),
        ("i_alpha", "I_alpha/A", 1.0),
        ("i_alpha", "Ialpha [mA]", 1e3),
        ("i_beta", "log.motor.i_beta [A]", 1.0),
        ("i_beta", "stator current beta (Amps)", 1.0),
    ],
)
def test_names_and_units_are_recognised(ours, theirs, factor):
    data = renamed(**{ours: theirs})
    data[theirs] = factor * data[theirs]
    assert_same(Log.from_columns(data), rtol=1e-14)


@pytest.mark.parametrize(
    ("theirs", "ours", "factor"),
    [
        ("theta_e [deg]", "theta_electrical", math.pi / 180.0),
        ("electrical angle (rad)", "theta_electrical", 1.0),
        ("theta_el [rev]", "theta_electrical", 2.0 * math.pi),
        ("omega_e", "omega_electrical", 1.0),
        ("we [Hz]", "omega_electrical", 2.0 * math.pi),
        ("n [rpm]", "omega_mechanical", math.pi / 30.0),
        ("speed (1/min)", "omega_mechanical", math.pi / 30.0),
        ("omega_m [deg/s]", "omega_mechanical", math.pi / 180.0),
        ("psi_alpha [mVs]", "flux_alpha", 1e-3),
        ("flux_beta [Wb]", "flux_beta", 1.0),
    ],
)
def test_truth_is_recognised_and_converted(theirs, ours, factor):
    log = Log.from_columns(HERE | {theirs: 5.0 + K})
    assert list(log.truth) == [ours]
    np.testing.assert_allclose(log.truth[ours], factor * (5.0 + K), rtol=1e-14)


@pytest.mark.parametrize(
    "name", ["i_alpha_ref", "Id", "speed", "n", "theta", "u_ab", "flux", "T [degC]"]
)
def test_what_is_something_else_is_left_alone(name):
    assert_same(Log.from_columns(HERE | {name: K}))
    assert not Log.from_columns(HERE | {name: K}).truth


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [
        ("u_alpha", "u_alpha [A]", "is in A, but `u_alpha` is a voltage (V)"),
        ("u_alpha", "u_alpha [p.u.]", "is without a unit (`p.u.`), but `u_alpha` is a"),
        ("i_alpha", "i_alpha [counts]", "is in counts, but `i_alpha` is a current (A)"),
        ("i_alpha", "i_alpha [zorks]", "is in `zorks`, which is not a unit that is known"),
        ("i_alpha", "i_alpha (measured)", "is in `measured`, which is not a unit"),
        ("t", "t [S]", "is in S, but `t` is a time (s)"),
        ("t", "t [rad]", "is in rad, but `t` is a time (s)"),
    ],
)
def test_a_unit_of_another_quantity_is_refused(ours, theirs, expected):
    message = refusal(renamed(**{ours: theirs}))
    assert f"column `{theirs}`, read as `{ours}`, {expected}" in message
    option = shlex.split(message[message.index("--column") :])[1]
    name, _, text = option.partition("=")  # pasted, it is taken as it stands
    assert_same(Log.from_columns(renamed(**{ours: theirs}), columns={name: text}))


@pytest.mark.parametrize("unit", ["m", "%", "1/s", "V", "s"])
def test_speeds_are_in_angles_and_turns_alone(unit):
    message = refusal(HERE | {f"omega_m [{unit}]": K})
    assert f"column `omega_m [{unit}]`, read as `omega_mechanical`" in message
    if unit == "1/s":
        assert "which may be rad/s or turns a second" in message


def test_generalised_coordinates_have_either_of_two_units():
    signals = Signals(("u1",), ("q1", "q2"), truth=("qdot2_true",))
    data = {
        "t": K,
        "u1 [mNm]": 1e3 + K,
        "q1 [mm]": 5.0 * K,
        "q2 [deg]": 180.0 + K,
        "qdot2_true [rpm]": 30.0 * K,
    }
    log = Log.from_columns(data, signals)
    np.testing.assert_allclose(log.u[:, 0], 1.0 + 1e-3 * K)
    np.testing.assert_allclose(log.y[:, 0], 5e-3 * K)
    np.testing.assert_allclose(log.y[:, 1], np.pi * (1.0 + K / 180.0))
    np.testing.assert_allclose(log.truth["qdot2_true"], np.pi * K)
    assert "is a force (N) or a torque (N m)" in refusal(
        {"t": K, "u1 [V]": K, "q1": K, "q2": K}, signals
    )


def test_expressions_are_over_columns_as_they_are():
    data = {
        "Time [ms]": 2.0 * K,
        "a b": K,
        "u_beta": 2.0 - K,
        "x": 0.5 + 0.0 * K,
        "i_beta": HERE["i_beta"],
    }
    given = {
        "t": "`Time [ms]`*1e-3/2",
        "u_alpha": "1 + `a b`",
        "i_alpha": "-(-3) + sin(`a b`*pi/pi)**1*(x+x)/sqrt(4*x*x)",
    }
    assert_same(Log.from_columns(data, columns=given), rtol=1e-14)
    assert_same(Log.from_columns(data, columns=given | {"t": "Time*0.5e-3"}), rtol=1e-14)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('x')*1",
        "u_alpha().real*1",
        "(1.5).real*u_alpha",
        "`u_alpha`.real*1",
        "(lambda: 1)()*u_alpha",
        "[u_alpha][0]*1",
        "u_alpha if 1 else u_beta+1",
        "u_alpha*True",
        "u_alpha*1j",
        "u_alpha*'a'",
        "eval(u_alpha)",
        "sin(u_alpha, u_beta)",
        "u_alpha*(",
        "u_alpha @ u_beta*1",
        "1" + "0" * 400 + "*u_alpha",
        "(" * 300 + "u_alpha" + ")" * 300 + "*1",
        "u_alpha" + "+1" * 400,
    ],
)
def test_expressions_run_no_code(text):
    assert "is not an arithmetic expression over columns" in refusal(
        HERE, columns={"u_beta": text}
    )


def test_expressions_name_columns_that_are_there():
    message = refusal(HERE, columns={"u_beta": "2*volts"})
    assert "--column 'u_beta=2*volts': the mapping has no column `volts`" in message
    assert "names no column of the mapping" in refusal(HERE, columns={"u_beta": "2*pi"})
    message = refusal(HERE, columns={"u_beta": "u_alpha/(u_alpha-4)"})
    assert (
        "row 3 (counted from 0), column `u_alpha/(u_alpha-4)`: the value is inf" in message
    )


def test_expressions_name_fields_of_structs():
    data = renamed(t="log.t [ms]", u_beta="log.drive.u_b", i_beta="y.i b")
    data["log.t [ms]"] = 1e3 * HERE["t"]
    given = {
        "t": "log.t*1e-3",
        "u_beta": "-(-log.drive.u_b)",
        "i_beta": "`y.i b`*1",
    }
    assert_same(Log.from_columns(data, columns=given), rtol=1e-13)
    message = refusal(data, columns=given | {"t": "log.tt*1e-3"})
    assert "has no column `log.tt`; its columns: `log.t [ms]`" in message


def test_an_angle_is_never_offered_for_a_voltage():
    data = renamed(u_alpha="theta_alpha", u_beta="currentbeta", t="uptime")
    message = refusal(data)
    assert "no columns `t`, `u_alpha`, `u_beta`" in message
    assert "t=uptime" in message
    assert "u_alpha=" not in message and "u_beta=" not in message


def test_two_columns_that_fit_are_named():
    data = renamed(t="Time [s]") | {"time [ms]": 1e3 * HERE["t"]}
    message = refusal(data)
    assert "`Time [s]` and `time [ms]`, each of which may be `t`" in message
    options = shlex.split(message[message.index("--column") :].replace(" or ", " "))
    assert_same(Log.from_columns(data, columns=dict([options[1].split("=")])))
    log = Log.from_columns(HERE | {"theta_e": K, "theta_el": K})
    assert not log.truth


def test_a_file_says_what_was_read(tmp_path):
    from aslo_jax.logs import LogReader

    rows = "\n".join(f"{k},{k},1,2,{k}" for k in range(3))
    (tmp_path / "log.csv").write_text(f"t [ms],u_alpha,u_beta,Ialpha,i_beta\n{rows}\n")
    said = LogReader(tmp_path / "log.csv").said
    assert said == ("read: t from `t [ms]` times 0.001, i_alpha from `Ialpha`",)
    assert read_log(tmp_path / "log.csv").t[-1] == 2e-3


def test_frames_are_suggested():
    dq = {"t": K, "Vd": K, "Vq": K, "id": K, "iq": K, "theta [rad]": K}
    assert "--frame dq --angle 'theta [rad]'" in refusal(dq)
    abc = {"t": K} | {f"{x}{y}": K for x in "ui" for y in "abc"}
    assert "--frame abc" in refusal(abc)
    assert "--frame alpha-beta" in refusal(HERE, frame="abc")
    assert "--frame dq" in refusal(dq, frame=Frame("abc"))


def test_truth_that_may_be_either_of_two_columns_is_not_read_and_said():
    there = HERE | {"theta_e": 0.1 * K, "theta_el": 0.2 * K}
    reader = LogReader(in_memory(there))
    assert reader.truth == ()
    (line,) = reader.unread
    assert line in reader.said
    assert "`theta_e` and `theta_el`, each of which may be `theta_electrical`" in line
    options = shlex.split(line.partition("say which: ")[2].replace(" or ", " "))[1::2]
    for option, column in zip(options, ("theta_e", "theta_el"), strict=True):
        name, _, given = option.partition("=")
        log = Log.from_columns(there, columns={name: given})
        np.testing.assert_array_equal(log.truth["theta_electrical"], there[column])
    assert LogReader(in_memory(there), truth=False).unread == ()
    assert LogReader(in_memory(HERE | {"theta_e": 0.1 * K})).unread == ()
