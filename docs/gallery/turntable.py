"""Two velocities, one after the other.

A carriage slides along a turntable, on a spring. From masses, forces and positions the
observer finds the velocities: the table's first, whose inertia depends on where the
carriage is, then the carriage's, which the turning throws outward. `structure_of` finds
that order.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo
from aslo_jax.plants import MechanicalState, MechanicalSystem

jax.config.update("jax_enable_x64", True)


def spring(q):  # J
    return 10.0 * (q[0] - 0.3) ** 2


def inputs(t):  # N, N m
    return jnp.stack([jnp.sin(3.0 * t), 0.2 * jnp.cos(2.0 * t)])


def table(mass):  # kg, of the carriage
    return MechanicalSystem(
        lambda q: jnp.stack([mass, 0.1 + mass * q[0] ** 2]),  # kg, kg m^2
        spring,
        position=[0.3, 0.0],
        friction=lambda q: jnp.array([0.4, 0.05]),  # N s/m, N m s
        angles=(False, True),
    )


print(aslo.structure_of(table(0.5)))
masses = {"mass as it is": 0.5, "5 % too large": 0.525}
observers = {
    name: aslo.velocity_observer(table(mass), aslo.LowPass(10.0))
    for name, mass in masses.items()
}
moving = MechanicalState(jnp.array([0.25, 0.4]), jnp.array([0.3, -1.5]))
ts = jnp.linspace(0.005, 3.0, 400)
run = aslo.simulate(table(0.5), inputs, observers, t1=3.0, ts=ts, initial=moving)

figure = Figure(figsize=(7.2, 3.4), layout="constrained")
panels = figure.subplots(2, 1, sharex=True)
for axes, j, name in zip(panels, (0, 1), ("carriage (m/s)", "table (rad/s)"), strict=True):
    axes.plot(ts, run.hidden[:, j], color="0.75", linewidth=4, label="true")
    for label, style in zip(masses, ("-", "--"), strict=True):
        axes.plot(ts, run.estimates[label].value[:, j], style, label=label, linewidth=1.2)
    axes.set(ylabel=name)
panels[0].legend(ncols=3)
panels[1].set(xlabel="t (s)")
assert jnp.abs(run.error("mass as it is")).max() < 1e-8
rms = jnp.sqrt(jnp.mean(run.error("5 % too large")[:, 0] ** 2))
headline = "Error of the carriage with a mass 5 % off", 1e3 * rms, "mm/s (rms)"
