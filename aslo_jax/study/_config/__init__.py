"""Files of studies: TOML to an experiment, a spread and metrics.

title = "A motor with a warm winding"
interval = 2e-4              # s
horizon = 2.0                # s

[machine]                    # as for `aslo-jax estimate`, with a load
kind = "pmsm"
...

[control]
kind = "field_oriented"
...

[observers.ASLO]
kind = "aslo"
cutoff = 50.0                # rad/s

[[sensor]]
kind = "noise"
deviation = 0.01             # A

[spread.resistance]
where = "plant.resistance"   # the observers keep the nominal one
distribution = "normal"
mean = 1.0
deviation = 0.1
relative = true

[metrics.rms]
kind = "rms"
"""

from ..._studies import NAMES as NAMES
from .file import (
    Configuration as Configuration,
    ConfigurationError as ConfigurationError,
    configure as configure,
    experiment_in as experiment_in,
    read_configuration as read_configuration,
    read_study as read_study,
)

__all__ = [
    "NAMES",
    "Configuration",
    "ConfigurationError",
    "configure",
    "experiment_in",
    "read_configuration",
    "read_study",
]
