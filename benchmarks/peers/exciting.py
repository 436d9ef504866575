"""exciting-environments: its batched PMSM, the two currents by Tsit5 of diffrax at given
speed; run by its own environment."""

import importlib
import json
import statistics
import time

import diffrax
import jax
import jax.numpy as jnp

jax.config.update("jax_enable_x64", True)
PMSM = importlib.import_module("exciting_environments.pmsm").PMSM
LANES, STEPS, RUNS = 1024, 1000, 5

environment = PMSM(
    batch_size=LANES,
    solver=diffrax.Tsit5(),
    tau=1e-4,
    static_params={
        "p": 5,
        "r_s": 8.875,
        "l_d": 40.03e-3,
        "l_q": 40.03e-3,
        "psi_p": 0.2086,
        "u_dc": 400.0,
        "deadtime": 1,
    },
)
_, state = environment.vmap_reset()
action = jnp.full((LANES, 2), 0.1)


@jax.jit
def run(state):
    def step(state, _):
        return environment.vmap_step(state, action)[1], None

    return jax.lax.scan(step, state, None, length=STEPS)[0]


seconds = []
for _ in range(1 + RUNS):
    start = time.perf_counter()
    jax.block_until_ready(run(state))
    seconds.append(time.perf_counter() - start)
speed = LANES * STEPS / statistics.median(seconds[1:]) / 1e6
what = f"{LANES} machines, currents only, Tsit5 in steps of 0.1 ms, under lax.scan"
print(json.dumps({"speed": speed, "what": what}))
