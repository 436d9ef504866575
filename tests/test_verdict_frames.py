"""The verdict on logs that were read in dq or abc: their own causes, in their own names."""

import dataclasses

import numpy as np
import pytest
from motor_logs import MOTORS, estimated, noisy, run

from aslo_jax.diagnosis import diagnose
from aslo_jax.frames import clarke
from aslo_jax.logs import Frame, Log

BY_NAME = {motor.name: motor for motor in MOTORS}
DQ = {"u_d": "Vd [V]", "u_q": "Vq", "i_d": "Id", "i_q": "Iq", "angle": "theta"}
slow = lambda *values: [pytest.param(v, marks=pytest.mark.slow) for v in values]


def in_dq(motor, profile="rich", held=False):
    """u and i in dq, and the electrical angle; u `held` in dq over its interval."""
    log = noisy(run(motor, profile), motor, 4, 0.005)
    angle = log["angle"]
    middle = angle + (0.5 * np.gradient(angle) if held else 0.0)
    return log["t"], log["u"] * np.exp(-1j * middle), log["i"] * np.exp(-1j * angle), angle


def found(motor, t, u, i, column, scale=1.0, pole_pairs=None):
    """The diagnosis of dq signals that are turned by an angle `column`, electrical, or of
    so many pole pairs."""
    angle = scale * column
    pair = lambda z: np.stack([z.real, z.imag], axis=1)
    turn = np.exp(1j * angle)
    log = Log(t, pair(u * turn), pair(i * turn), {}, angle)
    kind = None if scale == 1.0 else "mechanical"
    frame = Frame("dq", "theta", kind, pole_pairs or motor.pole_pairs)
    return diagnose(log, [motor.circle().read_from(frame, DQ)])


def wrapped(angle, turn=2 * np.pi):
    return angle % turn


# Of voltage, current, angle and motor: what is read, with other arguments of `found`.
WRONG = {
    "q_sign": lambda u, i, a, m: ((u, i.conj(), a), {}),
    "d_sign": lambda u, i, a, m: ((u, -i.conj(), a), {}),
    "dq_swapped": lambda u, i, a, m: ((1j * u.conj(), 1j * i.conj(), a), {}),
    "angle_sign": lambda u, i, a, m: ((u, i, -a), {}),
    "angle_kind": lambda u, i, a, m: ((u, i, wrapped(a / m.pole_pairs)), {}),
    "pole_pairs": lambda u, i, a, m: (
        (u, i, wrapped(a / m.pole_pairs)),
        {"scale": m.pole_pairs + 2.0, "pole_pairs": m.pole_pairs + 2},
    ),
    "angle_unit": lambda u, i, a, m: ((u, i, np.degrees(wrapped(a))), {}),
    "sign": lambda u, i, a, m: ((u, -i, a), {}),
    "axes_turned": lambda u, i, a, m: ((u, 1j * i, a), {}),
}


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("profile", ["rich", "load", "constant", *slow("start", "steps")])
@pytest.mark.parametrize("name", ["traction", *slow("drone", "salient", "stepper")])
def test_right_logs_in_dq_pass_in_silence(name, profile, held):
    """But for a d axis that is another one. Of voltages held in dq at most the timing is
    told."""
    motor = BY_NAME[name]
    t, u, i, angle = in_dq(motor, profile, held)
    right = found(motor, t, u, i, wrapped(angle))
    allowed = {"voltage_instant"} if held else set()
    assert {w.kind for w in right.warnings} <= allowed
    assert not any("d axis" in note for note in right.notes)
    turned = found(motor, t, u * 1j, i * 1j, wrapped(angle) - np.pi / 2)
    (warning,) = turned.warnings
    if warning.kind in allowed:
        return
    assert warning.kind == "angle_offset"
    assert "ahead of the d axis, by the angle `theta`" in warning.message
    ahead = float(warning.message.split("magnet is ")[1].split(" deg")[0])
    np.testing.assert_allclose(ahead, 90.0, atol=4.0)


def test_a_small_offset_of_the_angle_is_noted():
    motor = BY_NAME["servo"]
    t, u, i, angle = in_dq(motor)
    turn = np.exp(1j * np.radians(22.0))
    turned = found(motor, t, u * turn, i * turn, wrapped(angle - np.radians(22.0)))
    assert turned.warnings == ()
    assert "the magnet is 22" in turned.notes[-1]


# What is read at constant speed and current, where lengths tell little.
STEADY = {
    "q_sign": lambda u, i, a: (u.conj(), i, a),
    "dq_swapped": lambda u, i, a: (1j * u.conj(), i, a),
    "angle_sign": lambda u, i, a: (u.conj(), i.conj(), a),
    "angle_offset": lambda u, i, a: (-1j * u, -1j * i, a + np.pi / 2),
}


@pytest.mark.parametrize("kind", STEADY)
@pytest.mark.parametrize("name", ["traction", *slow("servo", "crane")])
def test_the_d_axis_tells_components_at_constant_speed(name, kind):
    motor = BY_NAME[name]
    t, u, i, angle = in_dq(motor, "constant")
    (warning,) = found(motor, t, *STEADY[kind](u, i, angle)).warnings
    assert warning.kind == kind


@pytest.mark.parametrize("kind", WRONG)
@pytest.mark.parametrize("name", ["servo", *slow("drone", "interior")])
def test_the_cause_of_a_wrong_log_in_dq_is_named(name, kind):
    motor = BY_NAME[name]
    t, u, i, angle = in_dq(motor, held=name == "servo")
    signals, options = WRONG[kind](u, i, angle, motor)
    (warning,) = found(motor, t, *signals, **options).warnings
    assert warning.kind == kind
    assert "alpha" not in warning.message and "beta" not in warning.message


def test_at_constant_speed_the_d_axis_tells_the_direction():
    """The length of the flux is then as constant, but the magnet is behind."""
    motor = BY_NAME["traction"]
    t, u, i, angle = in_dq(motor, "constant")
    (warning,) = found(motor, t, u, i, -angle).warnings
    assert warning.kind == "angle_sign"


def test_counts_of_an_encoder_are_named_with_their_number():
    motor = dataclasses.replace(BY_NAME["servo"], pole_pairs=3)
    t, u, i, angle = in_dq(motor)
    counts = np.floor(4096 * wrapped(angle / 3) / (2 * np.pi))
    (warning,) = found(motor, t, u, i, counts).warnings
    assert warning.kind == "angle_unit"
    assert "in counts, 4096 a turn, not in rad, and mechanical" in warning.message


def test_messages_name_the_columns_of_the_log(tmp_path, capsys):
    motor = BY_NAME["servo"]
    log = noisy(run(motor, "rich"), motor, 4, 0.005)
    of = lambda columns, *options: estimated(tmp_path, motor, columns, *options, "-q")[0]
    said = lambda *arguments: of(*arguments)["warnings"][0]["message"]
    stationary = {
        "Time": log["t"],
        "Ualpha": log["u"].real,
        "Ubeta": log["u"].imag,
        "I alpha": -log["i"].real,
        "I beta": -log["i"].imag,
    }
    assert "turn the sign of `I alpha` and `I beta`" in said(stationary)
    swapped = stationary | {"I alpha": log["i"].imag, "I beta": log["i"].real}
    hint = "--column 'i_alpha=I beta' --column 'i_beta=I alpha'"
    assert hint in said(swapped)
    mended = of(swapped, "--column", "i_alpha=I beta", "--column", "i_beta=I alpha")
    assert mended["warnings"] == []
    dq = {"t": log["t"], "theta_e": -log["angle"]}
    for name, z in (("V", log["u"]), ("I", log["i"])):
        z = z * np.exp(-1j * log["angle"])
        dq |= {f"{name}d": z.real, f"{name}q": z.imag}
    message = said(dq, "--frame", "dq", "--angle", "theta_e")
    assert "turn the sign of `theta_e`, or of Vq and Iq, in the log" in message
    phases = np.exp(2j * np.pi / 3 * np.arange(3))
    abc = {"t": log["t"]}
    for name, z in (("U", log["u"]), ("I", -log["i"])):
        for end, phase in zip("abc", phases, strict=True):
            abc[f"{name}_{end}"] = (z * np.conj(phase)).real
    assert "turn the sign of I_a, I_b and I_c in the log" in said(abc, "--frame", "abc")
    crossed = abc | {"I_b": -abc["I_a"], "I_a": -abc["I_b"], "I_c": -abc["I_c"]}
    assert "phases a and b of the currents are swapped" in said(crossed, "--frame", "abc")


def test_voltages_between_lines_are_no_phase_voltages():
    motor = BY_NAME["crane"]
    log = noisy(run(motor, "rich"), motor, 4, 0.005)
    frame = Frame("abc")
    labels = {f"{x}_{end}": f"{x}{end}" for x in "ui" for end in "abc"}
    pair = lambda z: np.stack([z.real, z.imag], axis=1)
    between = log["u"] * np.sqrt(3) * np.exp(1j * np.pi / 6)
    (warning,) = diagnose(
        Log(log["t"], pair(between), pair(log["i"]), {}),
        [motor.circle().read_from(frame, labels)],
    ).warnings
    assert warning.kind == "line_voltages"
    assert "ua, ub and uc are the voltages between lines" in warning.message


def phases(z):
    """Phases a, b and c of alpha + j beta."""
    return (z[:, None] * np.exp(-2j * np.pi / 3 * np.arange(3))).real


def of_phases(motor, log, u, i):
    """The warnings on a log in abc, of voltages and currents, shape `(N, 3)`."""
    names = [f"{x}_{end}" for x in "ui" for end in "abc"]
    circle = motor.circle().read_from(Frame("abc"), dict(zip(names, names, strict=True)))
    read = Log(log["t"], np.asarray(clarke(u)), np.asarray(clarke(i)), {})
    return diagnose(read, [circle]).warnings


def times(x, column, factor):
    x = x.copy()
    x[:, column] *= factor
    return x


ORDERS = {"ab, bc and ca": (0, 1), "ca, ab and bc": (2, 0), "bc, ca and ab": (1, 2)}
ORDERS |= {"ac, ba and cb": (0, 2), "ba, cb and ac": (1, 0), "cb, ac and ba": (2, 1)}


@pytest.mark.parametrize("order", ORDERS)
def test_every_order_of_the_voltages_between_lines_is_named(order):
    motor = BY_NAME["crane"]
    log = noisy(run(motor, "rich", 2001), motor, 4, 0.005)
    a, b = ORDERS[order]
    u = phases(log["u"])
    between = u - np.roll(u, -(b - a), axis=1)
    between = np.roll(between, -a, axis=1)
    (warning,) = of_phases(motor, log, between, phases(log["i"]))
    assert warning.kind == "line_voltages"
    assert f"between lines, {order}," in warning.message
    # The remedy gives the phases back.
    remedy = warning.message.split("convert them: ")[1]
    values = dict(zip(order.replace(" and", ",").split(", "), between.T, strict=True))
    for phase, column in (("a", 0), ("b", 1)):
        formula = remedy.split(f"{phase} = ")[1].split(", b =")[0]
        formula = formula.replace("2 ", "2*")
        mended = eval(formula, {}, values)
        np.testing.assert_allclose(mended, u[:, column], atol=1e-9 * np.abs(u).max())


@pytest.mark.parametrize("signal", ["voltage", "current"])
@pytest.mark.parametrize("phase", range(3))
@pytest.mark.parametrize("kind", ["phase_missing", "phase_sign"])
def test_one_phase_is_named(kind, phase, signal):
    motor = BY_NAME["crane"]
    log = noisy(run(motor, "rich", 2001), motor, 4, 0.005)
    u, i = phases(log["u"]), phases(log["i"])
    factor = 0.0 if kind == "phase_missing" else -1.0
    if signal == "voltage":
        u = times(u, phase, factor)
    else:
        i = times(i, phase, factor)
    (warning,) = of_phases(motor, log, u, i)
    assert warning.kind == kind
    assert f"phase {'abc'[phase]} of the {signal}s" in warning.message
