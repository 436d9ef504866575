"""A lane on its way from the first instant to the last, from jump to jump."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from .stepper import ENDED, RUNNING, Dense, Field, Lane, Stepper


class Carry(NamedTuple):
    """A lane, and how many jumps are behind it; None where there are none."""

    lane: Lane
    jump: Any


class March(NamedTuple):
    """From t0 to t1 (s) by steps that end at the float before each of the `jumps`,
    ascending, and begin at the one after it: no stage sees both sides."""

    stepper: Stepper
    jumps: np.ndarray
    t0: np.ndarray
    t1: np.ndarray

    @property
    def ends(self) -> np.ndarray:
        """Of the pieces between jumps."""
        jumps = self.jumps.astype(self.t0.dtype)
        return np.append(np.nextafter(jumps, jumps.dtype.type(-np.inf)), self.t1)

    def begin(self, rate: Field, x: Any) -> Carry:
        first = jnp.asarray(self.ends[0])
        lane = self.stepper.begin(rate, jnp.asarray(self.t0), first, x)
        return Carry(lane, jnp.asarray(0) if self.jumps.size else None)

    def step(self, rate: Field, carry: Carry) -> tuple[Carry, Any, Dense]:
        """The carry after an attempted step, whether the lane has ended, and the step."""
        lane, jump = carry
        if jump is None:
            lane, dense = self.stepper.step(rate, lane, jnp.asarray(self.t1))
            return Carry(lane, None), lane.code != RUNNING, dense
        jumps = self.jumps.astype(self.t0.dtype)
        after = np.append(np.nextafter(jumps, jumps.dtype.type(np.inf)), self.t1)
        end = jnp.asarray(self.ends)[jump]
        moved, dense = self.stepper.step(rate.until(end), lane, end)
        there = (lane.code == RUNNING) & (moved.code == ENDED)
        over = there & (jump < self.jumps.size)
        # After a jump a step is as long as the one before it was meant to be.
        lane = moved._replace(
            code=jnp.where(over, RUNNING, moved.code).astype(moved.code.dtype),
            t=jnp.where(over, jnp.asarray(after)[jump], moved.t),
            h=jnp.where(over, jnp.maximum(moved.h, lane.h), moved.h),
        )
        return Carry(lane, jump + over), lane.code != RUNNING, dense
