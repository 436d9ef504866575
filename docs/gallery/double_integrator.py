"""A velocity from a position, in closed form.

The paper's first example, the double integrator. The transient of its observer as
printed is `(lam y(0) - x2(0)) exp(-lam t)`, and that of the Luenberger observer of the
same rate is the same: it has the same transfer function. The exact start has none: what
is left is the accuracy of the solver.
"""

import jax
import jax.numpy as jnp
from matplotlib.figure import Figure

import aslo_jax as aslo

jax.config.update("jax_enable_x64", True)
lam, x0 = 3.0, jnp.array([0.2, 1.0])
plant, F = aslo.plants.IntegratorChain(2), aslo.LowPass(lam)
observers = {
    "ASLO, printed": aslo.AlgebraicObserver(
        plant.relation(), F, aslo.Repeat(), guard=None, start="paper"
    ),
    "Luenberger": aslo.ReducedLuenberger.of_chain(2, lam),
    "ASLO, exact": aslo.AlgebraicObserver(plant.relation(), F, aslo.Repeat(), guard=None),
}
ts = jnp.linspace(0.01, 4.0, 400)
run = aslo.simulate(plant, jnp.sin, observers, t1=4.0, ts=ts, initial=x0)

figure = Figure(figsize=(7.2, 3.2), layout="constrained")
axes = figure.subplots()
for name in observers:
    style = "--" if name == "Luenberger" else "-"
    axes.semilogy(ts, jnp.abs(run.error(name)[:, 0]), style, label=name)
closed_form = jnp.abs(lam * x0[0] - x0[1]) * jnp.exp(-lam * ts)
axes.semilogy(ts, closed_form, "k:", linewidth=1, label="closed form, printed")
axes.set(xlabel="t (s)", ylabel="error of x2", ylim=(1e-16, 10))
axes.legend(ncols=2)
printed = jnp.abs(run.error("ASLO, printed")[:, 0])
headline = "Printed start at 1 s over its closed form", printed[99] / closed_form[99], ""
