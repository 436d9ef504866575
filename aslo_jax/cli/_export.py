"""`aslo-jax export`: the observer of a machine as C or as an FMU."""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from .._choices import MOST_SUBSTEPS
from ._options import double_precision, option, refuse_rates, stated_rates

TARGETS = ("c", "fmu2", "fmu3")
CUTOFF = (
    "Cutoff of the filter (rad/s), in place of the machine's; needed where that has none, "
    "since there is no log to choose it for."
)


def export(
    machine: Annotated[Path, typer.Argument(help="The machine, a TOML file.")],
    out: Annotated[Path, typer.Option(help="The folder to write to; it is made.")],
    target: Annotated[
        str, typer.Option(metavar="|".join(TARGETS), help="What to make of it.")
    ] = "c",
    interval: Annotated[
        float | None, typer.Option(help="From step to step (s), a constant.")
    ] = None,
    variable_interval: Annotated[
        bool,
        typer.Option("--variable-interval", help="Every step is given its interval."),
    ] = False,
    dtype: Annotated[
        str, typer.Option(metavar="float32|float64", help="The type of its numbers.")
    ] = "float64",
    prefix: Annotated[
        str | None,
        typer.Option(help="Of every symbol and file; by default the machine's."),
    ] = None,
    cutoff: Annotated[float | None, typer.Option(help=CUTOFF)] = None,
    pll_bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Bandwidth of the phase-locked loop (rad/s) of a motor, in place of the "
            "machine's; by default 100."
        ),
    ] = None,
    substeps: Annotated[
        int,
        typer.Option(
            min=1,
            max=MOST_SUBSTEPS,
            help="Steps per sampling interval, between which outputs are interpolated.",
        ),
    ] = 1,
    missing: Annotated[
        str,
        typer.Option(
            metavar="refuse|coast",
            help="A sample that is not finite: refused, or taken as missing.",
        ),
    ] = "refuse",
    platform: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="A further platform for the binaries of an FMU, by its name in FMI 3, "
            "such as x86_64-windows, by the ziglang wheel; repeatable.",
        ),
    ] = None,
    fixed: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help='A parameter that becomes a constant, or "all"; repeatable.',
        ),
    ] = None,
) -> None:
    """Write the observer of a MACHINE as a program for the processor of its drive: C99 that
    needs no library, with a test, a filter of CSV files, and a README of what is in it; or
    that C as an FMU, for simulators.

    A motor's comes with a phase-locked loop for its angle, in one turn, and its speed.
    """
    double_precision()
    from ..machines import read_machine

    if target not in TARGETS:
        raise ValueError(
            f"--target must be one of {', '.join(TARGETS)}, but is {target!r}."
        )
    if platform and target == "c":
        raise ValueError(
            "--platform is of the binaries of an FMU, but --target is c, which has none; "
            "remove it, or give --target fmu3."
        )
    if (interval is None) != variable_interval:
        raise ValueError(
            "give either --interval, the seconds from step to step, or "
            "--variable-interval, with which every step is given them."
        )
    given = stated_rates(cutoff=cutoff, pll_bandwidth=pll_bandwidth)
    description = read_machine(machine)
    refuse_rates(given, description, machine)
    name = _prefix(machine) if prefix is None else prefix
    words = _command(
        machine, target, interval, dtype, name, given, substeps, missing, fixed
    )
    exported = exported_machine(
        description,
        machine,
        given,
        interval=interval,
        dtype=dtype,
        prefix=name,
        substeps=substeps,
        missing=missing,
        fixed=tuple(fixed or ()),
        command=words,
    )
    if target == "c":
        paths = exported.write(out)
    else:
        path = out / f"{name}.fmu"
        paths = [exported.write_fmu(path, int(target[-1]), tuple(platform or ()))]
    for path in paths:
        typer.echo(path)
    typer.echo(
        f"{exported.operations} operations a step in {dtype}, {exported.state_bytes} bytes "
        f"of state, {len(exported.parameters)} parameters"
    )


def exported_machine(
    description: Any, path: Path, given: Mapping[str, float], **settings: Any
) -> Any:
    """The observer of a machine as C, with the phase-locked loop of a motor."""
    import numpy as np

    from .. import export
    from ..machines import MachineError
    from ..machines._lifted import is_lifted
    from ..observers import PhaseLockedLoop, Staged

    known = description.stated(given)
    fields = type(description.observer).model_fields
    chosen = description.default_rates(None, known)
    if not is_lifted(description.observer) and "cutoff" not in {**known, **chosen}:
        raise MachineError(
            f"{path} has no `observer.cutoff`, and there is no log to choose it for: give "
            "--cutoff, in rad/s."
        )
    if description.lacks_noise:
        raise MachineError(
            f"{path} leaves the noise of its Kalman filter to a log: give "
            "`observer.output_deviation` and `observer.input_deviation`."
        )
    rates, signals = description.rates(given=given), description.signals
    interval = settings["interval"]
    observer, connect = description.state_observer(rates), description.followed()
    inputs = (*signals.inputs, *signals.optional)
    notes = {
        "u": f"{', '.join(inputs)}; {signals.note}",
        "y": f"{', '.join(signals.outputs)}; {signals.note}",
    }
    columns = {"u": inputs, "y": signals.outputs}
    outputs = None
    if connect is not None and "pll_bandwidth" in fields:
        bandwidth = rates["pll_bandwidth"].constant
        if interval is not None and interval * bandwidth > 0.5:
            raise MachineError(
                f"the bandwidth of the phase-locked loop must be at most "
                f"{0.5 / interval:.4g} rad/s for an interval of {interval:.4g} s, but is "
                f"{bandwidth:.4g}; lower --pll-bandwidth."
            )
        loop = PhaseLockedLoop(bandwidth, within=True)
        observer, outputs = Staged(observer, loop, connect), _of_motor
        notes |= {
            "flux": "Wb, alpha and beta",
            "angle": "rad, electrical, in one turn",
            "speed": "rad/s, electrical",
            "coasting": "whether the flux is carried along, since it is not observable now",
            "coasting_speed": "also until the loop follows the angle, or where it does not",
            "certificate": "dimensionless, small where the flux is not observable",
            "connect_inductance": "H, for the angle: change it with that of the relation",
        }
        columns |= {
            "flux": ("flux_alpha", "flux_beta"),
            "angle": ("theta_electrical",),
            "speed": ("omega_electrical",),
        }
    return export.export_c(
        observer,
        u=np.zeros(len(inputs)),
        y=np.zeros(len(signals.outputs)),
        outputs=outputs,
        notes=notes,
        columns=columns,
        **settings,
    )


def _of_motor(estimate: Any) -> dict[str, Any]:
    """What a drive wants, by name."""
    flux, loop = estimate["first"], estimate["second"]
    found = {
        "flux": flux.value,
        "certificate": flux.certificate,
        "coasting": flux.coasting,
        "angle": loop.value[..., 0],
        "speed": loop.value[..., 1],
        "coasting_speed": flux.coasting | loop.coasting,
    }
    return found if flux.covariance is None else found | {"covariance": flux.covariance}


def _prefix(machine: Path) -> str:
    """The name of a file as one of C."""
    name = re.sub(r"\W", "_", machine.stem, flags=re.ASCII)
    return (name if name[:1].isalpha() else f"machine_{name}")[:31]


def _command(
    machine: Path,
    target: str,
    interval: float | None,
    dtype: str,
    prefix: str,
    given: Mapping[str, float],
    substeps: int,
    missing: str,
    fixed: list[str] | None,
) -> str:
    """What was typed, without folders."""
    words = ["aslo-jax", "export", machine.name, "--target", target]
    words += (
        ["--variable-interval"] if interval is None else ["--interval", f"{interval:g}"]
    )
    words += ["--dtype", dtype, "--prefix", prefix]
    words += [word for k, v in given.items() for word in (option(k), f"{v:g}")]
    words += ["--substeps", str(substeps), "--missing", missing]
    words += [word for name in fixed or () for word in ("--fixed", name)]
    return shlex.join([*words, "--out", "."])
