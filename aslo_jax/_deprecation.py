"""Names that go: said for as long as CONTRIBUTING.md promises."""

import functools
import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def deprecated(
    *, since: str, removed: str, instead: str
) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A decorator of a function that warns with `DeprecationWarning` at each call.

    - `since`: the version that first warned;
    - `removed`: the version that no longer has it; `python -m release check` fails there;
    - `instead`: what to call, as one would write it.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        message = (
            f"`{function.__qualname__}` is deprecated since aslo_jax {since} and goes with "
            f"{removed}: use `{instead}`."
        )

        @functools.wraps(function)
        def warned(*args: P.args, **kwargs: P.kwargs) -> T:
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            return function(*args, **kwargs)

        return warned

    return decorate
