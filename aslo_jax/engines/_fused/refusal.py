"""What the fused engine says where it cannot run, and to whom."""

import sys
import warnings
from typing import Any

from ..._frontend.lower import NotFusible

# What may stand between a user's line and the one that warns.
BETWEEN = (
    "aslo_jax",
    "beartype",
    "contextlib",
    "equinox",
    "functools",
    "jax",
    "jaxtyping",
    "optax",
)


def refusal(error: Exception) -> Exception:
    """An error of the engine as users should meet it."""
    if isinstance(error, NotFusible | ImportError):
        return error
    found = NotFusible(
        f"The fused engine failed with {type(error).__name__}: {error}. This is a fault of "
        'its own: please report it, and use engine="scan" meanwhile.'
    )
    found.__cause__ = error
    return found


def notice(message: str) -> None:
    """A warning that names the innermost line that is neither ours nor a library's."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and _module(frame) in BETWEEN:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)


def _module(frame: Any) -> str:
    return frame.f_globals.get("__name__", "").partition(".")[0]
