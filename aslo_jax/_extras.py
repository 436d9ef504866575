"""Optional dependencies: a missing one is an ImportError that names the pip command."""

import importlib
from types import ModuleType


def missing(package: str, extra: str) -> ImportError:
    """The error that says which extra of aslo_jax brings `package`."""
    return ImportError(
        f'the package `{package}` is not installed: pip install "aslo_jax[{extra}]"'
    )


def require(module: str, extra: str) -> ModuleType:
    """Import `module`, which the extra `extra` of aslo_jax brings."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise missing(module.partition(".")[0], extra) from error
