"""Arguments and options that several commands take."""

from pathlib import Path
from typing import Annotated, Any

import typer

LogFile = Annotated[
    Path,
    typer.Argument(
        help="The log: text (.csv, .txt, .tsv, .dat, or these in .gz), .parquet, .npz, "
        ".mat, .tdms, or a bag of ROS (.bag, .mcap, .db3, or its folder)."
    ),
]
MachineFile = Annotated[Path, typer.Option(help="The machine, a TOML file.")]
BeforeAndAfter = Annotated[
    Path | None, typer.Option(help="A figure, before and after: .png, .pdf or .svg.")
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=COLUMN",
        help="What the log calls a column, for instance u_alpha=Ualpha, where it is not "
        "found by its name; or an expression over columns as they are, 't=Time*1e-3'; "
        "repeatable.",
    ),
]
FrameName = Annotated[
    str,
    typer.Option(
        metavar="FRAME",
        help="Frame of the log: alpha-beta; dq, columns u_d, u_q, i_d, i_q turned by the "
        "angle of their row; or abc, two or three phases u_a, u_b, u_c, i_a, i_b, i_c.",
    ),
]
AngleColumn = Annotated[
    str | None,
    typer.Option(
        metavar="COLUMN",
        help="Column of the angle of --frame dq, or an expression; by default one whose "
        "name says that it is electrical.",
    ),
]
AngleKind = Annotated[
    str | None,
    typer.Option(
        metavar="KIND",
        help="Of that angle: electrical, or mechanical, times the machine's pole pairs; "
        "electrical by default.",
    ),
]
PowerInvariant = Annotated[
    bool,
    typer.Option(
        "--power-invariant",
        help="alpha, beta, d and q of the log are power-invariant, sqrt(3/2) times the "
        "amplitude-invariant ones.",
    ),
]
MissingSamples = Annotated[
    str,
    typer.Option(
        metavar="WAY",
        help="What to do of a sample that is blank or not finite: refuse the log; coast, "
        "let the observer go on without; or interpolate by straight lines.",
    ),
]
MostMissing = Annotated[
    int,
    typer.Option(min=1, help="Rows next to each other that are interpolated at most."),
]
RemoveOffset = Annotated[
    str | None,
    typer.Option(
        metavar="standstill|periods",
        help="Take from stator voltages and currents what is constant in them, told from a "
        "standstill of the log or over whole electrical periods; it is stated.",
    ),
]
MaxGap = Annotated[
    float | None,
    typer.Option(help="Longest interval allowed (s); by default ten median ones."),
]
QuietSummary = Annotated[
    bool, typer.Option("--quiet", "-q", help="Neither summary nor progress.")
]
QuietTable = Annotated[
    bool, typer.Option("--quiet", "-q", help="Neither table nor progress.")
]


def reading(
    frame: str,
    angle: str | None,
    angle_kind: str | None,
    power_invariant: bool,
    missing: str,
    most_missing: int,
    pole_pairs: int | None,
    remove_offset: str | None = None,
) -> dict[str, Any]:
    """What `read_log` takes, of the options above and the machine's `pole_pairs`."""
    from ..logs import Frame

    return {
        "frame": Frame(frame, angle, angle_kind, pole_pairs, power_invariant),
        "missing": missing,
        "most_missing": most_missing,
        "remove_offset": remove_offset,
    }


def double_precision() -> None:
    """What every command computes in. JAX is imported here, and not before a command runs:
    help and a wrong option do without."""
    import jax

    jax.config.update("jax_enable_x64", True)


def option(name: str) -> str:
    """That of a key."""
    return "--" + name.replace("_", "-")


def stated_rates(**rates: float | None) -> dict[str, float]:
    """Those that options give (rad/s), by key.

    **Raises:** `ValueError` for one that is not positive."""
    from .._checks import positive

    given = {name: value for name, value in rates.items() if value is not None}
    for name, value in given.items():
        positive(option(name), value, "rad/s")
    return given


def refuse_rates(given: dict[str, float], description: Any, machine: Path) -> None:
    """Refuse rates that the kind of a machine does not have.

    **Raises:** [`MachineError`][]."""
    from ..machines import MachineError

    for name in given:
        if name in description.refused:
            raise MachineError(
                f"{option(name)} is not for {machine}, whose kind is "
                f'"{description.kind}": {description.refused[name]}.'
            )


def mapping(options: list[str] | None) -> dict[str, str]:
    """The columns of `--column`, by name.

    **Raises:** `ValueError` for one that is not `NAME=COLUMN`, or given twice.
    """
    columns: dict[str, str] = {}
    for option in options or []:
        name, equals, actual = option.partition("=")
        if not (name and equals and actual):
            raise ValueError(
                f"--column must have the form NAME=COLUMN, for instance u_alpha=Ualpha, "
                f"but is {option!r}."
            )
        if name in columns:
            raise ValueError(
                f"--column gives `{name}` twice, {columns[name]} and {actual}; keep one."
            )
        columns[name] = actual
    return columns
