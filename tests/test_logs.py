"""Logs: what is read is what was recorded, and what cannot be used is refused by place."""

import shlex
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest

from aslo_jax.logs import LogError, Signals, check_suffix, read_log, write_table

NAMES = ["t", "u_alpha", "u_beta", "i_alpha", "i_beta"]


def table(rows: int = 40) -> dict[str, np.ndarray]:
    """Five columns that differ from each other in every row."""
    k = np.arange(rows)
    return {name: 1e-3 * k + j * np.cos(k + j) for j, name in enumerate(NAMES)}


def lines(rows: int = 40) -> list[str]:
    columns = table(rows)
    body = [",".join(repr(float(columns[n][k])) for n in NAMES) for k in range(rows)]
    return [",".join(NAMES), *body]


def with_cell(line: int, name: str, value: str) -> list[str]:
    """The file with one cell replaced; `line` counts from 1, the header being line 1."""
    text = lines()
    cells = text[line - 1].split(",")
    cells[NAMES.index(name)] = value
    text[line - 1] = ",".join(cells)
    return text


def write(path: Path, text: list[str], end: str = "\n", encoding: str = "utf-8") -> Path:
    path.write_bytes((end.join(text) + end).encode(encoding))
    return path


def refusal(path: Path, **options) -> str:
    with pytest.raises(LogError) as error:
        read_log(path, **options)
    message = str(error.value)
    assert path.name in message
    return message


def assert_is_table(log, rows: int = 40):
    expected = table(rows)
    np.testing.assert_array_equal(log.t, expected["t"])
    np.testing.assert_array_equal(log.u[:, 0], expected["u_alpha"])
    np.testing.assert_array_equal(log.u[:, 1], expected["u_beta"])
    np.testing.assert_array_equal(log.y[:, 0], expected["i_alpha"])
    np.testing.assert_array_equal(log.y[:, 1], expected["i_beta"])


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npz", ".CSV"])
def test_written_and_read_again_is_bitwise_the_same(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    write_table(path, table())
    assert_is_table(read_log(path))


def _semicolons(text):
    return [line.replace(",", ";") for line in text]


DIALECTS = {
    "plain": (lambda text: text, "\n", "utf-8"),
    "byte order mark and CRLF": (lambda text: text, "\r\n", "utf-8-sig"),
    "CR": (lambda text: text, "\r", "utf-8"),
    "semicolons": (_semicolons, "\n", "utf-8"),
    "decimal commas": (
        lambda text: [line.replace(".", ",") for line in _semicolons(text)],
        "\n",
        "utf-8",
    ),
    "tabs": (lambda text: [line.replace(",", "\t") for line in text], "\n", "utf-8"),
    "spaces": (lambda text: [line.replace(",", " , ") for line in text], "\n", "utf-8"),
    "blank lines": (lambda text: ["", *text[:9], "", "", *text[9:]], "\n", "utf-8"),
    "quotes": (
        lambda text: [",".join(f'"{c}"' for c in line.split(",")) for line in text],
        "\n",
        "utf-8",
    ),
    "more columns, two of one name": (
        lambda text: [f"note,note,{text[0]},", *(f"x,,{line},?" for line in text[1:])],
        "\n",
        "utf-8",
    ),
    "another order": (
        lambda text: [",".join(line.split(",")[::-1]) for line in text],
        "\n",
        "utf-8",
    ),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_csv_dialects_give_the_same_numbers(tmp_path, dialect):
    change, end, encoding = DIALECTS[dialect]
    path = write(tmp_path / "log.csv", change(lines()), end, encoding)
    assert_is_table(read_log(path))


def test_integer_columns(tmp_path):
    path = write(tmp_path / "log.csv", ["t,u_alpha,u_beta,i_alpha,i_beta"])
    path.write_text(path.read_text() + "0,1,2,3,4\n1,5,6,7,8\n")
    log = read_log(path)
    assert log.u.dtype == float
    assert log.u.tolist() == [[1, 2], [5, 6]]
    write_table(tmp_path / "log.npz", {n: np.arange(3) for n in NAMES})
    assert read_log(tmp_path / "log.npz").t.tolist() == [0.0, 1.0, 2.0]


def test_names_are_mapped_and_truth_is_optional(tmp_path):
    columns = {f"x_{name}": column for name, column in table().items()}
    columns["i_alpha"] = np.full(40, np.nan)  # not read: another column is mapped to it
    columns["flux_alpha"] = np.arange(40.0)
    columns["motor speed"] = -np.arange(40.0)
    write_table(tmp_path / "log.csv", columns)
    mapping = {name: f"x_{name}" for name in NAMES}
    log = read_log(
        tmp_path / "log.csv", columns=mapping | {"omega_mechanical": "motor speed"}
    )
    assert_is_table(log)
    assert list(log.truth) == ["flux_alpha", "omega_mechanical"]
    assert log.truth["omega_mechanical"][7] == -7.0
    assert read_log(tmp_path / "log.csv", columns=mapping, truth=False).truth == {}


# The line of the file that an editor shows: the header is line 1.
CELLS = {
    "text": (6, "u_alpha", "abc", "line 6, column `u_alpha`: 'abc' is not a number"),
    "a word for nothing": (6, "u_alpha", "NA", "line 6, column `u_alpha`: 'NA' is not a"),
    "blank": (8, "i_alpha", "", "line 8, column `i_alpha`: the value is blank"),
    "NaN": (2, "u_beta", "nan", "line 2, column `u_beta`: the value is nan"),
    "infinite": (41, "i_beta", "-inf", "line 41, column `i_beta`: the value is -inf"),
    "overflow": (9, "i_beta", "1e999", "line 9, column `i_beta`: the value is inf"),
    "time NaN": (9, "t", "NaN", "line 9, column `t`: the value is nan"),
    "time repeats": (5, "t", "0.002", "line 5, column `t`: time repeats, 0.002 s"),
    "backwards": (5, "t", "0.0015", "line 5, column `t`: time runs backwards, 0.0015 s"),
    "gap": (41, "t", "0.1", "line 41, column `t`: a gap of 0.062 s before 0.1 s"),
    "cells": (30, "i_beta", "1,2", "line 30: 6 cells, but the header names 5 columns"),
}


@pytest.mark.parametrize("fault", CELLS)
def test_a_bad_cell_is_named_by_line_and_column(tmp_path, fault):
    line, name, value, expected = CELLS[fault]
    message = refusal(write(tmp_path / "log.csv", with_cell(line, name, value)))
    assert expected in message
    assert any(
        word in message for word in ("repair", "sort the log", "split the log", "digits")
    )


def test_the_first_bad_row_is_named_past_blank_lines(tmp_path):
    text = with_cell(20, "t", "nan")
    text[14] = text[14].replace(text[14].split(",")[4], "inf")
    path = write(tmp_path / "log.csv", ["", *text[:5], "", *text[5:]])
    assert "line 17, column `i_beta`: the value is inf" in refusal(path)


def test_the_gap_limit(tmp_path):
    path = write(tmp_path / "log.csv", with_cell(41, "t", "0.1"))
    assert "the limit of 0.01 s (ten median intervals)" in refusal(path)
    assert "--max-gap" in refusal(path)
    assert read_log(path, max_gap=0.07).t[-1] == 0.1
    assert "limit of 0.05 s (max_gap)" in refusal(path, max_gap=0.05)
    with pytest.raises(LogError, match=r"`max_gap` .* must be positive \(s\), but got -1"):
        read_log(path, max_gap=-1.0)


STRUCTURES = {
    "empty": ("", "log.csv is empty; a log begins with a line that names its columns"),
    "header only": (",".join(NAMES) + "\n", "has 0 rows of samples"),
    "one row": (
        "\n".join(lines(1)),
        "has 1 row of samples, but a log must have at least 2",
    ),
    "no header": ("\n".join(lines()[1:]), "must name the columns; add a header line such"),
    "two of one name": (
        "\n".join([*lines()[:1], *lines()[1:]]).replace("i_beta", "u_alpha", 1),
        "2 columns called `u_alpha` (columns 2, 5); rename all but one",
    ),
    "prose": ("Dear all,\nhello\n", "no columns `t`, `u_alpha`, `u_beta`"),
    "cut off": (
        "\n".join([*lines(), "0.04,1."]),
        "line 42: 2 cells, but the header names 5",
    ),
    "encoding": ("\n".join(lines()).encode("utf-16"), "is not UTF-8 text"),
}


@pytest.mark.parametrize("fault", STRUCTURES)
def test_a_bad_file_is_refused(tmp_path, fault):
    content, expected = STRUCTURES[fault]
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert expected in refusal(path)


def test_a_misnamed_column_is_suggested_with_its_option(tmp_path):
    header = "Clock of time,Ualph volts,u_beta,I_ALPHAA,i_beta"
    path = write(tmp_path / "log.csv", [header, *lines()[1:]])
    message = refusal(path)
    assert "no columns `t`, `u_alpha`, `i_alpha`" in message
    for option in ("'t=Clock of time'", "'u_alpha=Ualph volts'", "i_alpha=I_ALPHAA"):
        assert f"--column {option}" in message
    assert "u_beta=" not in message
    pasted = shlex.split(message.partition("another name: ")[2].partition(" (in Py")[0])
    columns = dict(option.split("=") for option in pasted if option != "--column")
    assert_is_table(read_log(path, columns=columns))


def test_a_bad_mapping_is_refused(tmp_path):
    path = write(tmp_path / "log.csv", lines())
    with pytest.raises(LogError, match="got `ualpha`; did you mean `u_alpha`"):
        read_log(path, columns={"ualpha": "u_alpha"})
    message = refusal(path, columns={"u_alpha": "u_beta"})
    assert "Column `u_beta` of" in message
    assert "read as `u_alpha` and `u_beta`" in message
    assert "map `u_alpha` to another" in message
    assert "no column `flux`" in refusal(path, columns={"flux_alpha": "flux"})


def test_bad_truth_names_the_way_around_it(tmp_path):
    columns = table() | {"flux_beta": np.where(np.arange(40) == 3, np.nan, 0.2)}
    write_table(tmp_path / "log.csv", columns)
    message = refusal(tmp_path / "log.csv")
    assert "line 5, column `flux_beta`" in message
    assert "--no-truth" in message
    assert_is_table(read_log(tmp_path / "log.csv", truth=False))


def test_what_is_not_a_log_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.csv does not exist"):
        read_log(tmp_path / "none.csv")
    assert "is a directory" in refusal(tmp_path)
    (tmp_path / "log.doc").write_text("t")
    assert "'.doc', but a log is one of .csv, .txt" in refusal(tmp_path / "log.doc")
    with pytest.raises(LogError, match=r"'\.txt', but a table is one of .*\.parquet"):
        check_suffix(tmp_path / "log.txt")
    for suffix in (".parquet", ".npz"):
        path = tmp_path / f"log{suffix}"
        path.write_text("t,u_alpha\n")
        assert f"is not a readable {suffix[1:].title()}" in refusal(path).replace(
            "NPZ", "Npz"
        )
    with pytest.raises(LogError, match="suffix ''"):
        check_suffix("log")


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.zeros((40, 2)), "column `u_alpha` has shape (40, 2), but it must be a vector"),
        (np.zeros(()), "column `u_alpha` has shape ()"),
        (np.zeros(39), "column `u_alpha` has 39 entries, but `t` has 40"),
        (np.zeros(40, complex), "column `u_alpha` holds complex128"),
        (np.array(["a"] * 40), "column `u_alpha` holds <U1"),
        (
            np.array([None] * 40),
            "column `u_alpha` is not numeric: it holds an array of Py",
        ),
        (np.where(np.arange(40) == 7, np.inf, 0), "row 7 (counted from 0), column `u_al"),
    ],
)
def test_npz_arrays_are_checked(tmp_path, array, expected):
    path = tmp_path / "log.npz"
    np.savez(path, **(table() | {"u_alpha": array}))
    assert expected in refusal(path)


def test_parquet_columns_are_checked(tmp_path):
    path = tmp_path / "log.parquet"

    def message(column) -> str:
        parquet.write_table(pa.table(table() | {"u_beta": column}), path)
        return refusal(path)

    null = pa.array([None if k == 11 else 1.0 for k in range(40)])
    assert "row 11 (counted from 0), column `u_beta`: the value is blank" in message(null)
    assert "column `u_beta` holds string" in message(pa.array(["1.0"] * 40))
    assert "column `u_beta` holds list" in message(pa.array([[1.0]] * 40))
    parquet.write_table(pa.table({k: v for k, v in table().items() if k != "t"}), path)
    assert "no column `t`" in refusal(path)
    single = pa.table({k: pa.array(v, pa.float32()) for k, v in table().items()})
    parquet.write_table(single, path)
    np.testing.assert_array_equal(read_log(path).u[:, 0], np.float32(table()["u_alpha"]))


def test_signals_are_documented_in_order():
    assert list(Signals().required) == NAMES


def test_signals_of_another_system(tmp_path):
    """A position log: no input, two outputs, an optional pair."""
    k = np.arange(5.0)
    columns = {
        "t": k,
        "q_2": 2 * k,
        "q_1": k,
        "velocity_1": 1 + k,
        "f_b": 5 * k,
        "f_a": 4 * k,
    }
    write_table(tmp_path / "log.csv", columns)
    signals = Signals(inputs=(), outputs=("q_1", "q_2"), truth=("velocity_1", "velocity_2"))
    log = read_log(tmp_path / "log.csv", signals)
    assert log.u.shape == (5, 0)
    np.testing.assert_array_equal(log.y, np.stack([k, 2 * k], axis=1))
    assert list(log.truth) == ["velocity_1"]

    fed = Signals((), ("q_1",), optional=("f_a", "f_b"), truth=())
    np.testing.assert_array_equal(
        read_log(tmp_path / "log.csv", fed).u, np.stack([4 * k, 5 * k], axis=1)
    )
    assert read_log(tmp_path / "log.csv", Signals((), ("q_1",), ("g",), ())).u.size == 0
    half = Signals((), ("q_1",), optional=("f_a", "f_c"))
    message = refusal(tmp_path / "log.csv", signals=half)
    assert "no column `f_c`; perhaps" in message and "or give none of f_a, f_c" in message
    fitting = read_log(tmp_path / "log.csv", half, columns={"f_c": "f_b"})
    np.testing.assert_array_equal(fitting.u[:, 1], 5 * k)


def test_a_mapping_to_no_column_shows_what_is_close_to_it(tmp_path):
    text = ["t,Ualpha,Ubeta,Ialpha mean,Ibeta [A]", *lines()[1:]]
    path = write(tmp_path / "log.csv", text)
    message = refusal(path, columns={"i_alpha": "Ialpha"})
    assert "no column `Ialpha`" in message
    assert "--column 'i_alpha=Ialpha mean' (close to it: `Ialpha mean`)" in message
    # What the user wrote goes before what it is called here.
    text = [
        "t,u_alpha,u_beta,i_alph,i_beta,phase current",
        *(f"{k},0,0,0,0,0" for k in "01"),
    ]
    message = refusal(write(path, text), columns={"i_alpha": "phase_curent"})
    assert (
        "--column 'i_alpha=phase current' (close to it: `phase current`, `i_al" in message
    )
