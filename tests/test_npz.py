"""NPZ logs and tables piece by piece: the bytes of NumPy, in memory that does not grow."""

import io
import itertools
import tracemalloc

import numpy as np
import pytest

from aslo_jax.logs import (
    LogError,
    LogReader,
    TableWriter,
    _npz,
    _reader,
    _source,
    read_log,
    write_table,
)

NAMES = ["t", "u_alpha", "u_beta", "i_alpha", "i_beta"]


def piece(first, rows):
    """Rows of a log of a motor."""
    k = np.arange(first, first + rows)
    t = 1e-3 * k
    return {"t": t, **{name: np.sin(n * t) for n, name in enumerate(NAMES[1:], 1)}}


def write(path, pieces):
    with TableWriter(path) as writer:
        for columns in pieces:
            writer.write(columns)


def test_the_file_is_that_of_numpy(tmp_path):
    """Columns of several types and shapes, some without rows, whole or in pieces."""
    columns = {
        "t": np.arange(7.0),
        "coasting": np.arange(7, dtype=np.uint8),
        "wide": np.arange(42, dtype=">f4").reshape(7, 3, 2),
        "strided": np.arange(14.0)[::2],
        "truth": np.arange(7) > 3,
    }
    expected = io.BytesIO()
    np.savez(expected, **columns)
    for edges in ([0, 7], [0, 2, 2, 6, 7], [0, 0, 7]):
        parts = [slice(*edge) for edge in itertools.pairwise(edges)]
        write(tmp_path / "x.npz", [{k: x[p] for k, x in columns.items()} for p in parts])
        assert (tmp_path / "x.npz").read_bytes() == expected.getvalue()
    assert [path.name for path in tmp_path.iterdir()] == ["x.npz"]


def test_a_table_that_fails_leaves_nothing(tmp_path):
    def pieces():
        yield {"t": np.arange(3.0)}
        raise KeyError

    with pytest.raises(KeyError):
        write(tmp_path / "x.npz", pieces())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ({"t": np.arange(3)}, "`t` must hold float64 in every piece .* it holds int64"),
        ({"t": np.zeros((3, 1))}, r"float64 of shape \(3, 1\)"),
        ({"x": np.zeros(3)}, "must have the columns t, but one has x"),
    ],
)
def test_a_piece_unlike_the_first_is_refused(tmp_path, second, message):
    with TableWriter(tmp_path / "x.npz") as writer:
        writer.write({"t": np.zeros(2)})
        with pytest.raises(ValueError, match=message):
            writer.write(second)
    with np.load(tmp_path / "x.npz") as found:
        np.testing.assert_array_equal(found["t"], np.zeros(2))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_a_log_comes_in_batches(tmp_path, monkeypatch, save):
    monkeypatch.setattr(_source, "BATCH", 30)
    columns = piece(0, 100)
    columns["u_beta"] = columns["u_beta"].astype(">f4")
    columns["i_beta"] = np.arange(100, dtype=np.int16)
    save(tmp_path / "log.npz", other=np.zeros((2, 2)), **columns)
    seen = []
    reader = LogReader(tmp_path / "log.npz", watch=lambda log: seen.append(log.t.size))
    assert seen == [30, 30, 30, 10]
    (log,) = reader.pieces(1000)
    np.testing.assert_array_equal(log.t, columns["t"])
    for k in range(2):
        np.testing.assert_array_equal(log.u[:, k], columns[NAMES[1 + k]].astype(float))
        np.testing.assert_array_equal(log.y[:, k], columns[NAMES[3 + k]].astype(float))
    columns["i_beta"] = np.where(np.arange(100) == 71, np.nan, 0.0)
    save(tmp_path / "log.npz", **columns)
    with pytest.raises(LogError, match=r"row 71 .*column `i_beta`"):
        read_log(tmp_path / "log.npz")


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("part", [0.3, 0.9])
def test_a_damaged_file_is_refused(tmp_path, save, part):
    """Wherever the damage is; the directory of the archive, at the end, is whole."""
    path = tmp_path / "log.npz"
    save(path, **piece(0, 1000))
    content = bytearray(path.read_bytes())
    place = int(part * len(content))
    content[place : place + 40] = bytes(255 - byte for byte in content[place : place + 40])
    path.write_bytes(content)
    with pytest.raises(LogError, match="not a readable NPZ file"):
        read_log(path)


def peak(run):
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_does_not_grow_with_the_rows(tmp_path, monkeypatch):
    """But for t, which is read as a whole; ten times the rows."""
    monkeypatch.setattr(_reader, "KEPT", 0)
    monkeypatch.setattr(_source, "BATCH", 5000)
    monkeypatch.setattr(_npz, "CHUNK", 1 << 15)
    rows = 5000
    writing, reading = [], []
    for count in (4, 40):
        path = tmp_path / f"{count}.npz"
        pieces = (piece(k * rows, rows) for k in range(count))
        writing.append(peak(lambda path=path, pieces=pieces: write(path, pieces)))

        def read(path=path):
            assert sum(log.t.size - 1 for log in LogReader(path).pieces(rows)) > 3 * rows

        instants = 8 * rows * count
        reading.append(peak(read) - 3 * instants)  # t, its pieces, and its differences
    one = 8 * rows * len(NAMES)
    assert max(writing) < 8 * one + (1 << 21)
    assert writing[1] < 1.1 * writing[0]
    assert reading[1] < 1.1 * reading[0] + one


def test_a_table_without_rows(tmp_path):
    write_table(tmp_path / "x.npz", {"t": np.zeros(0)})
    with np.load(tmp_path / "x.npz") as found:
        assert found["t"].size == 0
