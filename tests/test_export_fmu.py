"""Exported FMUs, validated and run by FMPy: the numbers of the C that they wrap."""

import shutil
import zipfile

import numpy as np
import pytest
from compiled_c import Compiled, compiler, rows_of
from exported_motor import LOG, MOTOR, command, export_motor

from aslo_jax.export._fmu import _built, this_platform
from aslo_jax.logs import read_log

fmpy = pytest.importorskip("fmpy")
from fmpy.validation import validate_fmu  # noqa: E402

ROWS, H = 151, 2e-4
NAMES = (
    "theta_electrical",
    "certificate",
    "coasting",
    "coasting_speed",
    "flux_alpha",
    "flux_beta",
    "omega_electrical",
)


@pytest.fixture(scope="module")
def log():
    return read_log(LOG)


@pytest.fixture(scope="module")
def made():
    return export_motor()


@pytest.fixture(scope="module")
def expected(made, log, tmp_path_factory):
    code = Compiled(made, tmp_path_factory.mktemp("c"))
    return code(rows_of(log.u, log.y)[:ROWS])


@pytest.fixture(scope="module", params=[2, 3])
def fmu(request, made, tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "motor.fmu"
    return request.param, made.write_fmu(path, request.param)


def signals(log):
    rows = np.column_stack([log.t, log.u, log.y])
    names = ("time", "u_alpha", "u_beta", "i_alpha", "i_beta")
    return np.array([tuple(row) for row in rows], [(name, float) for name in names])


def simulated(path, log, **settings):
    given = dict(step_size=H, output_interval=H, input=signals(log))
    found = fmpy.simulate_fmu(str(path), stop_time=(ROWS - 1) * H, **(given | settings))
    return np.stack([found[name].astype(float) for name in NAMES], axis=1)


def test_it_is_valid_and_has_what_it_says(fmu):
    version, path = fmu
    assert validate_fmu(str(path)) == []
    described = fmpy.read_model_description(str(path), validate=True)
    assert described.fmiVersion.startswith(str(version))
    assert described.coSimulation.canGetAndSetFMUstate
    assert described.coSimulation.canSerializeFMUstate
    inside = zipfile.ZipFile(path).namelist()
    assert {"sources/motor.c", "sources/motor.h", f"sources/motor_fmi{version}.c"} < set(
        inside
    )
    assert any(name.startswith("binaries/") for name in inside)
    text = zipfile.ZipFile(path).read("sources/motor.c").decode()
    assert text == export_motor().files["motor.c"]


def test_it_has_the_bits_of_the_c(fmu, log, expected):
    """One interval late: at the end of a step it gives what is known at its beginning."""
    _, path = fmu
    found = simulated(path, log)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_allclose(found[1:], expected[:-1], rtol=1e-12, atol=1e-15)


def test_parameters_are_those_of_the_c(fmu, made, log, tmp_path):
    _, path = fmu
    values = [float(f.default) for f in made.parameters]
    names = [f.name for f in made.parameters]
    values[names.index("first_filter_rate")] = 70.0
    rows = rows_of(log.u, log.y)[:ROWS]
    expected = Compiled(made, tmp_path)(rows, values)
    found = simulated(path, log, start_values={"first_filter_rate": 70.0})
    np.testing.assert_allclose(found[1:], expected[:-1], rtol=1e-12, atol=1e-15)


def test_a_state_is_restored_also_from_bytes(fmu, log):
    version, path = fmu
    folder = fmpy.extract(str(path))
    described = fmpy.read_model_description(folder)
    number = {v.name: v.valueReference for v in described.modelVariables}
    inputs = [number[n] for n in ("u_alpha", "u_beta", "i_alpha", "i_beta")]
    outputs = [number[n] for n in ("flux_alpha", "flux_beta", "omega_electrical")]
    kind = fmpy.fmi2.FMU2Slave if version == 2 else fmpy.fmi3.FMU3Slave
    unit = kind(
        guid=described.guid,
        modelIdentifier="motor",
        unzipDirectory=folder,
        instanceName="one",
    )
    put = unit.setReal if version == 2 else unit.setFloat64
    get = unit.getReal if version == 2 else unit.getFloat64
    save = unit.getFMUState
    unit.instantiate()
    if version == 2:
        unit.setupExperiment(startTime=0.0)
        unit.enterInitializationMode()
    else:
        unit.enterInitializationMode(startTime=0.0)
    put(inputs, [0.0, 0.0, *log.y[0]])
    unit.exitInitializationMode()

    def run(first, last):
        found = []
        for k in range(first, last):
            put(inputs, [*map(float, log.u[k]), *map(float, log.y[k])])
            unit.doStep(currentCommunicationPoint=k * H, communicationStepSize=H)
            found.append(get(outputs))
        return found

    run(0, 40)
    state = save()
    bytes_ = unit.serializeFMUState(state)
    later = run(40, 70)
    unit.setFMUState(state)
    assert run(40, 70) == later
    again = unit.deserializeFMUState(bytes_)
    unit.setFMUState(again)
    assert run(40, 70) == later
    unit.freeFMUState(state)
    with pytest.raises(Exception, match="DoStep"):
        unit.doStep(currentCommunicationPoint=70 * H, communicationStepSize=2 * H)
    unit.terminate()
    unit.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.mark.parametrize("version", [2, 3])
def test_single_precision_and_intervals_that_vary(version, log, tmp_path):
    made = export_motor(interval=None, dtype="float32")
    path = made.write_fmu(tmp_path / "motor.fmu", version)
    assert validate_fmu(str(path)) == []
    rows = rows_of(log.u, log.y, np.diff(log.t))[:ROWS]
    expected = Compiled(made, tmp_path / "c")(rows)
    found = simulated(path, log)
    np.testing.assert_allclose(found[1:], expected[:-1], rtol=2e-3, atol=2e-3)


def test_the_command_writes_one_and_other_versions_are_refused(made, tmp_path):
    given = ("export", MOTOR, "--target", "fmu3", "--interval", H, "--out", tmp_path)
    assert command(*given) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["motor.fmu"]
    with pytest.raises(ValueError, match="`version` must be 2 or 3"):
        made.write_fmu(tmp_path / "x.fmu", 1)


def test_a_compiler_that_fails_or_is_absent_is_named(monkeypatch):
    assert compiler()
    with pytest.raises(OSError, match="The C compiler failed"):
        _built({"x.c": "int f( { return 0; }"}, this_platform())
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(OSError, match='install one, or "pip install ziglang"'):
        _built({"x.c": "int f(void);"}, this_platform())
    with pytest.raises(OSError, match=r'for aarch64-darwin in it, .* that: "pip install'):
        _built({"x.c": "int f(void);"}, "aarch64-darwin")


def test_platforms_that_are_not_known_are_refused(made, tmp_path, capsys):
    with pytest.raises(ValueError, match="`platforms` must hold names of x86_64-linux"):
        made.write_fmu(tmp_path / "x.fmu", 3, ["vax-vms"])
    given = ("export", MOTOR, "--interval", H, "--out", tmp_path)
    assert command(*given, "--platform", "x86_64-windows") == 2
    assert "give --target fmu3" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.fixture
def ziglang_alone(monkeypatch):
    """As where there is no other C compiler."""
    pytest.importorskip("ziglang", reason="ziglang, a C compiler of 100 MB")
    monkeypatch.setattr(shutil, "which", lambda name: None)


@pytest.mark.slow
def test_the_compiler_of_the_wheel_gives_the_same_numbers(
    made, log, expected, ziglang_alone, tmp_path
):
    path = made.write_fmu(tmp_path / "motor.fmu", 3)
    found = simulated(path, log)
    np.testing.assert_allclose(found[1:], expected[:-1], rtol=1e-12, atol=1e-15)


# What a shared library of each system begins with. Windows is left out: its first one takes
# a minute.
MAGIC = {
    "aarch64-linux": b"\x7fELF\x02\x01",
    "x86_64-darwin": b"\xcf\xfa\xed\xfe\x07\x00\x00\x01",
    "aarch64-darwin": b"\xcf\xfa\xed\xfe\x0c\x00\x00\x01",
}


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_binaries_for_other_platforms(version, made, ziglang_alone, tmp_path):
    path = made.write_fmu(tmp_path / "motor.fmu", version, list(MAGIC))
    with zipfile.ZipFile(path) as archive:
        for name, magic in MAGIC.items():
            folder = "darwin64" if (version, name) == (2, "x86_64-darwin") else name
            suffix = ".so" if name.endswith("linux") else ".dylib"
            content = archive.read(f"binaries/{folder}/motor{suffix}")
            assert content.startswith(magic)
            assert f"fmi{version}DoStep".encode() in content
    assert validate_fmu(str(path)) == []
