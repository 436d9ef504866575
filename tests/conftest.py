"""Every test runs in float64 with warnings as errors (pyproject.toml) and fixed seeds.

`aslo_jax` must not be imported here: the checks of its annotations are installed first.
"""

from collections.abc import Iterator

import hypothesis
import jax
import pytest

jax.config.update("jax_enable_x64", True)

hypothesis.settings.register_profile(
    "fixed", derandomize=True, deadline=None, database=None
)
hypothesis.settings.load_profile("fixed")


@pytest.fixture(autouse=True, scope="module")
def forget_compiled_code() -> Iterator[None]:
    """A worker that keeps the compiled code of every test ends with more than 4 GB."""
    yield
    jax.clear_caches()
