"""What is found for a description in TOML: a machine's parameters from a log, the gains of
a study's observers by gradients, and the file with these values.

Above `machines`, `study` and `tune`, which know nothing of each other's files.
"""

from .calibrated import (
    calibrate_machine as calibrate_machine,
    calibrated_text as calibrated_text,
    values_of as values_of,
)
from .tuned import (
    Tuned as Tuned,
    calibrate_study as calibrate_study,
    changed as changed,
    machine_of as machine_of,
    tune_study as tune_study,
)
