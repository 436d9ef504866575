"""The rotor flux of an induction machine.

A wound-rotor induction machine, both of whose windings are fed, on a modulated supply.
The paper prints the stator's inductance in both relations. With the rotor's own, three
times as large here, the estimate of the rotor flux is right; with the printed one it is
off by about its own size.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
machine = aslo.plants.WRIM(1.3, 0.7, 0.1, 0.3, 0.15, 2, 0.02, friction=2e-3)


def supply(t):  # V, both windings fed
    level = 20.0 + 6.0 * jnp.sin(3.0 * t)
    stator = level * jnp.stack([jnp.cos(12.0 * t), jnp.sin(12.0 * t)])
    return jnp.concatenate([stator, 0.3 * level * jnp.array([jnp.cos(t), jnp.sin(2 * t)])])


def rotor(inductance):
    relation = aslo.plants.WindingFluxRelation("rotor", 0.7, inductance, 0.15)
    return aslo.AlgebraicObserver(relation, aslo.LowPass(5.0), guard=aslo.Guard(1e-6))


observers = {"own inductance": rotor(0.3), "as printed": rotor(0.1)}
run = aslo.Experiment(
    machine, aslo.control.OpenLoop(supply), observers, interval=1e-3, plant_steps=4
).run(steps=4_000, every=5)
truth = run.hidden[:, 2:]

figure = Figure(figsize=(7.2, 3.6), layout="constrained")
above, below = figure.subplots(2, 1, sharex=True)
above.plot(run.t, truth[:, 0], color="0.75", linewidth=4, label="true")
size = jnp.linalg.norm(truth, axis=1).mean()
late, errors = run.t > 1.0, {}
for name, found in run.estimates.items():
    error = jnp.linalg.norm(found.value - truth, axis=1) / size
    errors[name] = jnp.sqrt(jnp.mean(error[late] ** 2))
    above.plot(run.t, found.value[:, 0], label=name, linewidth=1)
    below.semilogy(run.t[1:], error[1:])
above.set(ylabel="rotor flux (Wb)")
above.legend(ncols=3)
below.set(xlabel="t (s)", ylabel="relative error", ylim=(1e-7, 10))
print({name: float(x) for name, x in errors.items()})
headline = "Error with the printed inductance", 100 * errors["as printed"], "% (rms)"
