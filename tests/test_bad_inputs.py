"""Bad inputs end with one line, without a traceback, and leave nothing behind; a table that
is written trusts no number that is not finite."""

import bad_inputs
import pytest

BLOCK = 100


def found(numbers, folder):
    return [each for n in numbers for each in bad_inputs.faults(n, folder / str(n))]


def test_a_few_bad_inputs(tmp_path):
    assert not found(range(60), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(1, 21))
def test_two_thousand_bad_inputs(block, tmp_path):
    assert not found(range(BLOCK * block, BLOCK * (block + 1)), tmp_path)


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
