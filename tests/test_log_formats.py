"""Files of every format, and every way to write a text file, hold the same log."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from aslo_jax.logs import Log, LogError, read_log

NAMES = ["t", "u_alpha", "u_beta", "i_alpha", "i_beta"]
ROWS = 50


def table(rows: int = ROWS) -> dict[str, np.ndarray]:
    """Columns that differ in every row, negative ones, and integers in the first row."""
    k = np.arange(rows)
    columns = {name: np.round(j * np.sin(0.3 * k * j), 6) for j, name in enumerate(NAMES)}
    return columns | {"t": np.round(2e-4 * k, 6)}


def lines(delimiter: str = ",", rows: int = ROWS) -> list[str]:
    columns = table(rows)
    cells = [[f"{columns[n][k]:.10g}" for n in NAMES] for k in range(rows)]
    return [delimiter.join(row) for row in [NAMES, *cells]]


def write(path: Path, text: list[str]) -> Path:
    path.write_bytes("\n".join([*text, ""]).encode())
    return path


def assert_is_table(log: Log):
    expected = table()
    found = np.column_stack([log.t, log.u, log.y])
    np.testing.assert_allclose(found, np.column_stack([expected[n] for n in NAMES]))


def refusal(path: Path, **options) -> str:
    with pytest.raises(LogError) as error:
        read_log(path, **options)
    return str(error.value)


HEADED = ["# made by tool, 2026", "// and, by, another, one, of", "% x"]
TEXTS = {
    "comments before": lambda: HEADED + lines(),
    "names in a comment": lambda: [f"# {lines(' ')[0]}", *lines(" ")[1:]],
    "comments among samples": lambda: [*lines()[:9], "# a,b,c,d,e", "% b", *lines()[9:]],
    "a comment at the end": lambda: [*lines(), "# end of file"],
    "metadata": lambda: ['"File","x"', '"Rate",5000', "", "Name,Scope,1", *lines()],
    "units": lambda: [lines()[0], "s,V,V,A,A", *lines()[1:]],
    "units in brackets": lambda: [lines(";")[0], "[s];[V];[V];[A];[A]", *lines(";")[1:]],
    "metadata, comments and units": lambda: [
        *HEADED,
        "Scope;7;x",
        lines(";")[0],
        "s;V;V;A;A",
        *lines(";")[1:],
    ],
    "blanks": lambda: lines(" "),
    "many blanks": lambda: [f"   {line.replace(' ', '   ')}  " for line in lines(" ")],
    "blanks and units": lambda: (
        ["t [s]  u_alpha [V] u_beta [V] i_alpha [A] i_beta (A)", *lines(" ")[1:]]
    ),
    "bars": lambda: lines("|"),
    "decimal commas": lambda: [x.replace(".", ",") for x in lines(";")],
    "decimal commas and blanks": lambda: [x.replace(".", ",") for x in lines(" ")],
    "decimal commas and tabs": lambda: [x.replace(".", ",") for x in lines("\t")],
    "a delimiter at every end": lambda: [lines()[0], *(f"{x}," for x in lines()[1:])],
    "blank lines": lambda: ["", *lines()[:1], "", *lines()[1:20], "", *lines()[20:]],
}


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".dat.gz"])
@pytest.mark.parametrize("text", TEXTS)
def test_texts(tmp_path, text, suffix):
    path = tmp_path / f"log{suffix}"
    content = "\n".join([*TEXTS[text](), ""]).encode()
    path.write_bytes(gzip.compress(content) if suffix.endswith("gz") else content)
    assert_is_table(read_log(path))


def test_a_row_past_comments_is_named_by_its_line(tmp_path):
    text = [*HEADED, *lines()]
    text[9] = text[9].replace(text[9].split(",")[3], "oops")
    path = write(tmp_path / "log.csv", [*text[:6], "# one more", *text[6:]])
    assert "line 11, column `i_alpha`: 'oops' is not a number" in refusal(path)


def test_a_decimal_comma_is_judged_over_rows_that_have_one(tmp_path):
    """Not by the first rows, which may be whole numbers."""
    body = [f"{k};0;{k};-{k};1" for k in range(1200)] + ["1200,5;0,25;7;8;9"]
    log = read_log(write(tmp_path / "log.csv", [lines(";")[0], *body]))
    assert (log.t[-1], log.u[-1, 0], log.y[3, 0]) == (1200.5, 0.25, -3.0)


def test_marks_with_two_readings_are_refused(tmp_path):
    head = lines(";")[0]
    path = tmp_path / "log.csv"
    both = refusal(write(path, [head, "0;1,234;2;3;4", "1;1,234;2;3;4", "2;5,250;2;3;4"]))
    assert "line 2: '1,234' may be 1.234 with a decimal comma, or 1234 with" in both
    assert "decimal points" in both
    mixed = refusal(write(path, [head, "0;1,5;2;3;4", "1;1,5;0.5;3;4"]))
    assert "'1,5' in line 2 has a comma and '0.5' in line 3 a point" in mixed
    marked = refusal(write(path, [head, "0;1.234,5;2;3;4", "1;1.234,5;0;3;4"]))
    assert "line 2: '1.234,5' has a mark between thousands" in marked
    # One number that has no other reading decides.
    decided = [head, "0;1,234;2;3;4", "1;1,2345;2;3;4"]
    np.testing.assert_array_equal(read_log(write(path, decided)).u[:, 0], [1.234, 1.2345])
    quoted = [lines()[0], '0,"1,234",2,3,4', "1,2,2,3,4"]
    assert "(1.234 with a decimal comma, or 1234 with" in refusal(write(path, quoted))


def test_a_second_table_is_not_dropped(tmp_path):
    path = write(tmp_path / "log.csv", [*lines(), "", *lines()])
    assert "line 53, column `t`: 't' is not a number" in refusal(path)


def test_a_broken_archive_is_refused(tmp_path):
    path = tmp_path / "log.csv.gz"
    path.write_bytes(b"t,u_alpha\n")
    assert "is not a readable .gz file" in refusal(path)


def test_matrices_of_numpy(tmp_path):
    columns = table()
    u = np.column_stack([columns["u_alpha"], columns["u_beta"]])
    i = np.column_stack([columns["i_alpha"], columns["i_beta"]])
    path = tmp_path / "log.npz"
    np.savez(path, t=columns["t"], u=u, y=i)
    assert_is_table(read_log(path))
    np.savez(path, time=columns["t"][:, None], u=u, i=i)
    assert_is_table(read_log(path))
    assert_is_table(read_log(path, columns={"u_alpha": "u[0]", "u_beta": "`u[1]`*1"}))
    np.savez(path, t=columns["t"], u=u.T, y=i)
    message = refusal(path)
    assert (
        "no columns `u_alpha`, `u_beta`" in message and "`u` has shape (2, 50)" in message
    )
    np.savez(path, t=columns["t"], u=u[:-1], y=i)
    assert "column `u[0]` has 49 entries, but `t` has 50" in refusal(path)


def test_matlab_structs(tmp_path):
    from scipy.io import savemat

    columns = table()
    nested = {
        "log": {
            "time": columns["t"][:, None],
            "voltage": {"alpha": columns["u_alpha"], "beta": columns["u_beta"]},
            "i_alpha": columns["i_alpha"][None, :],
            "i_beta": columns["i_beta"],
            "note": "text",
        }
    }
    savemat(tmp_path / "log.mat", nested)
    names = {"u_alpha": "log.voltage.alpha", "u_beta": "log.voltage.beta"}
    assert_is_table(read_log(tmp_path / "log.mat", columns=names))
    message = refusal(tmp_path / "log.mat")
    assert "`log.voltage.beta`" in message and "no columns `u_alpha`, `u_beta`" in message
    savemat(tmp_path / "broken.mat", nested, do_compression=True)
    whole = (tmp_path / "broken.mat").read_bytes()
    (tmp_path / "broken.mat").write_bytes(whole[: len(whole) // 2])
    assert "is not a readable MATLAB file" in refusal(tmp_path / "broken.mat")


def series(columns: dict[str, np.ndarray], **late: float) -> dict:
    """Every signal with instants of its own, some later than those of the others."""
    return {
        name: {"Time": columns["t"] + late.get(name, 0.0), "Data": columns[name]}
        for name in NAMES[1:]
    }


def test_matlab_series_have_clocks(tmp_path):
    from scipy.io import savemat

    path = tmp_path / "log.mat"
    savemat(path, series(table()))
    assert_is_table(read_log(path))
    savemat(path, series(table(), i_beta=1e-4))
    message = refusal(path)
    assert "each of which may be `t`" in message
    message = refusal(path, columns={"t": "u_alpha.Time"})
    assert "column `i_beta` has the instants `i_beta.Time`, which are not" in message
    simulink = {
        "out": {
            "time": table()["t"],
            "signals": {"values": np.column_stack([table()[n] for n in NAMES[1:]])},
        }
    }
    savemat(path, simulink)
    columns = {name: f"out[{k}]" for k, name in enumerate(NAMES[1:])}
    assert_is_table(read_log(path, columns=columns))


def test_matlab_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")
    columns, path = table(), tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        for name in NAMES:
            group[name] = columns[name][None, :]  # a column of MATLAB, stored by columns
            group[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["ts"] = np.zeros((1, 6), np.uint32)
        file["ts"].attrs["MATLAB_class"] = np.bytes_("timeseries")
        file["ts"].attrs["MATLAB_object_decode"] = np.int32(3)
        file["#refs#/a"] = np.zeros(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")
    assert_is_table(read_log(path))
    message = refusal(path, columns={"u_alpha": "ts"})
    assert "column `ts` is an object of the class timeseries" in message
    assert "struct('Time', ts.Time, 'Data', ts.Data)" in message


def test_tdms(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    columns, path = table(), tmp_path / "log.tdms"
    about = {"wf_increment": 2e-4, "wf_start_offset": 0.0}
    with nptdms.TdmsWriter(path) as writer:
        units = ("mV", "V", "A", "A")
        channels = [
            nptdms.ChannelObject("m", n, columns[n], about | {"unit_string": unit})
            for n, unit in zip(NAMES[1:], units, strict=True)
        ]
        writer.write_segment(channels)
    log = read_log(path)
    np.testing.assert_allclose(log.u[:, 0], 1e-3 * columns["u_alpha"])
    np.testing.assert_allclose(log.t, columns["t"], atol=1e-15)
    np.testing.assert_allclose(log.y[:, 1], columns["i_beta"])


def test_a_file_without_an_end_is_read_in_blocks(tmp_path):
    """Cleaned text too: what a block ends with is kept for the next."""
    from aslo_jax.logs import _text

    rows = 3000
    columns = {n: np.arange(rows) + j for j, n in enumerate(NAMES)}
    body = [" ".join(f"{columns[n][k]:.6f}" for n in NAMES) for k in range(rows)]
    path = write(tmp_path / "log.txt", [" ".join(NAMES), *body])
    before, _text.Cleaned.BLOCK = _text.Cleaned.BLOCK, 777
    try:
        log = read_log(path)
    finally:
        _text.Cleaned.BLOCK = before
    np.testing.assert_array_equal(log.y[:, 1], columns["i_beta"])


def test_columns_in_memory():
    pandas, xarray = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    columns = table()
    assert_is_table(Log.from_columns(columns))
    u = np.column_stack([columns["u_alpha"], columns["u_beta"]])
    i = [columns["i_alpha"], columns["i_beta"]]
    assert_is_table(
        Log.from_columns({"t": list(columns["t"]), "u": u, "y": np.transpose(i)})
    )
    frame = pandas.DataFrame({name: columns[name] for name in NAMES[1:]})
    frame.index = pandas.Index(1e3 * columns["t"], name="Time [ms]")
    assert_is_table(Log.from_columns(frame))
    in_millivolts = ("t", 1e3 * columns["u_alpha"], {"units": "mV"})
    rest = {name: ("t", columns[name]) for name in NAMES[2:]}
    data = xarray.Dataset({"u_alpha": in_millivolts, **rest}, {"t": columns["t"]})
    assert_is_table(Log.from_columns(data))


def test_columns_in_memory_are_refused_as_those_of_files_are():
    columns = table()
    with pytest.raises(LogError, match="the mapping has no column `i_beta`"):
        Log.from_columns({n: columns[n] for n in NAMES[:-1]})
    broken = columns | {"i_beta": np.where(np.arange(ROWS) == 7, np.nan, 0.0)}
    with pytest.raises(
        LogError, match=r"the mapping, row 7 .*, column `i_beta`: the value"
    ):
        Log.from_columns(broken)
    with pytest.raises(LogError, match="time runs backwards"):
        Log.from_columns(columns | {"t": columns["t"][::-1]})
    with pytest.raises(LogError, match=r"must be a mapping .* but is a list"):
        Log.from_columns([1, 2])
    with pytest.raises(LogError, match="column `u_alpha` holds complex128"):
        Log.from_columns(columns | {"u_alpha": columns["u_alpha"] + 0j})
    assert Log.from_columns(columns | {"notes": np.array(["x"] * ROWS)}).t.size == ROWS
