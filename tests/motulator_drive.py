"""A drive of motulator, simulated, and `data/motulator.npz`, what its controller and its
model recorded: made by `python tests/motulator_drive.py` with motulator 0.18.0, which needs
Python 3.12, for where that is absent. Nothing of motulator's own is in it."""

from math import pi
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

RECORDED = Path(__file__).parent / "data" / "motulator.npz"
RESISTANCE, INDUCTANCE, MAGNET_FLUX, POLE_PAIRS = 3.6, 0.04, 0.545, 3
PERIOD = 250e-6  # s
SERIES = {
    "ctrl": ("t",),
    "ctrl.fbk": ("i_s", "u_s_zoh", "theta_c"),
    "ctrl.ref": ("enabled",),
    "mdl": ("t",),
    "mdl.machine": ("psi_s_ab", "theta_m", "w_M"),
}


def simulate(t1: float, observer: Any = None, enable: Any = True) -> Any:
    """The results of a speed step, sensorless; with an `observer` in place of the one of
    motulator."""
    import motulator.drive.control.sm as control
    from motulator.drive import model

    par = model.SynchronousMachinePars(
        n_p=POLE_PAIRS, R_s=RESISTANCE, L_d=INDUCTANCE, L_q=INDUCTANCE, psi_f=MAGNET_FLUX
    )
    drive = model.Drive(
        model.SynchronousMachine(par),
        model.MechanicalSystem(J=0.015, B_L=0),
        model.VoltageSourceConverter(u_dc=540),
    )
    settings = control.CurrentVectorControllerCfg(
        i_s_max=10.0, T_s=PERIOD, alpha_c=2 * pi * 100
    )
    vector = control.CurrentVectorController(par, settings)
    if observer is not None:
        vector.observer = observer
    system = control.VectorControlSystem(
        vector, control.SpeedController(J=0.015, alpha_s=2 * pi * 4)
    )
    system.set_speed_ref(lambda t: (t > 0.005) * 2 * pi * 20)
    system.set_enable(enable)
    return model.Simulation(drive, system, show_progress=False).simulate(t_stop=t1)


def recorded() -> SimpleNamespace:
    """The recorded run, with the attributes of its results."""
    found = SimpleNamespace()
    with np.load(RECORDED) as file:
        for path, names in SERIES.items():
            place = found
            for part in path.split("."):
                if not hasattr(place, part):
                    setattr(place, part, SimpleNamespace())
                place = getattr(place, part)
            for name in names:
                setattr(place, name, file[f"{path}.{name}"])
    return found


def main() -> None:
    results = simulate(0.1)
    rows = np.searchsorted(results.mdl.t, results.ctrl.t - 1e-6 * PERIOD)
    columns = {}
    for path, names in SERIES.items():
        place = results
        for part in path.split("."):
            place = getattr(place, part)
        for name in names:
            series = np.asarray(getattr(place, name))
            columns[f"{path}.{name}"] = series[rows] if path[:3] == "mdl" else series
    RECORDED.parent.mkdir(exist_ok=True)
    np.savez_compressed(RECORDED, **columns)


if __name__ == "__main__":
    main()
