"""jaxonomy: its PMSM block under a constant voltage, a batch over the resistance; run by
its own environment."""

import importlib
import json
import statistics
import time

import numpy as np

jaxonomy = importlib.import_module("jaxonomy")
library = importlib.import_module("jaxonomy.library")
drives = importlib.import_module("jaxonomy.library.drives")
LANES, STEPS, INTERVAL, RUNS = 256, 1000, 1e-4, 3

builder = jaxonomy.DiagramBuilder()
motor = builder.add(
    drives.PMSM(
        R=8.875, Ld=40.03e-3, Lq=40.03e-3, lambda_m=0.2086, pole_pairs=5.0,
        J=60e-6, B=1e-4, name="motor",
    )
)  # fmt: skip
voltage = builder.add(library.Constant(np.array([0.0, 25.0]), name="voltage"))
builder.connect(voltage.output_ports[0], motor.input_ports[0])
diagram = builder.build()
options = jaxonomy.SimulatorOptions(
    math_backend="jax",
    max_major_steps=2 * STEPS,
    max_minor_step_size=INTERVAL,
    ode_solver_method="rk4",
)
batch = {"motor.R": 8.875 * np.linspace(0.9, 1.1, LANES)}


def run(vectorised):
    found = jaxonomy.simulate_batch(
        diagram,
        (0.0, STEPS * INTERVAL),
        batch,
        options=options,
        recorded_signals={"state": motor.output_ports[0]},
        use_vmap=vectorised,
    )
    return np.asarray(found.outputs["state"])


best = {}
for name, vectorised in {"kernel": False, "vmap": True}.items():
    seconds = []
    for _ in range(1 + RUNS):
        start = time.perf_counter()
        run(vectorised)
        seconds.append(time.perf_counter() - start)
    best[name] = LANES * STEPS / statistics.median(seconds[1:]) / 1e6
path = max(best, key=lambda name: best[name])
what = (
    f"{LANES} machines, RK4 in steps of 0.1 ms, constant voltage, simulate_batch ({path})"
)
print(json.dumps({"speed": best[path], "what": what}))
