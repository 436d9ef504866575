"""Claims of the paper's 4.3: friction."""

import jax
import jax.numpy as jnp
import numpy as np

from ..._simulate import Simulation
from .._claims import Above, Below, Claim, Near
from . import loops, settings as s

PLACE = "4.3, Assumption 3"
POINTS = 256  # of a closed path


def circulation(friction: float) -> float:
    """The integral of the right-hand side of Assumption 3 along the wanted motion of the
    leg, over one period of its length: zero if it is the derivative of a function of
    q1."""
    system = s.leg().system

    def right_side(t):
        length = lambda t: s.sway(t)[0]
        q1, rate = jax.jvp(length, (t,), (jnp.ones_like(t),))
        inertia = lambda q1: system.inertia(jnp.stack([q1, 0.0 * q1, 0.0 * q1]))[1, 1]
        m3, slope = jax.value_and_grad(inertia)(q1)
        return (slope * rate + friction) / m3

    # The trapezoidal rule of a periodic function converges faster than any power.
    t = 2 * np.pi * np.arange(POINTS) / POINTS
    return float(2 * np.pi * np.mean(jax.jit(jax.vmap(right_side))(t)))


def claims(constant: Simulation, varying: Simulation) -> list[Claim]:
    """Assumption 3, and what is found with friction and without it."""
    left = loops.error(constant, "left out")
    rms = np.sqrt(np.mean(left[constant.t > 1.0] ** 2, axis=0))
    later, end = constant.t > 0, varying.t >= 5.0 - 1e-9
    theory = 2 * np.pi * s.FRICTION / (s.MASS * (1 - s.SWING**2) ** 1.5)
    works = f"friction {s.FRICTION:g} on each of the leg's coordinates"
    return [
        Claim(
            "Assumption 3 without friction",
            PLACE,
            "There is a function z_j of q1 whose derivative is the right-hand side.",
            "integral of the right-hand side along a closed path of q1, no friction",
            abs(circulation(0.0)),
            "",
            Below(1e-9),
        ),
        Claim(
            "Assumption 3 with friction",
            PLACE,
            "There is a function z_j of q1 whose derivative is the right-hand side.",
            f"integral of the right-hand side along a closed path, friction {s.FRICTION:g}",
            circulation(s.FRICTION),
            "",
            Below(1e-9),
            Near(theory, 1e-9),
            "with friction there is none: R2/m3 adds up along a path that closes",
            "Constant friction integrates instead, with q2 in place of q1.",
        ),
        Claim(
            "constant friction, integrated",
            f"ours, on {PLACE}",
            "m3 q2' + R2 q2 has a measurable derivative, of any constant R2.",
            f"largest error, t >= 1 ms, exact start, {works}",
            float(np.abs(loops.error(constant, "integrated")[later]).max()),
            "m/s, rad/s",
            Below(1e-8),
        ),
        Claim(
            "friction left out",
            "4.3, and Prop. 4",
            "The design follows the construction of Props 4 and 5, without friction.",
            f"rms error of q1', t in [1, {s.SPAN:g}] s, {works}",
            float(rms[0]),
            "m/s",
            Below(1e-6),
            Near(1e-2, 2e-3),
            "friction that is left out leaves an error, about 1e-2 m/s here",
            f"Of q2' and q3': {rms[1]:.2g} and {rms[2]:.2g} rad/s.",
        ),
        Claim(
            "varying friction, bounded form",
            f"ours, on {PLACE}",
            "Friction that varies with q1 makes the momentum state-affine, with a bounded "
            "observer for lambda > R2/m3.",
            "largest error, t in [5, 8] s, friction 0.3 + 0.2 cos q1 and the like",
            float(np.abs(loops.error(varying, "bounded")[end]).max()),
            "m/s, rad/s",
            Below(1e-8),
        ),
        Claim(
            "varying friction left out",
            "ours, on 4.3",
            "This friction matters.",
            "largest error without it, t in [5, 8] s",
            float(np.abs(loops.error(varying, "left out")[end]).max()),
            "m/s, rad/s",
            Above(1e-3),
        ),
    ]
