"""A log in pieces gives the table of the log as a whole; few programs are compiled."""

import itertools
import subprocess
import sys
from importlib.resources import files

import equinox as eqx
import held_logs
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.cli import _summary as summary, _table as table, _trace as trace, main
from aslo_jax.engines import NotFusible
from aslo_jax.logs import LogReader, write_table
from aslo_jax.machines import read_machine, template

LOGS = {
    "stepper": lambda: held_logs.motor(
        0.55, 1.5e-3, 1.5e-3, 0.0038, 50, 300.0, 2.0, rows=601
    ),
    "wrim": lambda: held_logs.wrim(False, rows=601),
    "magnetic_bearing": lambda: held_logs.bearing(rows=601),
}


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    assert not left.value.code
    return capsys.readouterr().out


@pytest.mark.parametrize("truth", ["--truth", "--no-truth"])
@pytest.mark.parametrize("kind", LOGS)
def test_pieces_give_what_the_whole_gives(tmp_path, capsys, monkeypatch, kind, truth):
    write_table(tmp_path / "log.parquet", LOGS[kind]())
    (tmp_path / "machine.toml").write_text(template(kind))
    said, tables = [], []
    for rows in (10**6, 97):
        monkeypatch.setattr(table, "PIECE", rows)
        out = tmp_path / f"{rows}.npz"
        arguments = ["--machine", tmp_path / "machine.toml", "--out", out, truth]
        said.append(run(capsys, "estimate", tmp_path / "log.parquet", *arguments))
        with np.load(out) as found:
            tables.append(dict(found))
    whole, pieces = tables
    assert said[0] == said[1]
    assert list(whole) == list(pieces) and whole["t"].size == 601
    for name, x in whole.items():
        scale = np.abs(x).max()
        np.testing.assert_allclose(pieces[name], x, rtol=0, atol=1e-12 * scale)


def test_a_log_is_given_in_pieces_that_share_a_row(tmp_path):
    columns = LOGS["stepper"]()
    write_table(tmp_path / "log.csv", columns)
    reader = LogReader(tmp_path / "log.csv")
    pieces = list(reader.pieces(100))
    assert [piece.t.size for piece in pieces] == [101] * 6
    for a, b in itertools.pairwise(pieces):
        assert a.t[-1] == b.t[0] and (a.y[-1] == b.y[0]).all()
    joined = np.concatenate([pieces[0].u, *(piece.u[1:] for piece in pieces[1:])])
    np.testing.assert_array_equal(joined[:, 1], columns["u_beta"])


COUNTED = """
import sys
import jax
from jax import monitoring

compiled = []
monitoring.register_event_duration_secs_listener(
    lambda name, seconds, **about: compiled.append(name)
    if name == "/jax/core/compile/backend_compile_duration"
    else None
)
from aslo_jax.cli import main

try:
    main(sys.argv[1:])
finally:
    print("compiled", len(compiled))
"""


def test_an_estimate_compiles_few_programs(tmp_path):
    pytest.importorskip("llvmlite")
    data = files("aslo_jax") / "data"
    arguments = ["estimate", data / "pmsm_log.csv", "--machine", data / "motor.toml"]
    arguments += ["--out", tmp_path / "out.csv"]
    done = subprocess.run(
        [sys.executable, "-c", COUNTED, *map(str, arguments)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert 1 <= int(done.stdout.split()[-1]) <= 8


def test_the_automatic_engine_fuses_what_it_can():
    pytest.importorskip("llvmlite")
    t = np.arange(60) * 1e-3
    y = np.stack([np.cos(200 * t), np.sin(200 * t)], axis=1)
    u = np.stack([-y[:, 1], y[:, 0]], axis=1) * 40.0
    motor = read_machine(files("aslo_jax") / "data" / "motor.toml")

    def final(rate, engine):
        observer = aslo.AlgebraicObserver(motor.plant().flux_relation(), aslo.LowPass(rate))
        return aslo.replay(observer, t, u, y, engine=engine).value

    same = lambda a, b: np.testing.assert_array_equal(a, b)
    same(final(90.0, "auto"), final(90.0, "fused"))
    same(
        jax.jit(lambda r: final(r, "auto"))(90.0), jax.jit(lambda r: final(r, "scan"))(90.0)
    )
    slope = lambda engine: jax.grad(lambda r: jnp.sum(final(r, engine)[-1]))(90.0)
    assert slope("auto") == slope("scan") != 0.0


class Spectrum(aslo.AbstractObserver):
    def equations(self, F, u, y):
        size = jnp.abs(jnp.fft.fft(y))
        return aslo.Estimate(size, jnp.ones(()), jnp.asarray(False))


def test_the_automatic_engine_says_why_it_scans(monkeypatch):
    t, y = np.arange(3.0), np.array([[2.0, 1.0]] * 3)
    with pytest.warns(UserWarning, match=r'Running with engine="scan".*`jnp.fft.fft`'):
        found = aslo.replay(Spectrum(), t, y, y, engine="auto")
    np.testing.assert_allclose(found.value, [[3.0, 1.0]] * 3, rtol=1e-12)
    with pytest.raises(NotFusible):
        aslo.replay(Spectrum(), t, y, y, engine="fused")
    monkeypatch.setitem(sys.modules, "llvmlite", None)  # as if it were not installed
    assert eqx.tree_equal(aslo.replay(Spectrum(), t, y, y, engine="auto"), found)


def test_a_long_log_is_drawn_by_what_bounds_it(monkeypatch):
    """Every bucket of rows by its least and largest value, in whatever pieces they come."""
    monkeypatch.setattr(trace, "BUCKETS", 8)
    machine = read_machine(files("aslo_jax") / "data" / "motor.toml")
    rows = 100
    x = np.sin(np.arange(100.0) ** 2)
    columns = {"t": np.arange(100.0), "certificate": x, "coasting": (x > 0.9) * 1}
    gathered = trace.Trace(machine, rows)
    for part in (slice(0, 37), slice(37, 41), slice(41, 100)):
        piece = {name: column[part] for name, column in columns.items()}
        gathered.add(table.Piece(piece, {}, {"flux": np.abs(x[part])}))
    view = gathered.whole(object.__new__(summary.Summary))  # it is for scalars
    bucket = 13
    for k in range(8):
        part = x[bucket * k : bucket * (k + 1)]
        positive = part[part > 0]
        low, high = view.columns["certificate"][2 * k : 2 * k + 2]
        assert (low, high) == (positive.min(), positive.max())
        assert view.t[2 * k] == bucket * k
        assert view.columns["coasting"][2 * k] == (part > 0.9).any()
        assert view.errors["flux"][2 * k + 1] == np.abs(part).max()
