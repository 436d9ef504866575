"""Bad inputs end with one line, without a traceback, and leave nothing behind; a table that
is written trusts no number that is not finite."""

import bad_inputs
import pytest

BLOCK = 100
PARAMETERS = ("resistance", "inductance", "magnet_flux")


def found(numbers, folder):
    return [each for n in numbers for each in bad_inputs.faults(n, folder / str(n))]


def test_a_few_bad_inputs(tmp_path):
    assert not found(range(60), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(1, 21))
def test_two_thousand_bad_inputs(block, tmp_path):
    assert not found(range(BLOCK * block, BLOCK * (block + 1)), tmp_path)


@pytest.mark.parametrize(
    ("key", "size"),
    [
        *((key, size) for key in PARAMETERS for size in ("1e9", "1e30", "1e200")),
        *((key, size) for key in PARAMETERS[::2] for size in ("1e-30", "1e-9")),
    ],
)
def test_parameters_of_any_size(key, size, tmp_path):
    """An inductance that is too small shows in nothing here but 1 % of magnet flux."""
    cells = bad_inputs.as_text(bad_inputs.motor_log())
    log, machine = tmp_path / "log.csv", tmp_path / "m.toml"
    log.write_text("\n".join(",".join(row) for row in cells))
    lines = bad_inputs.MACHINE.splitlines()
    changed = [f"{key} = {size}" if line.startswith(key) else line for line in lines]
    machine.write_text("\n".join(changed))
    out = tmp_path / "out.csv"
    given = ["estimate", str(log), "--machine", str(machine), "--out", str(out)]
    code, _, error = bad_inputs.run(given)
    assert code in (0, 2), code
    assert code == 2 or "aslo-jax: warning:" in error  # never taken for right


def test_the_rules_see_what_breaks_them(tmp_path, monkeypatch):
    """A command that fails in each way that is ruled out is told of."""

    def broken(arguments):
        (tmp_path / "0" / "out.csv.part").write_text("half")
        return "Traceback: KeyError", "", "Traceback (most recent call last)"

    monkeypatch.setattr(bad_inputs, "run", broken)
    (first, second) = found([0], tmp_path)
    assert "ends with Traceback" in first
    assert "prints a traceback" in second
    monkeypatch.setattr(bad_inputs, "run", lambda _: broken(_) and (2, "", "no reason\x1b"))
    (tmp_path / "0").rename(tmp_path / "before")
    why, left, odd = found([0], tmp_path)
    assert "does not say why" in why and "leaves" in left and "control" in odd
