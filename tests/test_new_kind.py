"""A kind of machine that is added at run time, by one class and one entry of the registry:
estimate, study, calibrate, help and templates know it, and nothing takes it for another."""

import re
import tomllib
from typing import ClassVar, Literal

import held_logs
import numpy as np
import pytest

from aslo_jax.cli import main
from aslo_jax.described import calibrate_machine, calibrate_study
from aslo_jax.logs import Signals, read_log, write_table
from aslo_jax.machines import (
    KINDS,
    AbstractDescription,
    Layout,
    MachineError,
    Quantity,
    Rate,
    Study,
    Unknowns,
    offers,
    read_machine,
)
from aslo_jax.machines._base import algebraic, certified, in_columns
from aslo_jax.plants import PMSM
from aslo_jax.schema import Positive, Table, Whole, key
from aslo_jax.study import open_study
from aslo_jax.study._config import ConfigurationError, configure

FLUX = ("flux_a", "flux_b")
# A two-phase generator, by other keys and columns than the motors have.
R, L, M, POLES, SPEED = 1.7, 9e-3, 0.11, 8, 90.0


class GeneratorTable(Table):
    """`[machine]` of the generator."""

    kind: Literal["generator"] = key("the kind of machine", example="generator")
    resistance: Positive = key("of a phase", "ohm", example=R)
    inductance: Positive = key("of a phase", "H", example=L)
    magnet_flux: Positive = key("of the rotor", "Wb", example=M)
    poles: Whole = key("number of poles", example=POLES)


class GeneratorObserver(Table):
    """`[observer]` of the generator."""

    cutoff: Positive | None = key("cutoff", "rad/s", default=None, example=30.0)
    threshold: Positive = key("certificate", default=1e-3)


class DriveTable(Table):
    """What a study adds to the generator."""

    inertia: Positive = key("of the rotor", "kg m^2")


def generator(table, inertia=1.0):
    pole_pairs = table.poles // 2
    return PMSM(table.resistance, table.inductance, table.magnet_flux, pole_pairs, inertia)


class GeneratorDescription(AbstractDescription[GeneratorTable, GeneratorObserver]):
    """Fluxes of a generator."""

    machine: GeneratorTable
    observer: GeneratorObserver = GeneratorObserver()

    kind = "generator"
    title = "Two-phase generator"
    layout = Layout(
        Signals(("u_a", "u_b"), ("i_a", "i_b"), truth=FLUX, note="two phases"),
        (Quantity("flux", FLUX, "Wb", turns=True),),
    )
    motion = "does it turn?"
    residual = "| |flux - L i| / m - 1 |"
    refused: ClassVar = {"pll_bandwidth": "its angle is not estimated; remove it"}
    longest_interval = 5e-3
    unknowns = Unknowns(("resistance",), further=("inductance",))
    study = Study(
        machine=GeneratorTable,
        acting=DriveTable,
        entries=FLUX,
        units=("Wb", "Wb"),
        plant=lambda table: generator(table, table.inertia),
        start=lambda plant, table: None,
        observers=offers.algebraic(lambda g: (g.flux_relation(),), threshold=7e-4),
        controls=("open_loop",),
    )

    def plant(self):
        return generator(self.machine)

    def default_rates(self, log, stated):
        return {} if "cutoff" in stated else {"cutoff": Rate(30.0, "by default")}

    def state_observer(self, rates):
        relation = self.plant().flux_relation()
        return algebraic(relation, rates["cutoff"].value, threshold=self.observer.threshold)

    def columns(self, estimate, log):
        return in_columns(FLUX, estimate.value) | certified(estimate)

    def truth(self, log):
        return log.truth

    def residuals(self, columns, log):
        flux = np.stack([columns[name] for name in FLUX], axis=1)
        size = np.linalg.norm(flux - self.machine.inductance * log.y, axis=1)
        return {"flux": np.abs(size / self.machine.magnet_flux - 1.0)}


STUDY = f"""
title = "A generator"
interval = 1e-3
horizon = 0.2

[machine]
kind = "generator"
resistance = {R}
inductance = {L}
magnet_flux = {M}
poles = {POLES}
inertia = 0.01

[control]
kind = "open_loop"
signal = {{ kind = "supply", amplitude = 10.0, frequency = 60.0 }}

[observers.ASLO]
kind = "aslo"
cutoff = 30.0

[[sensor]]
kind = "noise"
deviation = 0.01

[spread.resistance]
where = "plant.resistance"
distribution = "uniform"
low = 0.9
high = 1.1
relative = true

[metrics.rms]
kind = "rms"
"""
METHODS = ("plant", "default_rates", "state_observer", "columns", "truth", "residuals")


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(KINDS, "generator", GeneratorDescription)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Of a motor that turns, by the columns of a generator, with noise of 2 mA."""
    recorded = held_logs.motor(R, L, L, M, POLES // 2, SPEED, 4.0, dt=5e-4, rows=1201)
    columns = {"t": recorded["t"]}
    for name in ("u", "i", "flux"):
        for old, new in (("alpha", "a"), ("beta", "b")):
            columns[f"{name}_{new}"] = recorded[f"{name}_{old}"]
    rng = np.random.default_rng(3)
    for name in ("i_a", "i_b"):
        columns[name] = columns[name] + rng.normal(0.0, 2e-3, columns["t"].size)
    path = tmp_path_factory.mktemp("generator") / "log.npz"
    write_table(path, columns)
    return path


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    output = capsys.readouterr()
    return int(left.value.code or 0), output.out, output.err


@pytest.fixture
def machine(tmp_path, capsys):
    code, printed, _ = run(capsys, "sample", "--kind", "generator")
    assert code == 0
    path = tmp_path / "machine.toml"
    path.write_text(printed)
    return path


def test_help_and_template_know_it(capsys, machine):
    assert f"magnet_flux = {M}" in machine.read_text()
    assert read_machine(machine).kind == "generator"
    _, printed, _ = run(capsys, "estimate", "--help")
    assert "generator\n    in: t, u_a, u_b, i_a, i_b\n    out: t, flux_a, flux_b (Wb)" in (
        printed
    )


def test_a_log_is_estimated(capsys, tmp_path, log, machine):
    out = tmp_path / "out.npz"
    code, printed, err = run(capsys, "estimate", log, "--machine", machine, "--out", out)
    assert (code, err) == (0, "")
    assert "observer for generator: exact start" in printed
    assert "cutoff 30 rad/s (by default)" in " ".join(printed.split())
    with np.load(out) as table:
        late = table["t"] > 0.2
        error = np.hypot(table["error_flux_a"][late], table["error_flux_b"][late])
    assert np.median(error) < 0.01 * M
    code, _, err = run(
        capsys, "estimate", log, "--machine", machine, "--out", out, "--pll-bandwidth", 9
    )
    assert code == 2 and "its angle is not estimated" in err


@pytest.mark.slow
def test_what_it_offers_is_calibrated(capsys, tmp_path, log, machine):
    machine.write_text(machine.read_text().replace(f"resistance = {R}", "resistance = 1.8"))
    out = tmp_path / "found.toml"
    code, printed, err = run(
        capsys, "calibrate", log, "--machine", machine, "--out", out, "-q"
    )
    assert (code, printed, err) == (0, "", "")
    found = read_machine(out).machine
    assert found.resistance == pytest.approx(R, rel=0.01)
    assert (found.inductance, found.magnet_flux) == (L, M)
    recorded = read_log(log, GeneratorDescription.layout.signals)
    with pytest.raises(MachineError, match="must name one of resistance, inductance for a"):
        calibrate_machine(read_machine(machine), recorded, ["magnet_flux"])
    _, values = calibrate_study(tomllib.loads(STUDY), recorded)
    assert values["machine"]["resistance"] == pytest.approx(R, rel=0.01)
    assert values["sensor.0"]["deviation"] == pytest.approx(2e-3, rel=0.2)


def test_a_study_runs_with_what_it_offers(capsys, tmp_path):
    path, out = tmp_path / "study.toml", tmp_path / "out"
    path.write_text(STUDY)
    options = ("--samples", 4, "--engine", "scan", "--quiet", "--no-report", "--out", out)
    code, _, err = run(capsys, "study", path, *options)
    assert (code, err) == (0, "")
    rms = open_study(out / "study.zarr")["rms"]
    assert rms.shape == (4, 1, 2) and np.isfinite(rms).all()
    experiment = configure(tomllib.loads(STUDY)).experiment
    assert experiment.plant.pole_pairs == POLES // 2
    assert experiment.observers["ASLO"].guard.threshold == 7e-4


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            '"aslo"',
            '"fo3"\ngain = 1.0',
            '"fo3", is for "pmsm" or "wrim", but `machine.kind` is "gen',
        ),
        ("inertia = 0.01", "", "`machine.inertia`, of the rotor (kg m^2), is missing"),
        ("inertia = 0.01", "load = 1.0", "unknown key `machine.load`"),
        ('"rms"', '"angle"', '"angle", is for "pmsm", but `machine.kind` is "generator"'),
        ('"generator"', '"generater"', "'generater'; did you mean `generator`?"),
    ],
)
def test_what_it_does_not_offer_is_refused(old, new, expected):
    with pytest.raises(ConfigurationError) as caught:
        configure(tomllib.loads(STUDY.replace(old, new, 1)))
    assert expected in str(caught.value)


def test_a_kind_that_offers_nothing_is_refused_by_name(monkeypatch, machine, log):
    """No study, no parameters: it is not taken for a kind that has them."""

    class Silent(AbstractDescription[GeneratorTable, GeneratorObserver]):
        machine: GeneratorTable
        observer: GeneratorObserver = GeneratorObserver()

        kind = "generator"
        layout = GeneratorDescription.layout
        refused: ClassVar = {}
        plant, default_rates, state_observer, columns, truth, residuals = (
            getattr(GeneratorDescription, name) for name in METHODS
        )

    monkeypatch.setitem(KINDS, "generator", Silent)
    recorded = read_log(log, Silent.layout.signals)
    refusal = 'of kind "generator" has no calibration: its description offers no parameters'
    with pytest.raises(MachineError, match=refusal):
        calibrate_machine(read_machine(machine), recorded)
    with pytest.raises(ConfigurationError, match=r"must be one of .* but is 'generator'"):
        configure(tomllib.loads(STUDY))


def test_an_unknown_kind_is_refused_with_the_nearest(capsys, tmp_path, machine, log):
    machine.write_text(machine.read_text().replace('"generator"', '"generatr"'))
    arguments = ("--machine", machine, "--out", tmp_path / "out.npz")
    code, _, err = run(capsys, "estimate", log, *arguments)
    assert code == 2
    assert "\"generator\", but is 'generatr'; did you mean `generator`?" in err
    content = tomllib.loads(STUDY)
    content["machine"]["kind"] = "double_integrator"
    recorded = read_log(log, GeneratorDescription.layout.signals)
    with pytest.raises(MachineError, match=r"a log must be one of .*'double_integrator'"):
        calibrate_study(content, recorded)


def test_a_class_that_lacks_what_all_ask_for_is_refused():
    class Coastless(Table):
        cutoff: Positive | None = None

    methods = {name: getattr(GeneratorDescription, name) for name in METHODS}
    for name, machine, observer, lacking in (
        ("wrong", GeneratorTable, GeneratorObserver, 'type Literal["wrong"]'),
        ("generator", GeneratorTable, Coastless, "must have the key `threshold`"),
    ):
        body = {"__module__": __name__, "kind": name, "layout": GeneratorDescription.layout}
        body |= {"__annotations__": {"machine": machine, "observer": observer}} | methods
        with pytest.raises(TypeError, match=re.escape(lacking)):
            type("Broken", (AbstractDescription[machine, observer],), body)


def test_what_the_registered_kinds_offer_exists():
    """A name that no table has would never be reached."""
    from aslo_jax.machines import studies
    from aslo_jax.study._config import control, metrics, observers

    def kinds(union):
        return {
            name
            for table in union.__args__[0].__args__
            for name in table.model_fields["kind"].annotation.__args__
        }

    for study in studies().values():
        assert set(study.observers) <= kinds(observers.Observer)
        assert set(study.controls) <= kinds(control.Control)
        assert set(study.metrics) <= kinds(metrics.Metric)
        assert len(study.entries) == len(study.units)
    for kind in KINDS.values():
        table = kind.model_fields["machine"].annotation
        named = {*kind.unknowns.usual, *kind.unknowns.further}
        assert named <= set(table.model_fields)
        assert bool(named) != bool(kind.unknowns.refused)
