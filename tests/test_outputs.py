"""Outputs that appear complete or not at all."""

import os
import signal
from pathlib import Path

import pytest

from aslo_jax.cli._outputs import staged


def test_an_interrupt_and_a_termination_leave_nothing(tmp_path):
    def work(number: int) -> None:
        with staged(tmp_path / "a.csv", tmp_path / "b.png") as parts:
            assert [part.suffix for part in parts] == [".csv", ".png"]
            parts[0].write_text("half")
            os.kill(os.getpid(), number)

    for number, error in ((signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, SystemExit)):
        before = signal.getsignal(signal.SIGTERM)
        with pytest.raises(error):
            work(number)
        assert list(tmp_path.iterdir()) == []
        assert signal.getsignal(signal.SIGTERM) is before


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.csv").write_text("earlier")
    (tmp_path / "a.csv").symlink_to(tmp_path / "real" / "a.csv")
    with staged(tmp_path / "a.csv") as (part,):
        part.write_text("new")
    assert (tmp_path / "a.csv").is_symlink()
    assert (tmp_path / "real" / "a.csv").read_text() == "new"


def test_an_unwritable_directory_is_refused_before_the_work(tmp_path, monkeypatch):
    def fail(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", fail)  # whoever runs this may be root
    with (
        pytest.raises(OSError, match=r"cannot write .*a\.csv: Permission denied"),
        staged(tmp_path / "a.csv"),
    ):
        pytest.fail("the context was entered")
    assert list(tmp_path.iterdir()) == []
