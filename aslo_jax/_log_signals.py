"""Which columns a log has: a value that readers, machines and messages share."""

import dataclasses


@dataclasses.dataclass(frozen=True)
class Signals:
    """The columns of a log beside `t` (s), in SI units; by default those of a motor in the
    stationary amplitude-invariant frame, voltages (V) and currents (A) in, fluxes (Wb),
    angle (rad) and speed (rad/s) for scoring.

    - `inputs`, `outputs`: those of u and of y, in order;
    - `optional`: further inputs, all or none of them;
    - `truth`: for scoring only, any of them;
    - `note`: frame and sign of these, in words.
    """

    inputs: tuple[str, ...] = ("u_alpha", "u_beta")
    outputs: tuple[str, ...] = ("i_alpha", "i_beta")
    optional: tuple[str, ...] = ()
    truth: tuple[str, ...] = (
        "flux_alpha",
        "flux_beta",
        "theta_electrical",
        "omega_electrical",
        "omega_mechanical",
    )
    note: str = "stationary frame, amplitude-invariant"

    @property
    def required(self) -> tuple[str, ...]:
        """What every log must have, `t` first."""
        return ("t", *self.inputs, *self.outputs)

    @property
    def names(self) -> tuple[str, ...]:
        """Every column that may be read."""
        return (*self.required, *self.optional, *self.truth)


MOTOR = Signals()
