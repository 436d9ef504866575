"""Modules as C for the processor of a drive, and as FMUs for simulators."""

from ._export import Chain as Chain, Exported as Exported, export_c as export_c

__all__ = ["Chain", "Exported", "export_c"]
