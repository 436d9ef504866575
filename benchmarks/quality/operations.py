"""How many operations a step of an observer takes in the fused engine."""

from typing import Any

from .regimes import CURRENT, INTERVAL, VOLTAGE


def counted(law: Any, advance: Any) -> int:
    """Those of `advance(law, X, sample)` of a law that has begun, once optimised; law and
    sample change from step to step of each lane, so that nothing is computed before."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp

    from aslo_jax.engines._fused.kept import ONE, shape_of
    from aslo_jax.engines._fused.program import Bodies, Program

    u = y = jnp.ones(2)
    arrays, rest = eqx.partition(law, eqx.is_array)
    X = law.start(u, y)
    signals = {"u": u, "y0": y, "y1": y}
    shapes = {
        "shared": jax.tree.map(shape_of, arrays),
        "lane": jax.tree.map(shape_of, X),
        "log": jax.tree.map(shape_of, signals),
    }

    def step(k, X, inputs):
        law = eqx.combine(inputs["shared"], rest)
        now = inputs["log"]
        return advance(law, X, (now["u"], now["y0"], now["y1"])), None

    bodies = Bodies(lambda inputs: (inputs["lane"], None), step, lambda X, inputs: X)
    return Program.of(bodies, shapes, ONE).operations


def counted_observer(observer: Any, u: Any, y: Any) -> int:
    """Those of a step of an observer that has begun, once optimised."""
    import equinox as eqx
    import jax

    from aslo_jax.engines._fused.kept import ONE, shape_of
    from aslo_jax.engines._fused.program import Bodies, Program

    arrays, rest = eqx.partition(observer, eqx.is_array)
    shapes = {
        "shared": jax.tree.map(shape_of, arrays),
        "lane": jax.tree.map(shape_of, observer.init(y, u)),
        "log": jax.tree.map(shape_of, {"u": u, "y": y}),
    }

    def step(k, X, inputs):
        observer, now = eqx.combine(inputs["shared"], rest), inputs["log"]
        coefficients = observer.allocate(now["y"], now["u"]).discretise(1e-3)
        X, estimate = observer.advance(X, now["u"], now["y"], coefficients)
        return X, estimate.value

    bodies = Bodies(lambda inputs: (inputs["lane"], None), step, lambda X, inputs: X)
    return Program.of(bodies, shapes, ONE).operations


def operations() -> dict[str, int]:
    """Of the filters: `Lifted`, and `Adaptive` once one of its bank is left."""
    import jax.numpy as jnp

    import aslo_jax as aslo

    relation = aslo.plants.PMSM.bmp0701f().flux_relation()
    h = jnp.asarray(INTERVAL)

    def settled(law, X, sample):
        u, y0, y1 = sample
        return law._settled(X, (u, y0, y1, None, h))

    def lifted(law, X, sample):
        u, y0, y1 = sample
        return law.advance(X, (u, y0), (u, y1), h)

    each = {
        "Lifted": (aslo.Lifted(relation, CURRENT, VOLTAGE).law, lifted),
        "Adaptive": (aslo.Adaptive(relation, CURRENT, VOLTAGE).law, settled),
    }
    return {name: counted(*parts) for name, parts in each.items()}
