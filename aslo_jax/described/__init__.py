"""What is found for a description in TOML: a machine's parameters from a log, the gains of
a study's observers by gradients, and the file with these values.

Above `machines`, `study` and `tune`, which know nothing of each other's files.
"""

from ..machines import machine_of as machine_of
from ._calibrated import (
    calibrate_machine as calibrate_machine,
    calibrated_text as calibrated_text,
    parameters_of as parameters_of,
    values_of as values_of,
)
from ._operated import calibrate_study as calibrate_study, operation_in as operation_in
from ._tuned import (
    Tuned as Tuned,
    by_table as by_table,
    changed as changed,
    compared as compared,
    tune_study as tune_study,
)

__all__ = [
    "Tuned",
    "by_table",
    "calibrate_machine",
    "calibrate_study",
    "calibrated_text",
    "changed",
    "compared",
    "machine_of",
    "operation_in",
    "parameters_of",
    "tune_study",
    "values_of",
]
