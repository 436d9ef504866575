"""motulator: one motor under its own current-vector and speed control with its own flux
observer, sampled at 0.1 ms, the plant by solve_ivp; run by its own environment."""

import importlib
import json
import math
import statistics
import time

model = importlib.import_module("motulator.drive.model")
control = importlib.import_module("motulator.drive.control.sm")
utils = importlib.import_module("motulator.drive.utils")
STEPS, RUNS = 300, 3


def simulation():
    values = utils.SynchronousMachinePars(
        n_p=5, R_s=8.875, L_d=40.03e-3, L_q=40.03e-3, psi_f=0.2086
    )
    drive = model.Drive(
        model.VoltageSourceConverter(u_dc=540.0),
        model.SynchronousMachine(values),
        model.StiffMechanicalSystem(J=60e-6),
    )
    reference = control.CurrentReferenceCfg(values, max_i_s=2.3, nom_w_m=500.0)
    sampled = control.CurrentVectorControl(
        values, reference, T_s=1e-4, J=60e-6, alpha_c=2000.0, sensorless=True
    )
    sampled.ref.w_m = lambda t: 5.0 * (20.0 + 5.0 * math.sin(t))
    return model.Simulation(drive, sampled)


seconds = []
for _ in range(RUNS):
    one = simulation()
    start = time.perf_counter()
    one.simulate(t_stop=1e-4 * STEPS)
    seconds.append(time.perf_counter() - start)
speed = STEPS / statistics.median(seconds) / 1e6
what = "one machine, its own controller and observer, solve_ivp, converter averaged"
print(json.dumps({"speed": speed, "what": what}))
