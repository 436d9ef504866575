"""`aslo-jax estimate` on structs of MATLAB whose fields are named in expressions."""

import json

import numpy as np
import pytest
from motor_logs import Motor, described, in_alpha_beta, noisy, run

from aslo_jax.cli import main

SPOOL = Motor("spool", "pmsm", 1.9, 5.5e-3, 5.5e-3, 0.15, 4, 280.0, 3.0, 1e-4)
OPTIONS = {
    "t": "log.t*1e-3",  # ms
    "u_alpha": "log.bridge.u_al/10",  # of a probe
    "u_beta": "-log.bridge.u_be/10",
    "i_alpha": "log.i_al",
    "i_beta": "1e-3*log.i_be",  # mA
}


def recorded() -> dict[str, np.ndarray]:
    return in_alpha_beta(noisy(run(SPOOL, "rich", 2001), SPOOL, 5, 0.004))


def fields(log: dict[str, np.ndarray]) -> dict:
    """A struct `log` that gives them by `OPTIONS`."""
    return {
        "t": 1e3 * log["t"],
        "bridge": {"u_al": 10 * log["u_alpha"], "u_be": -10 * log["u_beta"]},
        "i_al": log["i_alpha"],
        "i_be": 1e3 * log["i_beta"],
    }


def by_scipy(path, log) -> None:
    from scipy.io import savemat

    savemat(path, {"log": fields(log)}, oned_as="column")


def by_h5py(path, log) -> None:
    h5py = pytest.importorskip("h5py")

    def write(group, values) -> None:
        for name, value in values.items():
            if isinstance(value, dict):
                write(group.create_group(name), value)
                group[name].attrs["MATLAB_class"] = np.bytes_("struct")
            else:
                group[name] = value[None, :]  # a column of MATLAB, stored by columns
                group[name].attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        write(file, {"log": fields(log)})
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64")


def estimate(folder, log, *options: str):
    """The table and the summary for programs."""
    out, summary = folder / "out.npz", folder / "out.json"
    described(SPOOL, folder / "motor.toml")
    paths = ["--machine", folder / "motor.toml", "--out", out, "--json", summary]
    with pytest.raises(SystemExit) as left:
        main(["estimate", str(folder / log), *map(str, paths), "-q", *options])
    assert not left.value.code
    with np.load(out) as table:
        return dict(table), json.loads(summary.read_text())


@pytest.mark.parametrize("write", [by_scipy, by_h5py])
def test_expressions_name_fields_of_a_struct_in_a_file(write, tmp_path, capsys):
    log = recorded()
    np.savez(tmp_path / "plain.npz", **log)
    right, _ = estimate(tmp_path, "plain.npz")
    write(tmp_path / "log.mat", log)
    options = [x for name, says in OPTIONS.items() for x in ("--column", f"{name}={says}")]
    table, summary = estimate(tmp_path, "log.mat", *options)
    assert capsys.readouterr().err == ""
    assert summary["warnings"] == []
    assert list(table) == list(right)
    for name in ("t", "flux_alpha", "flux_beta", "coasting"):
        np.testing.assert_allclose(table[name], right[name], rtol=1e-9, atol=1e-12)


def test_a_field_that_is_not_there_is_refused_with_those_that_are(tmp_path, capsys):
    by_scipy(tmp_path / "log.mat", recorded())
    described(SPOOL, tmp_path / "motor.toml")
    paths = ["--machine", tmp_path / "motor.toml", "--out", tmp_path / "out.npz"]
    column = ["--column", "t=log.time*1e-3"]
    with pytest.raises(SystemExit) as left:
        main(["estimate", str(tmp_path / "log.mat"), *column, *map(str, paths)])
    assert left.value.code
    err = capsys.readouterr().err
    assert "has no column `log.time`" in err and "`log.bridge.u_al`" in err
